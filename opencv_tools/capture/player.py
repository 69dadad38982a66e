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

"""Playing a source: which of its frames are shown, and when."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import Event
import time

from opencv_tools.capture.frame import BrokenFrameError, CaptureError, Frame, Source

ON_END = ('stop', 'loop', 'hold')
PICTURE_RATE = 10.0  # frames per second of pictures, which have no rate of their own


class Pacer:
    """Say when the next frame is due, so many times a second."""

    def __init__(self, rate: float, stopped: Event, early: float = 0.0) -> None:
        """
        Start at once: the first frame is due now.

        :param rate: frames per second; 0.0 when every frame is due as soon as it is there.
        :param stopped: ends a wait.
        :param early: seconds that a frame may be ahead of its time.
        """
        self._early = early
        self._period = 1.0 / rate if rate else 0.0
        self._stopped = stopped
        self._due = 0.0

    def is_due(self) -> bool:
        """Tell whether the next frame's time has come."""
        return time.monotonic() >= self._due - self._early

    def wait(self) -> None:
        """Wait until the next frame is due, or playing is stopped."""
        delay = self._due - self._early - time.monotonic()
        if delay > 0:
            self._stopped.wait(delay)

    def advance(self) -> None:
        """Take note that a frame was shown; slots that passed meanwhile are not made up for."""
        now = time.monotonic()
        self._due = (self._due or now) + self._period
        if self._period and now > self._due:
            self._due += (now - self._due) // self._period * self._period


class Player:
    """Play every frame of a file at its rate, or the newest of a camera whenever one is due."""

    def __init__(
        self, source: Source, rate: float, on_end: str, stopped: Event,
        on_broken: Callable[[BrokenFrameError], None],
    ) -> None:
        """
        Prepare to play.

        :param source: where the frames come from.
        :param rate: frames per second; 0.0 for the source's own.
        :param on_end: what follows the last frame, one of ``ON_END``: ``stop``, ``loop`` back to
            the first, or ``hold`` the last and show it again at the same rate.
        :param stopped: set by another thread to end the playing.
        :param on_broken: told of each frame that cannot be read and is left out.
        """
        self._source = source
        self._on_end = on_end
        self._stopped = stopped
        self._on_broken = on_broken
        # A camera's frame that comes half its period early is nearer to the slot than the next.
        early = 0.5 / source.rate if source.live and source.rate else 0.0
        self._pacer = Pacer(_shown_rate(source, rate), stopped, early)

    def frames(self) -> Iterator[Frame]:
        """
        Yield each frame when it is due.

        :raises CaptureError: the source broke, or has no frame that can be read.
        """
        for frame in self._sequence():
            self._pacer.wait()
            if self._stopped.is_set():
                return
            yield frame
            self._pacer.advance()

    def _sequence(self) -> Iterator[Frame]:
        """Yield the frames in the order in which they are shown."""
        while True:
            last = None
            for frame in iter(self._read, None):
                last = frame
                yield frame
            if self._stopped.is_set():
                return
            if last is None:
                raise CaptureError(f'{self._source.name} has no frame that can be read')
            if self._on_end == 'stop':
                return
            if self._on_end == 'loop':
                self._source.rewind()
            while self._on_end == 'hold':
                yield last

    def _read(self) -> Frame | None:
        """Read the next readable frame; of a live source the first one that is due."""
        while not self._stopped.is_set():
            try:
                if not self._source.live or self._pacer.is_due():
                    return self._source.read()
                if not self._source.skip():
                    return None
            except BrokenFrameError as err:
                self._on_broken(err)
        return None


def _shown_rate(source: Source, rate: float) -> float:
    """Give the rate to play at; 0.0 means as the frames come."""
    if source.live:
        return min(rate, source.rate) if source.rate else rate
    return rate or source.rate or PICTURE_RATE
