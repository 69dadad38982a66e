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

"""Safe reading of regular files that other users can replace, and atomic writing of files."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
import errno
import fcntl
import os
from pathlib import Path
import re
import stat
from typing import Any, BinaryIO

_CHUNK = 1 << 20

# Descriptions of the file types other than a regular file.
_KINDS = {
    stat.S_IFLNK: 'a symbolic link', stat.S_IFIFO: 'a named pipe', stat.S_IFSOCK: 'a socket',
    stat.S_IFCHR: 'a device', stat.S_IFBLK: 'a device', stat.S_IFDIR: 'a folder'}


class RefusedFileError(OSError):
    """A file is not opened or not read. ``strerror`` contains the reason."""

    def __init__(self, path: Path, reason: str, number: int = errno.EINVAL) -> None:
        """
        Create the error in the form of an error of the operating system.

        :param reason: reason as text, for ``strerror``.
        :param number: error number, for ``errno``.
        """
        super().__init__(number, reason, str(path))


def describe_kind(mode: int) -> str:
    """
    Return the type of a file as text.

    :param mode: ``st_mode`` of the file.
    :returns: for example ``a named pipe``; '' for a regular file.
    """
    return '' if stat.S_ISREG(mode) else _KINDS.get(stat.S_IFMT(mode), 'not a file')


def check_kind(path: Path, mode: int) -> None:
    """
    Check that a file is a regular file.

    :param mode: ``st_mode`` of the file.
    :raises RefusedFileError: the file is not a regular file.
    """
    kind = describe_kind(mode)
    if kind == 'a folder':
        raise RefusedFileError(path, os.strerror(errno.EISDIR), errno.EISDIR)
    if kind:
        raise RefusedFileError(path, f'{path.name} is {kind}, not a regular file')


def natural_order(path: Path) -> list[tuple[bool, int, str]]:
    """Return a sort key that orders ``frame2`` before ``frame10``."""
    parts = re.split(r'([0-9]+)', path.name)
    return [(not part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]


def user_path(text: str) -> Path:
    """Return a path with ``~`` replaced; the path of an unknown user stays as it is."""
    try:
        return Path(text).expanduser()
    except RuntimeError:
        return Path(text)


def open_regular(path: Path, flags: int = os.O_RDONLY, follow: bool = True) -> int:
    """
    Open a regular file without blocking. Devices, pipes and sockets are not opened.

    :param flags: flags of ``os.open``; with ``os.O_CREAT`` the file need not exist.
    :param follow: whether to follow a symbolic link in the last part of the path.
    :returns: the descriptor, which the caller must close.
    :raises RefusedFileError: the path is not a regular file.
    :raises OSError: the file cannot be opened.
    """
    # Checked before opening too: opening can end the writer of a pipe, or start a device.
    try:
        check_kind(path, path.stat(follow_symlinks=follow).st_mode)
    except FileNotFoundError:
        if not flags & os.O_CREAT:
            raise
    links = 0 if follow else os.O_NOFOLLOW
    file = os.open(path, flags | links | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC, 0o666)
    try:  # the file may have been replaced since the first check
        check_kind(path, os.fstat(file).st_mode)
    except RefusedFileError:
        os.close(file)
        raise
    return file


def open_resolved(path: Path) -> int:
    """
    Open a regular file, to read it, by the path that `Path.resolve` has returned.

    :returns: the descriptor, which the caller must close.
    :raises RefusedFileError: a part of the path has been replaced by a link since then.
    :raises OSError: the file cannot be opened.
    """
    file = open_regular(path, follow=False)
    if Path(f'/proc/self/fd/{file}').readlink() != path:
        os.close(file)
        raise RefusedFileError(path, f'{path.name} has become a link, or was replaced')
    return file


def read_regular(path: Path, limit: int, follow: bool = True) -> bytes:
    """
    Read a regular file of limited size.

    :param limit: largest allowed size in bytes.
    :param follow: whether to follow a symbolic link in the last part of the path.
    :returns: content of the file.
    :raises RefusedFileError: the path is not a regular file, or the file is larger.
    :raises OSError: the file cannot be read.
    """
    return read_opened(open_regular(path, follow=follow), path, limit)


def read_opened(descriptor: int, path: Path, limit: int) -> bytes:
    """
    Read an open file of limited size, and close it.

    :param path: path of the file, for messages.
    :param limit: largest allowed size in bytes.
    :raises RefusedFileError: the file is larger.
    :raises OSError: the file cannot be read.
    """
    with os.fdopen(descriptor, 'rb', buffering=0) as file:
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
    Write a file atomically.

    :param path: path of the file; an existing regular file is replaced.
    :raises RefusedFileError: the path exists and is not a regular file, for example a link.
    :raises OSError: the file cannot be written.
    """
    with suppress(FileNotFoundError):
        check_kind(path, path.lstat().st_mode)
    temporary = write_beside(path, (content,))
    try:
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def write_beside(path: Path, parts: Iterable[Any], keeps_mode: bool = False) -> Path:
    """
    Write a temporary file that can replace another file of the same folder.

    :param path: path of the other file.
    :param parts: buffers with the content, in order.
    :param keeps_mode: whether the file has the permissions of the other one, if that exists.
    :returns: path of the temporary file.
    :raises OSError: the file cannot be written; it is removed.
    """
    temporary = path.with_name(f'.{os.urandom(8).hex()}.part')
    mode = None
    if keeps_mode:
        with suppress(FileNotFoundError):
            mode = stat.S_IMODE(path.stat().st_mode)
    write_new(temporary, parts, mode=mode)
    return temporary


def write_new(
    path: Path, parts: Iterable[Any], sync: bool = False, mode: int | None = None,
) -> None:
    """
    Write a new file.

    :param parts: buffers with the content, in order.
    :param sync: whether the file is flushed to disk.
    :param mode: permissions of the file; None for those of a new file.
    :raises FileExistsError: the path exists; it is not changed.
    :raises OSError: the file cannot be written; it is removed.
    """
    def opener(name: str, flags: int) -> int:
        return os.open(name, flags, 0o666 if mode is None else mode & 0o600)

    with open(path, 'xb', buffering=0, opener=opener) as file:
        try:
            if mode is not None:
                os.fchmod(file.fileno(), mode)
            for part in parts:
                write_buffer(file, part)
            if sync:
                os.fsync(file.fileno())
        except BaseException:
            path.unlink(missing_ok=True)
            raise


def write_buffer(file: BinaryIO, data: Any) -> None:
    """
    Write a buffer to an unbuffered file, which may accept only a part of it at once.

    :param file: file that is open for writing.
    :raises OSError: not all data can be written.
    """
    rest = memoryview(data).cast('B')
    while rest:
        rest = rest[file.write(rest):]


def is_same_file(file: int, path: Path) -> bool:
    """Return whether an open file is still the file at a path."""
    try:
        return os.path.samestat(os.fstat(file), path.lstat())
    except FileNotFoundError:
        return False


def try_lock(file: int) -> bool:
    """Lock a file exclusively without waiting; return whether it was locked."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False  # locked by another process, or the file system has no locks
    return True
