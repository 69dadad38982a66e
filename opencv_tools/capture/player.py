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

"""Play a file: every frame in order, each when it is due."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
import math
from threading import Event

from opencv_tools.capture.clock import Clock, SYSTEM_CLOCK
from opencv_tools.capture.frame import BrokenFrameError, CaptureError, FileSource, Frame

ON_END = ('stop', 'loop', 'hold')
PICTURE_RATE = 10.0  # frames per second of pictures, which have no rate of their own

_HELD_SECONDS = 0.02


@dataclass(frozen=True)
class Playback:
    """
    How a source is shown.

    :param rate: frames per second; 0.0 for the source's own.
    :param on_end: what follows the last frame of a file, one of ``ON_END``: ``stop``, ``loop``
        back to the first, or ``hold`` the last and show it again at the same rate.
    :param plays: how often a file is played before its end counts; 0 for ever.
    :param first: number of the first frame of a file to show, from 0.
    :param stop: number of the frame of a file to end before; 0 for its end.
    :param read_timeout: seconds without a frame after which a camera has stalled.
    :param reconnect: seconds after which a camera that is away is given up.
    """

    rate: float = 0.0
    on_end: str = 'stop'
    plays: int = 1
    first: int = 0
    stop: int = 0
    read_timeout: float = 2.0
    reconnect: float = math.inf


class Pacer:
    """Say when the next frame is due."""

    def __init__(self, clock: Clock = SYSTEM_CLOCK) -> None:
        """Start at once: the first frame is due now."""
        self._clock = clock
        self._due = 0.0

    def is_due(self, early: float = 0.0) -> bool:
        """
        Tell whether the next frame's time has come.

        :param early: seconds that it may be ahead of its time.
        """
        return self._clock.monotonic() >= self._due - early

    def wait(self, stopped: Event) -> int:
        """
        Wait until the next frame is due, or playing is stopped.

        :returns: when it was due, in nanoseconds of CLOCK_MONOTONIC.
        """
        self._due = self._due or self._clock.monotonic()
        delay = self._due - self._clock.monotonic()
        if delay > 0:
            self._clock.wait(stopped, delay)
        return int(self._due * 1e9)

    def advance(self, interval: float) -> None:
        """
        Take note that a frame was shown; time that was lost is not made up for.

        :param interval: seconds until the next.
        """
        now = self._clock.monotonic()
        self._due = max((self._due or now) + interval, now - interval)

    def restart(self) -> None:
        """Let the next frame be due now."""
        self._due = 0.0


class Player:
    """Play every frame of a file, at the rate that is asked for or in its own time."""

    def __init__(
        self, source: FileSource, playback: Callable[[], Playback], stopped: Event,
        is_held: Callable[[], bool], on_broken: Callable[[BrokenFrameError], object],
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        """
        Prepare to play.

        :param source: where the frames come from.
        :param playback: tells how to play; asked again for each frame.
        :param stopped: set by another thread to end the playing.
        :param is_held: tells whether nothing shall be shown for now.
        :param on_broken: told of each frame that cannot be read and is left out.
        :param clock: tells when a frame is due.
        """
        self._source = source
        self._playback = playback
        self._stopped = stopped
        self._is_held = is_held
        self._on_broken = on_broken
        self._clock = clock

    def frames(self) -> Iterator[Frame]:
        """
        Yield each frame when it is due, stamped with that time.

        :raises CaptureError: the source broke, or has no frame that can be read.
        """
        pacer = Pacer(self._clock)
        last: Frame | None = None
        for frame in self._sequence():
            if last is not None:
                pacer.advance(self._interval(last, frame))
            while self._is_held() and not self._clock.wait(self._stopped, _HELD_SECONDS):
                pacer.restart()
            due_ns = pacer.wait(self._stopped)
            if self._stopped.is_set():
                return
            yield replace(frame, stamp_ns=due_ns)
            last = frame

    def _interval(self, last: Frame, frame: Frame) -> float:
        """Give the seconds from one frame to the next."""
        rate = self._playback().rate
        if not rate and last.position is not None and frame.position is not None:
            interval = frame.position - last.position
            if interval > 0:  # but from the last frame to the first there is none
                return interval
        return 1.0 / (rate or self._source.rate or PICTURE_RATE)

    def _sequence(self) -> Iterator[Frame]:
        """Yield the frames in the order in which they are shown."""
        played = 0
        while True:
            last = None
            for frame in self._pass():
                last = frame
                yield frame
            played += 1
            if self._stopped.is_set():
                return
            if last is None:
                raise CaptureError(f'{self._source.name} has no readable frame')
            playback = self._playback()
            if not playback.plays or played < playback.plays:
                self._source.rewind()
                continue
            while playback.on_end == 'hold':
                yield last
            return

    def _pass(self) -> Iterator[Frame]:
        """
        Yield the frames that can be read, once.

        :raises CaptureError: the source ends before the first frame to show.
        """
        playback = self._playback()
        for number in range(playback.first):
            if not self._source.skip():
                raise self._too_short(number, playback.first)
        number = playback.first
        while not self._stopped.is_set() and (not playback.stop or number < playback.stop):
            number += 1
            try:
                frame = self._source.read()
            except BrokenFrameError as err:
                self._on_broken(err)
                continue
            if frame is None:
                if number == playback.first + 1 > 1:
                    raise self._too_short(playback.first, playback.first)
                return
            yield frame

    def _too_short(self, count: int, first: int) -> CaptureError:
        return CaptureError(f'start_frame is {first}, but {self._source.name} has only {count} '
                            'frames, numbered from 0')
