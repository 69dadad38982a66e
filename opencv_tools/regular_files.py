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

"""Files that others may have put there: only regular ones are opened, and no more is read."""

from __future__ import annotations

from contextlib import suppress
import errno
import os
from pathlib import Path
import stat

_CHUNK = 1 << 20

# What stands at a path in place of a regular file, by the type in its mode.
_KINDS = {
    stat.S_IFLNK: 'a symbolic link', stat.S_IFIFO: 'a named pipe', stat.S_IFSOCK: 'a socket',
    stat.S_IFCHR: 'a device', stat.S_IFBLK: 'a device', stat.S_IFDIR: 'a folder'}


class RefusedFileError(OSError):
    """A file that is not opened or not read; ``strerror`` has the reason."""

    def __init__(self, path: Path, reason: str, number: int = errno.EINVAL) -> None:
        """Keep the reason as an operating system's error does."""
        super().__init__(number, reason, str(path))


def describe_kind(mode: int) -> str:
    """
    Return what a file is, unless it is a regular one.

    :param mode: ``st_mode`` of it.
    :returns: for example ``a named pipe``; '' for a regular file.
    """
    return '' if stat.S_ISREG(mode) else _KINDS.get(stat.S_IFMT(mode), 'no file')


def open_regular(path: Path, flags: int = os.O_RDONLY, follow: bool = True) -> int:
    """
    Open a regular file, which neither waits nor reaches a device, a pipe or a socket.

    :param path: the file.
    :param flags: of ``os.open``, which are added to those that never block; with ``os.O_CREAT``
        the file need not exist.
    :param follow: whether a symbolic link at the path itself is followed.
    :returns: the descriptor, which the caller closes.
    :raises RefusedFileError: there is no regular file at the path.
    :raises OSError: the file cannot be opened.
    """
    try:  # whoever opens a pipe may end its writer, and some devices do something when opened
        _check_kind(path, path.stat(follow_symlinks=follow).st_mode)
    except FileNotFoundError:
        if not flags & os.O_CREAT:
            raise
    links = 0 if follow else os.O_NOFOLLOW
    file = os.open(path, flags | links | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC, 0o666)
    try:  # another one may stand there by now
        _check_kind(path, os.fstat(file).st_mode)
    except RefusedFileError:
        os.close(file)
        raise
    return file


def read_regular(path: Path, limit: int, follow: bool = True) -> bytes:
    """
    Read a regular file that is not too large.

    :param path: the file.
    :param limit: the most bytes that it may have.
    :param follow: whether a symbolic link at the path itself is followed.
    :returns: its content.
    :raises RefusedFileError: there is no regular file at the path, or it is larger.
    :raises OSError: it cannot be read.
    """
    with os.fdopen(open_regular(path, follow=follow), 'rb', buffering=0) as file:
        size = os.fstat(file.fileno()).st_size
        chunks: list[bytes] = []
        total = 0
        while total <= limit and size <= limit:
            chunk = file.read(size + 1 if not chunks else _CHUNK)
            if not chunk:
                return b''.join(chunks)
            chunks.append(chunk)
            total += len(chunk)
    raise RefusedFileError(path, f'{path.name} is larger than {limit} bytes', errno.EFBIG)


def replace_file(path: Path, content: bytes) -> None:
    """
    Write a file, which appears whole or not at all.

    :param path: the file; one that is there is replaced.
    :param content: of the file.
    :raises RefusedFileError: something else than a regular file is there, such as a link.
    :raises OSError: it cannot be written.
    """
    with suppress(FileNotFoundError):
        _check_kind(path, path.lstat().st_mode)
    temporary = path.with_name(f'.{os.urandom(8).hex()}.part')
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    file = os.open(temporary, flags, 0o666)
    try:
        with os.fdopen(file, 'wb') as writing:
            writing.write(content)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def _check_kind(path: Path, mode: int) -> None:
    kind = describe_kind(mode)
    if kind == 'a folder':
        raise RefusedFileError(path, os.strerror(errno.EISDIR), errno.EISDIR)
    if kind:
        raise RefusedFileError(path, f'{path.name} is {kind}, not a regular file')
