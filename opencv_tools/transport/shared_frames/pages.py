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

"""Errors, folder and pages of shared memory, checked before iceoryx2 uses them."""

from __future__ import annotations

import os
from pathlib import Path
import stat
from types import TracebackType
from typing import Any, Protocol


class SharedMemoryError(Exception):
    """Frames cannot be shared; the text is the reason."""


class ServiceMemory(Protocol):
    """The shared memory as writers and readers use it, see `FrameMemory`."""

    def check_room(self, size: int) -> None:
        """Check that /dev/shm has room for a number of bytes beside its reserve."""

    def builders(self, service: str) -> tuple[Any, Any]:
        """Return the builders of the frames and of the events of a service."""

    def strategies(self) -> tuple[Any, Any]:
        """Return the strategies that let frames grow, and that never wait for a reader."""

    def duration(self, seconds: float) -> Any:
        """Return a duration of iceoryx2."""


class _SharedMemoryErrors:
    """A class, because a generator takes three times as long, several times a frame."""

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None,
                 _: TracebackType | None) -> None:
        if kind is None or isinstance(err, SharedMemoryError):
            return
        if isinstance(err, Exception):
            raise SharedMemoryError(f'iceoryx2: {kind.__name__}: {err}') from err
        if kind.__name__ == 'PanicException':
            raise SharedMemoryError(f'iceoryx2: {err}') from None


#: Converts each failure of iceoryx2 in a block, a panic too, to a SharedMemoryError.
shared_memory_errors = _SharedMemoryErrors()


def private_folder(path: Path) -> Path:
    """
    Create a folder that only this user can use, or check the existing one.

    :raises SharedMemoryError: another user owns it, others may write to it, or it is no folder.
    """
    try:
        path.mkdir(mode=0o700, exist_ok=True)
        found = path.lstat()
    except OSError as err:
        raise SharedMemoryError(f'{path} cannot be created: {err.strerror}') from err
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise SharedMemoryError(f'{path} is not a folder that only this user can access')
    return path


def allocate_pages(address: int, size: int) -> None:
    """
    Allocate the pages of mapped memory, at most to its end.

    :raises SharedMemoryError: there is no room for them.
    """
    for line in Path('/proc/self/maps').read_text().splitlines():
        first, last = (int(number, 16) for number in line.split(maxsplit=1)[0].split('-'))
        if first <= address < last:
            _, _, offset, _, _, path = line.split(maxsplit=5)
            break
    else:
        raise SharedMemoryError('the memory of a frame is not mapped')
    try:
        file = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            os.posix_fallocate(
                file, int(offset, 16) + address - first, min(size, last - address))
        finally:
            os.close(file)
    except OSError as err:
        raise SharedMemoryError(f'{size} bytes of {path} cannot be allocated: {err.strerror}') \
            from err
