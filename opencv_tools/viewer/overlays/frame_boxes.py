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
"""Boxes of the frames of a topic, found by their stamps."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from opencv_tools.viewer.feed import NewFrame
from opencv_tools.viewer.overlays.boxes import Boxes
from opencv_tools.viewer.overlays.sources import BoxSource, Detections

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
