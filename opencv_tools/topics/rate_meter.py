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

"""Rate of the last frames of a stream."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import time

_FRAMES = 32
_SECONDS = 5.0


class RateMeter:
    """Measure the mean period and rate of the last 32 frames; may be read on any thread."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """
        Start without a frame.

        :param clock: monotonic clock in seconds.
        """
        self._clock = clock
        self._count = 0
        self._arrivals: deque[tuple[float, int]] = deque(maxlen=_FRAMES)

    def add(self, frames: int = 1) -> None:
        """Record that frames have arrived now."""
        self._count += frames
        self._arrivals.append((self._clock(), self._count))

    @property
    def period(self) -> float:
        """Return the mean time between two frames in seconds, 0.0 before the second one."""
        return _period(tuple(self._arrivals))

    @property
    def rate(self) -> float:
        """Return the rate of the frames of the last 5 s in Hz, 0.0 for fewer than two."""
        since = self._clock() - _SECONDS
        period = _period(tuple(
            arrival for arrival in tuple(self._arrivals) if arrival[0] > since))
        return 1 / period if period else 0.0

    @property
    def silent_seconds(self) -> float | None:
        """Return the time since the last frame in seconds, None before the first one."""
        last = tuple(self._arrivals)[-1:]
        return self._clock() - last[0][0] if last else None


def _period(arrivals: tuple[tuple[float, int], ...]) -> float:
    if len(arrivals) < 2:
        return 0.0
    (first_at, first), (last_at, last) = arrivals[0], arrivals[-1]
    return (last_at - first_at) / (last - first)
