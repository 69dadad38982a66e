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

"""Network streams as a source, with frames that the test sends."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from queue import SimpleQueue
from threading import Thread

import numpy as np
from opencv_tools.capture.errors import BrokenFrameError, UnavailableError
from opencv_tools.capture.frame import CapturedFrame
from opencv_tools.capture.opencv_video import OpenCvStream
from opencv_tools.capture.stream import StreamSource
import pytest
from waiting import item_of, join, LONGEST_SECONDS


class Capture:
    """A replacement of cv2.VideoCapture with frames from the test; None ends the stream."""

    def __init__(self) -> None:
        self.coming: SimpleQueue[int | None] = SimpleQueue()
        self.reads: SimpleQueue[None] = SimpleQueue()
        self.released = False
        self.endless = False

    def get(self, _: int) -> float:
        return 25.0

    def read(self) -> tuple[bool, np.ndarray | None]:
        self.reads.put(None)
        number = 0 if self.endless else self.coming.get()
        return number is not None, None if number is None else np.full((1, 1), number, np.uint8)

    def release(self) -> None:
        self.released = True


class CheckedSource(StreamSource):
    """A stream that checks that its frames are accessed only with the lock held."""

    @property
    def _waiting(self) -> deque[CapturedFrame]:
        assert self._changed._is_owned(), 'read without the lock'
        return self._checked

    @_waiting.setter
    def _waiting(self, frames: deque[CapturedFrame]) -> None:
        assert self._is_being_made(), 'written without the lock'
        self._checked = frames

    @property
    def _ended(self) -> bool:
        return self._has_ended

    @_ended.setter
    def _ended(self, ended: bool) -> None:
        assert self._is_being_made() or self._changed._is_owned(), 'ended without the lock'
        self._has_ended = ended

    def _is_being_made(self) -> bool:
        return not hasattr(self, '_thread')


@pytest.fixture
def capture() -> Iterator[Capture]:
    """Create a capture, and end its stream after the test."""
    made = Capture()
    yield made
    made.endless = False
    made.coming.put(None)


@pytest.fixture
def source(capture: Capture) -> StreamSource:
    return CheckedSource('rtsp://camera', OpenCvStream(capture))


def send(capture: Capture, *numbers: int | None) -> None:
    """Send frames, or the end, and wait until the last one has been read."""
    for number in numbers:
        item_of(capture.reads)  # the reader waits for this frame
        capture.coming.put(number)
    if None not in numbers:
        item_of(capture.reads)  # the reader waits for the next frame
        capture.reads.put(None)


def test_newest_frame_is_read_and_older_ones_count_as_missed(
        capture: Capture, source: StreamSource) -> None:
    send(capture, *range(1, 11))
    assert source.wait(0.0)
    assert source.read().image.tolist() == [[10]]
    assert source.missed == 9
    assert not source.wait(0.0)
    send(capture, 11)
    assert source.read().image.tolist() == [[11]]
    assert source.missed == 9
    assert (source.name, source.rate, source.live) == ('rtsp://camera', 25.0, True)


def test_wait_ends_with_the_next_frame(capture: Capture, source: StreamSource) -> None:
    Thread(target=lambda: send(capture, 1)).start()
    assert source.wait(LONGEST_SECONDS)
    assert source.read().image.tolist() == [[1]]


def test_skipped_frame_is_not_read(capture: Capture, source: StreamSource) -> None:
    send(capture, 1)
    source.skip()
    assert not source.wait(0.0)
    with pytest.raises(BrokenFrameError, match='rtsp://camera has no frame yet'):
        source.read()
    send(capture, 2)
    assert source.missed == 0


def test_last_frame_is_read_before_the_end_is_reported(
        capture: Capture, source: StreamSource) -> None:
    send(capture, 1, None)
    assert source.wait(0.0)
    source.read()
    with pytest.raises(UnavailableError, match='ended or is no longer reachable'):
        source.wait(LONGEST_SECONDS)
    source.close()
    assert capture.released


def test_running_stream_can_be_closed_twice(capture: Capture) -> None:
    capture.endless = True
    source = CheckedSource('rtsp://camera', OpenCvStream(capture))
    assert source.wait(LONGEST_SECONDS)
    closing = Thread(target=lambda: (source.close(), source.close()), daemon=True)
    closing.start()
    join(closing)
    assert not closing.is_alive()
    assert capture.released
