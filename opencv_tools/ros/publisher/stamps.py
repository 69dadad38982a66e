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

"""Stamps of frames: capture times in ROS time."""

from __future__ import annotations

import time

from builtin_interfaces.msg import Time
from rclpy.clock import ROSClock

STAMPS = ('capture', 'publish')
_NANO = 10**9


class Stamper:
    """Create stamps that increase from frame to frame."""

    def __init__(self, clock: ROSClock) -> None:
        """
        Store the clock.

        :param clock: clock of the node, which may be simulated.
        """
        self._clock = clock
        self._last_now = 0
        self._last = 0

    def stamp(self, captured_ns: int, event: str, offset: float) -> Time:
        """
        Return the stamp of a frame.

        :param captured_ns: time of capture in nanoseconds of CLOCK_MONOTONIC.
        :param event: one of ``STAMPS``: the capture of the frame, or its publication now.
        :param offset: seconds to add; negative to compensate the delay of a camera.
        :returns: the stamp, later than the previous one unless the clock was set back.
        """
        now, monotonic = self._read_clocks()
        age = monotonic - captured_ns if event == 'capture' else 0
        stamp = max(0, now - age + round(offset * 1e9))  # simulated time starts at 0
        if now >= self._last_now:
            stamp = max(stamp, self._last + 1)
        self._last_now, self._last = now, stamp
        sec, nanosec = divmod(stamp, _NANO)
        return Time(sec=sec, nanosec=nanosec)

    def _read_clocks(self) -> tuple[int, int]:
        """
        Read the clock and CLOCK_MONOTONIC at the same moment, in nanoseconds.

        The process may be preempted between the two readings, so the best of three attempts is
        used. Without simulated time, the clock is that of the system, which is faster to read.
        """
        is_simulated = self._clock.ros_time_is_active
        readings = []
        for _ in range(3):
            before = time.monotonic_ns()
            now = self._clock.now().nanoseconds if is_simulated else time.time_ns()
            after = time.monotonic_ns()
            readings.append((after - before, now, (before + after) // 2))
        _, now, monotonic = min(readings)
        return now, monotonic
