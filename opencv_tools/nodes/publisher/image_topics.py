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

"""Topics of a camera: images, compressed images, video and calibration, raw and rectified."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
import time

from builtin_interfaces.msg import Time
from opencv_tools.base.logs import Log
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.capture.rectified_image import RectifiedImage
from opencv_tools.image.cdr import WireHeader
from opencv_tools.image.errors import ImageError, RectificationError
from opencv_tools.image.orientation import turned_axes
from opencv_tools.nodes.publisher.backlog import Backlog
from opencv_tools.nodes.publisher.calibration_file import CameraInfoError
from opencv_tools.nodes.publisher.camera_info import PublishedCalibration, turn_camera_info
from opencv_tools.nodes.publisher.output_topics import OutputTopics
from opencv_tools.rectification import rectified_info, Rectifier
from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.topic_discovery import resolve_topic
from opencv_tools.transport.fastdds.profile import FastDdsSetup
from opencv_tools.video.settings import VideoSettings
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

# Name of image_proc for rectified images, beside the image topic.
_RECTIFIED = 'image_rect'
# A subscriber may discover a publisher slightly later than the publisher discovers it.
_SETTLE_SECONDS = 0.2


class ImageTopics:
    """
    Publish frames on the topics that have subscribers, and compute nothing for the others.

    The names of the other topics are those of image_transport.
    """

    def __init__(
        self, node: Node, topic: str, calibration: PublishedCalibration, fastdds: FastDdsSetup,
        subscribers: int, video: VideoSettings | None = None,
    ) -> None:
        """
        Create the publishers.

        :param subscribers: number of subscribers to wait for before the first frame.
        :param video: settings of the video topics; None for no such topics.
        :raises ParameterError: the ``qos_overrides`` parameters of a topic cannot be used.
        """
        self.calibration = calibration
        self._node = node
        self._fastdds = fastdds
        self._log = Log(node.get_logger())
        self._largest = 0  # bytes of the largest frame so far
        #: Messages that reliable subscribers have not confirmed.
        self.backlog = Backlog((), self._log)
        self._name = resolve_topic(node, topic)
        self._folder = self._name.rpartition('/')[0]
        self._video = video
        self._camera = self._create(topic, f'{self._folder}/camera_info')
        self._topics = self._camera.frames
        self.images = self._topics.images
        #: Topics of the raw images, and those of the rectified ones.
        self.outputs: tuple[OutputTopics, ...] = (self._camera,)
        self._rectifies = False
        self._rectifier = Rectifier()
        self._failure = ''  # why no rectified image is published, as logged
        #: Number of subscribers to wait for before the first frame; 0 after the wait.
        self.awaited = subscribers
        self._settled_at = 0.0

    def rectify(self, is_wanted: bool) -> None:
        """
        Publish rectified images as well, or no longer. A repeated call has no effect.

        :raises ParameterError: the topic of the rectified images has the name of the image topic,
            or its ``qos_overrides`` parameters cannot be used.
        """
        if is_wanted == self._rectifies:
            return
        self._rectifies = is_wanted
        self._failure = ''
        for topics in self.outputs[1:]:
            topics.destroy()
        self.outputs = (self._camera,)
        if is_wanted:
            topic = f'{self._folder}/{_RECTIFIED}'
            name = resolve_topic(self._node, topic)
            if name == self._name:
                raise ParameterError(f'parameter rectify is true, but {name} is the topic of the '
                                     'images: remap one of the two topics')
            self.outputs = self._camera, self._create(topic, f'{name}/camera_info')

    def may_publish(self) -> bool:
        """Return whether the awaited subscribers have come; later they may leave again."""
        if self.awaited:
            now = time.monotonic()
            count = sum(topics.frames.count_subscribers() for topics in self.outputs)
            # A subscriber may be in the graph, but not be connected yet.
            if count < self.awaited or not self.has_subscribers():
                self._settled_at = 0.0
            else:
                self._settled_at = self._settled_at or now + _SETTLE_SECONDS
                if now >= self._settled_at:
                    self.awaited = 0
        return not self.awaited

    def has_subscribers(self, *, of_frames: bool = False) -> bool:
        """
        Return whether any topic has a subscriber.

        :param of_frames: whether to ask for topics of images and video only, not of calibration.
        """
        return any((topics.frames if of_frames else topics).has_subscribers
                   for topics in self.outputs)

    def publish(
        self, output: OutputImage, stamp: Time, frame_id: str, *, is_live: bool,
    ) -> bool:
        """
        Publish a frame on each topic with subscribers, the rectified one last.

        :param output: frame to publish.
        :param is_live: whether a subscriber that is late loses frames; the publisher of a file
            waits for it.
        :returns: whether the frame was published in any form, not only its calibration; for a
            frame that is not due, whether its packet was.
        :raises ImageError: the frame cannot be decoded or converted.
        """
        header = WireHeader(stamp.sec, stamp.nanosec, frame_id)
        info = cache(lambda: self._camera_info(output, Header(stamp=stamp, frame_id=frame_id)))
        if not output.frame.is_due:
            needs_image = any(topics.frames.has_subscribers for topics in self.outputs[1:])
            return self._camera.pass_on(output, header, needs_image)
        failure: ImageError | None = None
        is_published = False
        try:
            is_published = self._camera.publish(output, header, info, is_live=is_live)
        except ImageError as err:
            failure = err
        try:
            is_published |= self._publish_rectified(output, header, info, is_live)
        except ImageError as err:
            failure = failure or err
        if failure:
            raise failure
        return is_published

    @property
    def needs_key_frame(self) -> bool:
        """Whether a subscriber waits for a key frame of a camera that encodes its video."""
        return any(topics.needs_key_frame for topics in self.outputs)

    def use_video(self, settings: VideoSettings, rate: float) -> None:
        """
        Encode video with these settings from the next frame on. A repeated call has no effect.

        :param rate: expected frames per second until they are measured; 0.0 if they are unknown.
        """
        self._video = settings
        for topics in self.outputs:
            topics.use_video(settings, rate)

    def close(self) -> None:
        """Stop sharing frames, with one wait for all readers."""
        for topics in self.outputs:
            topics.frames.shared.end()
        for topics in self.outputs:
            topics.frames.shared.destroy()

    def _create(self, topic: str, info_topic: str) -> OutputTopics:
        return OutputTopics(
            self._node, topic, info_topic, self._video, self.backlog, self._check_room)

    def _publish_rectified(
        self, output: OutputImage, header: WireHeader, info: Callable[[], CameraInfo],
        is_live: bool,
    ) -> bool:
        """Publish the rectified frame. An unusable calibration is logged once."""
        if len(self.outputs) == 1:
            return False
        topics = self.outputs[1]
        try:
            is_published = topics.publish(
                RectifiedImage(output, info, self._rectifier), header,
                lambda: rectified_info(info(), *output.size), is_live=is_live)
        except RectificationError as err:
            failure = (f'{topics.frames.name} is not published: {err}; camera_info_url names the '
                       'file of the calibration')
            if failure != self._failure and self._log.error(failure, every=1.0, key=_RECTIFIED):
                self._failure = failure
            return False
        if is_published:
            self._failure = ''
        return is_published

    def _camera_info(self, output: OutputImage, header: Header) -> CameraInfo:
        """Return the calibration of the bag that a frame comes from, else that of the camera."""
        flip, rotate = output.settings.flip, output.settings.rotate
        recorded = output.frame.recorded
        serialized = recorded.camera_info if recorded else None
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
