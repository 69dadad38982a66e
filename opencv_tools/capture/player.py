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

"""Playback of files: every frame in order, each at its due time by a clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from threading import Event, TIMEOUT_MAX
import time

from opencv_tools.capture.errors import BrokenFrameError, CaptureError
from opencv_tools.capture.frame import CapturedFrame, FileSource, Source
from opencv_tools.capture.settings import CaptureSettings

IMAGE_RATE = 10.0  # frames per second of image files, which have no native rate

#: A longer wait for the next image or message of a bag is logged.
LONG_WAIT_SECONDS = 60.0
_PAUSE_POLL_SECONDS = 0.02


class Clock:
    """The monotonic clock of the machine, and waits that time out by this clock."""

    def monotonic(self) -> float:
        """Return the seconds of CLOCK_MONOTONIC."""
        return time.monotonic()

    def wait(self, event: Event, seconds: float) -> bool:
        """
        Wait until an event is set or the timeout has passed.

        :param event: event that ends the wait.
        :param seconds: timeout in seconds.
        :returns: whether the event is set.
        """
        return event.wait(min(seconds, TIMEOUT_MAX))


#: The default clock of all classes of this package.
SYSTEM_CLOCK = Clock()


class Pacer:
    """The due time of the next frame."""

    def __init__(self, clock: Clock = SYSTEM_CLOCK) -> None:
        self._clock = clock
        self._due = self._last = 0.0  # due times of the next frame and of the last one

    def is_due(self, early: float = 0.0) -> bool:
        """
        Return whether the next frame is due.

        :param early: tolerance in seconds: a frame counts as due this long before its due time.
        """
        return self._clock.monotonic() >= self._due - early

    @property
    def seconds_left(self) -> float:
        """Seconds until the next frame is due; negative if it is late."""
        return self._due - self._clock.monotonic()

    def wait(self, ended: Event) -> int:
        """
        Wait until the next frame is due, or an event is set.

        :param ended: event that ends the wait.
        :returns: due time in nanoseconds of CLOCK_MONOTONIC.
        """
        self._due = self._due or self._clock.monotonic()
        if self.seconds_left > 0:
            self._clock.wait(ended, self.seconds_left)
        return int(self._due * 1e9)

    def advance(self, interval: float) -> None:
        """
        Set the due time of the next frame, counted from the due time of this one.

        After a delay of more than one interval the schedule continues from the current time:
        frames are not played faster to catch up.

        :param interval: seconds from this frame to the next.
        """
        now = self._clock.monotonic()
        self._last = self._due or now
        self._due = max(self._last + interval, now - interval)

    def change(self, interval: float) -> None:
        """
        Set another interval after the last frame; the next one is due now if it has passed.

        The first frame is due at once with any interval.

        :param interval: seconds from the last frame to the next.
        """
        if self._last:
            self._due = max(self._last + interval, self._clock.monotonic())

    def restart(self) -> None:
        """Make the next frame due now."""
        self._due = 0.0


class Player:
    """Playback of every frame of a file, at a fixed rate or with the times of the file."""

    def __init__(
        self, source: FileSource, settings: Callable[[], CaptureSettings], stopped: Event,
        is_paused: Callable[[], bool], on_broken: Callable[[BrokenFrameError], object],
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        """
        Create a player; ``frames`` starts the playback.

        :param settings: function that returns the current settings; called for each frame.
        :param stopped: event that another thread sets to end the playback.
        :param is_paused: function that returns whether playback is paused.
        :param on_broken: function that is called for each unreadable frame, which is skipped.
        :param clock: clock that paces the frames.
        """
        #: Called with the seconds of a wait of more than a minute, which the file requires.
        self.on_long_wait: Callable[[float], object] = lambda seconds: None
        #: Returns whether frames are decoded before they are due, or only if the image is used.
        self.has_subscribers: Callable[[], bool] = lambda: True
        #: Ends a wait: set after ``stopped``, and after a change of the settings.
        self.changed = stopped
        self._source = source
        self._settings = settings
        self._stopped = stopped
        self._is_paused = is_paused
        self._on_broken = on_broken
        self._clock = clock

    def frames(self) -> Iterator[CapturedFrame]:
        """
        Yield each frame at its due time, with the due time as its stamp.

        :raises CaptureError: the source has failed, or has no readable frame.
        """
        pacer = Pacer(self._clock)
        last: CapturedFrame | None = None
        for frame in self._sequence():
            if last is not None:
                pacer.advance(self._interval(last, frame))
            while self._is_paused() and not self._clock.wait(self._stopped, _PAUSE_POLL_SECONDS):
                pacer.restart()
            if pacer.seconds_left > LONG_WAIT_SECONDS and not self._settings().publish_rate:
                self.on_long_wait(pacer.seconds_left)
            due_ns = pacer.wait(self.changed)
            while self.changed.is_set() and not self._stopped.is_set():
                self.changed.clear()
                if last is not None:
                    pacer.change(self._interval(last, frame))
                due_ns = pacer.wait(self._stopped if self._stopped.is_set() else self.changed)
            if self._stopped.is_set():
                return
            yield replace(frame, stamp_ns=due_ns)
            last = frame

    def _interval(self, last: CapturedFrame, frame: CapturedFrame) -> float:
        """Return the seconds from one frame to the next."""
        rate = self._settings().publish_rate
        if not rate and last.position is not None and frame.position is not None:
            interval = frame.position - last.position
            if interval > 0:  # negative from the last frame back to the first
                return interval
        return 1.0 / published_rate(rate, self._source)

    def _sequence(self) -> Iterator[CapturedFrame]:
        """Yield the frames in playback order, with repetitions."""
        played = 0
        while True:
            last = None
            for frame in self._readable_frames():
                last = frame
                yield frame
            played += 1
            if self._stopped.is_set():
                return
            if last is None:
                raise CaptureError(f'{self._source.name} has no readable frame')
            settings = self._settings()
            if not settings.plays or played < settings.plays:
                self._source.rewind()
                continue
            while settings.on_end == 'hold':
                yield last
            return

    def _readable_frames(self) -> Iterator[CapturedFrame]:
        """Yield the readable frames of one pass."""
        settings = self._settings()
        first, stop = settings.start_frame, settings.stop_frame
        for number in range(first):
            if not self._source.skip():
                raise self._too_short(number, first)
        number = first
        while not self._stopped.is_set() and (not stop or number < stop):
            number += 1
            try:
                frame = (self._source.read() if self.has_subscribers() else
                         self._source.read_ahead())
            except BrokenFrameError as err:
                self._on_broken(err)
                continue
            if frame is None:
                if number == first + 1 > 1:
                    raise self._too_short(first, first)
                return
            yield frame

    def _too_short(self, count: int, first: int) -> CaptureError:
        return CaptureError(f'start_frame is {first}, but {self._source.name} has only {count} '
                            'frames, numbered from 0')


def published_rate(rate: float, source: Source) -> float:
    """
    Return the expected number of published frames per second; 0.0 if it is unknown.

    :param rate: number that is asked for; 0.0 to publish each frame at its time.
    """
    if source.live:
        return min(rate, source.rate) if rate and source.rate else rate or source.rate
    return rate or source.rate or IMAGE_RATE
