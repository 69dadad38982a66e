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

"""The topics on which frames are published, as images and as video."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, TYPE_CHECKING

from opencv_tools.base.logs import Log
from opencv_tools.image.cdr import WireHeader, WireImage
from opencv_tools.image.compressed_depth import COMPRESSED_DEPTH
from opencv_tools.image.errors import KeyFrameNeeded, VideoError
from opencv_tools.topics.compressed_topic import CompressedTopic
from opencv_tools.topics.qos import create_frame_publisher
from opencv_tools.topics.topic_discovery import resolve_topic
from opencv_tools.transport.message_type import message_type
from opencv_tools.transport.shared_frames.publisher import SharedFramePublisher
from opencv_tools.transport.shared_frames.writer import Slot
from opencv_tools.video.messages import video_to_cdr, VIDEO_TOPICS
from opencv_tools.video.settings import VideoSettings
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import Image

if TYPE_CHECKING:
    from opencv_tools.video.stream import Picture

# Pictures that a slow subscriber may receive later. Without one of them the picture stands still
# until the next key frame.
_DEPTH = 60
_LOGGED_SECONDS = 10.0


class VideoTopics:
    """
    Publish frames as video on a topic for each type of message, from one encoding.

    Frames are encoded only while somebody subscribes. A new subscriber gets a key frame.
    """

    def __init__(self, node: Node, name: str, settings: VideoSettings) -> None:
        """
        Create the publishers.

        :param name: name of the topic of raw images after remapping; the others have its name and
            a suffix.
        :param settings: codec, quality and so on.
        :raises ParameterError: the ``qos_overrides`` parameters of a topic cannot be used.
        """
        # It needs OpenCV, which publishers without video do not need.
        from opencv_tools.video.stream import VideoStream
        self._node = node
        self._log = Log(node.get_logger())
        #: The encoded video. Its settings may be changed.
        self.stream = VideoStream(settings)
        self._number = 0
        #: Number of published messages by topic.
        self.sent: Counter[str] = Counter()
        events = PublisherEventCallbacks(matched=self._count_new)
        #: Publishers of each type.
        self.publishers: dict[str, Publisher] = {
            type_name: create_frame_publisher(
                node, message_type(type_name), f'{name}/{suffix}', depth=_DEPTH, events=events)
            for type_name, suffix in VIDEO_TOPICS.items()}

    def count_subscribers(self) -> int:
        """Return the number of subscribers."""
        return sum(publisher.get_subscription_count() for publisher in self.publishers.values())

    def publish(self, picture: Callable[[], Picture], header: WireHeader) -> list[Publisher]:
        """
        Publish a frame, if somebody receives it. Errors of the encoder are logged.

        :param picture: returns the image and its encoding, or the packet of a camera.
        :returns: publishers that have published it.
        :raises KeyFrameNeeded: the packet of a camera needs a key frame that was not passed on.
        :raises ImageError: ``picture`` raised it.
        """
        used = {type_name: publisher for type_name, publisher in self.publishers.items()
                if publisher.get_subscription_count()}
        if not used:
            self.stream.end()
            self.stream.measure()  # for a later subscriber
            return []
        found = picture()
        try:
            packet = self.stream.packet(found, header.stamp_ns)
        except KeyFrameNeeded:
            raise
        except VideoError as err:
            self._log.error(f'no video: {err}', every=_LOGGED_SECONDS, key='video')
            return []
        self._number += 1
        for type_name, publisher in used.items():
            publisher.publish(video_to_cdr(type_name, header, packet, self._number))
            self.sent[publisher.topic_name] += 1
        return [*used.values()]

    def destroy(self) -> None:
        """Remove the publishers."""
        self.stream.end()
        for publisher in self.publishers.values():
            self._node.destroy_publisher(publisher)

    def _count_new(self, event: Any) -> None:
        """Request a key frame for new subscribers; called in the executor."""
        self.stream.requests += event.total_count_change


_PARTICIPANT_BYTES = 12  # of the identifier of an endpoint, see section 8.2.4 of DDSI-RTPS
#: Lends shared memory for a number of bytes, if it has readers.
Lend = Callable[[int], Slot | None]


def describe_partly_sent(counts: Mapping[str, int], sent: int) -> str:
    """
    Return on which topics fewer frames were published, as text that begins with a comma.

    :param counts: number of frames by topic.
    :param sent: number of frames that were published on any topic.
    """
    return ''.join(f', {count} on {name}' for name, count in counts.items() if 0 < count < sent)


class FrameTopics:
    """
    Publish raw images, also by shared memory, compressed images, depth and video.

    Nothing is computed for topics without subscribers.

    The names of the topics are those of image_transport.
    """

    def __init__(self, node: Node, topic: str, video: VideoSettings | None = None) -> None:
        """
        Create the publishers.

        :param topic: name of the topic of the raw images; compressed images are on
            ``<topic>/compressed``, and those of depth also on ``<topic>/compressedDepth``.
        :param video: settings of the video; None for no video.
        :raises ParameterError: the name of the topic or its ``qos_overrides`` parameters cannot be
            used.
        """
        #: Name of the image topic after remapping.
        self.name = resolve_topic(node, topic)
        self.images = create_frame_publisher(node, Image, topic)
        self.compressed = CompressedTopic(node, self.name)
        self.depth = CompressedTopic(node, self.name, COMPRESSED_DEPTH, is_expected=False)
        self.shared = SharedFramePublisher(node, self.images)
        #: Topics of the video; None without video.
        self.video = VideoTopics(node, self.name, video) if video else None
        self._node = node

    @property
    def has_subscribers(self) -> bool:
        """Whether a frame would be received, or its compressed form is asked for."""
        return self.has_image_subscribers or bool(self.video and self.video.count_subscribers())

    @property
    def has_image_subscribers(self) -> bool:
        """Whether an image would be received, not only video."""
        return bool(self.shared.has_subscribers or self.images.get_subscription_count()
                    or self.compressed.count_subscribers() or self.depth.count_subscribers())

    @property
    def has_other_subscribers(self) -> bool:
        """Whether a frame would be received in another form than as a raw image."""
        return bool(self.compressed.count_subscribers() or self.depth.count_subscribers()
                    or (self.video and self.video.count_subscribers()))

    def count_subscribers(self) -> int:
        """
        Return the number of subscribers of raw and compressed images, and of video.

        A subscriber by shared memory may have subscribed to the image topic as well.
        """
        raw, shared = (
            Counter((bytes(found.endpoint_gid)[:_PARTICIPANT_BYTES], found.node_namespace,
                     found.node_name)
                    for found in self._node.get_subscriptions_info_by_topic(name))
            for name in (self.images.topic_name, self.shared.topic_name))
        video = self.video.count_subscribers() if self.video else 0
        return int(self.images.get_subscription_count() + video
                   + self.compressed.count_subscribers() + self.depth.count_subscribers()
                   + (shared - raw).total())

    @property
    def sent(self) -> dict[str, int]:
        """
        Return the number of frames by topic.

        Those that were shared without a message of the image topic count for ``<topic>/shm``.
        """
        return {
            self.name: self.shared.messages,
            self.shared.topic_name: self.shared.frames - self.shared.messages,
            **{topic.topic_name: topic.sent for topic in (self.compressed, self.depth)},
            **(self.video.sent if self.video else {})}

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

    def destroy(self) -> None:
        """Remove the publishers."""
        self.shared.destroy()
        if self.video:
            self.video.destroy()
        self.compressed.destroy()
        self.depth.destroy()
        self._node.destroy_publisher(self.images)
