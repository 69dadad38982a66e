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

"""Publisher of the frames of an image topic, as messages and in shared memory."""

from __future__ import annotations

from collections.abc import Callable
import importlib.util
import math
from threading import RLock
import time

import numpy as np
from opencv_tools.base.logs import Log
from opencv_tools.image.cdr import WireImage
from opencv_tools.transport import zero_copy
from opencv_tools.transport.shared_frames.announcement import announce, SUFFIX
from opencv_tools.transport.shared_frames.header import FrameHeader, publisher_identity
from opencv_tools.transport.shared_frames.memory import MAX_DEPTH, process_memory
from opencv_tools.transport.shared_frames.pages import SharedMemoryError
from opencv_tools.transport.shared_frames.writer import FrameWriter, MAX_LOANS, Slot
from opencv_tools.transport.zero_copy import publish_image
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

# Frames for which /dev/shm must have room; with less, subscribers return to the image topic.
_SPARE_FRAMES = 2
_CHECK_SECONDS = 1.0
_RETRY_SECONDS = 5.0
# A subscription to the image topic may miss messages for this time after it was discovered.
_JOIN_SECONDS = 0.2
# Readers leave within 0.1 s, but those that were stopped or killed do not.
_LEAVE_SECONDS = 1.0
_POLL_SECONDS = 0.002

# Calls a function that sends a frame to readers, and that returns whether all had room for it. It
# may call it again: readers ignore a repeated frame.
Deliver = Callable[[Callable[[], bool]], object]


def can_share() -> bool:
    """Return whether this process can share frames: with iceoryx2 and without rclpy's copies."""
    return not zero_copy.reason_for_rclpy and importlib.util.find_spec('iceoryx2') is not None


class SharedFramePublisher:
    """
    Publish images as messages, and in shared memory for subscribers on this machine.

    The service is announced on ``<image topic>/shm`` when somebody subscribes to that topic. The
    announcement also has the number of the frames until then, so that a subscription knows which
    ones it has missed. All methods are thread-safe.
    """

    def __init__(self, node: Node, images: Publisher) -> None:
        self._node = node
        self._images = images
        #: Waits for readers without room; set before the first frame if frames can wait. Without
        #: it a frame replaces the oldest one that a reader has not received.
        self.deliver: Deliver | None = None
        self._log = Log(node.get_logger())
        # Frames have the order of their numbers. Memory is not lent again before its message is
        # published.
        self._lock = RLock()
        self._writer: FrameWriter | None = None
        self._ended: FrameWriter | None = None  # while readers receive its last frames
        self._is_announced = False
        self._next_check = self._leave_by = 0.0
        #: Number of frames published in any way, and on the image topic.
        self.frames = self.messages = 0
        self._announced_only_shared = 0
        self._publisher = zero_copy.publisher_id(images.handle)
        self._fields = FrameHeader()  # of the last frame
        self._fields.identity[:] = publisher_identity(self._publisher, images.topic_name)
        #: Name of the topic of the announcement.
        self.topic_name = f'{images.topic_name}{SUFFIX}'
        self._announcements = node.create_publisher(
            String, self.topic_name,
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
            # rclpy does not guard events, if one thread destroys them and another waits for them.
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
        ) if can_share() else None

    @property
    def has_subscribers(self) -> bool:
        """Whether a frame would be received, or could be after an announcement."""
        return (self._announcements is not None
                and self._announcements.get_subscription_count() > 0)

    def lend(self, size: int) -> Slot | None:
        """
        Lend shared memory for a frame, if it has readers.

        :param size: bytes of the pixels.
        :returns: a slot for ``publish``; None if there are no readers, no room, or ``MAX_LOANS``
            slots whose arrays are in use.
        """
        with self._lock:
            if not self.has_subscribers:
                return None
            try:
                writer = self._writer_with_room(size)
                return writer.lend(size) if writer and len(writer.loans) < MAX_LOANS else None
            except SharedMemoryError as err:
                self._withdraw(err)
                return None

    def publish(
        self, image: WireImage, *, is_message: bool, slot: Slot | None = None,
    ) -> bool:
        """
        Publish a frame.

        :param is_message: whether to publish it on the image topic. A frame that finds no room in
            shared memory is published there too.
        :param slot: lent memory that has the pixels of the frame; None to copy them. No other view
            of it may be left, because another thread may get the memory after the call.
        :returns: whether it was published on the image topic.
        :raises CdrError: a string cannot be part of a message.
        :raises RuntimeError: the middleware did not publish the message.
        """
        with self._lock:
            is_message = self._share(image, is_message, slot)
            if is_message and self.frames - self.messages != self._announced_only_shared:
                self._announce(self._writer.service if self._writer and self._is_announced else '')
            self.frames += 1
            if is_message:
                publish_image(self._images.handle, image)
                self.messages += 1
            return is_message

    @property
    def has_readers(self) -> bool:
        """Whether readers are left after ``end``, which have not received all frames."""
        ended, now = self._ended, time.monotonic()
        if ended is not None and ended.readers and now >= self._next_check:
            self._next_check = now + _CHECK_SECONDS
            process_memory().remove_dead()
        return ended is not None and ended.readers > 0

    def end(self) -> None:
        """Share no more frames. Readers leave when they have received those that were shared."""
        with self._lock:
            if self._writer:
                self._writer.end()
                self._ended, self._writer = self._writer, None
                self._leave_by, self._next_check = time.monotonic() + _LEAVE_SECONDS, 0.0
            if self._announcements is not None:
                self._node.destroy_publisher(self._announcements)
                self._announcements = None

    def destroy(self) -> None:
        """Stop sharing and remove the publisher. Readers have 1 s from its end to leave."""
        self.end()
        while self.has_readers and time.monotonic() < self._leave_by:
            time.sleep(_POLL_SECONDS)
        if self.has_readers:
            self._log.warning(
                f'up to {min(self.frames, MAX_DEPTH)} of the last frames on {self.topic_name} '
                'were not received by each subscriber; they may be lost')
        self._ended = None

    def _share(self, image: WireImage, is_message: bool, slot: Slot | None) -> bool:
        """Send a frame in shared memory, if it has subscribers; return whether it is a message."""
        give_up_at = math.inf

        def send() -> bool:
            nonlocal slot, is_message, give_up_at
            filled, slot = slot, None
            if filled is None and not self.has_subscribers:  # a slot is lent for subscribers
                if not self._is_announced:
                    self._writer = None  # its readers have left; others need the memory
                return True
            try:
                if filled is None or filled.writer is not self._writer:
                    data = np.frombuffer(image.data, np.uint8)
                    writer = self._writer_with_room(data.nbytes)
                    if writer is None:
                        return True
                    filled = writer.lend(data.nbytes)
                    np.copyto(filled.data, data)
                return self._send(filled, image, is_message)
            except SharedMemoryError as err:
                self._withdraw(err)
                # Meanwhile the readers release memory, or subscribe to the image topic again. They
                # remain readers until they have a message.
                readers = self._writer.readers if self._writer else 0
                subscribers, now = self._images.get_subscription_count(), time.monotonic()
                is_message = subscribers > 0
                give_up_at = min(give_up_at, now + _JOIN_SECONDS) if subscribers >= readers \
                    else math.inf
                return not readers or now >= give_up_at

        self.deliver(send) if self.deliver else send()
        return is_message

    def _writer_with_room(self, frame_bytes: int) -> FrameWriter | None:
        """
        Announce the service, or withdraw the announcement if there is no room for more frames.

        :returns: the writer of the service if it has readers.
        :raises SharedMemoryError: the service cannot be created.
        """
        now = time.monotonic()
        if now >= self._next_check:
            self._next_check = now + _CHECK_SECONDS
            memory = process_memory()
            memory.remove_dead()  # killed readers still count
            try:
                memory.check_room(_SPARE_FRAMES * frame_bytes)
            except SharedMemoryError as err:
                self._withdraw(err)
            else:
                if self._writer is None:
                    self._writer = memory.create_writer(
                        frame_bytes, overwrites=self.deliver is None)
                if not self._is_announced:
                    self._announce(self._writer.service)
        return self._writer if self._writer is not None and self._writer.readers else None

    def _send(self, slot: Slot, image: WireImage, is_message: bool) -> bool:
        """
        Send a filled slot.

        :returns: whether all readers had room for it.
        :raises SharedMemoryError: the texts are too long, or iceoryx2 failed.
        """
        header, fields = image.header, self._fields
        fields.number, fields.is_message = self.frames + 1, is_message
        fields.message, fields.publish_ns = self.messages + is_message, time.time_ns()
        fields.sec, fields.nanosec = header.sec, header.nanosec
        fields.height, fields.width, fields.step = image.height, image.width, image.step
        fields.is_bigendian = image.is_bigendian
        return slot.publish(fields, header.frame_id, image.encoding)

    def _withdraw(self, err: SharedMemoryError) -> None:
        """Have subscribers return to the image topic; the service remains while it has readers."""
        self._log.debug(f'frames are not shared: {err}')
        self._next_check = time.monotonic() + _RETRY_SECONDS
        if self._is_announced:
            self._announce('')
        if self._writer is not None and not self._writer.readers:
            self._writer = None

    def _announce(self, service: str) -> None:
        if self._announcements is not None:
            self._is_announced = bool(service)
            self._announced_only_shared = self.frames - self.messages
            self._announcements.publish(String(data=announce(
                service, self._publisher.hex(), self.frames, self.messages).to_text()))
