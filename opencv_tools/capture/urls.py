# Copyright 2026 opencv_tools maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""URLs of sources: their check, and why one cannot be opened."""

from __future__ import annotations

import re
import socket
from urllib.parse import quote, urlsplit

from opencv_tools.base.text import enumerated, printable, without_password

# URL schemes that FFmpeg opens over TCP, with their default ports.
_PORTS = {'http': 80, 'https': 443, 'rtsp': 554, 'rtsps': 322, 'rtmp': 1935, 'rtmps': 443,
          'ftp': 21, 'tcp': 0}

# Schemes that need a host; udp://@:5000 and srt://:9000 listen.
_WITH_HOST = ('http', 'https', 'rtsp', 'rtsps', 'rtmp', 'rtmps', 'ftp')
# Timeout of the connection to each address of the server.
_ANSWER_SECONDS = 2.0

# Characters that a user name or password may have as they are, and those that are encoded already.
_ALLOWED = "!$&'()*+,;=:@"
_ENCODED = re.compile('%[0-9A-Fa-f]{2}')


def check_url(url: str) -> None:
    """
    Check that the host and the port of a URL can be read.

    :raises ValueError: they cannot. The message has the characters of the user name and password
        to encode, and no other part of the URL, because each may be a part of the password.
    """
    remedy = 'write HOST:PORT or [ADDRESS]:PORT, with a port from 0 to 65535'
    try:
        parts = urlsplit(url)
        _ = parts.port
        host = parts.hostname or ''
        if (host or parts.scheme.lower() not in _WITH_HOST) and ' ' not in host:
            return
    except ValueError:  # it quotes a part of the URL
        pass
    user, at, _ = url.partition('://')[2].rpartition('@')
    odd = sorted(letter for letter in {*_ENCODED.sub('', user)}
                 if quote(letter, _ALLOWED, errors='replace') != letter)
    if at and odd:
        written = [f"'{printable(letter)}' as {quote(letter, '', errors='replace')}"
                   for letter in odd]
        remedy = f'write {enumerated(written)} in the user name and the password'
    raise ValueError(f'the host and the port of this URL cannot be read: {remedy}')


def describe_failure(url: str) -> str:
    """
    Return the reason why a stream could not be opened.

    Connects to the server of the stream once, to find out whether the server is reachable.

    :returns: a sentence with the host, the port and the reason, as far as they are known; without
        the password of the URL.
    """
    shown = without_password(url)
    unknown = f'{shown} cannot be opened as a video: it is unreachable or sends no video'
    try:
        check_url(url)
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port or _PORTS.get(parts.scheme)
        if '@' in parts.path + parts.query + parts.fragment:  # the host may be a part of the user
            return (f'{unknown}; write / ? # of a user name or password as %2F %3F %23')
        if parts.scheme not in _PORTS or not host or not port:
            return unknown
        socket.create_connection((host, port), _ANSWER_SECONDS).close()
    except UnicodeError:  # it quotes the host
        return f'{shown} is not a URL: its host is not a name or an address'
    except ValueError as err:
        return f'{shown} is not a URL: {err}'
    except TimeoutError:
        reason = f'no answer in {_ANSWER_SECONDS:g} s'
    except OSError as err:
        reason = err.strerror or str(err)
    else:
        return (f'{shown} cannot be opened as a video: {printable(host)} port {port} is '
                'reachable, but sends no readable video')
    return f'{shown} is not reachable: {printable(host)} port {port}: {reason}'
