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

"""Limit of the rate of pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

from hypothesis import given, strategies
from opencv_tools.viewer.streams.rate_limit import EvenRate
import pytest


@dataclass
class Timer:
    """A call at a time."""

    time: float
    function: Callable[[], object]
    is_cancelled: bool = False

    def cancel(self) -> None:
        self.is_cancelled = True


@dataclass
class Loop:
    """A loop whose time is set."""

    now: float = 100.0
    timers: list[Timer] = field(default_factory=list)

    def time(self) -> float:
        return self.now

    def call_later(self, delay: float, function: Callable[[], object]) -> Timer:
        self.timers.append(Timer(self.now + delay, function))
        return self.timers[-1]

    def run_until(self, end: float) -> None:
        """Make the calls until a time."""
        while due := [one for one in self.timers if not one.is_cancelled and one.time <= end]:
            first = min(due, key=lambda one: one.time)
            self.timers.remove(first)
            self.now = max(self.now, first.time)
            first.function()
        self.now = end


@dataclass
class Shown:
    """Frames that arrive at some times, and those that are shown."""

    rate: float
    source_rate: float
    frames: list[tuple[float, float]] = field(default_factory=list)  # times of arrival and display
    newest: float | None = None

    def __post_init__(self) -> None:
        self.loop = Loop()
        self.limit = EvenRate(cast(Any, self.loop), self.try_newest)

    def try_newest(self) -> None:
        if self.newest is not None and self.limit.allows(self.rate, self.source_rate):
            self.frames.append((self.newest, self.loop.now))
            self.newest = None

    def receive(self, times: Sequence[float]) -> None:
        for time in times:
            self.loop.run_until(100 + time)
            self.newest = self.loop.now
            self.try_newest()
        self.loop.run_until(self.loop.now + 10 / self.rate)


@pytest.mark.parametrize('source_rate', [30.4, 31.0, 40.0, 60.0, 90.0, 1000.0])
def test_frames_of_a_faster_camera_do_not_wait(source_rate: float) -> None:
    shown = Shown(30.0, source_rate)
    shown.receive([number / source_rate for number in range(int(20 * source_rate))])
    *before, last = shown.frames
    assert all(arrived == at for arrived, at in before)
    assert len(shown.frames) == pytest.approx(600, abs=2)
    assert last[0] == pytest.approx(120 - 1 / source_rate, abs=1 / 30)


def test_frames_with_jitter_are_all_shown() -> None:
    shown = Shown(30.0, 30.0)
    shown.receive([(number + 0.2 * (-1) ** number) / 30 for number in range(1, 300)])
    assert len(shown.frames) == 299
    assert all(arrived == at for arrived, at in shown.frames)


def test_second_of_two_frames_is_shown_when_it_is_due() -> None:
    shown = Shown(2.0, 0.0)
    shown.receive([0.0, 0.1])
    assert shown.frames == [(100.0, 100.0), (100.1, pytest.approx(100.25))]


def test_last_frame_of_a_camera_that_ends_is_shown() -> None:
    shown = Shown(30.0, 100.0)
    shown.receive([0.0, 0.01])
    assert shown.frames == [(100.0, 100.0), (100.01, pytest.approx(100 + 1 / 60 + 0.01))]


def test_nobody_is_woken_after_the_end() -> None:
    loop, woken = Loop(), list[int]()
    limit = EvenRate(cast(Any, loop), lambda: woken.append(1))
    assert limit.allows(1.0) and not limit.allows(1.0)
    limit.close()
    loop.run_until(200)
    assert not woken


@given(strategies.lists(strategies.floats(0, 0.3), max_size=50), strategies.floats(0.5, 100),
       strategies.sampled_from([0.0, 5.0, 30.0, 200.0]))
def test_rate_is_kept_and_the_newest_frame_is_shown(
        gaps: list[float], rate: float, source_rate: float) -> None:
    times = [sum(gaps[:count]) for count in range(1, len(gaps) + 1)]
    shown = Shown(rate, source_rate)
    shown.receive(times)
    ends = [at for _, at in shown.frames]
    for first, begin in enumerate(ends):
        for last in range(first, len(ends)):
            assert last - first <= (ends[last] - begin) * rate + 1 + 1e-6
    assert [arrived for arrived, _ in shown.frames][-1:] == [100 + time for time in times[-1:]]
    newer = 1 / source_rate if source_rate > rate else 0.0
    assert all(at - arrived <= 1 / rate + newer + 1e-6 for arrived, at in shown.frames)
