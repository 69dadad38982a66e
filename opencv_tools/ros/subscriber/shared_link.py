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

"""Shared frames of one publisher, and the thread that waits for them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from enum import auto, Enum
from threading import Thread
import time

from opencv_tools.image.errors import CdrError
from opencv_tools.ros.priority import current_priority, use_priority
from opencv_tools.ros.shared_frames.header import SharedFrame
from opencv_tools.ros.shared_frames.pages import SharedMemoryError
from opencv_tools.ros.shared_frames.reader import FrameReader

# Longest wait for messages of the image topic that precede the first shared frame.
_JOIN_SECONDS = 0.3
# The thread notices its end after this time.
_WAIT_SECONDS = 0.05


class LinkState(Enum):
    """How the frames of a publisher are received."""

    JOINING = auto()  # by the image topic, until the next shared frame continues its messages
    SHARING = auto()  # by shared memory; messages of the image topic are ignored
    LEAVING = auto()  # by shared memory, until the next message of the image topic


class SharedLink:
    """The shared frames of one publisher."""

    def __init__(self, publisher: bytes, service: str, reader: FrameReader) -> None:
        """
        Create a link without a thread.

        :param publisher: identifier of the publisher of the image topic.
        :param service: name of its service.
        :param reader: reader of this service.
        """
        self.publisher = publisher
        self.service = service
        self.state = LinkState.JOINING
        self.number = 0  # of the last frame
        self._reader = reader
        self._held: SharedFrame | None = None
        self._held_until = 0.0
        self._may_have_frames = False
        self._thread: Thread | None = None
        self._is_closed = False

    def start(
        self, on_frames: Callable[[SharedLink], None],
        on_error: Callable[[SharedLink, SharedMemoryError], None],
    ) -> None:
        """
        Wait for frames in a thread with the priority of this one.

        :param on_frames: called in that thread when there may be frames.
        :param on_error: called there with the error that ends the wait.
        """
        priority = current_priority()

        def wait() -> None:
            use_priority(priority)
            while not self._is_closed:
                try:
                    if self._reader.wait(_WAIT_SECONDS):
                        self._may_have_frames = True
                except SharedMemoryError as err:
                    on_error(self, err)
                    return
                # Repeated until somebody reads: an executor that ends loses what it was told.
                if self._may_have_frames or self.is_held:
                    on_frames(self)

        self._thread = Thread(target=wait, name='shared frames', daemon=True)
        self._thread.start()

    def frames(self, on_broken: Callable[[CdrError], None]) -> Iterator[SharedFrame]:
        """
        Yield the frames that wait.

        :param on_broken: called with the error of a frame that cannot be read.
        :raises SharedMemoryError: the memory cannot be read.
        """
        self._may_have_frames = False
        while not self._is_closed:
            frame, self._held = self._held, None
            try:
                frame = frame or self._reader.receive()
            except CdrError as err:
                on_broken(err)
                continue
            if frame is None:
                return
            yield frame

    def hold(self, frame: SharedFrame) -> None:
        """Return a frame to the link, because messages of the image topic precede it."""
        self._held = frame
        self._held_until = self._held_until or time.monotonic() + _JOIN_SECONDS

    @property
    def is_held(self) -> bool:
        """Whether a frame waits for messages of the image topic."""
        return self._held is not None

    @property
    def is_overdue(self) -> bool:
        """Whether a frame has waited too long for messages of the image topic."""
        return self.is_held and time.monotonic() >= self._held_until

    @property
    def is_closed(self) -> bool:
        """Whether ``close`` was called."""
        return self._is_closed

    def close(self) -> None:
        """Discard the frames that wait. The thread ends soon."""
        self._is_closed = True
        self._held = None

    def join(self) -> None:
        """Wait for the end of the thread."""
        if self._thread is not None:
            self._thread.join()
