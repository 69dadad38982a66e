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

"""The frames and the clock, at which the messages of a bag wait."""

from __future__ import annotations

from collections.abc import Callable
from threading import Condition
import time

from opencv_tools.capture.frame import Recorded
from opencv_tools.capture.player import LONG_WAIT_SECONDS
from opencv_tools.units import NANO

_MAX_WAIT_SECONDS = 3600.0  # times in a bag may be years apart
_PATIENCE_SECONDS = 2.0  # until a long wait is logged, because an image may end the wait


class Pace:
    """The frames and the clock, at which the messages of a bag wait."""

    def __init__(self, from_start: bool, on_long_wait: Callable[[float], object]) -> None:
        """
        Wait for the first frame.

        :param from_start: whether the messages before the first frame wait for their times.
        :param on_long_wait: called with the seconds of a wait of more than a minute.
        """
        self.changed = Condition()
        self.is_closed = False
        self._from_start = from_start
        self._on_long_wait = on_long_wait
        self._frame: Recorded | None = None  # the newest frame
        self._anchor: tuple[int, float] | None = None  # a time of the bag, and the time it was at
        self._reached = -1, -1  # play and time of the image that the messages have come to
        self._begun = -1  # play whose first frame is published
        self._ended = -1  # play whose messages are published
        self._is_finishing = False

    def advance(self, frame: Recorded) -> None:
        """
        Set the newest frame. A frame that is held comes again and changes nothing.

        The first frame of a play waits for the messages after the last frame of the play before,
        as ``finish`` does, and for the messages before itself.
        """
        with self.changed:
            last = self._frame
            if last and (last.play, last.log_ns) == (frame.play, frame.log_ns):
                return
            is_first = last is None or last.play != frame.play
            if is_first:
                self.finish()
                self._is_finishing = False
            self._frame = frame
            self.changed.notify_all()
            if is_first:
                self.changed.wait_for(
                    lambda: self._reached >= (frame.play, frame.log_ns) or self._is_over)
            self._begun, self._anchor = frame.play, (frame.log_ns, time.monotonic())
            self.changed.notify_all()

    def finish(self) -> None:
        """End the play at the next image, and wait for that."""
        with self.changed:
            self._is_finishing = True
            self.changed.notify_all()
            self.changed.wait_for(lambda: self._frame is None or self._is_over)

    def close(self) -> None:
        """End all waits."""
        with self.changed:
            self.is_closed = True
            self.changed.notify_all()

    def end_play(self, play: int) -> None:
        """Set the play whose messages are all published."""
        with self.changed:
            self._ended = play
            self.changed.notify_all()

    def next_play(self, last: Recorded | None) -> Recorded | None:
        """Wait for the first frame of another play than that of a frame; None at the end."""
        with self.changed:
            while not self.is_closed and (
                    self._frame is None or (last and self._frame.play == last.play)):
                self.changed.wait()
            self._anchor = None
            return None if self.is_closed else self._frame

    def waits_for_frame(self, play: int, log_ns: int) -> bool:
        """Wait at an image until its frame or a later one is published; False at the end."""
        with self.changed:
            self._reached = play, log_ns
            self.changed.notify_all()
            self.changed.wait_for(lambda: self._is_finishing or self.is_closed or (
                self._begun >= play and self._is_past(play, log_ns)))
            return self._is_playing(play) and self._is_past(play, log_ns)

    def waits_until_due(self, play: int, log_ns: int, is_before: bool) -> bool:
        """
        Wait until a message is due, or the next frame is published; return False at the end.

        :param is_before: whether the message is before the first frame.
        """
        began, is_reported = time.monotonic(), False
        with self.changed:
            while self._is_playing(play):
                if self._anchor is None:
                    self._anchor = log_ns, time.monotonic()
                at_ns, at = self._anchor
                seconds = (log_ns - at_ns) / NANO - (time.monotonic() - at)
                if (seconds <= 0 or (is_before and not self._from_start)
                        or (not is_before and self._is_past(play, log_ns))):
                    return True
                longest = _MAX_WAIT_SECONDS
                if seconds > LONG_WAIT_SECONDS and not is_reported:
                    longest = began + _PATIENCE_SECONDS - time.monotonic()
                    if longest <= 0:
                        is_reported, longest = True, _MAX_WAIT_SECONDS
                        self._on_long_wait(seconds)
                self.changed.wait(min(seconds, longest))
            return False

    @property
    def _is_over(self) -> bool:
        return self.is_closed or (self._frame is not None and self._ended >= self._frame.play)

    def _is_playing(self, play: int) -> bool:
        return not self.is_closed and self._frame is not None and self._frame.play == play

    def _is_past(self, play: int, log_ns: int) -> bool:
        """Return whether a frame of a time or a later one is published."""
        return self._frame is not None and (
            self._frame.play, self._frame.log_ns) >= (play, log_ns)
