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

from collections.abc import Sequence
import errno
import os
from pathlib import Path
import sys

from opencv_tools.image.text import printable
from opencv_tools.regular_files import write_beside, write_buffer
from opencv_tools.robot.xml.document import DescriptionError

_LONGEST_MESSAGE = 10_000  # characters


class NotWrittenError(DescriptionError):
    """A file, or standard output, that cannot be written."""

    def __init__(self, path: str | None, err: OSError) -> None:
        super().__init__(f'cannot be written: {err.strerror}', source=path or '<stdout>')


def write(path: str | None, data: bytes) -> None:
    """Write a file whole or not at all, or to standard output where there is no path."""
    write_all([(path, data)])


def write_all(files: Sequence[tuple[str | None, bytes]]) -> None:
    """
    Write several files, each as `write` does, or none of them.

    :raises NotWrittenError: one cannot be written.
    """
    ready: list[tuple[str, Path, Path]] = []
    try:
        streams = []
        for path, data in files:
            target = None if path is None or path == '-' else Path(path).resolve()
            if path is None or target is None or _is_stream(target):
                streams.append((path, data, target))
            else:
                ready.append((path, _beside(path, target, data), target))
        # What is written there cannot be taken back, so that all else is ready by then.
        for path, data, target in reversed(streams):
            if target is None:
                print_bytes(data)
            else:
                _write_stream(path, target, data)
        while ready:
            path, temporary, target = ready[0]
            try:
                temporary.replace(target)
            except OSError as err:
                raise NotWrittenError(path, err) from err
            ready.pop(0)
    finally:
        for _, temporary, _ in ready:
            temporary.unlink(missing_ok=True)


def _is_stream(target: Path) -> bool:
    """Return whether something is there that is no file, such as /dev/null or a pipe."""
    try:
        return target.exists() and not target.is_file() and not target.is_dir()
    except OSError:  # writing a file there says why
        return False


def _write_stream(path: str | None, target: Path, data: bytes) -> None:
    try:
        target.write_bytes(data)
    except OSError as err:
        raise NotWrittenError(path, err) from err


def _beside(path: str, target: Path, data: bytes) -> Path:
    """Write a temporary file where it can take the place of another one."""
    try:
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        return write_beside(target, data)
    except OSError as err:
        raise NotWrittenError(path, err) from err


def print_text(text: str) -> None:
    """Write a text to standard output, with control characters in its lines escaped."""
    encoding = sys.stdout.encoding or 'utf-8'
    lines = (printable(line, sys.maxsize) for line in text.rstrip().split('\n'))
    print_bytes('\n'.join((*lines, '')).encode(encoding, 'backslashreplace'))


def print_message(text: str) -> None:
    """Write a message to standard error, with control characters escaped and of bounded length."""
    print(printable(text, _LONGEST_MESSAGE), file=sys.stderr)


def print_bytes(data: bytes) -> None:
    """Write to standard output, all of it or an error."""
    try:
        write_buffer(sys.stdout.buffer, data)
        sys.stdout.buffer.flush()
    except OSError as err:
        # Nothing of it is left to be flushed at the exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(err, BrokenPipeError):
            raise
        raise NotWrittenError(None, err) from err
