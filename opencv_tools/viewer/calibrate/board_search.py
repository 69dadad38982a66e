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

"""Search of the newest images of a topic for the board, in a thread of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.units import NANO
from opencv_tools.calibration.detection import BoardFinder, Detection, no_board
from opencv_tools.cv_bridge import CvBridgeError, cvtColorForDisplay
from opencv_tools.image.cdr import WireMessage
from opencv_tools.image.display import finite_limits
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.image_codecs import convert_image
from opencv_tools.opencv import cv2
from opencv_tools.viewer.calibrate.session import Session, Sighting
from opencv_tools.viewer.streams.feed import NewFrame
from opencv_tools.viewer.streams.pixels import read_pixels
from opencv_tools.viewer.streams.stream import Stream

# A thorough search that finds nothing is repeated after this time, and this multiple of its own.
_THOROUGH_SECONDS, _THOROUGH_PART = 1.0, 3.0
_MAX_PIXELS = 1 << 25  # of 8K video


class ThoroughPace:
    """The times of thorough searches, which find why there is no board."""

    def __init__(self) -> None:
        self._due = 0.0

    def is_due(self, now: float) -> bool:
        """Return whether an image may be searched, given the time in seconds."""
        return now >= self._due

    def ended(self, now: float, duration: float) -> None:
        """Use the end and the duration of a search in seconds."""
        self._due = now + max(_THOROUGH_SECONDS, _THOROUGH_PART * duration)


def gray_image(message: WireMessage) -> NDArray[np.uint8]:
    """
    Return an image message as an (h, w) image.

    :raises ImageError: the message is not a valid image, it is too large, or its encoding cannot
        be shown.
    :raises CvBridgeError: the same, of a raw image.
    """
    pixels = read_pixels(message)
    image, encoding = pixels.image, pixels.encoding
    if not 0 < image.shape[0] * image.shape[1] <= _MAX_PIXELS:
        raise ImageError(f'an image of {image.shape[1]}x{image.shape[0]} is not searched for a '
                         'board: make the images smaller')
    image = pixels.numbers(image)
    is_small = np.dtype(encoding.dtype) == np.uint8
    if encoding.kind in ('bayer', 'yuv'):
        color = find_encoding('bgr8' if is_small else 'bgr16')
        image, encoding = convert_image(image, encoding, color), color
    low, high = (0.0, 0.0) if is_small or encoding.channels > 1 else finite_limits(image)
    return cvtColorForDisplay(image, encoding.name, 'mono8', False, low, high)


def search_fast(
    finder: BoardFinder, message: WireMessage,
) -> tuple[NDArray[np.uint8], Detection]:
    """
    Return an image message as ``gray_image`` does, and the board in it by a fast search.

    :raises ImageError: the image cannot be read.
    """
    try:
        gray = gray_image(message)
    except CvBridgeError as err:
        raise ImageError(str(err)) from err
    return gray, search(finder, gray, True)[0]


def search(
    finder: BoardFinder, gray: NDArray[np.uint8], is_fast: bool,
) -> tuple[Detection, float]:
    """Return the board in an image, or why there is none, and the duration in seconds."""
    begin = time.monotonic()
    try:
        found = finder.find(gray, is_fast)
    except (cv2.error, ArithmeticError, IndexError, np.linalg.LinAlgError, ValueError) as err:
        found = no_board((gray.shape[1], gray.shape[0]),
                         f'the search in this image has failed: {err}')
    return found, time.monotonic() - begin


_PERIOD = 1 / 15  # so that one session leaves time for others
_WAIT_SECONDS = 1.0
# A search that ends within this time has pages wait for the next one, for this time at most.
_SHOWN_SECONDS = 1.0
_IDLE_SECONDS = 0.2

#: What a page gets after a search: the newest image, or why it cannot be read.
Seen = Sighting | Exception


class BoardSearch:
    """
    Search a stream while somebody looks.

    All methods run in the loop of the server. A thread searches.
    """

    def __init__(
        self, stream: Stream, session: Session, thread: Executor, is_watched: Callable[[], bool],
        on_seen: Callable[[str, Seen], object],
    ) -> None:
        """
        Begin to search.

        :param session: session that gets the boards.
        :param thread: the thread that searches.
        :param is_watched: returns whether somebody looks.
        :param on_seen: called after each search with the identity of the frame.
        """
        self._stream = stream
        self._session = session
        self._thread = thread
        self._is_watched = is_watched
        self._on_seen = on_seen
        self._pace = ThoroughPace()
        self._shown: NewFrame | None = None
        self._shown_until = 0.0
        self._loop = asyncio.get_running_loop()
        stream.searched = self.shown
        self._watching = asyncio.ensure_future(self._watch())

    def close(self) -> None:
        """Search no more, and leave the frames of the stream to its pages."""
        self._watching.cancel()
        feed = self._stream.feed
        self._stream.searched = lambda: feed.newest

    async def _watch(self) -> None:
        """Search each new image, but no faster than the period."""
        number = 0
        while True:
            finder = self._session.finder
            if finder is None or not self._is_watched():
                await asyncio.sleep(_IDLE_SECONDS)
                continue
            begin = self._loop.time()
            frame = await self._stream.next_frame(number, _WAIT_SECONDS)
            if frame is None:
                continue
            number, searched = frame.number, self._loop.time()
            try:
                await self._examine(frame, finder)
            except ImageError as err:
                self._on_seen(frame.identity, err)
            if self._loop.time() < searched + _SHOWN_SECONDS:
                self._show(frame)
            await asyncio.sleep(max(0.0, begin + _PERIOD - self._loop.time()))

    def shown(self) -> NewFrame | None:
        """
        Return the frame that pages show, so that corners are drawn over the image they are of.

        :returns: the frame that was searched last; the newest one without quick searches. It is
            never older than the one before, and None before the first one.
        """
        if self._shown is None or self._loop.time() >= self._shown_until:
            self._shown = self._stream.feed.newest
        return self._shown

    def _show(self, frame: NewFrame) -> None:
        """Have pages show a frame that was searched."""
        if self._shown is None or frame.number > self._shown.number:
            self._shown = frame
        self._shown_until = self._loop.time() + _SHOWN_SECONDS
        for watcher in tuple(self._stream.watchers):
            watcher()

    async def _examine(self, frame: NewFrame, finder: BoardFinder) -> None:
        """Search an image for the board, and again for all details if they are needed."""
        session = self._session
        gray, found = await self._call(partial(search_fast, finder, frame.message))
        if not found.is_found and self._pace.is_due(time.monotonic()):
            found, duration = await self._call(partial(search, finder, gray, False))
            self._pace.ended(time.monotonic(), duration)
        if session.finder is not finder:
            return  # another board was chosen meanwhile
        if session.look(found, frame.receive_ns / NANO):
            found, _ = await self._call(partial(search, finder, gray, False))
            if session.finder is not finder:
                return
            session.take(found)
        if session.sighting:
            self._on_seen(frame.identity, session.sighting)

    async def _call(self, function: Callable[[], Any]) -> Any:
        return await self._loop.run_in_executor(self._thread, function)
