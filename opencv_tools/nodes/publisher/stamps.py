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
from typing import cast

from builtin_interfaces.msg import Time
from opencv_tools.base.units import NANO
from opencv_tools.capture.frame import CapturedFrame, Recorded
from opencv_tools.nodes.publisher.parameters import PublisherSettings
from rclpy.clock import ROSClock
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

_SECONDS = 1 << 31  # range of the seconds of a message: from -_SECONDS to _SECONDS - 1


class Stamper:
    """Create stamps that increase from frame to frame."""

    def __init__(self, clock: ROSClock) -> None:
        """
        Create no stamp yet.

        :param clock: clock of the node, which may be simulated.
        """
        self._clock = clock
        self._last_now = 0
        self._last = 0
        self._shift = 0  # from the times of a bag to the clock
        self._play = -1  # of the bag that the shift is for
        self._recorded: Recorded | None = None

    def stamp(
        self, captured_ns: int, event: str, offset: float, recorded: Recorded | None = None,
    ) -> Time:
        """
        Return the stamp of a frame.

        :param captured_ns: time of capture in nanoseconds of CLOCK_MONOTONIC.
        :param event: one of ``STAMPS``: the capture of the frame, its publication now, or its
            stamp in a bag.
        :param offset: seconds to add; negative to compensate the delay of a camera.
        :param recorded: metadata of a frame of a bag. Its capture is the time in the bag, shifted
            so that the first frame of each play was captured when it was due.
        :returns: the stamp. It is later than the previous one, unless the clock was set back or
            the time is that of a bag.
        """
        if recorded and event == 'original':
            return to_time(recorded.header_ns + round(offset * NANO))
        now, monotonic = self._read_clocks()
        if not now and not recorded:
            return Time()  # simulated time has not begun
        age = monotonic - captured_ns if event != 'publish' else 0
        stamp = max(0, now - age + round(offset * NANO))  # simulated time starts at 0
        if now >= self._last_now:
            stamp = max(stamp, self._last + 1)
        # A frame that is held at the end of a bag is captured again.
        if recorded and event == 'capture' and recorded is not self._recorded:
            if recorded.play != self._play:
                self._play, self._shift = recorded.play, stamp - recorded.time_ns
            stamp = recorded.time_ns + self._shift
        self._last_now, self._last, self._recorded = now, stamp, recorded
        return to_time(stamp)

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


def to_time(nanoseconds: int) -> Time:
    """Return a time as a message; a time that no message can have becomes the nearest one."""
    lowest, highest = -_SECONDS * NANO, _SECONDS * NANO - 1
    sec, nanosec = divmod(min(max(nanoseconds, lowest), highest), NANO)
    return Time(sec=sec, nanosec=nanosec)


class FrameHeaders:
    """The stamp and the ``frame_id`` of each frame, and the time of a bag on ``/clock``."""

    def __init__(self, node: Node, has_clock: bool) -> None:
        """
        Create the publisher of ``/clock`` if it is wanted.

        :param has_clock: whether the time of each frame of a bag is published.
        """
        self._stamper = Stamper(cast(ROSClock, node.get_clock()))
        self._clock = node.create_publisher(Clock, '/clock', 10) if has_clock else None

    def header(self, frame: CapturedFrame, settings: PublisherSettings) -> tuple[Time, str]:
        """
        Return the stamp and the ``frame_id`` of a frame; publish the time of a frame of a bag.

        :param settings: values of the parameters, with ``stamp``, ``stamp_offset`` and
            ``frame_id``.
        """
        recorded = frame.recorded
        is_original = recorded is not None and settings.stamp == 'original'
        stamp = self._stamper.stamp(
            frame.stamp_ns, settings.stamp, settings.stamp_offset, recorded)
        if recorded and self._clock:
            self._clock.publish(Clock(clock=to_time(recorded.log_ns) if is_original else stamp))
        return stamp, (recorded.message.header.frame_id if recorded and is_original
                       else settings.frame_id)
