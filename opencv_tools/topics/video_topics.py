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
import time
from typing import Any

from numpy.typing import NDArray
from opencv_tools.image.cdr import WireHeader
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import VideoError
from opencv_tools.logs import Log
from opencv_tools.topics.qos import create_frame_publisher
from opencv_tools.transport.message_type import message_type
from opencv_tools.units import NANO
from opencv_tools.video.encoder import VideoEncoder
from opencv_tools.video.messages import VIDEO_TOPICS, video_to_cdr
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.settings import VideoSettings
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher

# Pictures that a slow subscriber may receive later. Without one of them the picture stands still
# until the next key frame.
_DEPTH = 60
# A subscriber may discover a publisher later than the publisher discovers it, and misses the first
# key frame then. It gets another one.
_KEY_FRAMES = 2
_KEY_SECONDS = 1.0  # between key frames for new subscribers
_ASSUMED_RATE = 30.0  # frames per second, by which a bit rate becomes a size of frames
_LOGGED_SECONDS = 10.0

#: Returns an image and the name of its encoding.
Picture = Callable[[], tuple[NDArray[Any], str]]


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
        :param settings: codec, quality and so on; may be set later.
        :raises ParameterError: the ``qos_overrides`` parameters of a topic cannot be used.
        """
        self.settings = settings
        self._node = node
        self._log = Log(node.get_logger())
        self._encoder: VideoEncoder | None = None
        self._opened = settings, 0, 0  # settings, width and height of the encoder
        self._joined = 0  # subscribers until now; written in the executor
        self._seen = self._key_frames = 0  # those known to the encoder, and key frames for them
        self._keyed_at = 0.0
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

    def publish(self, picture: Picture, header: WireHeader) -> list[Publisher]:
        """
        Publish a frame, if somebody receives it. Errors of the encoder are logged.

        :param picture: returns the image.
        :param header: stamp and coordinate frame of the message.
        :returns: publishers that have published it.
        :raises ImageError: ``picture`` raised it.
        """
        used = {type_name: publisher for type_name, publisher in self.publishers.items()
                if publisher.get_subscription_count()}
        if not used:
            self._encoder = None
            return []
        image, encoding = picture()
        try:
            packet = self._encode(image, encoding, header.sec * NANO + header.nanosec)
        except VideoError as err:
            self._encoder = None
            self._log.error(f'no video: {err}', every=_LOGGED_SECONDS, key='video')
            return []
        self._number += 1
        for type_name, publisher in used.items():
            publisher.publish(video_to_cdr(type_name, header, packet, self._number))
        return [*used.values()]

    def destroy(self) -> None:
        """Remove the publishers."""
        self._encoder = None
        for publisher in self.publishers.values():
            self._node.destroy_publisher(publisher)

    def _encode(self, image: NDArray[Any], encoding: str, stamp_ns: int) -> VideoPacket:
        needed = self.settings, image.shape[1], find_encoding(encoding).height(image.shape[0])
        if self._encoder is None or self._opened != needed:
            self._encoder = VideoEncoder(*needed, _ASSUMED_RATE)
            self._opened = needed
        if self._seen != self._joined:
            self._seen, self._key_frames = self._joined, _KEY_FRAMES
        now = time.monotonic()
        is_key = self._key_frames > 0 and now >= self._keyed_at + _KEY_SECONDS
        packet = self._encoder.encode(image, encoding, stamp_ns, key=is_key)
        if packet.is_key:
            self._keyed_at = now
            self._key_frames = max(0, self._key_frames - 1)
        return packet

    def _count_new(self, event: Any) -> None:
        """Count new subscribers; called in the executor."""
        self._joined += event.total_count_change
