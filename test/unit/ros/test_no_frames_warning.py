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

"""When it is told that no frames come, by a clock that the test controls."""

from __future__ import annotations

from opencv_tools.ros.subscriber import no_frames_warning
from opencv_tools.ros.subscriber.no_frames_warning import NoFramesWarning
import pytest


class Desk:
    """A clock, a reason, and the lines of a log with their times."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        self.reason = 'nobody publishes'
        self.lines: list[tuple[float, str]] = []
        monkeypatch.setattr(no_frames_warning.time, 'monotonic', lambda: 100.0 + self.now)
        self.silence = NoFramesWarning(self, lambda: self.reason)

    def info(self, message: str) -> None:
        self.lines.append((self.now, message))

    warning = error = info

    def pass_by(self, seconds: float, is_expected: bool = False) -> None:
        """Look every half second."""
        for _ in range(round(seconds * 2)):
            self.now += 0.5
            self.silence.check(0.5, is_expected)

    def frame(self) -> None:
        self.silence.frame_received('/camera')


@pytest.fixture
def desk(monkeypatch: pytest.MonkeyPatch) -> Desk:
    return Desk(monkeypatch)


def test_reason_is_told_after_three_seconds_and_when_it_changes(desk: Desk) -> None:
    desk.pass_by(10)
    assert desk.lines == [(3.0, 'No frames: nobody publishes')]
    desk.reason = 'the publisher is paused'
    desk.pass_by(3)
    assert desk.lines[1:] == [(12.0, 'No frames: the publisher is paused')]
    desk.frame()
    assert desk.lines[2:] == [(13.0, 'Frames arrive on /camera')]
    desk.pass_by(2.5)
    assert len(desk.lines) == 3
    desk.pass_by(0.5)
    assert desk.lines[3:] == [(16.0, 'No frames: the publisher is paused')]


def test_slow_stream_has_three_of_its_periods(desk: Desk) -> None:
    for _ in range(4):
        desk.frame()
        desk.pass_by(2)
    desk.pass_by(3.5)
    assert desk.lines == []
    desk.pass_by(0.5)
    assert desk.lines == [(12.0, 'No frames: nobody publishes')]


def test_period_of_other_publishers_is_forgotten(desk: Desk) -> None:
    desk.frame()
    desk.pass_by(2)
    desk.frame()
    desk.silence.reset()
    desk.pass_by(5.5)
    assert desk.lines == []
    desk.silence.reset_period()
    desk.pass_by(3)
    assert desk.lines == [(10.5, 'No frames: nobody publishes')]


def test_silence_that_is_expected_is_not_told(desk: Desk) -> None:
    desk.pass_by(60, is_expected=True)
    assert desk.lines == []
