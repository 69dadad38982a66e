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

"""Pictures of one topic for all its viewers."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from typing import Any, ParamSpec, TypeVar

from opencv_tools.base.logs import Log
from opencv_tools.viewer.protocol import finite
from opencv_tools.viewer.streams.depth_colors import DepthRange, Steady
from opencv_tools.viewer.streams.encoding import Picture, picture_or_reason, PictureOptions
from opencv_tools.viewer.streams.feed import Feed, FeedKey, NewFrame
from opencv_tools.viewer.streams.packets import PACKETS
from opencv_tools.viewer.streams.pixels import Pixels, read_pixels
from opencv_tools.viewer.watched import in_loop, Watched

_P = ParamSpec('_P')
_T = TypeVar('_T')

# Time after the last question about pixels until they are forgotten.
_PIXELS_SECONDS = 2.0
# Pictures of a frame that are kept for other pages; a page may request any region.
_MAX_PICTURES = 16


class Stream(Watched[Callable[[], object]]):
    """
    Encode the newest frame of a topic, once for each size and quality.

    All methods run in the loop of the server. The pool encodes.
    """

    def __init__(
        self, number: int, key: FeedKey, loop: asyncio.AbstractEventLoop, pool: Executor,
        log: Log, feed_type: type[Feed] = Feed,
    ) -> None:
        """
        Create a stream without viewers.

        :param key: name of the topic, and the transport.
        :param pool: threads that encode.
        """
        super().__init__()
        self.number = number
        self.key = key
        self.name, _ = key
        #: The last picture that was encoded; None before the first one.
        self.last_picture: Picture | None = None
        #: Number of encodings so far.
        self.encodings = 0
        self._loop = loop
        self._pool = pool
        self._log = log
        self._range = DepthRange()
        self._error = ''  # of the newest picture
        self._logged = ''
        self._broken = 0
        self._broken_number = 0
        self._newest_number = 0  # of the frames that were encoded
        self._is_notified = False
        self._wake = in_loop(self._frame_arrived)
        self._pictures: dict[PictureOptions, tuple[int, asyncio.Future[Picture | str]]] = {}
        self._pixels: tuple[int, asyncio.Future[Pixels]] | None = None
        self._forgets: asyncio.TimerHandle | None = None
        self.feed = feed_type(self._notify)
        #: Returns the frame on pages that calibrate; None before the first one.
        self.searched: Callable[[], NewFrame | None] = lambda: self.feed.newest

    @property
    def broken(self) -> int:
        """Return the number of messages that are not valid images."""
        return self.feed.broken + self._broken

    @property
    def error(self) -> str:
        """Return the reason why the newest frame is not shown; '' if there is none."""
        return self.feed.error or self._error

    def status(self) -> dict[str, Any]:
        """Return what the protocol tells about the pictures."""
        feed, picture = self.feed, self.last_picture
        width, height = picture.source_size if picture else (0, 0)
        limits = picture and picture.limits
        quiet, restarted = feed.quiet_seconds, feed.restarts.seconds
        return {
            'id': self.number, 'name': self.name, 'width': width, 'height': height,
            'encoding': picture.encoding if picture else '',
            'unit': picture.unit if picture else '', 'rate': round(feed.rate, 1),
            'frames': feed.frames, 'broken': self.broken, 'encodings': self.encodings,
            'quiet': None if quiet is None else round(quiet, 2),
            'restarted': None if restarted is None else round(restarted, 1),
            'lost': feed.lost, 'reason': feed.reason or self.error,
            'range': limits and [finite(limit) for limit in limits]}

    def picture(self, frame: NewFrame, options: PictureOptions) -> asyncio.Future[Picture | str]:
        """
        Return the picture of a frame; viewers with the same options share it.

        :param frame: newest frame.
        :returns: future of the picture, or of the reason why there is none.
        """
        number, future = self._pictures.get(options, (0, None))
        if future is None or number != frame.number:
            self.encodings += 1
            # A frame that is encoded again, or that a page holds, keeps its colours.
            began = self._loop.time()
            steady = (self._range.at(began) if frame.number > self._newest_number
                      else Steady(self._range.limits))
            future = self._loop.run_in_executor(
                self._pool, picture_or_reason, frame.message, options, steady)
            future.add_done_callback(
                lambda done: self.record(frame.number, done.result(), began))
            kept = [(key, value) for key, value in self._pictures.items()
                    if value[0] == frame.number]
            self._pictures = dict(kept[-_MAX_PICTURES:])
            self._pictures[options] = frame.number, future
        return future

    async def pixels(self, frame: NewFrame) -> Pixels:
        """
        Return the pixels of a frame, upright; those of the last one are kept for 2 s.

        :raises ImageError: the message is not a valid image.
        :raises CvBridgeError: the message is not a valid image.
        """
        if self._pixels is None or self._pixels[0] != frame.number:
            self._pixels = frame.number, asyncio.ensure_future(
                self.in_pool(read_pixels, frame.message, upright=True,
                             codec='decoded video' if self.key[1] == PACKETS else ''))
        if self._forgets:
            self._forgets.cancel()
        self._forgets = self._loop.call_later(_PIXELS_SECONDS, self._forget_pixels)
        return await asyncio.shield(self._pixels[1])

    def _forget_pixels(self) -> None:
        self._pixels = None

    async def next_frame(self, after: int, seconds: float) -> NewFrame | None:
        """
        Wait for a frame.

        :param after: number of the last frame that is too old.
        :param seconds: maximum time in seconds.
        :returns: the newest frame, or None.
        """
        arrived = asyncio.Event()
        self.watchers.add(arrived.set)
        try:
            deadline = self._loop.time() + seconds
            while self.feed.frames <= after:
                arrived.clear()
                await asyncio.wait_for(arrived.wait(), deadline - self._loop.time())
        except asyncio.TimeoutError:
            return None
        finally:
            self.watchers.discard(arrived.set)
        return self.feed.newest

    async def in_pool(self, function: Callable[_P, _T], *args: _P.args,
                      **keywords: _P.kwargs) -> _T:
        """Return the result of a function that a thread of the pool calls."""
        call = partial(function, *args, **keywords)
        return await self._loop.run_in_executor(self._pool, call)

    def record(self, number: int, outcome: Picture | str, began: float = 0.0) -> None:
        """
        Record the outcome of an encoding.

        :param number: number of the frame; negative for one that a page has stepped to.
        :param outcome: the picture, or the reason why there is none.
        :param began: time when the encoding of a picture of numbers began.
        """
        if number < 0:
            return
        if isinstance(outcome, Picture):
            if number < self._newest_number:
                return  # a page holds this frame, and looks into it
            if outcome.measured and number > self._newest_number:
                self._range.follow(outcome.measured, began)
            self._newest_number = number
            self.last_picture = outcome
            self._error = ''
            return
        self._error = outcome
        if self._broken_number != number:
            self._broken_number = number
            self._broken += 1
        if outcome != self._logged and self._log.warning(
                f'frame of {self.name} left out: {outcome}', every=1.0, key=self.name):
            self._logged = outcome

    def _notify(self) -> None:
        """Wake the loop, in the executor; once for all frames that it has not seen yet."""
        if not self._is_notified:
            self._is_notified = True
            self._wake()

    def _frame_arrived(self) -> None:
        self._is_notified = False
        for watcher in tuple(self.watchers):
            watcher()
