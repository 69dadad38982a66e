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
"""Messages of overlays for all pages, from the executor to the loop of the server."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from opencv_tools.base.text import printable
from opencv_tools.image.errors import CdrError
from opencv_tools.viewer.errors import MAX_MESSAGE, RequestError
from opencv_tools.viewer.executor_calls import ExecutorCalls
from opencv_tools.viewer.overlays.boxes import (
    Boxes, BoxHeader, DETECTIONS, MAX_BYTES, read_boxes, read_header)
from opencv_tools.viewer.overlays.topics import CALIBRATION, OverlayKey, OverlayTopics
from opencv_tools.viewer.watched import in_loop, LOAD, Watched

# Messages that are kept for pictures of the same stamps, and their bytes.
_MAX_KEPT, _MAX_KEPT_BYTES = 512, 2 * MAX_BYTES
_MAX_PAUSE = 1.0


class Source(Watched[Callable[[], object]]):
    """
    Messages of a topic.

    All methods run in the loop of the server.
    """

    def __init__(self, key: OverlayKey) -> None:
        super().__init__()
        self.key = key
        #: Reason why the topic is not read; '' if it is.
        self.refusal = ''
        #: Reason why the newest message cannot be used; '' if it can.
        self.problem = ''

    def opened(self, outcome: RequestError | None) -> None:
        """Use the outcome of a subscription."""
        self.refusal = str(outcome or '')

    def receive(self, messages: Sequence[Any]) -> None:
        """Keep serialized messages."""
        for message in messages:
            try:
                self._keep(memoryview(message))
                self.problem = ''
            except CdrError as err:
                self.problem = printable(err, MAX_MESSAGE)
        for watcher in tuple(self.watchers):
            watcher()

    def _keep(self, message: memoryview) -> None:
        raise NotImplementedError


class CameraInfoSource(Source):
    """The newest calibration of a camera."""

    #: The message; b'' before the first one.
    newest = b''

    def _keep(self, message: memoryview) -> None:
        self.newest = bytes(message)


_T = TypeVar('_T', bound=Source)


@dataclass(eq=False)
class Detections:
    """
    A message with boxes.

    :param data: its bytes.
    :param boxes: its boxes; None if they were not read yet, or cannot be.
    :param is_read: whether they were read.
    """

    header: BoxHeader
    data: memoryview
    boxes: Boxes | None = None
    is_read: bool = False


class BoxSource(Source):
    """The newest messages with boxes, by their stamps."""

    def __init__(self, key: OverlayKey) -> None:
        super().__init__(key)
        #: The newest message; None before the first one.
        self.newest: Detections | None = None
        self._kept: dict[int, Detections] = {}
        self._bytes = 0
        self._reading = asyncio.Lock()
        self._due = 0.0

    def find(self, stamp_ns: int) -> Detections | None:
        """Return the message with a stamp; None for no stamp, or no message."""
        return self._kept.get(stamp_ns) if stamp_ns else None

    def copy(self) -> dict[int, Detections]:
        """Return the messages by their stamps."""
        return dict(self._kept)

    async def read(self, detections: Detections) -> None:
        """Read the boxes of a message, once for all pages, in at most a quarter of the time."""
        async with self._reading:
            if detections.is_read:
                return
            loop = asyncio.get_running_loop()
            await asyncio.sleep(self._due - loop.time())
            begin = loop.time()
            try:
                detections.boxes = await asyncio.to_thread(read_boxes, detections.data)
            except CdrError as err:
                self.problem = printable(err, MAX_MESSAGE)
            detections.is_read = True
            elapsed = loop.time() - begin
            self._due = begin + elapsed + min(_MAX_PAUSE, (LOAD - 1) * elapsed)

    def _keep(self, message: memoryview) -> None:
        found = Detections(read_header(message), message)
        self.newest = found
        self._forget(found.header.stamp_ns)
        self._kept[found.header.stamp_ns] = found
        self._bytes += len(message)
        while len(self._kept) > _MAX_KEPT or self._bytes > _MAX_KEPT_BYTES:
            self._forget(next(iter(self._kept)))

    def _forget(self, stamp_ns: int) -> None:
        earlier = self._kept.pop(stamp_ns, None)
        self._bytes -= len(earlier.data) if earlier else 0


class OverlaySources:
    """
    Read the topics that pages show, each of them once.

    All methods run in the loop of the server.
    """

    def __init__(self, topics: OverlayTopics, calls: ExecutorCalls) -> None:
        """
        Create an object that reads nothing.

        :param topics: topics of overlays, used in the executor.
        """
        self._topics = topics
        self._calls = calls
        self._sources: dict[OverlayKey, Source] = {}

    def boxes(self, name: str) -> BoxSource:
        """Return the source of a topic with boxes; the caller uses it."""
        return self._acquire(BoxSource, (name, DETECTIONS))

    def camera(self, image_topic: str) -> CameraInfoSource:
        """Return the source of the calibration of an image topic."""
        return self._acquire(CameraInfoSource, (image_topic, CALIBRATION))

    def open(self, source: Source) -> None:  # noqa: A003
        """Read a topic, or try it again after a refusal."""
        self._calls.call(partial(self._topics.open, source.key, in_loop(source.receive)),
                         in_loop(source.opened))

    def _acquire(self, kind: type[_T], key: OverlayKey) -> _T:
        source = self._sources.get(key)
        if not isinstance(source, kind):  # there is none, because the type of a key is fixed
            source = self._sources[key] = kind(key)
            source.on_unused = partial(self._close, key)
            self.open(source)
        return source

    def _close(self, key: OverlayKey) -> None:
        del self._sources[key]
        self._calls.call(partial(self._topics.close, key))
