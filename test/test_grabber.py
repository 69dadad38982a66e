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

from __future__ import annotations

from collections.abc import Callable, Iterator
import itertools
from threading import Thread
import time

import numpy as np
from opencv_tools.capture.frame import (
    BrokenFrameError, CaptureError, Frame, Source, UnavailableError,
)
from opencv_tools.capture.grabber import Grabber
from opencv_tools.capture.player import Playback
import pytest


class Camera:
    """A camera that gives a numbered frame every 10 ms, whether or not it is read."""

    name = 'camera'
    description = '1x1'
    rate = 100.0
    live = True
    missed = 0

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._number = 0
        self.decoded: list[int] = []
        self.fault: Exception | None = None
        self.stalled = self.closed = False
        self.damaged = 0

    def wait(self, seconds: float) -> bool:
        if self.fault:
            raise self.fault
        due = self._began + (self._number + 1) / self.rate
        if self.stalled:
            time.sleep(seconds)
            return False
        time.sleep(max(0.0, due - time.monotonic()))
        self._number = int((time.monotonic() - self._began) * self.rate)
        return True

    def skip(self) -> None:
        pass

    def read(self) -> Frame:
        self.decoded.append(self._number)
        if len(self.decoded) == self.damaged:
            raise BrokenFrameError('it is damaged')
        return Frame(np.full((1, 1), self._number, np.uint16), 'mono16', time.monotonic_ns())

    def close(self) -> None:
        self.closed = True


class Log:
    """Keep what a grabber tells, and look at its frames or not."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.there = self.looking = True

    def opened(self, source: Source) -> None:
        self.lines.append('opened')

    def lost(self, reason: UnavailableError) -> None:
        self.lines.append(f'lost: {reason}')

    def returned(self, source: Source, seconds: float) -> None:
        self.lines.append(f'returned after {seconds:.1f} s')

    def broken(self, reason: BrokenFrameError) -> None:
        self.lines.append(f'broken: {reason}')

    def is_there(self) -> bool:
        return self.there

    def is_looking(self) -> bool:
        return self.looking


@pytest.fixture
def log() -> Log:
    return Log()


@pytest.fixture
def grab(log: Log) -> Iterator[Callable[..., Grabber]]:
    """Make grabbers of a sequence of cameras and failures to open one, and end them."""
    grabbers: list[Grabber] = []

    def _grab(*attempts: Camera | Exception, **settings: float) -> Grabber:
        coming = iter(attempts)

        def _open() -> Source:
            attempt = next(coming)
            if isinstance(attempt, Exception):
                raise attempt
            return attempt

        grabbers.append(Grabber(_open, Playback(**settings), log, log))
        return grabbers[-1]

    yield _grab
    for grabber in grabbers:
        grabber.stop()


def take(grabber: Grabber, seconds: float) -> list[Frame | None]:
    """Take the frames that come within a time."""
    until = time.monotonic() + seconds
    taken = []
    for frame in grabber.frames():
        taken.append(frame)
        if time.monotonic() > until:
            break
    return taken


@pytest.mark.parametrize(('rate', 'shown'), [(0.0, 100), (20.0, 20), (1000.0, 100)])
def test_a_camera_is_shown_as_often_as_asked_and_never_stale(
        grab: Callable[..., Grabber], rate: float, shown: int) -> None:
    ages = []
    until = time.monotonic() + 1.0
    for frame in grab(Camera(), rate=rate).frames():
        ages.append((time.monotonic_ns() - frame.stamp_ns) / 1e9)
        if time.monotonic() > until:
            break
    assert len(ages) == pytest.approx(shown, rel=0.15)
    assert np.median(ages) < 0.01


def test_frames_that_are_not_due_are_not_decoded(grab: Callable[..., Grabber]) -> None:
    camera = Camera()
    taken = take(grab(camera, rate=10.0), 0.5)
    assert len(camera.decoded) == len(taken) == pytest.approx(6, abs=1)


def test_frames_that_nobody_sees_are_counted_but_not_decoded(
        grab: Callable[..., Grabber], log: Log) -> None:
    camera = Camera()
    log.looking = False
    taken = take(grab(camera), 0.3)
    assert set(taken) == {None}
    assert len(taken) == pytest.approx(30, abs=5)
    assert not camera.decoded


def test_nothing_is_shown_before_the_audience_is_there(
        grab: Callable[..., Grabber], log: Log) -> None:
    log.there = False
    grabber = grab(Camera())
    frames = grabber.frames()
    began = time.monotonic()
    thread = Thread(target=lambda: time.sleep(0.3) or setattr(log, 'there', True))
    thread.start()
    first = next(frames)
    thread.join()
    assert 0.3 <= time.monotonic() - began < 0.4
    assert int(first.image[0, 0]) > 25


def test_a_damaged_frame_is_left_out_and_said(grab: Callable[..., Grabber], log: Log) -> None:
    camera = Camera()
    camera.damaged = 5
    numbers = [int(frame.image[0, 0]) for frame in take(grab(camera), 0.2)]
    assert numbers == camera.decoded[:4] + camera.decoded[5:]
    assert log.lines == ['opened', 'broken: it is damaged']


def test_a_camera_that_goes_is_closed_and_opened_again(
        grab: Callable[..., Grabber], log: Log) -> None:
    first, second = Camera(), Camera()
    away = UnavailableError('not there')
    grabber = grab(first, away, away, UnavailableError('not ours'), second)
    for count, _ in enumerate(grabber.frames()):
        if count == 10:
            first.fault = UnavailableError('gone')
        if count == 20:
            break
    assert first.closed
    assert log.lines[1:] == [
        'lost: gone', 'lost: not there', 'lost: not ours', 'opened', 'returned after 1.5 s']
    assert grabber.reconnects == 1
    assert not grabber.trouble


def test_a_camera_that_is_not_there_yet_is_the_same_case(
        grab: Callable[..., Grabber], log: Log) -> None:
    assert next(grab(UnavailableError('not there'), Camera()).frames()) is not None
    assert log.lines == ['lost: not there', 'opened', 'returned after 0.1 s']


def test_a_camera_that_stalls_is_opened_anew_until_it_gives_frames(
        grab: Callable[..., Grabber], log: Log) -> None:
    cameras = [Camera() for _ in range(3)]
    cameras[1].stalled = True
    grabber = grab(*cameras, read_timeout=0.3)
    for count, _ in enumerate(grabber.frames()):
        if count == 10:
            cameras[0].stalled = True
            stalled_at = time.monotonic()
        if count == 11:
            break
    assert 0.6 < time.monotonic() - stalled_at < 1.5
    assert [camera.closed for camera in cameras[:2]] == [True, True]
    assert [line[:40] for line in log.lines[1:]] == [
        'lost: camera has given no frame for 0.3 ', 'opened', 'opened', log.lines[-1]]
    assert log.lines[-1].startswith('returned after ')


@pytest.mark.parametrize(('reconnect', 'message', 'least', 'most'), [
    (0.0, 'gone', 0.0, 0.1), (0.5, r'not there; given up after 0\.[56] s', 0.5, 0.8)])
def test_a_camera_that_stays_away_is_given_up(
        grab: Callable[..., Grabber], reconnect: float, message: str, least: float,
        most: float) -> None:
    camera = Camera()
    grabber = grab(camera, *itertools.repeat(UnavailableError('not there'), 20),
                   reconnect=reconnect)
    frames = grabber.frames()
    next(frames)
    camera.fault = UnavailableError('gone')
    began = time.monotonic()
    with pytest.raises(CaptureError, match=f'^{message}$'):
        list(frames)
    assert least <= time.monotonic() - began < most


def test_what_cannot_be_opened_at_all_is_not_waited_for(grab: Callable[..., Grabber]) -> None:
    with pytest.raises(CaptureError, match='no camera'):
        next(grab(CaptureError('no camera'), Camera()).frames())


def test_a_pause_lets_the_camera_go_and_an_end_of_it_takes_it_back(
        grab: Callable[..., Grabber], log: Log) -> None:
    cameras = [Camera(), Camera()]
    grabber = grab(*cameras)
    thread = Thread(target=lambda: take(grabber, 1.0))
    thread.start()
    time.sleep(0.2)
    assert grabber.pause(1.0)
    assert cameras[0].closed and grabber.paused
    time.sleep(0.3)
    assert not cameras[1].decoded
    grabber.resume()
    thread.join()
    assert cameras[1].decoded
    assert log.lines == ['opened', 'opened']


def test_a_camera_is_opened_anew_when_something_else_is_wanted_of_it(
        grab: Callable[..., Grabber], log: Log) -> None:
    cameras = [Camera(), Camera()]
    grabber = grab(*cameras)
    frames = grabber.frames()
    next(frames)
    grabber.reopen()
    next(frames)
    assert [camera.closed for camera in cameras] == [True, False]
    assert log.lines == ['opened', 'opened']
    assert grabber.reconnects == 0


def test_a_stop_ends_a_wait_for_a_camera(grab: Callable[..., Grabber]) -> None:
    grabber = grab(*itertools.repeat(UnavailableError('not there'), 50))
    Thread(target=lambda: time.sleep(0.8) or grabber.stop()).start()
    began = time.monotonic()
    assert not list(grabber.frames())
    assert time.monotonic() - began < 1.0
