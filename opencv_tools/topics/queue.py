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

"""The queue between the sources of a subscription and its only consumer."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from threading import Condition, RLock
from typing import Any

from opencv_tools.base.units import NANO
from opencv_tools.image.cdr import WireMessage
from opencv_tools.image.errors import CdrError
from opencv_tools.topics.messages import AnyMessage
from opencv_tools.topics.order import FrameOrder, Position, Way
from opencv_tools.video.messages import WireVideo
from sensor_msgs.msg import CameraInfo

_MAX_INFOS = 30  # calibrations that wait for their image
_MAX_UNPAIRED = 2  # images that wait for their calibration, beside the capacity


@dataclass
class ReceivedMessage:
    """
    A received image message.

    :param message: raw or compressed image, or video if the subscription does not decode it.
    :param receive_ns: time of reception in nanoseconds of the system clock.
    :param publish_ns: time of publication in nanoseconds of the system clock; 0 if unknown.
    :param number: number that the publisher gave; 0 if unknown.
    :param camera_info: calibration with the same stamp, if it was requested.
    :param publisher: identifier of the publisher; b'' if unknown.
    """

    message: AnyMessage
    receive_ns: int
    publish_ns: int = 0
    number: int = 0
    camera_info: CameraInfo | None = None
    publisher: bytes = b''

    @property
    def image(self) -> WireMessage:
        """
        Return the message of a subscription that decodes video.

        :raises TypeError: it is video.
        """
        if isinstance(self.message, WireVideo):
            raise TypeError('the message is video, which this subscription does not decode')
        return self.message

    @property
    def stamp_ns(self) -> int:
        """Stamp in nanoseconds."""
        return self.message.header.stamp_ns


#: A frame that waits: a message, or the error of one that cannot be read.
QueuedFrame = ReceivedMessage | CdrError


class FrameQueue:
    """
    Frames that wait for the consumer, oldest first, from all sources of a subscription.

    A frame that finds the queue full replaces the oldest one, so that a capacity of one keeps the
    newest frame. All methods are thread-safe.
    """

    def __init__(self, capacity: int, *, with_info: bool = False) -> None:
        """
        Create an empty queue.

        :param capacity: maximum number of frames that wait.
        :param with_info: whether a frame waits for the calibration with the same stamp.
        """
        self._capacity = capacity
        self._with_info = with_info
        self._order = FrameOrder()
        self._frames: deque[QueuedFrame] = deque()
        self._unpaired: deque[ReceivedMessage] = deque()
        self._infos: dict[int, CameraInfo] = {}
        self._is_closed = False
        lock = RLock()
        self._room = Condition(lock)
        #: Held for each access. No code of the user runs meanwhile.
        self.lock = Condition(lock)
        #: Number of frames that were not passed on, because newer ones have replaced them, their
        #: calibration did not arrive, or the queue was closed.
        self.skipped = 0
        #: Called before a frame gets its calibration.
        self.before_pairing: Callable[[], object] = lambda: None
        #: Number of messages of video that need one that did not arrive.
        self.left_out = 0
        #: Whether the last message was one of them.
        self.waits_for_key_frame = False
        #: Number of frames that were put into the queue, and of those with their calibration.
        self.count = self.complete = 0

    @property
    def order(self) -> FrameOrder:
        """Numbers of the frames, to be used with ``lock`` held."""
        return self._order

    @property
    def has_frames(self) -> bool:
        """Whether ``pop`` would return a frame."""
        return bool(self._frames)

    @property
    def keeps_newest(self) -> bool:
        """Whether only the newest frame is kept."""
        return self._capacity == 1

    @property
    def is_full(self) -> bool:
        """Whether another frame would replace one, although more than the newest are kept."""
        return len(self._frames) >= self._capacity and not self.keeps_newest

    def wait_for_room(self, seconds: float) -> bool:
        """
        Wait while the queue is full.

        :param seconds: timeout in seconds.
        :returns: whether another frame would replace none, unless only the newest is kept.
        """
        with self.lock:
            return self._room.wait_for(lambda: not self.is_full or self._is_closed, seconds)

    @property
    def has_unpaired(self) -> bool:
        """Whether frames wait for their calibration."""
        return bool(self._unpaired)

    def put(
        self, frame: QueuedFrame, publisher: bytes, position: Position | None, *,
        keeps_all: bool = False,
    ) -> Way:
        """
        Add a frame, unless it is repeated.

        :param position: its place among those of the publisher; None for a message that the
            middleware has discarded.
        :param keeps_all: whether to exceed the capacity instead of replacing the oldest frame.
        :returns: how the frames of the publisher arrive from now on.
        """
        with self.lock:
            try:
                if position is None:
                    self._order.add_unnumbered()
                elif not self._order.accepts(publisher, position):
                    return self._order.way(publisher)
            except CdrError as err:
                frame = err.with_traceback(None)  # which would keep the frame in memory
            if isinstance(frame, ReceivedMessage) and position:
                frame.number = self._order.last(publisher)  # not only among the messages
            self.count += 1
            self.waits_for_key_frame = False
            held = len(self._frames)  # with keeps_all there may be more than the capacity
            self._add(frame)
            if not keeps_all:
                self._skip_above(self._frames, max(self._capacity, held))
            self.lock.notify()
            return self._order.way(publisher)

    def leave_out(self, publisher: bytes, position: Position | None) -> None:
        """Count a message of video that needs one that did not arrive."""
        with self.lock, suppress(CdrError):  # the next frame has the same error
            if position is None:
                self._order.add_unnumbered()
            elif not self._order.accepts(publisher, position):
                return
            self.left_out += 1
            self.waits_for_key_frame = True

    def put_info(self, info: CameraInfo) -> None:
        """Add a calibration."""
        stamp = info.header.stamp.sec * NANO + info.header.stamp.nanosec
        with self.lock:
            self._infos[stamp] = info
            while len(self._infos) > _MAX_INFOS:
                del self._infos[next(iter(self._infos))]
            if any(frame.stamp_ns == stamp for frame in self._unpaired):
                waiting, held = [*self._unpaired], len(self._frames)
                self._unpaired.clear()
                for frame in waiting:
                    self._add(frame)
                self._skip_above(self._frames, max(self._capacity, held))
                self.lock.notify()

    def forget_infos(self) -> None:
        """Remove the calibrations, which were those of another topic."""
        with self.lock:
            self._infos.clear()

    def pop(self) -> QueuedFrame | None:
        """Remove and return the oldest frame, or return None."""
        with self.lock:
            return self._take() if self._frames else None

    def wait(self) -> QueuedFrame | None:
        """Wait for a frame, then remove and return it; return None once the queue is closed."""
        with self.lock:
            self.lock.wait_for(lambda: self._frames or self._is_closed)
            return None if self._is_closed else self._take()

    def close(self) -> None:
        """End ``wait``, and skip the frames that still wait."""
        with self.lock:
            self._is_closed = True
            self._skip_above(self._unpaired, 0)
            self._skip_above(self._frames, 0)
            self.lock.notify_all()
            self._room.notify_all()

    def _take(self) -> QueuedFrame:
        self._room.notify_all()
        return self._frames.popleft()

    def _add(self, frame: QueuedFrame) -> None:
        """Add a frame to those that are complete, or to those that wait for their calibration."""
        if self._with_info and isinstance(frame, ReceivedMessage):
            self.before_pairing()
            frame.camera_info = self._infos.pop(frame.stamp_ns, None)
            if frame.camera_info is None:
                self._unpaired.append(frame)
                self._skip_above(self._unpaired, self._capacity + _MAX_UNPAIRED)
                return
            # The calibrations of earlier frames would have come before.
            self._skip_above(self._unpaired, 0)
        self._frames.append(frame)
        self.complete += 1

    def _skip_above(self, frames: deque[Any], most: int) -> None:
        while len(frames) > most:
            frames.popleft()
            self.skipped += 1
