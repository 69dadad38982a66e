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

"""Atomic output to files and to standard output."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
import errno
import os
from pathlib import Path
import sys

from opencv_tools.base.regular_files import write_beside, write_buffer
from opencv_tools.base.text import printable
from opencv_tools.robot.xml.document import DescriptionError

_LONGEST_MESSAGE = 10_000  # characters


class NotWrittenError(DescriptionError):
    """A file, or standard output, cannot be written."""

    def __init__(self, path: str | None, err: OSError) -> None:
        super().__init__(f'cannot be written: {err.strerror}', source=path or '<stdout>')


@contextmanager
def _not_written(path: str) -> Iterator[None]:
    try:
        yield
    except OSError as err:
        raise NotWrittenError(path, err) from err


def check_different(outputs: Mapping[str, str | None]) -> None:
    """
    Check that the outputs of a command are different files, because one would replace the other.

    :param outputs: options and their paths. The path None or ``-`` is standard output.
    :raises DescriptionError: two options name the same file.
    """
    options: dict[Path, str] = {}
    for option, path in outputs.items():
        target = _target(path)
        if path is None or target is None or _is_stream(target):
            continue
        other = options.setdefault(target, option)
        if other != option:
            raise DescriptionError(f'is the file of {other} and of {option}: '
                                   'give each a file of its own', source=path)


def check_not_inputs(outputs: Mapping[str, str | None], inputs: Iterable[str]) -> None:
    """
    Check that no output of a command is one of its inputs, because it would be replaced.

    :param outputs: see `check_different`.
    :param inputs: files that the command reads. The path ``-`` is standard input.
    :raises DescriptionError: an option names a file that the command reads, also by a link.
    """
    for path in inputs:
        for option, output in outputs.items():
            target = _target(output)
            if output and target and _is_same(target, '/dev/stdin' if path == '-' else path):
                raise DescriptionError(f'is read by the command, but {option} would replace it: '
                                       'give another file', source=output)


def _is_same(target: Path, path: str) -> bool:
    try:
        return target.is_file() and target.samefile(path)
    except OSError:  # the error is reported when the file is read or written
        return False


def write_all(files: Sequence[tuple[str | None, bytes]]) -> None:
    """
    Write several files atomically, or none of them.

    :param files: paths and contents. The path None or ``-`` is standard output.
    :raises NotWrittenError: a file cannot be written.
    """
    write_parts([(path, (data,)) for path, data in files])


def write_parts(files: Sequence[tuple[str | None, Iterable[bytes]]]) -> None:
    """
    Write several files atomically, or none of them. A file that is replaced keeps its permissions.

    :param files: paths, and contents in parts. The path None or ``-`` is standard output.
    :raises NotWrittenError: a file cannot be written.
    """
    streams: list[tuple[str, Path | None, Iterable[bytes]]] = []
    ready: list[tuple[str, Path, Path]] = []  # path, temporary file, target
    try:
        for path, parts in files:
            target = _target(path)
            if path is None or target is None or _is_stream(target):
                streams.append((path or '-', target, parts))
                continue
            with _not_written(path):
                if target.is_symlink():
                    raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
                if target.is_dir():
                    raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
                ready.append((path, write_beside(target, parts, keeps_mode=True), target))
        # Output to a stream cannot be undone, so all files are ready before it.
        for path, target, parts in reversed(streams):
            if target is None:
                for part in parts:
                    print_bytes(part)
            else:
                with _not_written(path), target.open('wb') as file:
                    file.writelines(parts)
        while ready:
            path, temporary, target = ready[0]
            with _not_written(path):
                temporary.replace(target)
            ready.pop(0)
    finally:
        for _, temporary, _ in ready:
            temporary.unlink(missing_ok=True)


def _target(path: str | None) -> Path | None:
    """Return the file that a path names after its links, None for standard output."""
    # Path.resolve raises RuntimeError for a loop of links before Python 3.13.
    return None if path is None or path == '-' else Path(os.path.realpath(path))


def _is_stream(target: Path) -> bool:
    """Return whether a path exists and is neither a file nor a folder, such as a pipe."""
    try:
        return target.exists() and not target.is_file() and not target.is_dir()
    except OSError:  # write_beside reports the error
        return False


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of texts as lines with columns, with control characters escaped."""
    cells = [[printable(cell, sys.maxsize) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells)]
    return '\n'.join('  '.join(map(str.ljust, row, widths)).rstrip() for row in cells)


def print_text(text: str) -> None:
    """Write a text to standard output, with control characters in its lines escaped."""
    encoding = sys.stdout.encoding or 'utf-8'
    lines = (printable(line, sys.maxsize) for line in text.rstrip().split('\n'))
    print_bytes('\n'.join((*lines, '')).encode(encoding, 'backslashreplace'))


def print_message(text: str) -> None:
    """Write a message to standard error, with control characters escaped and of bounded length."""
    print(printable(text, _LONGEST_MESSAGE), file=sys.stderr)


def print_bytes(data: bytes) -> None:
    """Write data to standard output, completely or with an error."""
    try:
        write_buffer(sys.stdout.buffer, data)  # with PYTHONUNBUFFERED, write() may write a part
        sys.stdout.buffer.flush()
    except OSError as err:
        # Otherwise Python would write the buffer again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(err, BrokenPipeError):
            raise
        raise NotWrittenError(None, err) from err
