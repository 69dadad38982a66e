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

"""Input from regular files and from standard input."""

from __future__ import annotations

from pathlib import Path
import re
import sys

from opencv_tools.base.regular_files import read_regular
from opencv_tools.robot.xml.document import DescriptionError

MAX_BYTES = 100_000_000
# Files that the shell has opened, for example for <(command).
_OPEN_FILE = re.compile(r'/dev/stdin|/(?:dev|proc/self)/fd/\d+')
_URI = re.compile(r'([A-Za-z][A-Za-z0-9+.-]+):/+(.*)', re.DOTALL)


def read_bytes(path: str) -> bytes:
    """
    Read a regular file, or standard input if the path is ``-``.

    :raises DescriptionError: the file cannot be read, or is larger than ``MAX_BYTES``.
    """
    try:
        if path == '-':
            data = sys.stdin.buffer.read(MAX_BYTES + 1)
        elif _OPEN_FILE.fullmatch(path):
            with Path(path).open('rb') as file:
                data = file.read(MAX_BYTES + 1)
        else:
            data = read_regular(Path(path), MAX_BYTES)
    except OSError as err:
        raise DescriptionError(_reason(path, err), source=display_name(path)) from err
    if len(data) > MAX_BYTES:
        raise DescriptionError(f'cannot be read: it is larger than {MAX_BYTES} bytes',
                               source=display_name(path))
    return data


def _reason(path: str, err: OSError) -> str:
    """Return why a file cannot be read, and what to give instead of a URI."""
    uri = _URI.fullmatch(path)
    if not uri:
        return f'cannot be read: {err.strerror}'
    scheme, rest = uri.groups()
    package, _, inside = rest.partition('/')
    instead = {'file': f'give the path /{rest}',
               'package': f'give the path $(ros2 pkg prefix --share {package})/{inside}',
               'model': 'give the path of the file or of the model folder'}
    return (f'cannot be read: URIs of {scheme}: are not supported; '
            + instead.get(scheme.lower(), 'download the file and give its path'))


def display_name(path: str) -> str:
    """Return the name of a file for messages."""
    return '<stdin>' if path == '-' else path
