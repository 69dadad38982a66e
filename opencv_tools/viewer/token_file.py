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

"""The file that keeps the token of the viewer."""

from __future__ import annotations

import os
import stat

from opencv_tools.viewer.access import AUTOMATIC, check_token, create_token
from opencv_tools.viewer.errors import ViewerError

_PRIVATE = 0o600
_MAX_BYTES = 1000


def read_token(path: str) -> str:
    """
    Read the token in a file; create a file that is missing, which only its owner can read.

    :param path: file that keeps the token.
    :returns: the token.
    :raises ViewerError: others can read the file, or it cannot be used.
    """
    try:
        return _read(path)
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as err:
        raise _error(path, err) from err
    try:
        return _create(path)
    except (OSError, ValueError) as err:
        raise _error(path, err) from err


def _read(path: str) -> str:
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(descriptor, 'rb') as file:
        state = os.fstat(descriptor)
        if not stat.S_ISREG(state.st_mode):
            raise ValueError('it is not a regular file; give the path of a file')
        if stat.S_IMODE(state.st_mode) & ~_PRIVATE:
            raise ValueError(f'others can read it (mode {stat.S_IMODE(state.st_mode):o}); '
                             'run chmod 600, or remove it for a new token')
        token = file.read(_MAX_BYTES).decode(errors='replace').strip()
    if token in ('', AUTOMATIC):
        raise ValueError('it has no token; remove it for a new one')
    try:
        check_token(token)
    except ValueError as err:
        raise ValueError('it has no token: give one line of 8 to 200 letters, digits or - _ . ~, '
                         'or remove it for a new one') from err
    return token


def _create(path: str) -> str:
    token = create_token()
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, _PRIVATE)
    with os.fdopen(descriptor, 'w') as file:
        file.write(f'{token}\n')
    return token


def _error(path: str, err: OSError | ValueError) -> ViewerError:
    reason = f'{err.strerror}; set token_file to a file that this user can write' if isinstance(
        err, OSError) else err
    return ViewerError(f'token_file {path!r} cannot be used: {reason}')
