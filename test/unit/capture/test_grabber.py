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

"""The grabber with a clock that the test controls, so that no test waits."""

from __future__ import annotations

from collections.abc import Callable
import itertools
from threading import Thread
from typing import Any

import numpy as np
from opencv_tools.capture.errors import BrokenFrameError, CaptureError, UnavailableError
from opencv_tools.capture.frame import CapturedFrame, Source
from opencv_tools.capture.grabber import Grabber
from opencv_tools.capture.pattern import PatternSource, PatternSpec
from opencv_tools.capture.settings import CaptureSettings
import pytest
from stepped_clock import BEGAN, SteppedClock
from waiting import LONGEST_SECONDS

RATE = 128  # a power of two, so that sums of periods are exact


class Camera:
    """A camera that sends a numbered frame RATE times a second, whether it is read or not."""

    name = 'camera'
    description = '1x1'
    rate = float(RATE)
    live = True
    missed = 0
    needs_every = False

    def __init__(self, clock: SteppedClock) -> None:
        self._clock = clock
        self._began = clock.now
        self._number = 0
        self.decoded: list[int] = []
        self.skipped: list[int] = []
        self.fault: Exception | None = None
        self.stalled = self.closed = False
        self.damaged = 0

    def wait(self, seconds: float) -> bool:
        if self.fault:
            raise self.fault
        until = self._clock.now + seconds
        due = self._began + (self._number + 1) / RATE
        if self.stalled or due > until:
            self._clock.step_to(until)
            return False
        self._clock.step_to(due)
        self._number = int((self._clock.now - self._began) * RATE)
        return True

    def skip(self) -> None:
        self.skipped.append(self._number)

    def read(self) -> CapturedFrame:
        self.decoded.append(self._number)
        if len(self.decoded) == self.damaged:
            raise BrokenFrameError('it is damaged')
        return CapturedFrame(np.full((1, 1), self._number, np.uint16), 'mono16',
                             int(self._clock.now * 10**9))

    def close(self) -> None:
        self.closed = True


class Log:
    """A listener that records the events of a grabber, and a demand that the test sets."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.there = self.looking = True

    def opened(self, source: Source, is_back: bool) -> None:
        self.lines.append('opened')

    def lost(self, reason: UnavailableError, longest: float) -> None:
        self.lines.append(f'lost: {reason}')

    def returned(self, source: Source, seconds: float) -> None:
        self.lines.append(f'returned after {seconds:.2f} s')

    def broken(self, reason: BrokenFrameError) -> None:
        self.lines.append(f'broken: {reason}')

    def waiting(self, seconds: float) -> None:
        self.lines.append(f'waiting {seconds:.0f} s')

    def may_publish(self) -> bool:
        return self.there

    def has_subscribers(self) -> bool:
        return self.looking


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()


@pytest.fixture
def log() -> Log:
    return Log()


@pytest.fixture
def camera(clock: SteppedClock) -> Camera:
    return Camera(clock)


@pytest.fixture
def grab(clock: SteppedClock, log: Log) -> Callable[..., Grabber]:
    """Return a function that creates a grabber for a sequence of cameras and open errors."""
    def _grab(*attempts: Camera | Exception, rate: float = 0.0, **policy: Any) -> Grabber:
        coming = iter(attempts)

        def _open() -> Source:
            attempt = next(coming)
            if isinstance(attempt, Exception):
                raise attempt
            return attempt

        return Grabber(
            _open, CaptureSettings(publish_rate=rate, **policy), log, log, clock)

    return _grab


def take(grabber: Grabber, clock: SteppedClock, seconds: float) -> list[CapturedFrame | None]:
    """Return the frames that come within some seconds."""
    clock.plan(seconds, grabber.stop)
    return list(grabber.frames())


def numbers_of(frames: list[CapturedFrame]) -> list[int]:
    return [int(frame.image[0, 0]) for frame in frames]


@pytest.mark.parametrize(('rate', 'step'), [
    (0.0, 1), (1000.0, 1), (RATE, 1), (64.0, 2), (32.0, 4), (2.0, 64)])
def test_camera_frames_have_the_requested_rate(
        grab: Callable[..., Grabber], clock: SteppedClock, camera: Camera, rate: float,
        step: int) -> None:
    frames = take(grab(camera, rate=rate), clock, 1.0)
    assert numbers_of(frames) == list(range(1, RATE + 1, step))


@pytest.mark.parametrize(('rate', 'first', 'count'), [
    (48.0, [1, 4, 6, 9, 12, 14, 17], 48), (51.2, [1, 3, 6, 8, 11, 13, 16], 52)])
def test_rate_that_does_not_divide_is_met_on_average(
        grab: Callable[..., Grabber], clock: SteppedClock, camera: Camera, rate: float,
        first: list[int], count: int) -> None:
    frames = take(grab(camera, rate=rate), clock, 1.0)
    assert numbers_of(frames)[:7] == first
    assert len(frames) == count


def test_slow_reader_gets_the_newest_frame(
        grab: Callable[..., Grabber], clock: SteppedClock, camera: Camera) -> None:
    taken, ages = [], []
    for frame in itertools.islice(grab(camera).frames(), 5):
        ages.append(clock.now * 10**9 - frame.stamp_ns)
        taken.append(frame)
        clock.step_to(clock.now + 10.5 / RATE)
    assert ages == [0, 0, 0, 0, 0]
    assert numbers_of(taken) == [1, 11, 22, 32, 43]


@pytest.mark.parametrize(('old', 'new', 'changed_at', 'taken'), [
    (0.1, 64.0, 0.5, [1, 64, 66]), (64.0, 0.125, 0.0625, [1, 3, 5, 7]), (0.1, 2.0, 0.25, [1, 65])])
def test_change_of_the_rate_of_a_camera(
        grab: Callable[..., Grabber], clock: SteppedClock, camera: Camera, old: float, new: float,
        changed_at: float, taken: list[int]) -> None:
    grabber = grab(camera, rate=old)
    clock.plan(changed_at, lambda: grabber.use(CaptureSettings(publish_rate=new)))
    assert numbers_of(take(grabber, clock, max(changed_at + 0.02, 0.51)))[:4] == taken


def test_frames_before_their_due_time_are_not_decoded(
        grab: Callable[..., Grabber], clock: SteppedClock, camera: Camera) -> None:
    frames = take(grab(camera, rate=8.0), clock, 0.5)
    assert camera.decoded == numbers_of(frames) == [1, 17, 33, 49]
    assert camera.skipped == sorted({*range(1, 65)} - {*camera.decoded})


def test_frames_without_subscribers_are_counted_not_decoded(
        grab: Callable[..., Grabber], clock: SteppedClock, camera: Camera, log: Log) -> None:
    log.looking = False
    assert take(grab(camera), clock, 0.25) == [None] * (RATE // 4)
    assert camera.skipped == list(range(1, RATE // 4 + 1))
    assert not camera.decoded


@pytest.mark.parametrize('spec', [
    PatternSpec(64, 48, 5.0), PatternSpec(64, 48, 30.0), PatternSpec(64, 48, 90.0, is_depth=True)])
def test_frames_of_a_file_without_subscribers(
        grab: Callable[..., Grabber], clock: SteppedClock, log: Log, spec: PatternSpec) -> None:
    frames = grab(PatternSource(spec)).frames()
    known = PatternSource(spec)
    for number in range(6):
        log.looking = number in (2, 3)
        frame, expected = next(frames), known.read()
        assert callable(frame.pixels) is not log.looking  # drawn when it is used
        assert number == 4 or np.array_equal(frame.image, expected.image)


def test_no_frame_is_published_before_publishing_may_run(
        grab: Callable[..., Grabber], clock: SteppedClock, camera: Camera, log: Log) -> None:
    log.there = False
    clock.plan(0.25, lambda: setattr(log, 'there', True))
    first = next(grab(camera).frames())
    assert numbers_of([first]) == camera.decoded == [RATE // 4]


def test_damaged_frame_is_skipped_and_reported(
        grab: Callable[..., Grabber], clock: SteppedClock, camera: Camera, log: Log) -> None:
    camera.damaged = 5
    frames = take(grab(camera), clock, 8 / RATE)
    assert numbers_of(frames) == [1, 2, 3, 4, 6, 7, 8]
    assert camera.decoded == [1, 2, 3, 4, 5, 6, 7, 8]
    assert log.lines == ['opened', 'broken: it is damaged']


def test_disconnected_camera_is_closed_and_reopened(
        grab: Callable[..., Grabber], clock: SteppedClock, log: Log) -> None:
    first, second = Camera(clock), Camera(clock)
    away = UnavailableError('not there')
    grabber = grab(first, away, away, UnavailableError('not ours'), away, away, second)
    frames = grabber.frames()
    next(frames)
    clock.waits.clear()
    first.fault = UnavailableError('gone')
    next(frames)
    assert first.closed
    assert clock.waits == [0.1, 0.2, 0.4, 0.8, 1.0, 1.0]
    assert log.lines[1:] == ['lost: gone', 'lost: not there', 'lost: not ours', 'lost: not there',
                             'opened', 'returned after 3.50 s']
    assert grabber.outage.count == 1
    assert not grabber.outage.reason


def test_camera_missing_at_the_start_is_retried(
        grab: Callable[..., Grabber], clock: SteppedClock, camera: Camera, log: Log) -> None:
    assert next(grab(UnavailableError('not there'), camera).frames()) is not None
    assert clock.waits == [0.0, 0.1]
    assert log.lines == ['lost: not there', 'opened', 'returned after 0.10 s']


def test_first_retry_delay_after_a_frame(
        grab: Callable[..., Grabber], clock: SteppedClock) -> None:
    cameras = [Camera(clock), Camera(clock), Camera(clock)]
    away = UnavailableError('not there')
    frames = grab(away, away, cameras[0], away, cameras[1], cameras[2]).frames()
    for camera in cameras[:2]:
        next(frames)
        camera.fault = UnavailableError('gone')
    next(frames)
    assert clock.waits == [0.0, 0.1, 0.2, 0.1, 0.2, 0.1]


def test_stalled_camera_is_reopened_until_it_sends_frames(
        grab: Callable[..., Grabber], clock: SteppedClock, log: Log) -> None:
    cameras = [Camera(clock) for _ in range(3)]
    cameras[1].stalled = True
    frames = grab(*cameras, read_timeout=0.25).frames()
    next(frames)
    cameras[0].stalled = True
    began = clock.now
    next(frames)
    # Three waits of 0.1 s (two are shorter than 0.25 s) and a delay; the third camera has a frame.
    assert clock.now - began == pytest.approx(0.3 + 0.1 + 0.3 + 0.2)
    assert [camera.closed for camera in cameras] == [True, True, False]
    assert log.lines[1:] == ['lost: camera sent no frame for 0.25 s', 'opened', 'opened',
                             'returned after 0.90 s']


@pytest.mark.parametrize(('reconnect', 'message', 'waits'), [
    (0.0, 'gone', []), (0.0625, r'not there; gave up after 0\.1 s', [0.0625]),
    (0.5, r'not there; gave up after 0\.5 s', [0.1, 0.2, 0.2]),
    (3.0, r'not there; gave up after 3\.0 s', [0.1, 0.2, 0.4, 0.8, 1.0, 0.5])])
def test_reconnect_timeout(
        grab: Callable[..., Grabber], clock: SteppedClock, camera: Camera, reconnect: float,
        message: str, waits: list[float]) -> None:
    frames = grab(camera, *itertools.repeat(UnavailableError('not there'), 20),
                  reconnect=str(reconnect)).frames()
    next(frames)
    clock.waits.clear()
    camera.fault = UnavailableError('gone')
    began = clock.now
    with pytest.raises(CaptureError, match=f'^{message}$'):
        list(frames)
    assert clock.waits == pytest.approx(waits)
    assert clock.now - began == pytest.approx(reconnect)


def test_permanent_failure_is_not_retried(
        grab: Callable[..., Grabber], clock: SteppedClock, camera: Camera) -> None:
    with pytest.raises(CaptureError, match='no camera'):
        next(grab(CaptureError('no camera'), camera).frames())
    assert clock.now == BEGAN


def test_pause_closes_the_camera_and_resume_reopens_it(
        grab: Callable[..., Grabber], clock: SteppedClock, log: Log) -> None:
    cameras = [Camera(clock), Camera(clock)]
    grabber = grab(*cameras)
    frames = grabber.frames()
    next(frames)
    assert not grabber.pause(0.0)  # the camera is closed when the next frame is requested
    assert grabber.paused

    def look_and_resume() -> None:
        assert grabber.pause(0.0)
        assert cameras[0].closed
        assert log.lines == ['opened']
        grabber.resume()

    clock.plan(1.0, look_and_resume)
    next(frames)
    assert cameras[1].decoded
    assert log.lines == ['opened', 'opened']
    assert BEGAN + 1.0 <= clock.now < BEGAN + 1.0 + 2 * 0.1


def test_pause_waits_until_the_camera_is_closed(
        grab: Callable[..., Grabber], camera: Camera) -> None:
    grabber = grab(camera)
    frames = grabber.frames()
    next(frames)

    def let_go_when_paused() -> None:
        while not grabber.paused:
            pass
        frames.close()

    thread = Thread(target=let_go_when_paused)
    thread.start()
    gone = grabber.pause(LONGEST_SECONDS)
    closed = camera.closed
    thread.join()
    assert gone and closed


def test_pause_of_a_disconnected_camera_returns_at_once(
        grab: Callable[..., Grabber], clock: SteppedClock, camera: Camera) -> None:
    grabber = grab(UnavailableError('not there'), camera)
    gone = []
    clock.plan(0.0625, lambda: gone.append(grabber.pause(0.0)))
    clock.plan(10.0, grabber.resume)
    next(grabber.frames())
    assert gone == [True]
    assert BEGAN + 10.0 < clock.now < BEGAN + 10.2


def test_reopen_request_opens_the_camera_again(
        grab: Callable[..., Grabber], clock: SteppedClock, log: Log) -> None:
    cameras = [Camera(clock), Camera(clock)]
    grabber = grab(*cameras)
    frames = grabber.frames()
    next(frames)
    grabber.reopen()
    next(frames)
    assert [camera.closed for camera in cameras] == [True, False]
    assert clock.waits == [0.0, 0.0]
    assert log.lines == ['opened', 'opened']
    assert grabber.outage.count == 0


def test_stop_ends_the_wait_for_a_camera(
        grab: Callable[..., Grabber], clock: SteppedClock) -> None:
    grabber = grab(*itertools.repeat(UnavailableError('not there'), 50))
    clock.plan(0.8125, grabber.stop)
    assert not list(grabber.frames())
    assert clock.now == BEGAN + 0.8125
