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

"""Search of the newest images of a stream for the board of a session."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
import time
from typing import Any

from opencv_tools.calibration.detection import BoardFinder
from opencv_tools.image.errors import ImageError
from opencv_tools.units import NANO
from opencv_tools.viewer.calibrate.searches import search, search_fast, ThoroughPace
from opencv_tools.viewer.calibrate.session import Session, Sighting
from opencv_tools.viewer.feed import NewFrame
from opencv_tools.viewer.stream import Stream

_PERIOD = 1 / 15  # so that one session leaves time for others
_WAIT_SECONDS = 1.0
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
        on_seen: Callable[[Seen], object],
    ) -> None:
        """
        Begin to search.

        :param stream: images of the topic.
        :param session: session that gets the boards.
        :param thread: the thread that searches.
        :param is_watched: returns whether somebody looks.
        :param on_seen: called after each search.
        """
        self._stream = stream
        self._session = session
        self._thread = thread
        self._is_watched = is_watched
        self._on_seen = on_seen
        self._pace = ThoroughPace()
        self._loop = asyncio.get_running_loop()
        self._watching = asyncio.ensure_future(self._watch())

    def close(self) -> None:
        """Search no more."""
        self._watching.cancel()

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
            number = frame.number
            try:
                await self._examine(frame, finder)
            except ImageError as err:
                self._on_seen(err)
            await asyncio.sleep(max(0.0, begin + _PERIOD - self._loop.time()))

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
            self._on_seen(session.sighting)

    async def _call(self, function: Callable[[], Any]) -> Any:
        return await self._loop.run_in_executor(self._thread, function)
