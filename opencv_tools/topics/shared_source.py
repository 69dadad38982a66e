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

"""Source of the frames that a publisher shares."""

from __future__ import annotations

from collections.abc import Callable
import math
from threading import Lock, Thread
import time
from typing import NamedTuple

from opencv_tools.image.cdr import WireHeader, WireImage
from opencv_tools.image.errors import CdrError
from opencv_tools.topics.order import Position, Way
from opencv_tools.topics.queue import FrameQueue, QueuedFrame, ReceivedMessage
from opencv_tools.transport.scheduling import current_priority, use_priority
from opencv_tools.transport.shared_frames.header import SharedFrame
from opencv_tools.transport.shared_frames.memory import MAX_DEPTH
from opencv_tools.transport.shared_frames.pages import SharedMemoryError
from opencv_tools.transport.shared_frames.reader import FrameReader

# Longest wait for messages of the image topic that precede the first shared frame.
_JOIN_SECONDS = 0.3
# The thread notices its end after this time.
_WAIT_SECONDS = 0.05
# More than a service keeps for a reader.
_MAX_FRAMES = 2 * MAX_DEPTH


class WriterEndedError(SharedMemoryError):
    """The publisher has stopped sharing, or has ended."""


class Origin(NamedTuple):
    """
    What shared frames come from.

    :param identity: what each of its frames repeats, see `publisher_identity`.
    """

    publisher: bytes
    service: str
    identity: bytes


class SharedSource:
    """A thread that puts the shared frames of one publisher into the queue."""

    def __init__(
        self, origin: Origin, reader: FrameReader, queue: FrameQueue,
        on_change: Callable[[], None], on_frame: Callable[[], object],
    ) -> None:
        """
        Start the thread, with the priority of this one.

        :param queue: queue that gets the frames.
        :param on_change: called in the thread when the frames arrive in another way, when messages
            are missing before the next frame, and at the end of the thread by an error.
        :param on_frame: called after each frame that was put into the queue.
        """
        self.origin = origin
        #: Error that has ended the thread.
        self.error: Exception | None = None
        self._reader = reader
        self._delays_writer = reader.delays_writer
        self._queue = queue
        self._on_change = on_change
        self._on_frame = on_frame
        self._taken: tuple[QueuedFrame, Position | None] | None = None
        self._way = Way.JOINING
        self._overdue_at = time.monotonic() + _JOIN_SECONDS  # while joining
        self._is_closed = False
        self._lock = Lock()  # one thread at a time receives
        self._priority = current_priority()
        self._thread = Thread(target=self._run, name='shared frames', daemon=True)
        self._thread.start()

    @property
    def is_overdue(self) -> bool:
        """Whether messages that precede the first frame have been missing for too long."""
        return self._way is Way.JOINING and time.monotonic() >= self._overdue_at

    def stop_joining(self) -> None:
        """Wait no longer for the messages that precede the first frame."""
        self._overdue_at = math.inf

    def receive(self) -> None:
        """
        Put all waiting frames into the queue.

        :raises SharedMemoryError: the memory cannot be read, or belongs to another publisher.
        """
        self._receive_in_order(may_wait=False)

    def close(self) -> None:
        """Discard the frames that wait. The thread ends soon."""
        with self._lock:
            self._is_closed = True
            self._taken = None

    def join(self) -> None:
        """Wait for the end of the thread."""
        self._thread.join()

    def _run(self) -> None:
        use_priority(self._priority)
        try:
            while not self._is_closed:
                self._wait()
        except Exception as err:  # noqa: B902 (the subscription goes on without this source)
            self.error = err
        if not self._reader.has_writer:  # another one would use memory of frames that are held
            self.close()
            self._reader.close()
        if self.error:
            self._on_change()

    def _wait(self) -> None:
        """Wait for frames and receive them."""
        way = self._way
        is_notified = self._reader.wait(_WAIT_SECONDS)
        has_writer = is_notified or self._reader.has_writer
        are_all_received = self._receive_in_order(may_wait=has_writer)
        if self._way is not way or self.is_overdue:
            self._on_change()
        if are_all_received and not has_writer:
            raise WriterEndedError('its writer has ended')

    def _receive_in_order(self, *, may_wait: bool) -> bool:
        """
        Put waiting frames into the queue, and return whether none is left.

        If their publisher waits, they wait for earlier messages.

        :param may_wait: whether they also wait for room in the queue.
        """
        keeps_all = self._delays_writer and not (may_wait or self._queue.keeps_newest)
        for _ in range(_MAX_FRAMES):
            if self._delays_writer and may_wait and not self._queue.wait_for_room(_WAIT_SECONDS):
                return False
            with self._lock:
                if not self._take():
                    return True
                if self._delays_writer and self._is_early():
                    return False
                self._put(keeps_all=keeps_all)
        return False

    def _take(self) -> bool:
        """Receive the next frame, if none is taken already, and return whether there is one."""
        if self._is_closed:
            return False
        if self._taken is None:
            try:
                frame = self._reader.receive()
                if frame is None:
                    return False
                header = frame.header
                self._taken = ReceivedMessage(
                    _read(frame, self.origin.identity), time.time_ns(), header.publish_ns,
                    header.message if header.is_message else header.number,
                    publisher=self.origin.publisher), Position(
                        header.message, header.number, bool(header.is_message))
            except CdrError as err:
                self._taken = err.with_traceback(None), None  # which would keep the frame
        return True

    def _is_early(self) -> bool:
        """Return whether messages are missing before the taken frame."""
        position = self._taken and self._taken[1]
        if not position:
            return False
        with self._queue.lock:
            return self._queue.order.is_early(self.origin.publisher, position)

    def _put(self, *, keeps_all: bool = False) -> None:
        """Put the taken frame into the queue, which may exceed its capacity with keeps_all."""
        if self._taken:
            (received, position), self._taken = self._taken, None
            self._way = self._queue.put(
                received, self.origin.publisher, position, keeps_all=keeps_all)
            self._on_frame()


def _read(frame: SharedFrame, identity: bytes) -> WireImage:
    """
    Return the message of a frame.

    :raises SharedMemoryError: the frame is of another publisher.
    """
    header = frame.header
    if bytes(header.identity) != identity:
        raise SharedMemoryError('its memory has frames of another publisher')
    return WireImage(
        header=WireHeader(header.sec, header.nanosec, frame.frame_id), height=header.height,
        width=header.width, encoding=frame.encoding, is_bigendian=bool(header.is_bigendian),
        step=header.step, data=frame.data)
