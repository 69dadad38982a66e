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

"""Access to the viewer: tokens, hosts and origins."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
import hmac
import ipaddress
import os
import re
import secrets
import socket
import stat
from urllib.parse import urlsplit

from opencv_tools.base.text import printable
from opencv_tools.viewer.certificate import is_address
from opencv_tools.viewer.errors import RequestError, ViewerError, WrongTokenError

#: Value of the parameter ``token`` that creates a token if one is necessary.
AUTOMATIC = 'auto'

_TOKEN = re.compile(r'[A-Za-z0-9_.~-]{8,200}')
_TOKEN_BYTES = 18
_PRIVATE = 0o600
_MAX_TOKEN_FILE = 1000
_ORIGIN = re.compile(r'https?://([A-Za-z0-9._-]{1,253}|\[[0-9A-Fa-f:.]{2,45}\])(:[0-9]{1,5})?')
_HOST = re.compile(r'([A-Za-z0-9._-]{1,253}|\[[0-9A-Fa-f:.]{2,45}\])(?::[0-9]{1,5})?')


def check_token(text: str) -> None:
    """
    Check the parameter ``token``.

    :raises ValueError: the text cannot be a token.
    """
    if text not in ('', AUTOMATIC) and not _TOKEN.fullmatch(text):
        raise ValueError('give 8 to 200 letters, digits or - _ . ~, an empty text or auto')


def check_origins(text: str) -> None:
    """
    Check the parameter ``allowed_origins``.

    :raises ValueError: a name is not an origin.
    """
    for origin in names_of(text):
        if not _ORIGIN.fullmatch(origin):
            raise ValueError(f'{printable(origin)} is not an origin: give the beginning of the '
                             'address of the page, such as http://192.168.1.5:3000')


def names_of(text: str) -> frozenset[str]:
    """Return the names in a parameter, which commas separate, in lower case."""
    return frozenset(name.strip().lower() for name in text.split(',') if name.strip())


def is_loopback(address: str) -> bool:
    """Return whether only programs of this machine can reach an address."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address == 'localhost'


def local_names() -> frozenset[str]:
    """Return the names of this machine."""
    name = socket.gethostname().lower()
    return frozenset({'localhost', name, name.partition('.')[0],
                      f'{name.partition(".")[0]}.local'})


@dataclass(frozen=True)
class Access:
    """
    Rules for requests.

    :param token: secret text that a request must have; '' for none.
    :param hosts: names that the header ``Host`` may have, besides addresses.
    :param origins: origins of other pages that may show pictures.
    :param is_kept: whether the token stays the same after a restart.
    """

    token: str
    hosts: Collection[str]
    origins: Collection[str] = ()
    is_kept: bool = False

    @classmethod
    def create(
        cls, token: str, address: str, control: bool, allowed_hosts: str,
        allowed_origins: str = '', is_kept: bool = False,
    ) -> Access:
        """
        Return the rules for the values of the parameters.

        :param token: parameter ``token``, or the token of the parameter ``token_file``.
        :param address: parameter ``address``.
        :param control: parameter ``control``.
        :param allowed_hosts: parameter ``allowed_hosts``, names separated by commas.
        :param allowed_origins: parameter ``allowed_origins``, origins separated by commas.
        :param is_kept: whether the token stays the same after a restart.
        """
        if token == AUTOMATIC:
            is_needed = control or not is_loopback(address)
            token = create_token() if is_needed else ''
        return cls(token, local_names() | names_of(allowed_hosts), names_of(allowed_origins),
                   is_kept)

    def check_host(self, host: str) -> None:
        """
        Check the header ``Host``, because a foreign name may be made to resolve to this machine.

        A page under such a name has no token, so any name is allowed if there is a token.

        :raises RequestError: the name is not allowed.
        """
        name = _host_name(host)
        if name in self.hosts or is_address(name) or (name and self.token):
            return
        raise RequestError(f'the host {name[:80]!r} is not a name of this machine: use its '
                           'address, or add the name to the parameter allowed_hosts', 403)

    def check_token(self, *given: str | None) -> None:
        """
        Check the token of a request.

        :param given: texts of which one must be the token.
        :raises WrongTokenError: none of them is the token, but there is one.
        :raises RequestError: there is none.
        """
        # Each text is compared, so that the time does not depend on the first one.
        matches = [hmac.compare_digest((text or '').encode(errors='replace'), self.token.encode())
                   for text in given]
        if not self.token or any(matches):
            return
        if any(given):
            raise WrongTokenError(
                'the token is wrong: open the address that the node has printed', 403)
        raise RequestError(
            'a token is needed: open the address that the node has printed', 403)

    def embedding_origin(self, origin: str | None, referer: str | None) -> str:
        """
        Return the allowed origin of the page that shows a picture, '' for all other pages.

        :param origin: header ``Origin``, which the element ``img`` does not send.
        :param referer: header ``Referer``, which begins with the origin of the page.
        """
        given = origin or '/'.join((referer or '').split('/')[:3])
        return given if given.lower() in self.origins else ''


def create_token() -> str:
    """Create a token that cannot be guessed."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def check_origin(origin: str) -> None:
    """
    Check the header ``Origin``, which Tornado splits without a check.

    :raises RequestError: it is no address.
    """
    try:
        urlsplit(origin)
    except ValueError as err:
        raise RequestError(f'the origin {origin[:80]!r} is not an address: {err}', 403) from err


def is_same_origin(origin: str | None, host: str) -> bool:
    """
    Return whether a page of this server opens a WebSocket.

    :param origin: header ``Origin``; None from programs that are not browsers.
    :param host: header ``Host``.
    """
    if origin is None:
        return True
    try:
        return urlsplit(origin).netloc.lower() == host.lower()
    except ValueError:
        return False


def _host_name(host: str) -> str:
    """Return the name or address in a header ``Host``, without its port; '' if it is invalid."""
    parts = _HOST.fullmatch(host)
    return parts[1].strip('[]').rstrip('.').lower() if parts else ''


def read_token(path: str) -> str:
    """
    Read the token in a file; create a file that is missing, which only its owner can read.

    :param path: file that keeps the token.
    :returns: the token.
    :raises ViewerError: others can read the file, or it cannot be used.
    """
    try:
        return _read_token(path)
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as err:
        raise _token_error(path, err) from err
    try:
        return _create_token_file(path)
    except (OSError, ValueError) as err:
        raise _token_error(path, err) from err


def _read_token(path: str) -> str:
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(descriptor, 'rb') as file:
        state = os.fstat(descriptor)
        if not stat.S_ISREG(state.st_mode):
            raise ValueError('it is not a regular file; give the path of a file')
        if stat.S_IMODE(state.st_mode) & ~_PRIVATE:
            raise ValueError(f'others can read it (mode {stat.S_IMODE(state.st_mode):o}); '
                             'run chmod 600, or remove it for a new token')
        token = file.read(_MAX_TOKEN_FILE).decode(errors='replace').strip()
    if token in ('', AUTOMATIC):
        raise ValueError('it has no token; remove it for a new one')
    try:
        check_token(token)
    except ValueError as err:
        raise ValueError('it has no token: give one line of 8 to 200 letters, digits or - _ . ~, '
                         'or remove it for a new one') from err
    return token


def _create_token_file(path: str) -> str:
    token = create_token()
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, _PRIVATE)
    with os.fdopen(descriptor, 'w') as file:
        file.write(f'{token}\n')
    return token


def _token_error(path: str, err: OSError | ValueError) -> ViewerError:
    reason = f'{err.strerror}; set token_file to a file that this user can write' if isinstance(
        err, OSError) else err
    return ViewerError(f'token_file {path!r} cannot be used: {reason}')
