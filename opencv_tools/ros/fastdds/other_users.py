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

"""Nodes of other users on this machine, with which Fast DDS does not share memory."""

from __future__ import annotations

from contextlib import suppress
import fcntl
import os
from pathlib import Path
import pwd
import re
import stat

from opencv_tools.ros.fastdds import shared_memory

# Each participant of Fast DDS has a port, and a lock file that it holds while it runs.
_LOCK = re.compile(r'fastrtps_port([0-9]{1,5})_el')
_FIRST_PORT = 7400
_PORTS_OF_A_DOMAIN = 250


def find_other_user() -> str:
    """Return the name of another user who runs a node in this ROS domain; '' if there is none."""
    for path in sorted(shared_memory.SHARED_MEMORY.glob('fastrtps_port*_el')):
        match = _LOCK.fullmatch(path.name)
        if match and _is_of_domain(int(match[1])):
            with suppress(OSError):
                owner = _find_owner(path)
                if owner not in (None, os.geteuid()):
                    return _user_name(owner)
    return ''


def _is_of_domain(port: int) -> bool:
    domain = os.environ.get('ROS_DOMAIN_ID') or '0'
    return domain.isdecimal() and (
        (port - _FIRST_PORT) // _PORTS_OF_A_DOMAIN == int(domain))


def _find_owner(path: Path) -> int | None:
    """
    Return the owner of a lock file, None if no process holds the lock.

    :raises OSError: the file was removed, or is not a regular file.
    """
    file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        status = os.fstat(file)
        if stat.S_ISREG(status.st_mode):
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return status.st_uid
    finally:
        os.close(file)
    return None


def _user_name(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:  # the user of a container or of another machine
        return str(number)
