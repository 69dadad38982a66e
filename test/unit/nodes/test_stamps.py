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

from opencv_tools.base.units import NANO
from opencv_tools.capture.frame import Recorded
from opencv_tools.image.cdr import WireCompressedImage, WireHeader
from opencv_tools.nodes.publisher.stamps import Stamper
import pytest
from rclpy.clock import ClockType, ROSClock
from rclpy.time import Time


@pytest.mark.parametrize(('captured', 'stamp', 'offset', 'expected'), [
    (49.0, 'capture', 0.0, 99.0), (49.0, 'publish', 0.0, 100.0), (49.0, 'capture', -12.5, 86.5),
    (50.0, 'publish', 3.0, 103.0), (40.0, 'capture', -95.0, 1e-9)])
def test_stamps_in_nanoseconds(
        monkeypatch: pytest.MonkeyPatch, captured: float, stamp: str, offset: float,
        expected: float) -> None:
    monkeypatch.setattr('opencv_tools.nodes.publisher.stamps.time',
                        SimpleNamespace(monotonic_ns=lambda: 50 * 10**9))
    clock = ROSClock()
    clock._set_ros_time_is_active(True)
    clock.set_ros_time_override(Time(seconds=100, clock_type=ClockType.ROS_TIME))
    stamper = Stamper(clock)
    stamps = [Time.from_msg(stamper.stamp(int(captured * 1e9), stamp, offset)).nanoseconds
              for _ in range(3)]
    assert stamps == [round(expected * 1e9) + extra for extra in range(3)]


def test_stamps_of_the_system_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('opencv_tools.nodes.publisher.stamps.time', SimpleNamespace(
        monotonic_ns=lambda: 50 * 10**9, time_ns=lambda: 1_700_000_000_000_000_100))
    stamp = Stamper(ROSClock()).stamp(49_999_999_999, 'capture', 0.0)
    assert (stamp.sec, stamp.nanosec) == (1_700_000_000, 99)


def recorded(stamp_ns: int, play: int = 0, log_ns: int = 7) -> Recorded:
    sec, nanosec = divmod(stamp_ns, NANO)
    message = WireCompressedImage(header=WireHeader(sec, nanosec, ''), format='', data=b'')
    return Recorded(message=message, topic='', log_ns=log_ns, play=play)


@pytest.fixture
def stamper(monkeypatch: pytest.MonkeyPatch) -> Stamper:
    """Create a stamper at 100 s of a simulated clock and 50 s of the monotonic clock."""
    monkeypatch.setattr('opencv_tools.nodes.publisher.stamps.time',
                        SimpleNamespace(monotonic_ns=lambda: 50 * NANO))
    clock = ROSClock()
    clock._set_ros_time_is_active(True)
    clock.set_ros_time_override(Time(seconds=100, clock_type=ClockType.ROS_TIME))
    return Stamper(clock)


@pytest.mark.parametrize(('stamp_ns', 'offset', 'expected'), [
    (0, 0.0, 0), (-5, 0.0, -5), (1_700_000_000 * NANO + 1, 0.0, 1_700_000_000 * NANO + 1),
    (3 * NANO, -4.5, -1_500_000_000), (2**40 * NANO, 0.0, 2**31 * NANO - 1),
    (-2**40 * NANO, 0.0, -2**31 * NANO)])
def test_original_stamp_of_a_bag(
        stamper: Stamper, stamp_ns: int, offset: float, expected: int) -> None:
    for _ in range(2):
        stamp = stamper.stamp(50 * NANO, 'original', offset, recorded(stamp_ns))
        assert stamp.sec * NANO + stamp.nanosec == expected


def test_capture_shifts_the_stamps_of_each_play_by_one_amount(stamper: Stamper) -> None:
    stamps = [Time.from_msg(stamper.stamp(
        due * NANO // 10, 'capture', 0.0, recorded(stamp, play))).nanoseconds
        for due, stamp, play in ((490, 1000, 0), (491, 1030, 0), (492, 1010, 0), (495, 1000, 1),
                                 (496, 1050, 1))]
    first, second = 99_000_000_000, 99_500_000_000
    assert stamps == [first, first + 30, first + 10, second, second + 50]


def test_bag_without_stamps_is_shifted_by_its_times(stamper: Stamper) -> None:
    stamps = [Time.from_msg(stamper.stamp(
        49 * NANO, 'capture', 0.5, recorded(0, log_ns=log_ns))).nanoseconds
        for log_ns in (2000, 2040)]
    assert stamps == [99_500_000_000, 99_500_000_040]


def test_publication_of_a_bag_is_now(stamper: Stamper) -> None:
    stamps = [Time.from_msg(stamper.stamp(1, 'publish', 0.0, recorded(5))).nanoseconds
              for _ in range(2)]
    assert stamps == [100 * NANO, 100 * NANO + 1]


def test_held_frame_of_a_bag_is_captured_again(stamper: Stamper) -> None:
    frames = [recorded(1000), recorded(1030)]
    stamps = [Time.from_msg(stamper.stamp(due * NANO // 10, 'capture', 0.0, frame)).nanoseconds
              for due, frame in ((490, frames[0]), (491, frames[1]), (492, frames[1]))]
    assert stamps == [99_000_000_000, 99_000_000_030, 99_200_000_000]


def test_no_stamp_before_simulated_time_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('opencv_tools.nodes.publisher.stamps.time',
                        SimpleNamespace(monotonic_ns=lambda: 50 * NANO))
    clock = ROSClock()
    clock._set_ros_time_is_active(True)
    stamper = Stamper(clock)
    for offset in (0.0, 0.5, -3.0):
        stamp = stamper.stamp(50 * NANO, 'capture', offset)
        assert (stamp.sec, stamp.nanosec) == (0, 0)
    clock.set_ros_time_override(Time(seconds=7, clock_type=ClockType.ROS_TIME))
    assert stamper.stamp(50 * NANO, 'capture', 0.0).sec == 7
