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

"""Shared memory of this machine: free space, segments of killed processes, other users."""

from __future__ import annotations

from contextlib import suppress
import fcntl
import os
from pathlib import Path
import pwd
import re

from opencv_tools.base.regular_files import open_regular, try_lock

SHARED_MEMORY = Path('/dev/shm')

# Each participant of Fast DDS has a segment and a port. It holds their lock files while it runs.
# Their names begin with fastrtps in Fast DDS 2, and with fastdds in Fast DDS 3.
_LOCK = re.compile(r'fast(?:rtps|dds)_[0-9a-f]{16}_el')
_PORT_LOCK = re.compile(r'fast(?:rtps|dds)_port([0-9]{1,5})_el')
_FIRST_PORT = 7400
_PORTS_OF_A_DOMAIN = 250
# Each process holds the lock of its profile until Fast DDS has read it.
_PROFILE = re.compile(r'opencv_tools_[0-9a-z_]{8}\.xml')


def is_writable() -> bool:
    """Return whether files can be created in the shared memory."""
    return os.access(SHARED_MEMORY, os.W_OK | os.X_OK)


def free_bytes() -> int:
    """Return the free bytes of the shared memory, 0 if it is not writable."""
    if not is_writable():
        return 0
    status = os.statvfs(SHARED_MEMORY)
    return status.f_bavail * status.f_frsize


def remove_dead_segments() -> int:
    """
    Remove segments that killed Fast DDS processes have left behind.

    ``fastdds shm clean`` does the same, and also removes ports. Ports stay here, because the next
    process reuses them.

    :returns: number of removed segments.
    """
    removed = 0
    for lock in SHARED_MEMORY.glob('fast*_el'):
        if _LOCK.fullmatch(lock.name):
            with suppress(OSError):  # it belongs to another user, or was just removed
                removed += _remove_if_dead(lock)
    return removed


def _remove_if_dead(lock: Path) -> bool:
    """
    Remove a segment and its lock file, unless a process holds the lock.

    A process that is about to take the lock chooses another name instead.
    """
    with os.fdopen(open_regular(lock, follow=False), 'rb') as file:
        if not try_lock(file.fileno()):
            return False
        lock.with_name(lock.name.removesuffix('_el')).unlink(missing_ok=True)
        lock.unlink()
        return True


def remove_dead_profiles() -> None:
    """Remove profiles that killed processes have left behind. An empty one is not locked yet."""
    for path in SHARED_MEMORY.glob('opencv_tools_*.xml'):
        if _PROFILE.fullmatch(path.name):
            with suppress(OSError), os.fdopen(open_regular(path, follow=False), 'rb') as file:
                if try_lock(file.fileno()) and os.fstat(file.fileno()).st_size:
                    path.unlink()


def find_other_user() -> str:
    """Return the name of another user who runs a node in this ROS domain; '' if there is none."""
    domain = os.environ.get('ROS_DOMAIN_ID') or '0'
    for path in sorted(SHARED_MEMORY.glob('fast*_port*_el') if domain.isdecimal() else ()):
        match = _PORT_LOCK.fullmatch(path.name)
        if match and (int(match[1]) - _FIRST_PORT) // _PORTS_OF_A_DOMAIN == int(domain):
            with suppress(OSError):
                owner = _find_owner(path)
                if owner not in (None, os.geteuid()):
                    return _user_name(owner)
    return ''


def _find_owner(path: Path) -> int | None:
    """Return the owner of a lock file, None if no process holds the lock."""
    with os.fdopen(open_regular(path, follow=False), 'rb') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return os.fstat(file.fileno()).st_uid
    return None


def _user_name(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:  # the user of a container or of another machine
        return str(number)
