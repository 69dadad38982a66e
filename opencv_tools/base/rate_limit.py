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

"""Limit of the rate of frames."""

from __future__ import annotations

from opencv_tools.base.units import NANO, STANDING

#: Highest maximum rate in Hz.
MAX_RATE = 1e6

_LONGEST_NS = 1 << 62
# Jitter tolerance: a frame this fraction of a period early still counts as on time.
_JITTER_TOLERANCE = 0.25


class RateLimit:
    """Select frames at a maximum rate, by their times."""

    def __init__(self, max_rate: float) -> None:
        """
        Create a limit; the first frame is always selected.

        :param max_rate: maximum rate of the selected frames in Hz; 0 for all frames.
        """
        self._period_ns = int(min(NANO / max_rate, _LONGEST_NS)) if max_rate else 0
        self._due_ns = 0
        self._last: tuple[int, int] | None = None  # stamp and arrival
        self._are_standing = False

    def selects(self, stamp_ns: int, arrival_ns: int) -> bool:
        """
        Return whether a frame is selected.

        Its stamp is its time. From a stamp on that is unset or stands still, that is the arrival.
        The times are compared with a fixed grid, so that rates that do not divide have the right
        mean. A pause, or a clock that was set, begins another grid.

        :param stamp_ns: stamp in nanoseconds; 0 if it is unset.
        :param arrival_ns: nanoseconds of any clock.
        """
        if not self._period_ns:
            return True
        last_stamp, last_arrival = self._last or (0, arrival_ns)
        self._are_standing |= not stamp_ns or (
            0 <= (stamp_ns - last_stamp) * STANDING < arrival_ns - last_arrival)
        self._last = stamp_ns, arrival_ns
        time_ns = arrival_ns if self._are_standing else stamp_ns
        period = self._period_ns
        early = self._due_ns - time_ns
        if period * _JITTER_TOLERANCE < early <= 2 * period:
            return False
        is_on_grid = -period <= early <= period * _JITTER_TOLERANCE
        self._due_ns = (self._due_ns if is_on_grid else time_ns) + period
        return True
