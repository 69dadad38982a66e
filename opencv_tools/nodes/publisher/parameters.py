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

"""Parameters of ``img_publisher``, and the capture settings and frame size that they imply."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from opencv_tools.base.logs import Log, log_if_slow
from opencv_tools.base.text import without_password
from opencv_tools.capture.errors import CaptureError
from opencv_tools.capture.settings import CaptureSettings
from opencv_tools.capture.source import (
    check_source, describe_opening, expected_size, is_camera, is_pattern, names_bag)
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.nodes.parameters import parameter, parameter_group, parameter_table
from opencv_tools.nodes.publisher.calibration_file import check_camera_name
from opencv_tools.nodes.settings import FULL_HD_BYTES, NodeSettings, priority_parameter
from opencv_tools.nodes.topic_patterns import check_patterns
from opencv_tools.nodes.video_settings import check_video
from opencv_tools.topics.errors import ParameterError
from opencv_tools.video.settings import VideoSettings
from rclpy.logging import get_logger

STAMPS = ('capture', 'publish', 'original')
_UNKNOWN_SIZE = (1920, 1080)


def _check_camera_name(name: str) -> None:
    if name:
        check_camera_name(name)


@dataclass(frozen=True, kw_only=True)
class PublisherSettings(NodeSettings):
    """Values of the parameters of ``img_publisher``, in the order of ``--help``."""

    source: str = parameter(
        '0', 'Device number, device path, video file, bag, image file, folder or glob of images, '
        'stream URL, or pattern[:depth][:WIDTHxHEIGHT[@FPS]]', check=check_source, ends=True,
        other_names=('video_device', 'device', 'device_id', 'device_path', 'input_device',
                     'camera', 'camera_device', 'camera_index', 'filename', 'file', 'path',
                     'videofile', 'video_file', 'video_path', 'index', 'url', 'uri',
                     'gscam_config'))
    bag_topic: str = parameter(
        '', 'Topic of the images of a bag; empty for the only one')
    topics: str = parameter(
        '', 'Topics of a bag whose messages are published beside the images, at their times; '
        'names in which * stands for any characters, as a list, or a text with blanks between '
        'them',
        check=check_patterns, words=True)
    capture: CaptureSettings = parameter_group(CaptureSettings(
        publish_rate=10.0, encoding='bgr8'))
    frame_id: str = parameter(
        'camera', 'Coordinate frame of the camera, for the message headers', changeable=True,
        other_names=('camera_frame_id', 'camera_frame'))
    rectify: bool = parameter(
        False, 'Whether to publish images without the distortion of the lens on image_rect, by '
        'the calibration', changeable=True)
    video: VideoSettings = parameter_group(VideoSettings(), 'video_')
    stamp: str = parameter(
        'capture', 'Event whose time is the stamp of a frame; original keeps the stamp and the '
        'frame_id of a bag, capture shifts the stamps of a bag by one amount to now',
        choices=STAMPS, changeable=True)
    stamp_offset: float = parameter(
        0.0, 'Offset added to each stamp in seconds; negative to compensate the delay of a camera',
        bounds=(-1e6, 1e6), changeable=True)
    clock: bool = parameter(
        False, 'Publish the time of each frame of a bag on /clock, for nodes with use_sim_time')
    camera_info_url: str = parameter(
        '', 'URL of the calibration file: file:// or package://, with ${NAME} and ${ROS_HOME}; '
        'empty for file://${ROS_HOME}/camera_info/${NAME}.yaml',
        other_names=('camera_info_path', 'camera_calibration_file'))
    camera_name: str = parameter(
        '', 'Name of the camera, for ${NAME} in camera_info_url; empty for the namespace of the '
        'node, or camera if there is none', check=_check_camera_name)
    max_frames: int = parameter(
        0, 'Number of published frames after which the node exits; 0 for no limit',
        bounds=(0, 10**9), ends=True)
    wait_for_subscribers: int = parameter(
        0, 'Number of subscribers to wait for before the first frame; 0 to start at once',
        bounds=(0, 1000))
    priority: int = priority_parameter()

    FRAME_BYTES = FULL_HD_BYTES

    def frame_bytes(self) -> int:
        """
        Estimate the bytes of the frames that will be published.

        Patterns and cameras report their size. A file is opened to read its first frame. The size
        of a stream, or of a source that the node will refuse, is assumed to be 1920x1080 in
        colour.
        """
        try:
            with log_if_slow(Log(get_logger('img_publisher')), describe_opening(self.source)):
                size = expected_size(self.source, self.capture, self.bag_topic)
            width, height = size or _UNKNOWN_SIZE
            encoding = find_encoding(self.capture.encoding or 'bgr8')
            return max(1, encoding.rows(height) * width * encoding.pixel_bytes)
        except (CaptureError, ImageError, OSError, ValueError):
            return self.FRAME_BYTES

    @property
    def shown_source(self) -> str:
        """Name of the source without passwords."""
        return without_password(self.source)

    def check(self) -> None:
        """
        Check the parameters against each other.

        :raises ParameterError: the encoder of the video is missing, ``start_frame`` is not before
            ``stop_frame``, or a parameter has no effect with this source or with ``on_end``.
        """
        check_video(self.video)
        capture = self.capture
        start, stop = capture.start_frame, capture.stop_frame
        if 0 < stop <= start:
            raise ParameterError(
                f'parameter start_frame is {start}, which is not before stop_frame {stop}: give a '
                'smaller start_frame, or 0 as stop_frame')
        source = f'the source {self.shown_source}'
        of_bags = {'bag_topic': self.bag_topic, 'topics': self.topics, 'clock': self.clock,
                   'stamp': self.stamp if self.stamp == 'original' else ''}
        loop = {'loop': capture.loop if capture.loop > 1 else 0}
        of_files = {'start_frame': start, 'stop_frame': stop, **loop}
        # Values that are given if they are true, whether they have an effect, and why not.
        rules: tuple[tuple[Mapping[str, object], bool, str], ...] = (
            (of_bags, names_bag(self.source), f'{source} is not a bag: give a .mcap, a .db3, a '
             "folder with metadata.yaml, or files such as 'drive/*.mcap'"),
            (of_files, not is_camera(self.source), f'{source} is a camera: give a file'),
            (loop, stop > 0 or not is_pattern(self.source),
             f'{source} has no end: give stop_frame'),
            (loop, capture.on_end != 'loop', 'on_end is loop, which repeats the file forever: '
             'give only one of them'))
        for values, has_effect, reason in rules:
            for name, value in values.items():
                if value and not has_effect:
                    raise ParameterError(f'parameter {name} is {value!r}, but {reason}')


#: Parameters of ``img_publisher``.
PARAMETERS = parameter_table(PublisherSettings)
