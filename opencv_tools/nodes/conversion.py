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

"""Conversion of received messages to frames of a recording, for files and for bags."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

from opencv_tools.bags.offered_qos import offered_qos_text, OfferedQos
from opencv_tools.bags.schemas import CAMERA_INFO
from opencv_tools.bags.writing import BagChannel
from opencv_tools.base.logs import Log, Throttle
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.cdr import COMPRESSED_IMAGE, IMAGE, WireCompressedImage, WireMessage
from opencv_tools.image.compressed_depth import compressed_size
from opencv_tools.image.errors import CodecError, SizeError
from opencv_tools.image.image_size import check_size, MAX_PIXELS
from opencv_tools.image.topic_names import camera_info_topic, camera_info_topics, image_topic
from opencv_tools.recording.bag_sink import MessageFrame, RecordedMessage
from opencv_tools.recording.frames import (
    ArrivalClock, CompressedFrame, packet_frame, RawFrame, ReceivedFrame)
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.topics.message_reader import MessageReader
from opencv_tools.topics.qos import following_qos
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.topics.timers import create_steady_timer
from opencv_tools.video.messages import VIDEO_TOPICS, WireVideo
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import CameraInfo

# Messages of camera_info that the middleware keeps while the node is busy.
_DEPTH = 100
# Period of the check of the publishers of camera_info.
_CHECK_SECONDS = 1.0
# Period in which camera_info is taken while no frame arrives.
_TAKE_SECONDS = 0.25
# Maximum size of a camera_info in bytes, because many may wait for the next frame.
_MAX_BYTES = 1 << 16
_WARNING_SECONDS = 60.0
# Publishers of a topic whose quality of service is stored.
_MAX_PUBLISHERS = 100


class FrameConverter:
    """Convert messages to frames, without a copy of their data."""

    def __init__(self, bridge: CvBridge, max_pixels: int = MAX_PIXELS) -> None:
        """
        Create a converter.

        :param max_pixels: maximum number of pixels of a frame.
        """
        self._bridge = bridge
        self._max_pixels = max_pixels
        self._arrivals = ArrivalClock()

    def convert(
        self, message: WireMessage | WireVideo, topic: str, receive_ns: int,
        publisher: bytes = b'', number: int = 0,
    ) -> ReceivedFrame:
        """
        Convert a message to a frame.

        :param message: raw or compressed image message, or message with video.
        :param receive_ns: time of reception in nanoseconds of the system clock.
        :param publisher: identifier of the publisher of video; b'' if unknown.
        :param number: number of the message from its publisher; 0 if unknown.
        :returns: the frame, a view of the message; a compressed image or video is not decoded.
        :raises CvBridgeError: the message is not a valid image.
        :raises SizeError: the image has too many pixels.
        :raises ImageError: the video is damaged, or its codec is unknown.
        """
        arrival_ns = self._arrivals.arrival_ns(receive_ns)
        header = message.header
        stamp_ns = header.stamp_ns
        if isinstance(message, WireCompressedImage):
            self._check_size(*_declared_size(message))
            return CompressedFrame(
                metadata=FrameMetadata(stamp_ns, header.frame_id, message.format, topic),
                receive_ns=receive_ns, arrival_ns=arrival_ns, data=message.data,
                max_pixels=self._max_pixels)
        if isinstance(message, WireVideo):
            frame = packet_frame(message, topic, receive_ns, arrival_ns, publisher, number)
            self._check_size(frame.packet.width, frame.packet.height)
            return frame
        self._check_size(message.width, message.height)
        return RawFrame(
            metadata=FrameMetadata(stamp_ns, header.frame_id, message.encoding, topic),
            receive_ns=receive_ns, arrival_ns=arrival_ns,
            image=self._bridge.imgmsg_to_cv2(message))

    def _check_size(self, width: int, height: int) -> None:
        try:
            check_size(width, height, self._max_pixels)
        except SizeError as err:
            raise SizeError(f'{err}; raise the parameter max_pixels to receive it') from err


def _declared_size(message: WireCompressedImage) -> tuple[int, int]:
    """Read the size of a compressed image; 0 by 0 if it has none and will not be decoded."""
    try:
        return compressed_size(bytes(message.data), message.format)
    except CodecError:
        return 0, 0


class InfoMessages:
    """
    Take the serialized messages of a topic of camera_info, as its publishers offer them.

    They do not wake the executor, which would cost as much as the frames do.
    """

    def __init__(
        self, node: Node, topic: str, on_message: Callable[[str, Any, int, int, int], object],
    ) -> None:
        """
        Subscribe.

        :param topic: name of the topic after remapping.
        :param on_message: called with the topic, a serialized message, the times of reception and
            of publication in nanoseconds, and the number of the message; 0 for what is unknown.
        """
        self._node, self._topic, self._on_message = node, topic, on_message
        self._subscribe(offers_of(node, topic, CAMERA_INFO))

    def take(self) -> None:
        """Pass on the messages that have arrived."""
        for _ in range(_DEPTH):
            taken = self._reader.take_serialized()
            if taken is None:
                break
            serialized, info = taken
            self._on_message(self._topic, serialized, info.received_timestamp,
                             info.source_timestamp, info.number)

    def follow(self) -> None:
        """Subscribe again if the publishers offer something else."""
        offers = offers_of(self._node, self._topic, CAMERA_INFO)
        if offers and _qos(offers) != self._qos:
            self.close()
            self._subscribe(offers)

    def close(self) -> None:
        """Pass on the messages that have arrived, and unsubscribe."""
        self.take()
        self._reader.destroy()

    def _subscribe(self, offers: list[TopicEndpointInfo]) -> None:
        self._qos = _qos(offers)
        self._reader = MessageReader(self._node, CameraInfo, self._topic, self._qos)


class BagMessages:
    """Create the messages of a bag. The topics are described with what their publishers offer."""

    def __init__(
        self, node: Node, topic: str, log: Log, on_message: Callable[[RecordedMessage], object],
    ) -> None:
        """
        Create a converter and subscribe to the camera_info that may belong to the images.

        :param topic: topic of the frames, after remapping.
        :param on_message: called with each camera_info, as it was received.
        """
        self._node = node
        self._log = log
        self._on_message = on_message
        self._arrivals = ArrivalClock()
        self._channels: dict[tuple[str, str], BagChannel] = {}
        self._image_topics: dict[str, str] = {}
        self._throttle = Throttle()
        self._topic = topic
        self._checks = 0
        self._found = set[str]()  # topics of camera_info with messages
        # The first messages of each topic: that of rectified images may be discovered later than
        # that of the camera.
        self._held: list[RecordedMessage] | None = []
        self._infos = [InfoMessages(node, info_topic, self._pass_on)
                       for info_topic in camera_info_topics(topic)]
        self._timer = create_steady_timer(node, _TAKE_SECONDS, self._take)

    def frame(self, received: ReceivedMessage, topic: str) -> MessageFrame:
        """
        Return a message as a frame, without a check of its content.

        :param received: raw or compressed image message, or message with video.
        :param topic: topic of the message, after remapping.
        """
        self._take()
        type_name = type_of(received)
        if type_name == IMAGE:
            topic = self._topic_of_images(topic)
        if self._throttle.passes('camera_info', _CHECK_SECONDS):
            for info in self._infos:
                info.follow()
            if self._checks:
                self._release()
            self._checks += 1
        return frame_of(received, self._channel(topic, type_name),
                        self._arrivals.arrival_ns(received.receive_ns))

    def close(self) -> None:
        """Pass on the messages of camera_info that have arrived, and unsubscribe."""
        self._node.destroy_timer(self._timer)
        for info in self._infos:
            info.close()
        self._release()

    def _take(self) -> None:
        """Take the messages of camera_info that have arrived."""
        for info in self._infos:
            info.take()

    def _release(self) -> None:
        """Pass on the first messages, and hold none from now on."""
        held, self._held = self._held, None
        for message in held or ():
            self._add(message)

    def _add(self, message: RecordedMessage) -> None:
        """Pass on a message, if its topic belongs to the images."""
        topic = message.channel.topic
        if topic == camera_info_topic(self._topic, lambda name: (
                name in self._found or self._node.count_publishers(name))):
            self._on_message(message)

    def _pass_on(
        self, topic: str, serialized: Any, received_ns: int, source_ns: int, number: int,
    ) -> None:
        if len(serialized) > _MAX_BYTES:
            self._log.warning(
                f'a message of {len(serialized)} bytes on {topic} was not recorded: a '
                f'camera_info has at most {_MAX_BYTES}', every=_WARNING_SECONDS, key='camera_info')
            return
        self._found.add(topic)
        log_ns = received_ns or time.time_ns()
        message = RecordedMessage(
            channel=self._channel(topic, CAMERA_INFO), parts=(serialized,), log_ns=log_ns,
            publish_ns=source_ns or log_ns, number=number)
        if self._held is None:
            self._add(message)
            return
        self._held.append(message)
        if len(self._held) == _DEPTH:
            self._release()

    def _topic_of_images(self, topic: str) -> str:
        """Return the topic of raw images, which may be decoded from a video topic."""
        if topic not in self._image_topics:
            is_video = any(offers_of(self._node, topic, type_name) for type_name in VIDEO_TOPICS)
            self._image_topics[topic] = image_topic(topic) if is_video else topic
        return self._image_topics[topic]

    def _channel(self, topic: str, type_name: str) -> BagChannel:
        """Return a topic as a bag describes it, with the publishers at its first message."""
        if (topic, type_name) not in self._channels:
            self._channels[topic, type_name] = bag_channel(
                topic, type_name, offers_of(self._node, topic, type_name))
        return self._channels[topic, type_name]


def type_of(received: ReceivedMessage) -> str:
    """Return the type of a message."""
    message = received.message
    if isinstance(message, WireVideo):
        return message.type_name
    return COMPRESSED_IMAGE if isinstance(message, WireCompressedImage) else IMAGE


def frame_of(
    received: ReceivedMessage, channel: BagChannel, arrival_ns: int = 0,
) -> MessageFrame:
    """
    Return a message as a frame, without a check of its content.

    :param arrival_ns: time of reception in nanoseconds of CLOCK_MONOTONIC.
    """
    message = received.message
    header = message.header
    encoding = message.format if isinstance(message, WireCompressedImage) else message.encoding
    return MessageFrame(
        metadata=FrameMetadata(header.stamp_ns, header.frame_id, encoding, channel.topic),
        receive_ns=received.receive_ns, arrival_ns=arrival_ns, message=message, channel=channel,
        publish_ns=received.publish_ns, number=received.number)


def offers_of(node: Node, topic: str, type_name: str) -> list[TopicEndpointInfo]:
    """Return the publishers of a topic that have a type."""
    return [info for info in node.get_publishers_info_by_topic(topic)
            if info.topic_type == type_name][:_MAX_PUBLISHERS]


def bag_channel(topic: str, type_name: str, offers: list[TopicEndpointInfo]) -> BagChannel:
    """Return a topic as a bag describes it, given its publishers."""
    hashes = {str(offer.topic_type_hash) for offer in offers} - {'INVALID'}
    return BagChannel(
        topic=topic, type_name=type_name, qos=offered_qos_text(map(offered_qos, offers)),
        type_hash=min(hashes, default=''))


def _qos(offers: list[TopicEndpointInfo]) -> QoSProfile:
    return following_qos([offer.qos_profile for offer in offers], _DEPTH)


def offered_qos(offer: TopicEndpointInfo) -> OfferedQos:
    """Return the quality of service of a publisher as a bag describes it."""
    qos = offer.qos_profile
    return OfferedQos(
        history=qos.history.value, depth=qos.depth, reliability=qos.reliability.value,
        durability=qos.durability.value, deadline_ns=qos.deadline.nanoseconds,
        lifespan_ns=qos.lifespan.nanoseconds, liveliness=qos.liveliness.value,
        liveliness_lease_ns=qos.liveliness_lease_duration.nanoseconds)
