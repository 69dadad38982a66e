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

"""
Run a command in mount, network and IPC namespaces of its own: own_namespaces.py COMMAND...

Its /dev/shm is empty, and its only network is a loopback of its own, so it meets no node of other
users, workers or runs. An ordinary user needs a kernel that permits user namespaces; the command
keeps the user's number. Where the kernel refuses, the command runs without namespaces.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
from pathlib import Path
import socket
import struct
import subprocess
import sys

#: What stands before a command that runs in namespaces of its own.
PREFIX = (sys.executable, '-S', __file__)
_NEW_MOUNTS, _NEW_IPC, _NEW_USER, _NEW_NETWORK = 0x20000, 0x8000000, 0x10000000, 0x40000000
_RECURSIVE_PRIVATE = 0x4000 | 0x40000
_READ_FLAGS, _WRITE_FLAGS, _IS_UP = 0x8913, 0x8914, 1


def _call(name: str, *arguments: object) -> None:
    """Call a function of the C library; raise OSError with its reason."""
    library = ctypes.CDLL(None, use_errno=True)
    if getattr(library, name)(*arguments):
        raise OSError(ctypes.get_errno(), f'{name}: {os.strerror(ctypes.get_errno())}')


def enter() -> None:
    """
    Move this process, which has one thread, into new namespaces.

    :raises OSError: the kernel refuses.
    """
    user, group = os.geteuid(), os.getegid()
    _call('unshare', _NEW_MOUNTS | _NEW_IPC | _NEW_NETWORK | (_NEW_USER if user else 0))
    if user:
        Path('/proc/self/setgroups').write_text('deny')
        Path('/proc/self/uid_map').write_text(f'{user} {user} 1')
        Path('/proc/self/gid_map').write_text(f'{group} {group} 1')
    _call('mount', b'none', b'/', None, ctypes.c_ulong(_RECURSIVE_PRIVATE), None)
    _call('mount', b'tmpfs', b'/dev/shm', b'tmpfs', ctypes.c_ulong(0), None)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = bytearray(struct.pack('16sh22x', b'lo', 0))
        fcntl.ioctl(any_socket, _READ_FLAGS, request)
        flags, = struct.unpack_from('h', request, 16)
        struct.pack_into('h', request, 16, flags | _IS_UP)
        fcntl.ioctl(any_socket, _WRITE_FLAGS, request)


def reason_against() -> str:
    """Return why the kernel refuses such namespaces; '' if it has them."""
    return subprocess.run([*PREFIX, 'true'], stderr=subprocess.PIPE, text=True,
                          check=False).stderr.strip()


if __name__ == '__main__':
    try:
        enter()
    except OSError as err:
        sys.exit(str(err))
    os.execvp(sys.argv[1], sys.argv[1:])
