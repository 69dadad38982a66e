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

"""Diagnosis of a stream that cannot be opened: server unreachable, or no video."""

from __future__ import annotations

import socket
from urllib.parse import urlsplit

from opencv_tools.image.text import printable, without_password

# URL schemes that FFmpeg opens over TCP, with their default ports.
_PORTS = {'http': 80, 'https': 443, 'rtsp': 554, 'rtsps': 322, 'rtmp': 1935, 'rtmps': 443,
          'ftp': 21, 'tcp': 0}

# Timeout of the connection to each address of the server.
_ANSWER_SECONDS = 2.0


def describe_failure(url: str) -> str:
    """
    Return the reason why a stream could not be opened.

    Connects to the server of the stream once, to find out whether the server is reachable.

    :param url: URL of the stream.
    :returns: a sentence with the host, the port and the reason, as far as they are known; without
        the password of the URL.
    """
    shown = without_password(url)
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port or _PORTS.get(parts.scheme)
        if parts.scheme not in _PORTS or not host or not port:
            return f'{shown} cannot be opened as a video: it is unreachable or sends no video'
        socket.create_connection((host, port), _ANSWER_SECONDS).close()
    except ValueError as err:
        return f'{shown} is not a URL: {printable(err)}'
    except TimeoutError:
        reason = f'no answer in {_ANSWER_SECONDS:g} s'
    except OSError as err:
        reason = err.strerror or str(err)
    else:
        return (f'{shown} cannot be opened as a video: {printable(host)} port {port} is '
                'reachable, but sends no readable video')
    return f'{shown} is not reachable: {printable(host)} port {port}: {reason}'
