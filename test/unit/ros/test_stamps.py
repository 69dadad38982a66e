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

"""Stamps of frames."""

from __future__ import annotations

from types import SimpleNamespace

from opencv_tools.ros.publisher.stamps import Stamper
import pytest
from rclpy.clock import ClockType, ROSClock
from rclpy.time import Time


@pytest.mark.parametrize(('captured', 'stamp', 'offset', 'expected'), [
    (49.0, 'capture', 0.0, 99.0), (49.0, 'publish', 0.0, 100.0), (49.0, 'capture', -12.5, 86.5),
    (50.0, 'publish', 3.0, 103.0), (40.0, 'capture', -95.0, 1e-9)])
def test_stamps_in_nanoseconds(
        monkeypatch: pytest.MonkeyPatch, captured: float, stamp: str, offset: float,
        expected: float) -> None:
    monkeypatch.setattr('opencv_tools.ros.publisher.stamps.time',
                        SimpleNamespace(monotonic_ns=lambda: 50 * 10**9))
    clock = ROSClock()
    clock._set_ros_time_is_active(True)
    clock.set_ros_time_override(Time(seconds=100, clock_type=ClockType.ROS_TIME))
    stamper = Stamper(clock)
    stamps = [Time.from_msg(stamper.stamp(int(captured * 1e9), stamp, offset)).nanoseconds
              for _ in range(3)]
    assert stamps == [round(expected * 1e9) + extra for extra in range(3)]


def test_stamps_of_the_system_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('opencv_tools.ros.publisher.stamps.time', SimpleNamespace(
        monotonic_ns=lambda: 50 * 10**9, time_ns=lambda: 1_700_000_000_000_000_100))
    stamp = Stamper(ROSClock()).stamp(49_999_999_999, 'capture', 0.0)
    assert (stamp.sec, stamp.nanosec) == (1_700_000_000, 99)
