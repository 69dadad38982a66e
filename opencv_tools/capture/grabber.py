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

"""Keep a source open: show the newest frame of a camera, and find it again when it was away."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import Event
from typing import Protocol

from opencv_tools.capture.clock import Clock, SYSTEM_CLOCK
from opencv_tools.capture.frame import (
    BrokenFrameError, CaptureError, Frame, LiveSource, Source, UnavailableError,
)
from opencv_tools.capture.player import Pacer, Playback, Player

# How long one wait for a frame, or for a change of mind, may last.
_SLICE_SECONDS = 0.1

# A camera that is away is looked for after the first delay, twice that, ..., the last delay.
_FIRST_DELAY = 0.1
_LAST_DELAY = 1.0


class Watcher(Protocol):
    """Who wants to know how it goes with a source; told from the thread that reads it."""

    def opened(self, source: Source) -> None:
        """Hear that a source is open."""

    def lost(self, reason: UnavailableError) -> None:
        """Hear why a source is not there, each time that the reason is another."""

    def returned(self, source: Source, seconds: float) -> None:
        """Hear that a source gives frames again, after so many seconds."""

    def broken(self, reason: BrokenFrameError) -> None:
        """Hear of a frame that is left out."""


class Audience(Protocol):
    """Whom the frames are for."""

    def is_there(self) -> bool:
        """Tell whether the show may begin, and go on."""

    def is_looking(self) -> bool:
        """Tell whether anybody would see the next frame."""


class Grabber:
    """
    The frames of a source, which is opened, and opened again when it comes back.

    One thread runs through ``frames``; the other methods are for any thread. ``trouble`` says why
    the source is away, until it gives frames again.
    """

    def __init__(
        self, open_source: Callable[[], Source], playback: Playback,
        watcher: Watcher, audience: Audience, clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        """
        Prepare to open.

        :param open_source: opens the source, and raises ``UnavailableError`` as long as it is not
            there.
        :param playback: how it is shown; may be replaced at any time.
        :param watcher: told how it goes.
        :param audience: whom the frames are for; a camera's that nobody sees are not decoded.
        :param clock: tells when a frame is due, and how long a source is away.
        """
        self.playback = playback
        self.source: Source | None = None
        self.reconnects = 0
        self._missed = 0
        self._open_source = open_source
        self._watcher = watcher
        self._audience = audience
        self._clock = clock
        self._stopped = Event()
        self._paused = Event()
        self._reopened = Event()
        self._released = Event()
        self._released.set()
        self.trouble = ''
        self._heard_at = self._clock.monotonic()
        self._delay = 0.0

    @property
    def stopped(self) -> bool:
        """Tell whether it was asked to stop."""
        return self._stopped.is_set()

    def stop(self) -> None:
        """End ``frames``."""
        self._stopped.set()

    def pause(self, seconds: float) -> bool:
        """
        Show nothing, and let a camera or stream go, for others to use.

        :param seconds: how long to wait until it has gone.
        :returns: whether it has.
        """
        self._paused.set()
        source = self.source
        return (source is not None and not source.live) or self._released.wait(seconds)

    def resume(self) -> None:
        """Go on after a pause."""
        self._heard_at = self._clock.monotonic()
        self._paused.clear()

    @property
    def paused(self) -> bool:
        """Tell whether nothing is to be shown."""
        return self._paused.is_set()

    @property
    def missed(self) -> int:
        """Count the frames that a camera gave and nobody could take, for want of time."""
        source = self.source
        return self._missed + (source.missed if source is not None and source.live else 0)

    def reopen(self) -> None:
        """Close a camera or stream and open it as it is wanted now."""
        self._reopened.set()

    def frames(self) -> Iterator[Frame | None]:
        """
        Yield each frame when it is due; None for one of a camera that nobody wants to see.

        :raises CaptureError: the source cannot be opened, has broken, or stayed away too long.
        """
        while (source := self._open()) is not None:
            try:
                if not source.live:
                    yield from Player(source, lambda: self.playback, self._stopped, self._is_held,
                                      self._watcher.broken, self._clock).frames()
                    return
                yield from self._show(source)
            except UnavailableError as err:
                self._note_loss(err)
            finally:
                self._missed = self.missed
                self.source = None
                source.close()
                self._released.set()

    def _is_held(self) -> bool:
        return self._paused.is_set() or not self._audience.is_there()

    def _open(self) -> Source | None:
        """
        Open the source as soon as it is there.

        :returns: the source, or None when it was asked to stop.
        :raises CaptureError: it cannot be opened, or stayed away too long.
        """
        while not self._clock.wait(self._stopped, self._delay):
            if self._paused.is_set():
                self._delay = _SLICE_SECONDS
                continue
            self._reopened.clear()
            self._released.clear()
            try:
                self.source = self._open_source()
            except UnavailableError as err:
                self._released.set()
                self._note_loss(err)
                continue
            self._watcher.opened(self.source)
            return self.source
        return None

    def _note_loss(self, err: UnavailableError) -> None:
        """
        Take note that the source is away.

        :raises CaptureError: it has been for too long.
        """
        away = self._clock.monotonic() - self._heard_at
        left = self.playback.reconnect - away
        if left <= 0:
            raise CaptureError(
                f'{err}; gave up after {away:.1f} s' if self._delay else str(err)) from err
        if str(err) != self.trouble:
            self.trouble = str(err)
            self._watcher.lost(err)
        self._delay = min(self._delay * 2 or _FIRST_DELAY, _LAST_DELAY, left)

    def _note_frame(self, source: LiveSource) -> None:
        """Take note that a frame came."""
        if self.trouble:
            self.reconnects += 1
            self._watcher.returned(source, self._clock.monotonic() - self._heard_at)
        self.trouble = ''
        self._delay = 0.0
        self._heard_at = self._clock.monotonic()

    def _show(self, source: LiveSource) -> Iterator[Frame | None]:
        """
        Yield the newest frame whenever one is due, until the source is let go.

        :raises UnavailableError: the source has gone or stalled.
        """
        pacer = Pacer(self._clock)
        # A frame that comes half its period early is nearer to its slot than the next.
        early = 0.5 / source.rate if source.rate else 0.0
        quiet_since = self._clock.monotonic()
        while not (self._stopped.is_set() or self._paused.is_set() or self._reopened.is_set()):
            if not source.wait(_SLICE_SECONDS):
                timeout = self.playback.read_timeout
                if self._clock.monotonic() - quiet_since > timeout:
                    raise UnavailableError(f'{source.name} sent no frame for {timeout:g} s')
                continue
            self._note_frame(source)
            if pacer.is_due(early) and self._audience.is_there():
                try:
                    frame = self._take(source)
                except BrokenFrameError as err:
                    self._watcher.broken(err)
                else:
                    pacer.advance(self._period(source))
                    yield frame
            else:
                source.skip()
            quiet_since = self._clock.monotonic()

    def _take(self, source: LiveSource) -> Frame | None:
        """
        Read a frame if anybody looks.

        :raises BrokenFrameError: it is unreadable.
        """
        if self._audience.is_looking():
            return source.read()
        source.skip()
        return None

    def _period(self, source: LiveSource) -> float:
        """Give the seconds between frames that are shown, 0.0 for each that comes."""
        rate = self.playback.rate
        if rate and source.rate:
            rate = min(rate, source.rate)
        return 1.0 / rate if rate else 0.0
