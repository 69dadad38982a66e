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

"""Times of the warning that no frames arrive, on a clock that the test controls."""

from __future__ import annotations

from opencv_tools.base.logs import Log
from opencv_tools.topics.subscription import NoFramesWarning
import pytest


class Console:
    """Time in seconds, a reason, and the log lines with their times."""

    def __init__(self) -> None:
        self.now = 0.0
        self.reason = 'nobody publishes'
        self.lines: list[tuple[float, str]] = []
        self.frames = 0
        self.no_frames_warning = NoFramesWarning(Log(self), lambda: self.reason)

    def info(self, message: str) -> None:
        self.lines.append((self.now, message))

    debug = warning = error = info

    def wait(self, seconds: float, is_expected: bool = False) -> None:
        """Check every half second."""
        for _ in range(round(seconds * 2)):
            self.now += 0.5
            self.no_frames_warning.check(
                0.5, self.frames, '/camera', is_expected=is_expected)

    def receive(self) -> None:
        self.frames += 1
        self.wait(0.5)


@pytest.fixture
def console() -> Console:
    return Console()


def test_warning_after_three_seconds_and_for_a_new_reason(console: Console) -> None:
    console.wait(10)
    assert console.lines == [(3.0, 'No frames: nobody publishes')]
    console.reason = 'the publisher is paused'
    console.wait(3)
    assert console.lines[1:] == [(12.0, 'No frames: the publisher is paused')]
    console.receive()
    assert console.lines[2:] == [(13.5, 'Frames arrive on /camera')]
    console.wait(2.5)
    assert len(console.lines) == 3
    console.wait(0.5)
    assert console.lines[3:] == [(16.5, 'No frames: the publisher is paused')]


def test_warning_after_three_periods_of_a_slow_stream(console: Console) -> None:
    for _ in range(4):
        console.receive()
        console.wait(1.5)
    console.wait(4)
    assert console.lines == []
    console.wait(0.5)
    assert console.lines == [(12.5, 'No frames: nobody publishes')]


def test_reset_of_the_period(console: Console) -> None:
    for _ in range(4):
        console.receive()
        console.wait(1.5)
    console.no_frames_warning.reset()
    console.wait(5.5)
    assert console.lines == []
    console.no_frames_warning.reset_period()
    console.wait(3)
    assert console.lines == [(16.5, 'No frames: nobody publishes')]


def test_no_warning_for_expected_silence(console: Console) -> None:
    console.wait(60, is_expected=True)
    assert console.lines == []
