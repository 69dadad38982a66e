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

"""The topics on which frames are published as video."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TYPE_CHECKING

from opencv_tools.image.cdr import WireHeader
from opencv_tools.image.errors import KeyFrameNeeded, VideoError
from opencv_tools.logs import Log
from opencv_tools.topics.qos import create_frame_publisher
from opencv_tools.transport.message_type import message_type
from opencv_tools.video.messages import video_to_cdr, VIDEO_TOPICS
from opencv_tools.video.settings import VideoSettings
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher

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
        :param header: stamp and coordinate frame of the message.
        :returns: publishers that have published it.
        :raises KeyFrameNeeded: the packet of a camera needs a key frame that was not passed on.
        :raises ImageError: ``picture`` raised it.
        """
        used = {type_name: publisher for type_name, publisher in self.publishers.items()
                if publisher.get_subscription_count()}
        if not used:
            self.stream.end()
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
        return [*used.values()]

    def destroy(self) -> None:
        """Remove the publishers."""
        self.stream.end()
        for publisher in self.publishers.values():
            self._node.destroy_publisher(publisher)

    def _count_new(self, event: Any) -> None:
        """Request a key frame for new subscribers; called in the executor."""
        self.stream.requests += event.total_count_change
