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
"""Frames of a topic and their boxes, matched by their stamps."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable

from opencv_tools.base.text import printable
from opencv_tools.topics.rate_meter import RateMeter
from opencv_tools.viewer.overlays.boxes import Boxes
from opencv_tools.viewer.overlays.sources import BoxSource, Detections
from opencv_tools.viewer.streams.feed import Feed, NewFrame
from opencv_tools.viewer.watched import quiet_limit

_MAX_READ = 8  # frames whose boxes are kept; a page may request one with another region


class FrameBoxes:
    """
    Find and read the boxes of frames.

    Boxes belong to a frame with the same stamp. If both have a frame_id, it is the same as well.
    """

    def __init__(self, source: BoxSource, on_match: Callable[[NewFrame], Awaitable[None]]) -> None:
        """
        Create an object without boxes.

        :param source: messages with boxes.
        :param on_match: called with a frame when its boxes, or other boxes, were read.
        """
        self._source = source
        self._on_match = on_match
        self._read: dict[int, Detections] = {}  # by the number of the frame
        self._held: dict[int, Detections] = {}  # by their stamps
        self._task: asyncio.Task[None] | None = None

    def close(self) -> None:
        """Read nothing any more."""
        if self._task:
            self._task.cancel()

    def clear(self) -> None:
        """Forget all frames, whose numbers begin again."""
        self._read.clear()

    def known(self, number: int) -> Detections | None:
        """Return the message of a frame with a number, if it was read; else None."""
        return self._read.get(number)

    def find(self, frame: NewFrame) -> Detections | None:
        """Return the message of a frame; None without one, or for one that cannot be read."""
        found = self._held.get(frame.stamp_ns) or self._source.find(frame.stamp_ns)
        is_broken = found is not None and found.is_read and found.boxes is None
        return found if found and not is_broken and has_same_camera(frame, found) else None

    def of(self, frame: NewFrame) -> Boxes | None:
        """Return the boxes of a frame that is sent; None if they follow, or if it has none."""
        found = self._read.get(frame.number) or self.find(frame)
        if found and not found.is_read:
            self.close()
            self._task = asyncio.ensure_future(self.read(frame, found))
        elif found:
            self._add(frame, found)
        return found.boxes if found else None

    def hold(self, is_held: bool) -> None:
        """Keep the present messages while a page is paused, which may show earlier frames."""
        if is_held != bool(self._held):
            self._held = self._source.copy() if is_held else {}

    async def read(self, frame: NewFrame, detections: Detections) -> None:
        """Read the boxes of a frame, unless they were, and announce them."""
        await self._source.read(detections)
        self._add(frame, detections)
        if detections.boxes is not None:
            await self._on_match(frame)

    def _add(self, frame: NewFrame, detections: Detections) -> None:
        self._read.pop(frame.number, None)
        self._read[frame.number] = detections
        if len(self._read) > _MAX_READ:
            del self._read[next(iter(self._read))]


def frame_id(frame: NewFrame) -> str:
    """Return the coordinate frame of an image; '' if it has none."""
    return frame.message.header.frame_id


def has_same_camera(frame: NewFrame, found: Detections) -> bool:
    """Return whether boxes are those of the camera of a frame, as far as both say."""
    names = {frame_id(frame), found.header.frame_id} - {''}
    return len(names) < 2


# Frames that wait for their boxes, and their bytes.
_MAX_FRAMES, _MAX_FRAME_BYTES = 32, 64 << 20
_PERIOD = 1 / 60  # between two matches in seconds
_MAX_QUIET_SECONDS = 3.0  # without a match, after which frames are shown without boxes


class MatchedFrames:
    """
    Choose the frames that a page shows: the newest one with boxes, while boxes arrive.

    Boxes follow their frame by the time that a detector needs, so that newer frames have none.
    """

    def __init__(self, source: BoxSource, matched: Callable[[NewFrame], Awaitable[None]],
                 expired: Callable[[], object]) -> None:
        """
        Create an object without frames.

        :param source: messages with boxes.
        :param matched: called with a frame when its boxes, or other boxes, have arrived.
        :param expired: called when frames are shown without boxes again.
        """
        #: Messages with boxes.
        self.source = source
        #: Boxes of the frames.
        self.boxes = FrameBoxes(source, matched)
        self._on_expiry = expired
        self._loop = asyncio.get_running_loop()
        self._feed: Feed | None = None
        self._task: asyncio.Task[None] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._clear()
        source.join(self.look)

    def close(self) -> None:
        """Match nothing any more."""
        self.source.leave(self.look)
        self.boxes.close()
        for work in (self._task, self._timer):
            if work:
                work.cancel()

    def choose(self, feed: Feed) -> NewFrame | None:
        """Return the frame to show; None before the first one."""
        if feed is not self._feed:  # numbers of frames begin again
            self._feed = feed
            self._clear()
        newest = feed.newest
        if newest and not (self._frames and self._frames[-1].number == newest.number):
            self._keep(newest)
            self.look()
        wait = self._hold_seconds()
        if self._matched is None or wait <= 0:
            return newest
        if self._timer:
            self._timer.cancel()
        self._timer = self._loop.call_later(wait, self._on_expiry)
        return self._matched

    def look(self) -> None:
        """Read the boxes of the newest frame that has some."""
        if (self._task is None or self._task.done()) and self._next():
            self._task = asyncio.ensure_future(self._read_all())

    def describe(self, number: int) -> str:
        """Return what is drawn over a picture, or why nothing is."""
        topic, source = printable(self.source.key[0]), self.source
        if source.refusal or source.problem:
            return source.refusal or f'a message of {topic} is left out: {source.problem}'
        drawn = self.boxes.known(number)
        if drawn and drawn.boxes:
            return drawn.boxes.describe()
        if source.newest is None:
            return f'no message on {topic} yet'
        if not source.newest.header.stamp_ns:
            return f'the messages of {topic} have no stamp, which boxes need'
        for frame in self._frames:
            found = source.find(frame.stamp_ns)
            if found and not has_same_camera(frame, found):
                names = printable(found.header.frame_id), printable(frame_id(frame))
                return f'{topic} has the frame_id {names[0]}, but the pictures have {names[1]}'
        if len(self._frames) > 1 and source.newest.header.stamp_ns < self._frames[0].stamp_ns:
            return (f'the messages of {topic} come too late: the node keeps '
                    f'{len(self._frames)} pictures')
        which = 'this' if any(map(self.boxes.find, self._frames)) else 'a'
        return f'no message of {topic} has the stamp of {which} picture'

    def _clear(self) -> None:
        self._frames: deque[NewFrame] = deque(maxlen=_MAX_FRAMES)
        self.boxes.clear()
        self._matched: NewFrame | None = None
        self._meter = RateMeter(self._loop.time)

    def _keep(self, frame: NewFrame) -> None:
        self._frames.append(frame)
        while len(self._frames) > 1 and sum(
                memoryview(one.message.data).nbytes for one in self._frames) > _MAX_FRAME_BYTES:
            self._frames.popleft()

    def _hold_seconds(self) -> float:
        """Return the time until frames without boxes are shown again."""
        quiet = self._meter.silent_seconds
        return -1.0 if quiet is None else min(
            _MAX_QUIET_SECONDS, quiet_limit(self._meter)) - quiet

    def _next(self) -> tuple[NewFrame, Detections] | None:
        """Return the newest frame whose boxes have arrived and were not read."""
        for frame in reversed(self._frames):
            found = self.boxes.find(frame)
            if found and found is not self.boxes.known(frame.number):
                return frame, found
            if self._matched and frame.number <= self._matched.number:
                break
        return None

    async def _read_all(self) -> None:
        while found := self._next():
            frame, detections = found
            feed = self._feed
            await self.source.read(detections)
            if feed is self._feed and detections.boxes is not None:
                self._matched = frame
                self._meter.add()
            if feed is self._feed:
                await self.boxes.read(frame, detections)
            await asyncio.sleep(_PERIOD)
