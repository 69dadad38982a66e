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

"""The recorder: queue, threads, order, and an account of every frame."""

from __future__ import annotations

import errno
from pathlib import Path
import threading

from conftest import read_manifest, recorded_files
from console import Console
import numpy as np
from opencv_tools.recording.errors import LimitReached
from opencv_tools.recording.frames import RawFrame, ReceivedFrame
from opencv_tools.recording.image_encoder import encode_frame, EncodedImage, EncoderSettings
from opencv_tools.recording.image_sink import ImageSink
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.recorder import FrameCounts, Recorder, SinkCounts
from opencv_tools.recording.selection import Limits
import pytest
from recordings import frame_of, gray_frame, gray_numbers, image_sink, record
from switching import switching_in
from waiting import join, wait_until


def test_frames_are_numbered_in_the_order_of_arrival(tmp_path: Path) -> None:
    folder = tmp_path / 'a' / 'b'
    recorder = record(folder, 50)
    assert [path.name for path in recorded_files(folder)] == [
        f'{number:03d}.png' for number in range(50)]
    assert gray_numbers(folder) == list(range(50))
    assert recorder.counts == FrameCounts(written=50)


class SlowSink(ImageSink):
    """A sink that writes nothing before ``may_write`` is set."""

    def __init__(self, *args: object) -> None:
        super().__init__(*args)
        self.has_begun, self.may_write = threading.Event(), threading.Event()

    def prepare(self, frame: ReceivedFrame) -> object:
        self.has_begun.set()
        wait_until(self.may_write.is_set)
        return super().prepare(frame)


@pytest.fixture
def slow_sink(tmp_path: Path) -> SlowSink:
    return image_sink(tmp_path, '{seq:03d}.png', SlowSink)


def test_full_queue_drops_the_oldest_frame(tmp_path: Path, slow_sink: SlowSink) -> None:
    console = Console()
    recorder = Recorder(slow_sink, console, queue_size=3, writers=1)
    recorder.put(gray_frame(0))
    wait_until(slow_sink.has_begun.is_set)
    made_room = [recorder.put(gray_frame(number)) for number in range(1, 20)]
    slow_sink.may_write.set()
    recorder.close()
    assert made_room == [True] * 3 + [False] * 16
    assert gray_numbers(tmp_path) == [0, 17, 18, 19]
    assert [path.name for path in recorded_files(tmp_path)] == [
        '000.png', '001.png', '002.png', '003.png']
    assert recorder.counts == FrameCounts(written=4, dropped=16)
    assert [line.partition(':')[0] for line in console.lines] == ['warning']


def test_room_in_the_queue(tmp_path: Path, slow_sink: SlowSink) -> None:
    recorder = Recorder(slow_sink, Console(), queue_size=2, writers=1)
    recorder.put(gray_frame(0))
    wait_until(slow_sink.has_begun.is_set)  # it is not in the queue any more
    room = []
    for number in range(1, 3):
        room.append(recorder.has_room)
        recorder.put(gray_frame(number))
    assert (room, recorder.has_room) == ([True, True], False)
    slow_sink.may_write.set()
    recorder.close()
    assert recorder.has_room


def test_blocking_queue_loses_no_frame(tmp_path: Path, slow_sink: SlowSink) -> None:
    recorder = Recorder(slow_sink, Console(), queue_size=3, writers=2, block=True)
    putting = threading.Thread(
        target=lambda: [recorder.put(gray_frame(number)) for number in range(40)])
    putting.start()
    wait_until(lambda: not recorder.has_room, 'the full queue')
    assert putting.is_alive()
    slow_sink.may_write.set()
    join(putting)
    recorder.close()
    assert gray_numbers(tmp_path) == list(range(40))
    assert recorder.counts.dropped == 0


def test_queue_that_is_abandoned(tmp_path: Path, slow_sink: SlowSink) -> None:
    outcomes: list[Path | str] = []
    recorder = Recorder(slow_sink, Console(), writers=1)
    for number in range(5):
        recorder.put(gray_frame(number), outcomes.append)
    wait_until(slow_sink.has_begun.is_set)

    def abandon() -> None:
        wait_until(lambda: recorder._queue._closed, 'the closed queue')
        recorder.abandon()
        slow_sink.may_write.set()

    abandoning = threading.Thread(target=abandon, daemon=True)
    abandoning.start()
    recorder.close()
    join(abandoning)
    assert outcomes == [tmp_path / '000.png'] + ['the recording was interrupted'] * 4
    assert gray_numbers(tmp_path) == [0]
    assert recorder.abandoned == 4
    assert recorder.counts == FrameCounts(written=1)


def test_bad_frame_is_logged_once_and_numbering_continues(tmp_path: Path) -> None:
    console = Console()
    names = FileNames('{seq}.png')
    sink = open_sink(tmp_path, names, EncoderSettings('.png'), 'continue', Limits(), False)
    recorder = Recorder(sink, console, writers=2)
    for _ in range(5):
        recorder.put(frame_of(np.zeros((2, 2), np.float32), '32FC1'))
        recorder.put(gray_frame(7))
    recorder.close()
    assert (recorder.counts.written, recorder.counts.failed) == (5, 5)
    assert [line['file'] for line in read_manifest(tmp_path)] == [
        f'{number}.png' for number in range(5)]
    assert console.lines == [
        'error: a frame was not written: a 32FC1 frame cannot be stored as .png; '
        'set the extension of file_name to .tif or .tiff or .npy, or allow a loss and give the '
        'range of the numbers']


def test_unexpected_error_does_not_stop_the_recorder(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stumble(frame: RawFrame, settings: EncoderSettings) -> EncodedImage:
        if frame.image[0, 0] % 3 == 0:
            raise ZeroDivisionError('oops')
        return encode_frame(frame, settings)

    monkeypatch.setattr('opencv_tools.recording.image_sink.encode_frame', stumble)
    recorder = record(tmp_path, 12)
    assert gray_numbers(tmp_path) == [1, 2, 4, 5, 7, 8, 10, 11]
    assert (recorder.counts.written, recorder.counts.failed) == (8, 4)


@pytest.mark.parametrize(('error', 'reason'), [
    (ZeroDivisionError('oops'), 'oops'), (ZeroDivisionError(), 'ZeroDivisionError'),
    (OSError(), 'OSError'), (OSError(errno.EIO, 'Input/output error', 'x'), 'Input/output error'),
    (FileNotFoundError(errno.ENOENT, '', 'x'), 'FileNotFoundError')])
def test_every_error_has_a_reason(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, reason: str) -> None:
    def stumble(*_: object) -> None:
        raise error

    monkeypatch.setattr('opencv_tools.recording.image_sink.encode_frame', stumble)
    console, outcomes = Console(), []
    recorder = Recorder(image_sink(tmp_path, '{seq}.png'), console)
    recorder.put(gray_frame(0), outcomes.append)
    recorder.close()
    assert outcomes == [reason]
    assert console.lines == [f'error: a frame was not written: {reason}']


def test_writer_threads_end_with_the_recorder(slow_sink: SlowSink) -> None:
    before = set(threading.enumerate())
    recorder = Recorder(slow_sink, Console(), writers=3)
    writers = set(threading.enumerate()) - before
    assert len(writers) == 3 and all(thread.daemon for thread in writers)
    recorder.close()
    assert not any(thread.is_alive() for thread in writers)


class Numbers:
    """A sink that records the numbers of frames in the order of their commits."""

    def __init__(self) -> None:
        self.placed: list[int] = []
        self.counts = SinkCounts()

    def prepare(self, frame: RawFrame) -> Numbers:
        return self

    def commit(self, frame: RawFrame, _: Numbers) -> Path:
        self.placed.append(int(frame.image[0, 0]))
        self.counts.kept += 1
        return Path()

    def discard(self) -> None:
        pass

    def close(self) -> None:
        pass


class Unfinished(Numbers):
    """A sink whose ``close`` fails."""

    def close(self) -> None:
        raise OSError(errno.EIO, 'Input/output error', 'x')


def test_failure_of_close_is_logged_once() -> None:
    console = Console()
    recorder = Recorder(Unfinished(), console)
    recorder.put(gray_frame(0))
    recorder.close()
    recorder.close()
    assert recorder.counts == FrameCounts(written=1)
    assert recorder.is_unfinished
    assert console.lines == ['error: the recording was not finished: Input/output error']


class Waiting(Numbers):
    """A sink that keeps three frames at a time, and loses the rest in ``close``."""

    def commit(self, frame: RawFrame, _: Numbers) -> Path:
        path = super().commit(frame, self)
        self.counts.kept = len(self.placed) // 3 * 3
        return path

    def close(self) -> None:
        self.counts.lost = len(self.placed) - self.counts.kept
        self.counts.reason = 'the disk is full'


def test_frame_is_counted_when_its_outcome_is_known() -> None:
    console, sink = Console(), Waiting()
    recorder = Recorder(sink, console, block=True)
    for number in range(5):
        recorder.put(gray_frame(number))
    recorder.close()
    assert recorder.counts == FrameCounts(written=3, failed=2)
    assert console.lines == ['error: a frame was not written: the disk is full']


class Full(Numbers):
    """A sink that is full at the first frame, when the second one is prepared too."""

    def __init__(self) -> None:
        super().__init__()
        self.discarded = 0
        self._both = threading.Barrier(2)

    def prepare(self, frame: RawFrame) -> Numbers:
        self._both.wait()
        return self

    def commit(self, frame: RawFrame, _: Numbers) -> Path:
        super().commit(frame, self)
        raise LimitReached('no more')

    def discard(self) -> None:
        self.discarded += 1


def test_frames_prepared_before_the_limit_are_discarded() -> None:
    sink = Full()
    outcomes: list[object] = []
    recorder = Recorder(sink, Console(), writers=2)
    for number in range(2):
        recorder.put(gray_frame(number), outcomes.append)
    recorder.close()
    assert sink.placed == [0]
    assert outcomes == ['no more', 'the recording has reached its limits']
    assert (recorder.counts.skipped, sink.discarded) == (2, 2)


@pytest.mark.filterwarnings('error::pytest.PytestUnhandledThreadExceptionWarning')
def test_order_is_independent_of_thread_switches() -> None:
    sink = Numbers()
    with switching_in(Recorder._write_all):
        recorder = Recorder(sink, Console(), writers=4, block=True)
        for number in range(40):
            recorder.put(gray_frame(number))
        recorder.close()
    assert sink.placed == list(range(40))
    assert recorder.counts.written == 40
