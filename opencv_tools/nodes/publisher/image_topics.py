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

"""Topics of a camera: images, compressed images and calibration."""

from __future__ import annotations

import time
from typing import Any

from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.image.cdr import (
    compressed_image_to_cdr, WireCompressedImage, WireHeader, WireImage)
from opencv_tools.image.encodings import declared_encoding, Encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.image.layout import array_to_wire, view_image
from opencv_tools.image.orientation import turned_axes
from opencv_tools.logs import Log
from opencv_tools.nodes.publisher.backlog import Backlog
from opencv_tools.nodes.publisher.calibration_file import CameraInfoError
from opencv_tools.nodes.publisher.camera_info import Calibration
from opencv_tools.nodes.publisher.turned_camera_info import turn_camera_info
from opencv_tools.topics.frame_topics import FrameTopics, Lend
from opencv_tools.topics.qos import create_frame_publisher
from opencv_tools.transport.fastdds.profile import FastDdsSetup
from opencv_tools.transport.shared_frames.writer import Slot
from opencv_tools.video.settings import VideoSettings
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

# A subscriber may discover a publisher slightly later than the publisher discovers it.
_SETTLE_SECONDS = 0.2


class ImageTopics:
    """
    Publish frames on the topics that have subscribers, and compute nothing for the others.

    The names of the other topics are those of image_transport.
    """

    def __init__(
        self, node: Node, topic: str, calibration: Calibration, fastdds: FastDdsSetup,
        subscribers: int, video: VideoSettings | None = None,
    ) -> None:
        """
        Create the publishers.

        :param topic: name of the image topic.
        :param calibration: calibration of the camera.
        :param fastdds: result of the configuration of Fast DDS.
        :param subscribers: number of subscribers to wait for before the first frame.
        :param video: settings of the video topics; None for no such topics.
        :raises ParameterError: the ``qos_overrides`` parameters of a topic cannot be used.
        """
        self.calibration = calibration
        self._fastdds = fastdds
        self._log = Log(node.get_logger())
        self._largest = 0  # bytes of the largest frame so far
        self._topics = FrameTopics(node, topic, video)
        self.images = self._topics.images
        self._infos = create_frame_publisher(
            node, CameraInfo, f'{self._topics.name.rpartition("/")[0]}/camera_info')
        #: Messages that reliable subscribers have not confirmed.
        self.backlog = Backlog(self._publishers(), self._log)
        #: Number of subscribers to wait for before the first frame; 0 after the wait.
        self.awaited = subscribers
        self._settled_at = 0.0

    def may_publish(self) -> bool:
        """Return whether the awaited subscribers have come; later they may leave again."""
        if self.awaited:
            now = time.monotonic()
            if self._topics.count_subscribers() < self.awaited:
                self._settled_at = 0.0
            else:
                self._settled_at = self._settled_at or now + _SETTLE_SECONDS
                if now >= self._settled_at:
                    self.awaited = 0
        return not self.awaited

    def has_subscribers(self) -> bool:
        """Return whether any topic has a subscriber."""
        return self._topics.has_subscribers or self._infos.get_subscription_count() > 0

    def publish(
        self, output: OutputImage, stamp: Time, frame_id: str, *, is_live: bool,
    ) -> bool:
        """
        Publish a frame on each topic with subscribers, raw pixels first because they are fast.

        :param output: frame to publish.
        :param stamp: stamp of the messages.
        :param frame_id: coordinate frame of the camera.
        :param is_live: whether a subscriber that is late loses frames; the publisher of a file
            waits for it.
        :returns: whether any topic has a subscriber.
        :raises ImageError: the frame cannot be decoded or converted.
        """
        header = WireHeader(stamp.sec, stamp.nanosec, frame_id)
        failure: ImageError | None = None
        is_published = False
        self._topics.shared.deliver = None if is_live else self.backlog.deliver
        try:
            # All other work is done after the pixels are on their way.
            is_message = self._topics.publish_raw(
                lambda lend: _wire_image(output, header, lend))
            is_published = is_message is not None
            if is_message:
                self._check_room(output.image.nbytes)
                self.backlog.add(self.images)
            if self._infos.get_subscription_count():
                self._infos.publish(self._camera_info(
                    output, Header(stamp=stamp, frame_id=frame_id)))
                self.backlog.add(self._infos)
                is_published = True
        except ImageError as err:
            failure = err  # the JPEG data of the camera may still be published unchanged
        if self._topics.publish_compressed(lambda: _compressed(output, header)):
            self.backlog.add(self._topics.compressed)
            is_published = True
        if failure:
            raise failure
        return self._publish_video(output, header) or is_published

    def use_video(self, settings: VideoSettings) -> None:
        """Encode video with other settings from the next frame on."""
        if self._topics.video:
            self._topics.video.stream.settings = settings

    def close(self) -> None:
        """Stop sharing frames."""
        self._topics.shared.destroy()

    def _publish_video(self, output: OutputImage, header: WireHeader) -> bool:
        video = self._topics.video
        used = video.publish(lambda: (output.image, output.encoding), header) if video else []
        for publisher in used:
            self.backlog.add(publisher)
        return bool(used)

    def _camera_info(self, output: OutputImage, header: Header) -> CameraInfo:
        """Return the calibration of the bag that a frame comes from, else that of the camera."""
        flip, rotate = output.settings.flip, output.settings.rotate
        serialized = output.recorded.camera_info if output.recorded else None
        if serialized is not None:
            try:
                info = deserialize_message(bytes(serialized), CameraInfo)
                message = turn_camera_info(info, turned_axes(flip, rotate))
            except (CameraInfoError, RuntimeError, ValueError) as err:
                self._log.warning(
                    f'the camera_info of the bag is not used: {err}', once='camera_info')
            else:
                message.header = header
                return message
        return self.calibration.message(header, *output.size, flip, rotate)

    def _check_room(self, frame_bytes: int) -> None:
        """Log a warning when frames become too large for the shared memory."""
        if frame_bytes > self._largest:
            self._largest = frame_bytes
            size_warning = self._fastdds.size_warning(frame_bytes)
            if size_warning:
                self._log.warning(size_warning)

    def _publishers(self) -> tuple[Publisher, ...]:
        video = self._topics.video
        return (self.images, self._topics.compressed, self._infos,
                *(video.publishers.values() if video else ()))


def _wire_image(
    output: OutputImage, header: WireHeader, lend: Lend,
) -> tuple[WireImage, Slot | None]:
    """Return a message, and the lent memory that the last conversion has written to."""
    slot: Slot | None = None

    def lend_image(height: int, width: int, encoding: Encoding) -> NDArray[Any] | None:
        nonlocal slot
        slot = lend(encoding.size(height, width))
        return view_image(slot.data, height, width, encoding) if slot else None

    output.lend = lend_image  # it keeps the slot as long as the pixels
    image = output.image
    return array_to_wire(image, declared_encoding(image, output.encoding), header), slot


def _compressed(output: OutputImage, header: WireHeader) -> bytes:
    data, format_text = output.jpeg
    return compressed_image_to_cdr(WireCompressedImage(
        header=header, format=format_text, data=data.data))
