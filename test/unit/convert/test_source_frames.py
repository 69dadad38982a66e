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

"""Selected frames of files and streams, and their times."""

from __future__ import annotations

import time
from typing import Literal

import numpy as np
from opencv_tools.capture.errors import BrokenFrameError, UnavailableError
from opencv_tools.capture.frame import CapturedFrame
from opencv_tools.capture.pattern import PatternSource, PatternSpec
from opencv_tools.convert.convert import numbered_frames, received_frame
import pytest


class Stream:
    """A live source of some frames, of which the one with the number 1 is broken."""

    live: Literal[True] = True
    name, description, rate, missed = 'stream', '', 0.0, 0

    def __init__(self, count: int, is_silent: bool = False) -> None:
        self._frames = iter(range(count))
        self._is_silent = is_silent
        self._number: int | None = None

    def wait(self, seconds: float) -> bool:
        self._number = next(self._frames, None)
        if self._number is None and not self._is_silent:
            raise UnavailableError('ended')
        return self._number is not None

    def skip(self) -> None:
        pytest.fail('a frame of a stream is read, because each has a number')

    def read(self) -> CapturedFrame:
        if self._number == 1:
            raise BrokenFrameError('broken')
        return CapturedFrame(np.full((2, 2), self._number, np.uint8), 'mono8', 5)

    def close(self) -> None:
        pass


@pytest.mark.parametrize('is_silent', [False, True])
@pytest.mark.parametrize(('first', 'stop', 'every', 'expected'), [
    (0, 0, 1, [0, 2, 3, 4]), (0, 3, 1, [0, 2]), (2, 0, 2, [2, 4])])
def test_frames_of_a_stream_until_its_end(
        first: int, stop: int, every: int, expected: list[int], is_silent: bool) -> None:
    broken: list[BrokenFrameError] = []
    found = list(numbered_frames(Stream(5, is_silent), first, stop, every, broken.append, bool))
    assert [number for number, _ in found] == expected
    assert [frame.image[0, 0] for _, frame in found] == expected
    assert len(broken) == 1


def test_skipped_frames_are_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    source = PatternSource(PatternSpec(64, 48, 25.0))
    reads: list[CapturedFrame] = []
    read = source.read
    monkeypatch.setattr(source, 'read', lambda: reads.append(read()) or reads[-1])
    found = list(numbered_frames(source, 3, 20, 5, pytest.fail, bool))
    assert [number for number, _ in found] == [3, 8, 13, 18]
    assert len(reads) == 4


def test_time_of_a_frame_of_a_stream() -> None:
    captured_ns = time.monotonic_ns()
    before = time.time_ns()
    frame = received_frame(CapturedFrame(np.zeros((2, 2), np.uint8), 'mono8', captured_ns), 7, 0.0)
    assert abs(frame.metadata.stamp_ns - before) < 60 * 10**9
    assert frame.receive_ns == frame.metadata.stamp_ns == frame.arrival_ns


@pytest.mark.parametrize(('position', 'rate', 'expected'), [
    (0.25, 25.0, 250_000_000), (None, 25.0, 280_000_000), (None, 0.0, 700_000_000)])
def test_time_of_a_frame_of_a_file(position: float | None, rate: float, expected: int) -> None:
    frame = received_frame(
        CapturedFrame(np.zeros((2, 2), np.uint8), 'mono8', position=position), 7, rate)
    assert (frame.receive_ns, frame.time_ns) == (expected, expected)
