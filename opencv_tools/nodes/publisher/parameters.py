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
import math

from opencv_tools.base.logs import Log, log_if_slow
from opencv_tools.base.text import without_password
from opencv_tools.capture.errors import CaptureError
from opencv_tools.capture.frame import MAX_RATE
from opencv_tools.capture.grabber import ReconnectPolicy
from opencv_tools.capture.output_image import OutputSettings
from opencv_tools.capture.player import ON_END, PlaybackSettings
from opencv_tools.capture.source import (
    check_source, describe_opening, expected_size, is_camera, is_pattern, names_bag)
from opencv_tools.capture.v4l2.modes import CameraRequest
from opencv_tools.capture.v4l2.pixel_formats import check_fourcc
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.image.errors import ImageError, VideoError
from opencv_tools.image.orientation import FLIPS, ROTATIONS
from opencv_tools.nodes.parameters import parameter, parameter_table, rate_parameter
from opencv_tools.nodes.publisher.calibration_file import check_camera_name
from opencv_tools.nodes.publisher.stamps import STAMPS
from opencv_tools.nodes.settings import FULL_HD_BYTES, NodeSettings, priority_parameter
from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.topic_patterns import check_patterns
from opencv_tools.video.settings import (
    check_codec_name, check_encoder, check_preset_name, VideoSettings)
from rclpy.logging import get_logger

_UNKNOWN_SIZE = (1920, 1080)


def _parse_reconnect(text: str) -> float:
    """Read the seconds to wait for a disconnected camera: forever, never or a number."""
    named = {'forever': math.inf, 'never': 0.0}
    try:
        seconds = named[text] if text in named else float(text)
    except ValueError:
        seconds = math.nan
    if not seconds >= 0:
        raise ValueError('set it to forever, never or a number of seconds')
    return seconds


def _check_camera_name(name: str) -> None:
    if name:
        check_camera_name(name)


@dataclass(frozen=True, kw_only=True)
class PublisherSettings(NodeSettings):
    """Values of the parameters of ``img_publisher``, in the order of ``--help``."""

    source: str = parameter(
        '0', 'Device number, device path, video file, bag, image file, folder or glob of images, '
        'stream URL, or pattern[:WIDTHxHEIGHT[@FPS]]', check=check_source)
    bag_topic: str = parameter(
        '', 'Topic of the images of a bag; empty for the only one')
    topics: str = parameter(
        '', 'Topics of a bag whose messages are published beside the images, at their times; '
        'names in which * stands for any characters, as a list, or a text with blanks between '
        'them',
        check=check_patterns, words=True)
    publish_rate: float = rate_parameter(
        10.0, 'Frame rate of the published images in Hz; 0 for the rate of the source', MAX_RATE,
        changeable=True)
    encoding: str = parameter(
        'bgr8', "Encoding of the published images; '' for the encoding of the source",
        choices=(*ENCODINGS, ''), changeable=True)
    frame_id: str = parameter(
        'camera', 'Coordinate frame of the camera, for the message headers', changeable=True)
    width: int = parameter(
        0, 'Width of the camera image in pixels; 0 for the default (640)', bounds=(0, 1 << 16),
        changeable=True)
    height: int = parameter(
        0, 'Height of the camera image in pixels; 0 for the default (480)', bounds=(0, 1 << 16),
        changeable=True)
    fps: float = rate_parameter(
        0.0, 'Frame rate requested from the camera in Hz; 0 for the default (30)', MAX_RATE,
        changeable=True)
    fourcc: str = parameter(
        '', 'Pixel format requested from the camera, such as YUYV or MJPG; empty for the best '
        'format at this size and rate', check=check_fourcc, changeable=True)
    flip: str = parameter('none', 'Mirroring of the images', choices=tuple(FLIPS), changeable=True)
    rotate: int = parameter(
        0, 'Clockwise rotation of the images in degrees, applied after flip', choices=ROTATIONS,
        changeable=True)
    rectify: bool = parameter(
        False, 'Whether to publish images without the distortion of the lens on image_rect, by '
        'the calibration', changeable=True)
    jpeg_quality: int = parameter(
        95, 'JPEG quality of video_frames/compressed, from 1 (smallest) to 100 (best)',
        bounds=(1, 100), changeable=True)
    video_codec: str = parameter(
        'h264', 'Codec of the video topics: h264, h265, or an encoder of FFmpeg such as '
        'h264_nvenc', check=check_codec_name, changeable=True)
    video_quality: int = parameter(
        23, 'Quality of the video (CRF), from 0 (best) to 51', bounds=(0, 51),
        changeable=True)
    video_bit_rate: int = parameter(
        0, 'Largest number of bits per second of the video, from 10000; 0 for a constant quality',
        bounds=(0, 10**9), changeable=True)
    video_key_interval: float = parameter(
        2.0, 'Seconds between two key frames of the video', bounds=(0.1, 3600.0),
        changeable=True)
    video_preset: str = parameter(
        '', 'Preset of the encoder of the video; empty for a fast one',
        check=check_preset_name, changeable=True)
    stamp: str = parameter(
        'capture', 'Event whose time is the stamp of a frame; original keeps the stamp and the '
        'frame_id of a bag, capture shifts the stamps of a bag by one amount to now',
        choices=STAMPS, changeable=True)
    stamp_offset: float = parameter(
        0.0, 'Offset added to each stamp in seconds; negative to compensate the delay of a camera',
        bounds=(-1e6, 1e6), changeable=True)
    clock: bool = parameter(
        False, 'Publish the time of each frame of a bag on /clock, for nodes with use_sim_time')
    read_timeout: float = parameter(
        2.0, 'Seconds without a frame after which a camera or stream is reopened',
        bounds=(0.1, 1e6), changeable=True)
    reconnect: str = parameter(
        'forever', 'How long to wait for a disconnected camera: forever, never, or seconds',
        check=_parse_reconnect, ends=True, changeable=True)
    camera_info_url: str = parameter(
        '', 'URL of the calibration file: file:// or package://, with ${NAME} and ${ROS_HOME}; '
        'empty for file://${ROS_HOME}/camera_info/${NAME}.yaml')
    camera_name: str = parameter(
        '', 'Name of the camera, for ${NAME} in camera_info_url; empty for the namespace of the '
        'node, or camera if there is none', check=_check_camera_name)
    on_end: str = parameter(
        'stop', 'Action after the last frame of a file', choices=ON_END, ends=True)
    loop: int = parameter(
        1, 'Number of times a file is played; 0 to repeat it forever, like on_end:=loop',
        bounds=(0, 10**9), ends=True)
    start_frame: int = parameter(
        0, 'Number of the first frame of a file to publish, counted from 0', bounds=(0, 10**9))
    stop_frame: int = parameter(
        0, 'Number of the first frame of a file not to publish, counted from 0; 0 for the end of '
        'the file', bounds=(0, 10**9), ends=True)
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
                size = expected_size(self.source, self.camera_request(), self.bag_topic)
            width, height = size or _UNKNOWN_SIZE
            encoding = find_encoding(self.encoding or 'bgr8')
            return max(1, encoding.rows(height) * width * encoding.pixel_bytes)
        except (CaptureError, ImageError, OSError, ValueError):
            return self.FRAME_BYTES

    def playback(self) -> PlaybackSettings:
        """Return the playback settings."""
        for_ever = self.on_end == 'loop' and self.loop == 1
        return PlaybackSettings(
            rate=self.publish_rate, on_end=self.on_end, plays=0 if for_ever else self.loop,
            first=self.start_frame, stop=self.stop_frame)

    @property
    def shown_source(self) -> str:
        """Name of the source without passwords."""
        return without_password(self.source)

    def check(self) -> None:
        """
        Check the parameters against each other.

        :raises ParameterError: the video cannot have these settings, ``start_frame`` is not before
            ``stop_frame``, or a parameter has no effect with this source or with ``on_end``.
        """
        self.video()
        if 0 < self.stop_frame <= self.start_frame:
            raise ParameterError(
                f'parameter start_frame is {self.start_frame}, which is not before stop_frame '
                f'{self.stop_frame}: give a smaller start_frame, or 0 as stop_frame')
        source = f'the source {self.shown_source}'
        of_bags = {'bag_topic': self.bag_topic, 'topics': self.topics, 'clock': self.clock,
                   'stamp': self.stamp if self.stamp == 'original' else ''}
        loop = {'loop': self.loop if self.loop > 1 else 0}
        of_files = {'start_frame': self.start_frame, 'stop_frame': self.stop_frame, **loop}
        # Values that are given if they are true, whether they have an effect, and why not.
        rules: tuple[tuple[Mapping[str, object], bool, str], ...] = (
            (of_bags, names_bag(self.source), f'{source} is not a bag: give a .mcap, a .db3 or a '
             'folder with metadata.yaml'),
            (of_files, not is_camera(self.source), f'{source} is a camera: give a file'),
            (loop, self.stop_frame > 0 or not is_pattern(self.source),
             f'{source} has no end: give stop_frame'),
            (loop, self.on_end != 'loop', 'on_end is loop, which repeats the file forever: give '
             'only one of them'))
        for values, has_effect, reason in rules:
            for name, value in values.items():
                if value and not has_effect:
                    raise ParameterError(f'parameter {name} is {value!r}, but {reason}')

    def reconnect_policy(self) -> ReconnectPolicy:
        """Return the policy for outages of a camera or stream."""
        return ReconnectPolicy(self.read_timeout, _parse_reconnect(self.reconnect))

    def output(self) -> OutputSettings:
        """Return the settings of the published images."""
        return OutputSettings(self.encoding, self.flip, self.rotate, self.jpeg_quality)

    def video(self) -> VideoSettings:
        """
        Return the settings of the video topics.

        :raises ParameterError: a value is invalid for this codec, or the encoder is missing.
        """
        try:
            settings = VideoSettings(
                codec=self.video_codec, quality=self.video_quality, bit_rate=self.video_bit_rate,
                key_interval=self.video_key_interval, preset=self.video_preset)
            check_encoder(settings)
            return settings
        except VideoError as err:
            raise ParameterError(f'parameter video_{err}') from err

    def camera_request(self, controls: tuple[tuple[str, int], ...] = ()) -> CameraRequest:
        """Return the request to a camera."""
        return CameraRequest(
            width=self.width, height=self.height, fps=self.fps, fourcc=self.fourcc,
            encoding=self.encoding, controls=controls)


#: Parameters of ``img_publisher``.
PARAMETERS = parameter_table(PublisherSettings)
