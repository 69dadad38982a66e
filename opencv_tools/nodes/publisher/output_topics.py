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

"""Topics on which an image and its calibration are published, and their messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray
from opencv_tools.capture.output_image import (
    compressed_loss, depth_form, depth_loss, OutputImage, why_no_depth)
from opencv_tools.image.cdr import WireHeader, WireImage
from opencv_tools.image.encodings import declared_encoding, Encoding
from opencv_tools.image.errors import ImageError, KeyFrameNeeded
from opencv_tools.image.layout import array_to_wire, view_image
from opencv_tools.nodes.publisher.backlog import Backlog
from opencv_tools.topics.frame_topics import FrameTopics, Lend
from opencv_tools.topics.qos import create_frame_publisher
from opencv_tools.transport.shared_frames.writer import Slot
from opencv_tools.video.settings import VideoSettings
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo


def raw_message(
    output: OutputImage, header: WireHeader, lend: Lend,
) -> tuple[WireImage, Slot | None]:
    """
    Return a message, and the lent memory that the last conversion has written to.

    :param output: image to publish.
    :param lend: lends memory that subscribers read.
    :raises ImageError: the image cannot be decoded or converted.
    """
    slot: Slot | None = None

    def lend_image(height: int, width: int, encoding: Encoding) -> NDArray[Any] | None:
        nonlocal slot
        slot = lend(encoding.size(height, width))
        return view_image(slot.data, height, width, encoding) if slot else None

    output.lend = lend_image  # it keeps the slot as long as the pixels
    image = output.image
    return array_to_wire(image, declared_encoding(image, output.encoding), header), slot


class OutputTopics:
    """Publish images on the topics that have subscribers, and compute nothing for the others."""

    def __init__(
        self, node: Node, topic: str, info_topic: str, video: VideoSettings | None,
        backlog: Backlog, check_room: Callable[[int], object],
    ) -> None:
        """
        Create the publishers.

        :param video: settings of the video topics; None for no such topics.
        :param check_room: called with the bytes of each image message.
        :raises ParameterError: the ``qos_overrides`` parameters of a topic cannot be used.
        """
        self._node = node
        #: Topics of the images.
        self.frames = FrameTopics(node, topic, video)
        self._infos = create_frame_publisher(node, CameraInfo, info_topic)
        video_topics = self.frames.video
        self._publishers = (
            self.frames.images, self.frames.compressed, self.frames.depth, self._infos,
            *(video_topics.publishers.values() if video_topics else ()))
        self._backlog = backlog
        self._check_room = check_room
        backlog.watch(self._publishers)
        #: Whether a subscriber waits for a key frame of a camera that encodes its video.
        self.waits_for_key = False

    @property
    def has_subscribers(self) -> bool:
        """Whether any topic has a subscriber."""
        return self.frames.has_subscribers or self._infos.get_subscription_count() > 0

    @property
    def needs_key_frame(self) -> bool:
        """Whether a subscriber waits for a key frame of a camera that encodes its video."""
        video = self.frames.video
        return self.waits_for_key or (video is not None and video.stream.needs_key_frame)

    def publish(
        self, output: OutputImage, header: WireHeader, camera_info: Callable[[], CameraInfo], *,
        is_live: bool,
    ) -> bool:
        """
        Publish an image on each topic with subscribers, raw pixels first because they are fast.

        :param output: image to publish.
        :param is_live: whether a subscriber that is late loses frames.
        :returns: whether the image was published in any form.
        :raises ImageError: the image cannot be decoded or converted.
        """
        self.frames.shared.deliver = None if is_live else self._backlog.deliver
        return self._publish_each(
            lambda: self._publish_raw(output, header, camera_info),
            lambda: self._publish_compressed(output, header),
            lambda: self._publish_depth(output, header),
            lambda: self._publish_video(output, header))

    def pass_on(self, output: OutputImage, header: WireHeader, needs_image: bool) -> bool:
        """
        Publish the packet of a camera or stream whose image is not due.

        It is decoded if somebody receives images, because the next image needs it.

        :param needs_image: whether the image is needed for other topics as well.
        :returns: whether the packet was published.
        :raises ImageError: the packet cannot be decoded.
        """
        def decode() -> bool:
            if needs_image or self.frames.has_image_subscribers or not output.packet:
                _ = output.image
            return False

        return self._publish_each(
            decode, lambda: bool(output.packet) and self._publish_video(output, header))

    def _publish_each(self, *steps: Callable[[], bool]) -> bool:
        """Publish in each form; an error of one form does not keep back the others."""
        failure: ImageError | None = None
        is_published = self.waits_for_key = False
        for publish in steps:
            try:
                is_published = publish() or is_published
            except KeyFrameNeeded:  # of a camera; its next key frame comes soon
                self.waits_for_key = True
            except ImageError as err:
                failure = failure or err  # the JPEG of the camera may still be published
        if failure:
            raise failure
        return is_published

    def use_video(self, settings: VideoSettings, rate: float) -> None:
        """
        Encode video with these settings from the next frame on. A repeated call has no effect.

        :param rate: expected frames per second until they are measured; 0.0 if they are unknown.
        """
        if self.frames.video:
            stream = self.frames.video.stream
            stream.settings, stream.expected_rate = settings, rate

    def destroy(self) -> None:
        """Remove the publishers."""
        self._backlog.forget(self._publishers)
        self.frames.destroy()
        self._node.destroy_publisher(self._infos)

    def _publish_raw(
        self, output: OutputImage, header: WireHeader, camera_info: Callable[[], CameraInfo],
    ) -> bool:
        """Publish pixels and calibration; all other work is done after they are on their way."""
        is_message = self.frames.publish_raw(lambda lend: raw_message(output, header, lend))
        if is_message:
            self._check_room(output.image.nbytes)
            self._backlog.add(self.frames.images)
        if self._infos.get_subscription_count():
            self._infos.publish(camera_info())
            self._backlog.add(self._infos)
        return is_message is not None

    def _publish_compressed(self, output: OutputImage, header: WireHeader) -> bool:
        topic = self.frames.compressed
        is_published = (
            self.frames.has_image_subscribers and topic.is_due(output.why_not_compressed)
            and topic.publish(lambda: output.compressed, header, compressed_loss(output)))
        if is_published:
            self._backlog.add(topic)
        return is_published

    def _publish_depth(self, output: OutputImage, header: WireHeader) -> bool:
        topic = self.frames.depth
        is_published = topic.is_due(why_no_depth(output)) and topic.publish(
            lambda: depth_form(output), header, depth_loss(output))
        if is_published:
            self._backlog.add(topic)
        return is_published

    def _publish_video(self, output: OutputImage, header: WireHeader) -> bool:
        video = self.frames.video
        if video is None:
            return False
        if output.frame.video and not output.packet and video.count_subscribers():
            self._node.get_logger().info(
                'The H.264 of the source is decoded and encoded again, because flip, rotate or '
                'encoding changes its pictures', once=True)
        used = video.publish(lambda: output.packet or (output.image, output.encoding), header)
        for publisher in used:
            self._backlog.add(publisher)
        return bool(used)
