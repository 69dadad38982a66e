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

"""Limit of the rate of pictures, without frames that grow old while they wait."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

# Part of the period by which a frame may come early, or late without a change of the next one.
_JITTER = 0.5


class EvenRate:
    """
    Tell whether a frame may be shown now.

    A frame that comes too early is left out if a newer one is expected when it is due. Else it
    waits.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, wake: Callable[[], object]) -> None:
        """
        Create a limit that allows the first frame at once.

        :param wake: called when a frame that had to wait is due, unless another was shown first.
        """
        self._loop = loop
        self._wake = wake
        self._due = 0.0
        self._timer: asyncio.TimerHandle | None = None

    def allows(self, rate: float, source_rate: float = 0.0) -> bool:
        """
        Return whether the newest frame may be shown; it counts as shown then.

        :param rate: highest rate in Hz.
        :param source_rate: rate of new frames in Hz; 0 if no newer one is expected.
        """
        now, jitter = self._loop.time(), _JITTER / rate
        wait = self._due - jitter - now
        if wait > 0:
            if self._timer is None:
                newer = 1 / source_rate if source_rate > rate else 0.0
                self._timer = self._loop.call_later(wait + newer, self._end_wait)
            return False
        self.close()
        self._due = (self._due if now <= self._due + jitter else now) + 1 / rate
        return True

    def close(self) -> None:
        """Wake nobody."""
        if self._timer:
            self._timer.cancel()
            self._timer = None

    def _end_wait(self) -> None:
        self._timer = None
        self._wake()
