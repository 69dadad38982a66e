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

"""Keep a source open: read the newest frame of a camera, and reconnect after an outage."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from threading import Event
from typing import Protocol

from opencv_tools.capture.errors import BrokenFrameError, CaptureError, UnavailableError
from opencv_tools.capture.frame import CapturedFrame, LiveSource, Source
from opencv_tools.capture.player import Clock, Pacer, Player, published_rate, SYSTEM_CLOCK
from opencv_tools.capture.settings import CaptureSettings

# Longest wait for a frame before pause, stop and reopen requests are checked again.
_POLL_SECONDS = 0.1

# Seconds between two attempts to open a disconnected camera: doubled from the first to the last.
_FIRST_DELAY = 0.1
_LAST_DELAY = 1.0


class SourceListener(Protocol):
    """Receiver of the events of a source. All methods run in the thread that reads the source."""

    def opened(self, source: Source, is_back: bool) -> None:
        """Handle a source that has been opened, after an outage or not."""

    def lost(self, reason: UnavailableError, longest: float) -> None:
        """
        Handle a source that is unavailable; called again only when the reason changes.

        :param longest: longest outage in seconds that is waited for.
        """

    def returned(self, source: Source, seconds: float) -> None:
        """Handle a source that sends frames again after an outage of some seconds."""

    def broken(self, reason: BrokenFrameError) -> None:
        """Handle a frame that is unreadable and therefore skipped."""

    def waiting(self, seconds: float) -> None:
        """Handle a wait of more than a minute for the next frame of a file."""


class Demand(Protocol):
    """The demand for the frames of a source."""

    def may_publish(self) -> bool:
        """Return whether publishing may run."""

    def has_subscribers(self) -> bool:
        """Return whether any topic has a subscriber."""


class Outage:
    """The time without frames of a source that is opened again and again."""

    def __init__(self, listener: SourceListener, clock: Clock) -> None:
        #: Reason of the outage; empty while the source sends frames.
        self.reason = ''
        #: Number of outages that have ended.
        self.count = 0
        #: Seconds until the next attempt to open the source.
        self.delay = 0.0
        self._listener = listener
        self._clock = clock
        self.restart()

    def restart(self) -> None:
        """Measure the time without frames from now on."""
        self._last_frame_at = self._clock.monotonic()

    def begin(self, err: UnavailableError, longest: float) -> None:
        """
        Report that the source is unavailable, and set the delay of the next attempt.

        :param longest: longest outage in seconds.
        :raises CaptureError: the outage lasts longer.
        """
        away = self._clock.monotonic() - self._last_frame_at
        left = longest - away
        if left <= 0:
            raise CaptureError(
                f'{err}; gave up after {away:.1f} s' if self.delay else str(err)) from err
        if str(err) != self.reason:
            self.reason = str(err)
            self._listener.lost(err, longest)
        self.delay = min(self.delay * 2 or _FIRST_DELAY, _LAST_DELAY, left)

    def end(self, source: LiveSource) -> None:
        """Record that a frame has come, and report the end of an outage."""
        if self.reason:
            self.count += 1
            self._listener.returned(source, self._clock.monotonic() - self._last_frame_at)
        self.reason = ''
        self.delay = 0.0
        self.restart()


class Grabber:
    """
    A source that is opened, read, and opened again after an outage.

    One thread iterates over ``frames``; the other methods are thread-safe.
    """

    def __init__(
        self, open_source: Callable[[], Source], settings: CaptureSettings,
        listener: SourceListener, demand: Demand, clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        """
        Create a grabber; ``frames`` opens the source.

        :param open_source: function that opens the source; raises ``UnavailableError`` while the
            source is unavailable.
        :param settings: times of frames and outages; ``use`` replaces them.
        :param demand: demand for frames; camera frames without a subscriber are not decoded.
        :param clock: clock that paces frames and measures outages.
        """
        self.settings = settings
        self.source: Source | None = None
        #: Outage of the source, and the number of earlier ones.
        self.outage = Outage(listener, clock)
        self._missed = 0
        self._open_source = open_source
        self._listener = listener
        self._demand = demand
        self._clock = clock
        self._stopped = Event()
        self._changed = Event()  # the settings, or stopped
        self._paused = Event()
        self._reopened = Event()
        self._released = Event()
        self._released.set()

    @property
    def stopped(self) -> bool:
        """Whether ``stop`` was called."""
        return self._stopped.is_set()

    def stop(self) -> None:
        """Stop the iteration over ``frames``."""
        self._stopped.set()
        self._changed.set()

    def use(self, settings: CaptureSettings) -> None:
        """Replace the settings; a wait for the next frame follows them at once."""
        self.settings = settings
        self._changed.set()

    def pause(self, seconds: float) -> bool:
        """
        Stop publishing, and close a camera or stream so that other programs can use it.

        :param seconds: longest wait for the source to close, in seconds.
        :returns: whether the source is closed; always True for a file, which stays open.
        """
        self._paused.set()
        source = self.source
        return (source is not None and not source.live) or self._released.wait(seconds)

    def resume(self) -> None:
        """End a pause."""
        self.outage.restart()
        self._paused.clear()

    @property
    def paused(self) -> bool:
        """Whether publishing is paused."""
        return self._paused.is_set()

    @property
    def missed(self) -> int:
        """Count of the camera frames that were lost because the publisher was too slow."""
        source = self.source
        return self._missed + (source.missed if source is not None and source.live else 0)

    def reopen(self) -> None:
        """Request that a camera or stream is closed and opened with the current settings."""
        self._reopened.set()

    def frames(self) -> Iterator[CapturedFrame | None]:
        """
        Yield each frame when it is due, and None for a camera frame without a subscriber.

        :raises CaptureError: the source cannot be opened, has failed, or was unavailable for
            longer than the reconnect time.
        """
        while (source := self._open()) is not None:
            try:
                if not source.live:
                    player = Player(
                        source, lambda: self.settings, self._stopped,
                        lambda: self.paused or not self._demand.may_publish(),
                        self._listener.broken, self._clock)
                    player.has_subscribers = self._demand.has_subscribers
                    player.on_long_wait = self._listener.waiting
                    player.changed = self._changed
                    yield from player.frames()
                    return
                yield from self._live_frames(source)
            except UnavailableError as err:
                self.outage.begin(err, self.settings.reconnect_seconds)
            finally:
                self._missed = self.missed
                self.source = None
                source.close()
                self._released.set()

    def _open(self) -> Source | None:
        """Open the source, and retry while it is unavailable; return None after ``stop``."""
        while not self._clock.wait(self._stopped, self.outage.delay):
            if self._paused.is_set():
                self.outage.delay = _POLL_SECONDS
                continue
            self._reopened.clear()
            self._released.clear()
            try:
                self.source = self._open_source()
            except UnavailableError as err:
                self._released.set()
                self.outage.begin(err, self.settings.reconnect_seconds)
                continue
            self._listener.opened(self.source, bool(self.outage.reason))
            return self.source
        return None

    def _live_frames(self, source: LiveSource) -> Iterator[CapturedFrame | None]:
        """Yield the newest frame whenever one is due, until the source has to be closed."""
        pacer = Pacer(self._clock)
        # A frame that is up to half a period early is nearer to the due time than the next frame.
        early = 0.5 / source.rate if source.rate else 0.0
        quiet_since = self._clock.monotonic()
        while not (self._stopped.is_set() or self._paused.is_set() or self._reopened.is_set()):
            if not source.wait(_POLL_SECONDS):
                timeout = self.settings.read_timeout
                if self._clock.monotonic() - quiet_since > timeout:
                    raise UnavailableError(f'{source.name} sent no frame for {timeout:g} s')
                continue
            self.outage.end(source)
            if self._changed.is_set():
                self._changed.clear()
                pacer.change(_period(self.settings.publish_rate, source))
            is_due = pacer.is_due(early)
            if (is_due or source.needs_every) and self._demand.may_publish():
                frame: CapturedFrame | None = None
                try:
                    if self._demand.has_subscribers():
                        frame = replace(source.read(), is_due=is_due)
                    else:
                        source.skip()
                except BrokenFrameError as err:
                    self._listener.broken(err)
                else:
                    if is_due:
                        pacer.advance(_period(self.settings.publish_rate, source))
                    if is_due or frame:
                        yield frame
            else:
                source.skip()
            quiet_since = self._clock.monotonic()


def _period(rate: float, source: LiveSource) -> float:
    """Return the seconds between published frames at a rate; 0.0 to publish every frame."""
    return 1.0 / published_rate(rate, source) if rate else 0.0
