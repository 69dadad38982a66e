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

"""Pictures of one topic for one page; the next one is sent when the page has answered."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from typing import Any

from opencv_tools.topics.rate_meter import RateMeter
from opencv_tools.viewer.encoding import Picture, PictureOptions
from opencv_tools.viewer.feed import Feed, NewFrame
from opencv_tools.viewer.link_rate import LinkRate, MAX_WINDOW
from opencv_tools.viewer.protocol import finite, step_width, ViewOptions
from opencv_tools.viewer.rate_limit import RateLimit
from opencv_tools.viewer.shown_frame import ShownFrame
from opencv_tools.viewer.stream import Stream


class Channel:
    """
    Send the newest frame of a stream, when the page has drawn the previous picture.

    There is no queue. Frames that arrive meanwhile are skipped.
    """

    #: Largest number of pictures that the page has not read.
    window = MAX_WINDOW

    def __init__(
        self, stream: Stream, options: ViewOptions, send: Callable[[NewFrame, Picture], int],
        newest: Callable[[Feed], NewFrame | None] = attrgetter('newest'),
    ) -> None:
        """
        Create a channel and send the newest frame.

        :param stream: stream of the topic.
        :param options: what the viewer requests, without zeros except for the width.
        :param send: sends a picture and returns its sequence number.
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
        self._limit = RateLimit(self._loop, self.frame_arrived)
        self._is_encoding = False
        self._is_closed = False
        #: What the viewer requests.
        self.options = options
        self._restart_link()
        self.frame_arrived()
        stream.watchers.add(self.frame_arrived)

    def set_options(self, options: ViewOptions) -> None:
        """Change what the viewer requests, and send the newest frame so."""
        before, self.options = self.options, options
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
        self.stream.watchers.discard(self.frame_arrived)
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

    def answered(self, sequence: int) -> bool:
        """Use an answer of the page; return whether it belongs to this channel."""
        if sequence not in self._unanswered:
            return False
        sent_at, size, frame = self._unanswered.pop(sequence)
        self.shown.drawn(sequence, frame)
        now = self._loop.time()
        if self._link:
            period = max(1 / self.options.rate, 1 / (self.stream.feed.rate or 1000))
            self._link.answered(size, now - sent_at, period, now)
        self.frame_arrived()
        return True

    def frame_of(self, sequence: int) -> NewFrame | None:
        """Return the frame of the picture that the page shows; None for another picture."""
        return self.shown.of(sequence)

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
            now, len(picture.data), frame if self.options.looks else None)
        if frame.number != self._last_number:  # not again with another region
            self._sent.add()
        self._last_number = frame.number
        self._last = picture, self._link.quality
