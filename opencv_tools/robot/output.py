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

"""Files and standard output, written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path
import sys
import tempfile

from opencv_tools.robot.xml import DescriptionError


def write(path: str | None, data: bytes) -> None:
    """Write a file whole or not at all, or to standard output where there is no path."""
    if path is None or path == '-':
        print_bytes(data)
        return
    target = Path(path).resolve()
    if target.exists() and not target.is_file():  # a device, such as /dev/null
        try:
            target.write_bytes(data)
        except OSError as err:
            raise DescriptionError(f'cannot be written: {err.strerror}', source=path) from err
        return
    temporary = ''
    try:
        descriptor, temporary = tempfile.mkstemp(dir=target.parent, prefix=f'.{target.name}.')
        with open(descriptor, 'wb') as file:  # noqa: PTH123
            file.write(data)
        mask = os.umask(0)
        os.umask(mask)
        Path(temporary).chmod(0o666 & ~mask)
        Path(temporary).replace(target)
    except OSError as err:
        if temporary:
            Path(temporary).unlink(missing_ok=True)
        raise DescriptionError(f'cannot be written: {err.strerror}', source=path) from err


def print_text(text: str) -> None:
    """Write a text and the end of its last line to standard output."""
    encoding = sys.stdout.encoding or 'utf-8'
    print_bytes(f'{text.rstrip()}\n'.encode(encoding, 'backslashreplace'))


def print_bytes(data: bytes) -> None:
    """Write to standard output, all of it or an error."""
    rest = memoryview(data)
    try:
        while rest:  # with PYTHONUNBUFFERED a part may be written and no error raised
            rest = rest[sys.stdout.buffer.write(rest):]
        sys.stdout.buffer.flush()
    except OSError as err:
        # Nothing of it is left to be flushed at the exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(err, BrokenPipeError):
            raise
        raise DescriptionError(f'cannot be written: {err.strerror}', source='<stdout>') from err
