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

"""What goes wrong with a recording, said once each and not for every frame."""

from __future__ import annotations

from threading import Lock
import time
from typing import Protocol

# A hostile publisher can go wrong in ever new ways.
_MAX_REASONS = 20


class Log(Protocol):
    """Where a node says how it goes."""

    def info(self, message: str) -> object:
        """Say what is as it should be."""

    def warning(self, message: str) -> object:
        """Say what may not be wanted."""

    def error(self, message: str) -> object:
        """Say what failed."""


class Troubles:
    """Say what failed when it begins and when it is over; more than one thread may call."""

    def __init__(self, log: Log) -> None:
        """Expect no trouble."""
        self._log = log
        self._lock = Lock()
        self._reasons: set[str] = set()
        self._outage = ''
        self._failed_since = 0

    def failed(self, reason: str) -> None:
        """
        Take note of a frame that nothing can be made of.

        :param reason: why; it is said once, for the next such frame is no better.
        """
        with self._lock:
            if reason in self._reasons or len(self._reasons) >= _MAX_REASONS:
                return
            self._reasons.add(reason)
        self._log.error(reason)

    def outage(self, reason: str) -> None:
        """
        Take note of a frame that could not be written.

        :param reason: why; it is said again when it changes, or when it comes back.
        """
        with self._lock:
            self._failed_since += 1
            is_new = reason != self._outage
            self._outage = reason
        if is_new:
            self._log.error(reason)

    def written(self) -> None:
        """Take note of a frame that was written: what kept others from it is over."""
        if not self._outage:
            return
        with self._lock:
            count, self._failed_since, self._outage = self._failed_since, 0, ''
        self._log.info(f'Writing again; {count} frames were not written')


class Throttle:
    """Let something be said at most once a second."""

    def __init__(self, seconds: float = 1.0) -> None:
        """Let the first pass."""
        self._seconds = seconds
        self._passed_at = float('-inf')

    def passes(self) -> bool:
        """Tell whether it may be said now, and count on it that it is."""
        now = time.monotonic()
        if now - self._passed_at < self._seconds:
            return False
        self._passed_at = now
        return True
