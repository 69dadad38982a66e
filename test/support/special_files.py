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

"""Files of each kind that is not a regular file."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import socket


def make_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))


#: Functions that create each kind of file at a path, and the reason in the error.
KINDS: dict[str, tuple[Callable[[Path], object], str]] = {
    'fifo': (os.mkfifo, 'is a named pipe, not a regular file'),
    'socket': (make_socket, 'is a socket, not a regular file'),
    'device': (lambda path: path.symlink_to('/dev/null'), 'is a device, not a regular file'),
    'folder': (Path.mkdir, 'Is a directory')}
