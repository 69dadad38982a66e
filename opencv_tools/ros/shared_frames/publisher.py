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

"""Publisher of frames in shared memory, beside the image topic."""

from __future__ import annotations

import importlib.util
import time

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.cdr import WireImage
from opencv_tools.ros import zero_copy
from opencv_tools.ros.shared_frames.announcement import announce, SUFFIX
from opencv_tools.ros.shared_frames.header import FrameHeader
from opencv_tools.ros.shared_frames.memory import process_memory
from opencv_tools.ros.shared_frames.pages import SharedMemoryError
from opencv_tools.ros.shared_frames.writer import FrameWriter
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

# Frames for which /dev/shm must have room; with less, subscribers return to the image topic.
_SPARE_FRAMES = 2
_CHECK_SECONDS = 1.0
_RETRY_SECONDS = 5.0
#: Why a process cannot receive shared frames.
NOT_SHARED = ('frames cannot be shared with this process, because iceoryx2 is not installed or '
              'OPENCV_TOOLS_TRANSPORT is default; run pip install iceoryx2, or set '
              'transport:=auto')


def can_share() -> bool:
    """Return whether this process can share frames: with iceoryx2 and without rclpy's copies."""
    return not zero_copy.reason_for_rclpy and importlib.util.find_spec('iceoryx2') is not None


class SharedFramePublisher:
    """
    Write the frames of an image topic into shared memory for subscribers on this machine.

    The service is announced on ``<image topic>/shm`` when somebody subscribes to that topic. One
    thread at a time publishes.
    """

    def __init__(self, node: Node, images: Publisher) -> None:
        """
        Create the publisher of the announcement.

        :param node: node of the publishers.
        :param images: publisher of the image topic.
        """
        self._node = node
        self._log = node.get_logger()
        self._writer: FrameWriter | None = None
        self._is_announced = False
        self._next_check = 0.0
        self._messages = 0  # published on the image topic
        self._publisher = zero_copy.publisher_id(images.handle).hex()
        self._announcements = node.create_publisher(
            String, f'{images.topic_name}{SUFFIX}',
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
        ) if can_share() else None

    @property
    def has_subscribers(self) -> bool:
        """Whether a frame would be received, or could be after an announcement."""
        if self._writer is not None and self._writer.readers:
            return True
        return (self._announcements is not None
                and (self._is_announced or time.monotonic() >= self._next_check)
                and self._announcements.get_subscription_count() > 0)

    def publish(self, image: WireImage, is_message: bool) -> None:
        """
        Write a frame, if it has subscribers.

        :param image: the frame.
        :param is_message: whether the frame is also published on the image topic, directly after
            this call.
        """
        self._messages += is_message
        if not self.has_subscribers:
            if not self._is_announced:
                self._writer = None  # its readers have left; others need the memory
            return
        data = np.frombuffer(image.data, np.uint8)
        try:
            self._check_room(data.nbytes)
            if self._writer is not None and self._writer.readers:
                self._write(self._writer, image, data, is_message)
        except SharedMemoryError as err:
            self._withdraw(err)

    def destroy(self) -> None:
        """Stop sharing and remove the publisher."""
        self._writer = None
        if self._announcements is not None:
            self._node.destroy_publisher(self._announcements)
            self._announcements = None

    def _check_room(self, frame_bytes: int) -> None:
        """
        Announce the service, or withdraw the announcement if there is no room for more frames.

        :raises SharedMemoryError: the service cannot be created.
        """
        now = time.monotonic()
        if now < self._next_check:
            return
        self._next_check = now + _CHECK_SECONDS
        memory = process_memory()
        memory.remove_dead()  # killed readers still count
        try:
            memory.check_room(_SPARE_FRAMES * frame_bytes)
        except SharedMemoryError as err:
            self._withdraw(err)
            return
        if self._writer is None:
            self._writer = memory.create_writer(frame_bytes)
        if not self._is_announced:
            self._announce(self._writer.service)

    def _write(
        self, writer: FrameWriter, image: WireImage, data: NDArray[np.uint8], is_message: bool,
    ) -> None:
        """
        Write a frame.

        :raises SharedMemoryError: /dev/shm is full, or iceoryx2 failed.
        """
        header = image.header
        try:
            slot = writer.lend(data.nbytes)
            np.copyto(slot.data, data)
            slot.publish(FrameHeader(
                message=self._messages, sec=header.sec, nanosec=header.nanosec,
                height=image.height, width=image.width, step=image.step,
                is_bigendian=image.is_bigendian, is_message=is_message),
                header.frame_id, image.encoding)
        except SharedMemoryError:
            writer.skip()
            raise

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
            text = announce(service, self._publisher).to_text()
            self._announcements.publish(String(data=text))
