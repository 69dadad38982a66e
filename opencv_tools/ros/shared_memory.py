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

"""The shared memory of this machine: how much is free, and what killed processes left in it."""

from __future__ import annotations

from contextlib import suppress
import fcntl
import os
from pathlib import Path
import re

from opencv_tools.regular_files import open_regular

SHARED_MEMORY = Path('/dev/shm')

# Of each participant Fast DDS keeps a segment, and beside it a file that is locked while it lives.
_LOCK = re.compile(r'fastrtps_[0-9a-f]{16}_el')


def is_writable() -> bool:
    """Return whether files can be made in the shared memory."""
    return os.access(SHARED_MEMORY, os.W_OK | os.X_OK)


def free_bytes() -> int:
    """Return how many more bytes fit into the shared memory, 0 where it cannot be written to."""
    if not is_writable():
        return 0
    status = os.statvfs(SHARED_MEMORY)
    return status.f_bavail * status.f_frsize


def remove_dead_segments() -> int:
    """
    Remove what Fast DDS processes that were killed have left behind.

    As ``fastdds shm clean`` does, but without the ports, which the next process takes over.

    :returns: how many segments were removed.
    """
    removed = 0
    for lock in SHARED_MEMORY.glob('fastrtps_*_el'):
        if _LOCK.fullmatch(lock.name):
            with suppress(OSError):  # of another user, or just removed by another process
                removed += _remove_if_dead(lock)
    return removed


def _remove_if_dead(lock: Path) -> bool:
    """
    Remove a segment and its lock unless somebody holds the lock.

    Should its owner be about to take it, it takes another name instead.
    """
    with os.fdopen(open_regular(lock, follow=False), 'rb') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        lock.with_name(lock.name.removesuffix('_el')).unlink(missing_ok=True)
        lock.unlink()
        return True
