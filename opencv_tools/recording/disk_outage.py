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

"""Time in which the disk takes no new file."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path

from opencv_tools.recording.errors import error_text

# Delay after an error of the disk before a new file begins.
_RETRY_SECONDS = 2.0
# A new file begins when the disk has room for this multiple of the data that did not fit.
_ROOM = 2


class DiskOutage:
    """Decide when a new file begins after an error of the disk."""

    def __init__(self, monotonic: Callable[[], float]) -> None:
        self._monotonic = monotonic
        self._error: tuple[int, str] | None = None
        self._retry_at = 0.0
        self._needed = 0  # bytes of free space

    def begin(self, err: OSError, bytes_waiting: int) -> None:
        """Delay the next file, because data that wait in memory could not be written."""
        self._error = err.errno or 0, error_text(err)
        self._retry_at = self._monotonic() + _RETRY_SECONDS
        self._needed = max(self._needed, _ROOM * bytes_waiting)

    def attempt(self) -> None:
        """Delay the file after the one that begins now. A frame that is left out begins none."""
        self._retry_at = self._monotonic() + _RETRY_SECONDS

    def end(self) -> None:
        """Note that data were written."""
        self._error, self._needed = None, 0

    def check(self, folder: Path) -> None:
        """
        Check that a new file may begin: it is time, and the disk has room.

        :raises OSError: it may not; the error is that of the disk.
        """
        if self._error and not self._may_retry(folder):
            raise OSError(*self._error)

    def _may_retry(self, folder: Path) -> bool:
        now = self._monotonic()
        if now < self._retry_at:
            return False
        try:
            disk = os.statvfs(folder)
        except OSError:  # the folder was removed, and is created again
            return True
        if disk.f_bavail * disk.f_frsize >= self._needed:
            return True
        self._retry_at = now + _RETRY_SECONDS
        return False
