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

"""Pictures of one topic for one page, of the width and quality that its link carries."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from typing import Any

from opencv_tools.topics.rate_meter import RateMeter
from opencv_tools.viewer.protocol import finite, step_width, ViewRequest, WIDTHS
from opencv_tools.viewer.streams.encoding import Picture, PictureOptions
from opencv_tools.viewer.streams.feed import Feed, is_own, NewFrame
from opencv_tools.viewer.streams.rate_limit import EvenRate
from opencv_tools.viewer.streams.stream import Stream


class ShownFrame:
    """Frame of the newest picture that the page has drawn."""

    def __init__(self) -> None:
        self._drawn: tuple[int, NewFrame | None] = 0, None
        self._stepped: NewFrame | None = None
        self._step: asyncio.Future[str] | None = None

    @property
    def held(self) -> NewFrame | None:
        """Return the frame of a paused page."""
        return self._stepped or self._drawn[1]

    def of(self, sequence: int) -> NewFrame | None:
        """Return the frame of the picture that the page shows; None for another picture."""
        drawn, frame = self._drawn
        return frame if drawn == sequence else None

    def step(self, frame: NewFrame) -> asyncio.Future[str]:
        """
        Hold another frame, and give up an earlier step.

        :returns: future of '' once the page has drawn the frame, or of the reason why it cannot.
        """
        if self._step is None or frame is not self._stepped:
            self.close()
            self._stepped = frame
            self._step = asyncio.get_running_loop().create_future()
        return self._step

    def drawn(self, sequence: int, frame: NewFrame | None) -> None:
        """Use the answer of the page to a picture."""
        if sequence > self._drawn[0]:
            self._drawn = sequence, frame
        if frame and frame is self._stepped:
            self.close()

    def failed(self, frame: NewFrame, reason: str) -> None:
        """Use the reason why a frame has no picture."""
        if frame is self._stepped:
            self.close(reason)

    def close(self, reason: str = '') -> None:
        """End a step."""
        if self._step and not self._step.done():
            self._step.set_result(reason)


# Pictures below this width are worse than a lower quality.
_LEAST_WIDTH = 320
_QUALITIES = (60, 40, 25)
# Weight of each answer in the moving averages.
_WEIGHT = 1 / 4
# Number of answers before a change, so that the averages describe the present size.
_LEAST_ANSWERS = 6
# Part of the available time that a picture may need before it is made smaller or larger.
_TOO_SLOW, _QUICK = 1.15, 0.5
# Seconds without a delay before larger pictures are tried, and their maximum after failures.
_FIRST_TRIAL, _LAST_TRIAL = 3.0, 60.0
# A smaller picture that arrives hardly sooner shows that the link is far, not slow.
_FAR = 0.85
#: Maximum number of unanswered pictures of a topic.
MAX_WINDOW = 2


class LinkRate:
    """
    Choose the size of pictures from the times of their answers.

    Width goes down first, then quality. If smaller pictures do not arrive sooner, the round trip
    takes the time. Then two pictures may be on their way instead of one.
    """

    def __init__(self, width: int, quality: int, fixed: bool = False) -> None:
        """
        Start with the wanted size.

        :param width: wanted width in pixels.
        :param fixed: whether the size never changes.
        """
        self._levels = [(width, quality)]
        if not fixed:
            widths = [step for step in reversed(WIDTHS) if _LEAST_WIDTH <= step < width]
            self._levels += [(step, quality) for step in widths]
            self._levels += [(self._levels[-1][0], lower) for lower in _QUALITIES
                             if lower < quality]
        self._level = 0
        self._before: float | None = None  # seconds that a picture needed at the larger size
        self._trial_seconds = _FIRST_TRIAL
        self._trial_at: float | None = None
        self._raised_at: float | None = None
        #: Number of pictures that may be unanswered.
        self.window = 1
        #: Rate of the link in bytes a second, at least; None before the first answer.
        self.bytes_per_second: float | None = None
        self._reset()

    @property
    def width(self) -> int:
        """Return the width of the next picture in pixels."""
        return self._levels[self._level][0]

    @property
    def quality(self) -> int:
        """Return the JPEG quality of the next picture."""
        return self._levels[self._level][1]

    @property
    def is_lowered(self) -> bool:
        """Return whether pictures are smaller than wanted."""
        return self._level > 0

    def answered(self, size: int, seconds: float, period: float, now: float) -> None:
        """
        Use the time of an answer.

        :param size: size of the picture in bytes.
        :param seconds: time from sending to the answer.
        :param period: wanted time between pictures in seconds.
        :param now: monotonic clock in seconds.
        """
        rate = size / max(seconds, 1e-6)
        self.bytes_per_second = (rate if self.bytes_per_second is None else
                                 self.bytes_per_second + (rate - self.bytes_per_second) * _WEIGHT)
        self._seconds += (seconds - self._seconds) * (_WEIGHT if self._answers else 1)
        self._answers += 1
        if self._answers < _LEAST_ANSWERS:
            return
        available = period * self.window
        if self._seconds > _TOO_SLOW * available:
            self._trial_at = None
            self._lower(now)
        elif self._level and self._seconds < _QUICK * available:
            self._trial_at = self._trial_at or now + self._trial_seconds
            if now >= self._trial_at:
                self._change(-1)
                self._raised_at = now
        else:
            self._trial_at = None

    def _lower(self, now: float) -> None:
        """Make the pictures smaller, or allow a second one if that has not helped."""
        if self._raised_at is not None and now - self._raised_at < self._trial_seconds:
            self._trial_seconds = min(2 * self._trial_seconds, _LAST_TRIAL)
        is_far = self._before is not None and self._seconds > _FAR * self._before
        if is_far and self.window < MAX_WINDOW:
            self.window = MAX_WINDOW
            self._change(-self._level)
        elif self._level + 1 < len(self._levels) and not is_far:
            before = self._seconds
            self._change(1)
            self._before = before

    def _change(self, steps: int) -> None:
        self._level += steps
        self._reset()

    def _reset(self) -> None:
        self._answers = 0
        self._seconds = 0.0
        self._before = None
        self._trial_at = None


class Channel:
    """
    Send the newest frame of a stream, when the page has drawn the previous picture.

    There is no queue. Frames that arrive meanwhile are skipped.
    """

    #: Largest number of pictures that the page has not read.
    window = MAX_WINDOW

    def __init__(
        self, stream: Stream, options: ViewRequest, send: Callable[[NewFrame, Picture], int],
        newest: Callable[[Feed], NewFrame | None] = attrgetter('newest'),
    ) -> None:
        """
        Create a channel and send the newest frame.

        :param options: what the viewer requests, without zeros except for the width.
        :param newest: returns the frame of a feed that is sent next; None before the first one.
        """
        self.stream = stream
        self._send = send
        self._newest = newest
        self._loop = asyncio.get_running_loop()
        self._unanswered: dict[int, tuple[float, int, NewFrame | None]] = {}
        #: The frame that the page shows.
        self.shown = ShownFrame()
        self._sent = RateMeter(self._loop.time)
        self._last: tuple[Picture, int] | None = None
        self._last_number = 0
        self._number = 0
        self._limit = EvenRate(self._loop, self.frame_arrived)
        self._is_encoding = False
        self._is_closed = False
        #: What the viewer requests.
        self.options = options
        self._restart_link()
        self.frame_arrived()
        if not options.held:
            stream.join(self.frame_arrived)

    def set_options(self, options: ViewRequest) -> None:
        """Change what the viewer requests, and send the newest frame so."""
        before, self.options = self.options, options
        if options.held:
            self.stream.leave(self.frame_arrived)
        if replace(before, held=options.held) == options:
            return
        if replace(before, region=options.region, limits=options.limits,
                   colors=options.colors) != options:
            self._restart_link()
        self._number = 0
        self.frame_arrived()

    def close(self) -> None:
        """Send nothing any more."""
        self._is_closed = True
        self.shown.close()
        self.stream.leave(self.frame_arrived)
        self._limit.close()

    def frame_arrived(self) -> None:
        """Send the newest frame, unless the page is busy or the frame is not due."""
        frame = self.shown.held if self.options.held else self._newest(self.stream.feed)
        window = self._link.window if self._link and not self.options.held else 1
        if (frame is None or frame.number == self._number or self._is_encoding
                or self._is_closed or len(self._unanswered) >= window):
            return
        source_rate = 0.0 if self.options.held else self.stream.feed.rate
        if not self._limit.allows(self.options.rate, source_rate):
            return
        self._number = frame.number
        self._is_encoding = True
        future = self.stream.picture(frame, self._picture_options())
        future.add_done_callback(lambda done: self._encoded(frame, done))

    def answered(self, sequence: int, busy: float = 0.0) -> bool:
        """
        Use an answer of the page; return whether it belongs to this channel.

        :param busy: seconds that the page was busy with other work, which is no fault of the link.
        """
        if sequence not in self._unanswered:
            return False
        sent_at, size, frame = self._unanswered.pop(sequence)
        self.shown.drawn(sequence, frame)
        now = self._loop.time()
        if self._link and busy < (now - sent_at) / 2:
            period = max(1 / self.options.rate, 1 / (self.stream.feed.rate or 1000))
            self._link.answered(size, now - sent_at - busy, period, now)
        self.frame_arrived()
        return True

    def status(self) -> dict[str, Any]:
        """Return the state of this channel for its page."""
        link = self._link.bytes_per_second if self._link else None
        sent, limits = None, None
        if self._last:
            picture, quality = self._last
            limits = picture.limits and [*map(finite, picture.limits)]
            sent = {'width': picture.width, 'height': picture.height, 'quality': quality,
                    'rate': round(self._sent.rate, 1), 'passed_through': picture.is_kept,
                    'bytes': len(picture.data)}
        return {'sent': sent, 'range': limits,
                'link': None if link is None else round(link * 8e-6, 2)}

    def _restart_link(self) -> None:
        """Begin with the requested size, whatever the link has carried before."""
        options = self.options
        self._width = options.width if options.fixed else step_width(options.width)
        self._link: LinkRate | None = None
        self._source_width = 0

    def _picture_options(self) -> PictureOptions:
        options = self.options
        width, quality = self._width, options.quality
        if self._link:
            width, quality = self._link.width, self._link.quality
            width = 0 if width >= self._source_width else width
        keep = not options.fixed and not (self._link and self._link.is_lowered)
        return PictureOptions(
            width, quality, limits=options.limits, keep=keep, region=options.region,
            colors=options.colors)

    def _encoded(self, frame: NewFrame, future: asyncio.Future[Picture | str]) -> None:
        self._is_encoding = False
        outcome = future.result()
        if isinstance(outcome, str):
            self.shown.failed(frame, outcome)
        elif not self._is_closed:
            self._send_picture(frame, outcome)
        self.frame_arrived()

    def _send_picture(self, frame: NewFrame, picture: Picture) -> None:
        source_width = picture.region.width
        if self._link is None or source_width != self._source_width:
            self._source_width = source_width
            width = min(self._width or source_width, source_width)
            self._link = LinkRate(width, self.options.quality, self.options.fixed)
        now = self._loop.time()
        self._unanswered[self._send(frame, picture)] = (
            now, len(picture.data), frame if self.options.looks or is_own(frame.message) else None)
        if frame.number != self._last_number:  # not again with another region
            self._sent.add()
        self._last_number = frame.number
        self._last = picture, self._link.quality
