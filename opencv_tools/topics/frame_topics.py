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

"""The topics on which frames are published."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from threading import Lock
import time
from typing import Any

from opencv_tools.image.cdr import WireImage
from opencv_tools.image.errors import FormError
from opencv_tools.logs import Log
from opencv_tools.topics.qos import create_frame_publisher
from opencv_tools.topics.topic_discovery import resolve_topic
from opencv_tools.topics.video_topics import VideoTopics
from opencv_tools.transport.shared_frames.announcement import SUFFIX
from opencv_tools.transport.shared_frames.publisher import SharedFramePublisher
from opencv_tools.transport.shared_frames.writer import Slot
from opencv_tools.video.settings import VideoSettings
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import CompressedImage, Image

_PARTICIPANT_BYTES = 12  # of the identifier of an endpoint, see section 8.2.4 of DDSI-RTPS
# Without a frame that has no compressed form, until the topic is advertised again.
_RETURN_SECONDS = 5.0
_LOGGED_SECONDS = 10.0
#: Lends shared memory for a number of bytes, if it has readers.
Lend = Callable[[int], Slot | None]


class FrameTopics:
    """
    Publish raw images, also by shared memory, compressed images and video.

    Nothing is computed for topics without subscribers. Each topic stands alone: while frames have
    no compressed form, its topic is not advertised, so that no subscriber waits for it.

    The names of the topics are those of image_transport.
    """

    def __init__(self, node: Node, topic: str, video: VideoSettings | None = None,
                 forget: Callable[[Publisher], object] = bool) -> None:
        """
        Create the publishers.

        :param topic: name of the topic of the raw images; compressed images are on
            ``<topic>/compressed``.
        :param video: settings of the video; None for no video.
        :param forget: called before a publisher is removed while the others remain.
        :raises ParameterError: the name of the topic or its ``qos_overrides`` parameters cannot be
            used.
        """
        #: Name of the image topic after remapping.
        self.name = resolve_topic(node, topic)
        self.images = create_frame_publisher(node, Image, topic)
        #: Publisher of compressed images; None while the frames have no such form.
        self.compressed: Publisher | None = None
        self._node = node
        self._log = Log(node.get_logger())
        self._forget = forget
        self._compressed_lock = Lock()  # several threads may publish
        self._without_form_at = 0.0
        self._advertise_compressed()
        self.shared = SharedFramePublisher(node, self.images)
        #: Topics of the video; None without video.
        self.video = VideoTopics(node, self.name, video) if video else None

    @property
    def has_subscribers(self) -> bool:
        """Whether a frame would be received."""
        return self.has_image_subscribers or bool(self.video and self.video.count_subscribers())

    @property
    def has_image_subscribers(self) -> bool:
        """Whether an image would be received, not only video."""
        return bool(self.shared.has_subscribers or self.images.get_subscription_count()
                    or self.count_compressed())

    def count_compressed(self) -> int:
        """Return the number of subscribers of compressed images."""
        with self._compressed_lock:
            return self.compressed.get_subscription_count() if self.compressed else 0

    def count_subscribers(self) -> int:
        """
        Return the number of subscribers of raw and compressed images, and of video.

        A subscriber by shared memory may have subscribed to the image topic as well.
        """
        raw, shared = (
            Counter((bytes(found.endpoint_gid)[:_PARTICIPANT_BYTES], found.node_namespace,
                     found.node_name)
                    for found in self._node.get_subscriptions_info_by_topic(name))
            for name in (self.images.topic_name, f'{self.images.topic_name}{SUFFIX}'))
        video = self.video.count_subscribers() if self.video else 0
        return int(self.images.get_subscription_count() + video
                   + self.count_compressed() + (shared - raw).total())

    def publish_raw(
        self, make: Callable[[Lend], tuple[WireImage, Slot | None]],
    ) -> bool | None:
        """
        Publish a raw image, if somebody receives it.

        :param make: creates the image, and returns the lent memory that has its pixels, see
            `SharedFramePublisher.publish`; its argument lends memory.
        :returns: whether it was published on the image topic; None if nobody receives it.
        """
        is_message = self.images.get_subscription_count() > 0
        if not is_message and not self.shared.has_subscribers:
            return None
        image, slot = make(self.shared.lend)
        return self.shared.publish(image, is_message=is_message, slot=slot)

    def publish_compressed(self, reason: str, make: Callable[[], Any]) -> Publisher | None:
        """
        Publish a compressed image, if somebody receives it.

        A frame without this form ends the topic. It returns with the first other frame after 5 s
        without such a frame.

        :param reason: why the frame has no compressed form; '' if it has one.
        :param make: creates the message, or its CDR. A `FormError` is logged.
        :returns: the publisher that has published it; None if none has.
        """
        if reason:
            self._withdraw_compressed(reason)
            return None
        if not self.compressed and time.monotonic() > self._without_form_at + _RETURN_SECONDS:
            self._advertise_compressed()
        if not self.count_compressed():
            return None
        try:
            message = make()
        except FormError as err:
            self._log.warning(f'no frame on {self.name}/compressed: {err}',
                              every=_LOGGED_SECONDS, key='compressed')
            return None
        with self._compressed_lock:
            if self.compressed:
                self.compressed.publish(message)
            return self.compressed

    def _advertise_compressed(self) -> None:
        with self._compressed_lock:
            self.compressed = self.compressed or create_frame_publisher(
                self._node, CompressedImage, f'{self.name}/compressed')

    def _withdraw_compressed(self, reason: str) -> None:
        self._without_form_at = time.monotonic()
        with self._compressed_lock:
            publisher, self.compressed = self.compressed, None
        if not publisher:
            return
        sentence = f'{self.name}/compressed is not published: {reason}; receive {self.name}'
        if publisher.get_subscription_count():
            self._log.warning(sentence, once=reason)
        else:
            self._log.info(sentence, once=reason)
        self._forget(publisher)
        self._node.destroy_publisher(publisher)

    def destroy(self) -> None:
        """Remove the publishers."""
        self.shared.destroy()
        if self.video:
            self.video.destroy()
        self._node.destroy_publisher(self.images)
        if self.compressed:
            self._node.destroy_publisher(self.compressed)
