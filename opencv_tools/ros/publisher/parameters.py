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

"""Parameter table of ``img_publisher``, and the capture settings that follow from it."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

from opencv_tools.capture.frame import MAX_RATE
from opencv_tools.capture.grabber import ReconnectPolicy
from opencv_tools.capture.output_image import OutputSettings
from opencv_tools.capture.player import ON_END, PlaybackSettings
from opencv_tools.capture.source import check_source
from opencv_tools.capture.v4l2.modes import CameraRequest
from opencv_tools.capture.v4l2.pixel_formats import check_fourcc
from opencv_tools.image.encodings import ENCODINGS
from opencv_tools.image.orientation import FLIPS, ROTATIONS
from opencv_tools.ros.parameters import Parameter, ParameterError
from opencv_tools.ros.publisher.calibration_file import check_camera_name
from opencv_tools.ros.publisher.stamps import STAMPS


def _parse_reconnect(text: str) -> float:
    """
    Read the maximum time to wait for a disconnected camera, in seconds.

    :param text: ``forever``, ``never`` or a number of seconds.
    :raises ValueError: the text is none of these.
    """
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


#: Parameters of ``img_publisher``, in the order of ``--help``.
PARAMETERS = (
    Parameter('source', '0', 'Device number, device path, video file, image file, folder or glob '
              'of images, stream URL, or pattern[:WIDTHxHEIGHT[@FPS]]', check=check_source),
    Parameter('publish_rate', 10.0, 'Frame rate of the published images in Hz; 0 for the rate of '
              'the source', maximum=MAX_RATE, changeable=True),
    Parameter('encoding', 'bgr8', "Encoding of the published images; '' for the encoding of the "
              'source', choices=(*ENCODINGS, ''), changeable=True),
    Parameter('frame_id', 'camera', 'Coordinate frame of the camera, for the message headers',
              changeable=True),
    Parameter('width', 0, 'Width of the camera image in pixels; 0 for the default (640)',
              maximum=1 << 16, changeable=True),
    Parameter('height', 0, 'Height of the camera image in pixels; 0 for the default (480)',
              maximum=1 << 16, changeable=True),
    Parameter('fps', 0.0, 'Frame rate requested from the camera in Hz; 0 for the default (30)',
              maximum=MAX_RATE, changeable=True),
    Parameter('fourcc', '', 'Pixel format requested from the camera, such as YUYV or MJPG; empty '
              'for the best format at this size and rate', check=check_fourcc, changeable=True),
    Parameter('flip', 'none', 'Mirroring of the images', choices=tuple(FLIPS), changeable=True),
    Parameter('rotate', 0, 'Clockwise rotation of the images in degrees, applied after flip',
              choices=ROTATIONS, changeable=True),
    Parameter('jpeg_quality', 95, 'JPEG quality of video_frames/compressed, from 1 (smallest) to '
              '100 (best)', minimum=1, maximum=100, changeable=True),
    Parameter('stamp', 'capture', 'Event whose time is the stamp of a frame', choices=STAMPS,
              changeable=True),
    Parameter('stamp_offset', 0.0, 'Offset added to each stamp in seconds; negative to compensate '
              'the delay of a camera', minimum=-1e6, maximum=1e6, changeable=True),
    Parameter('read_timeout', 2.0, 'Seconds without a frame after which a camera or stream is '
              'reopened', minimum=0.1, maximum=1e6, changeable=True),
    Parameter('reconnect', 'forever', 'How long to wait for a disconnected camera: forever, '
              'never, or seconds', check=_parse_reconnect, ends=True, changeable=True),
    Parameter('camera_info_url', '', 'URL of the calibration file: file:// or package://, with '
              '${NAME} and ${ROS_HOME}; empty for file://${ROS_HOME}/camera_info/${NAME}.yaml'),
    Parameter('camera_name', '', 'Name of the camera, for ${NAME} in camera_info_url; empty for '
              'the namespace of the node, or camera if there is none', check=_check_camera_name),
    Parameter('on_end', 'stop', 'Action after the last frame of a file', choices=ON_END,
              ends=True),
    Parameter('loop', 1, 'Number of times a file is played; 0 to repeat it forever, like '
              'on_end:=loop', maximum=10**9, ends=True),
    Parameter('start_frame', 0, 'Number of the first frame of a file to publish, counted from 0',
              maximum=10**9),
    Parameter('stop_frame', 0, 'Number of the first frame of a file not to publish, counted from '
              '0; 0 for the end of the file', maximum=10**9, ends=True),
    Parameter('max_frames', 0, 'Number of published frames after which the node exits; 0 for no '
              'limit', maximum=10**9, ends=True),
    Parameter('wait_for_subscribers', 0, 'Number of subscribers to wait for before the first '
              'frame; 0 to start at once', maximum=1000),
)

#: Parameters whose change requires reopening the camera.
REOPEN_ON_CHANGE = frozenset(('width', 'height', 'fps', 'fourcc'))

#: Parameter that may require reopening the camera, because not every format converts to it.
ENCODING = 'encoding'


def playback_settings(values: Mapping[str, Any]) -> PlaybackSettings:
    """
    Return the playback settings that the parameters describe.

    :param values: parameter values by name.
    :raises ParameterError: ``start_frame`` is not before ``stop_frame``.
    """
    first, stop = values['start_frame'], values['stop_frame']
    if 0 < stop <= first:
        raise ParameterError(f'parameter start_frame is {first}, which is not before stop_frame '
                             f'{stop}: give a smaller start_frame, or 0 as stop_frame')
    for_ever = values['on_end'] == 'loop' and values['loop'] == 1
    return PlaybackSettings(
        rate=values['publish_rate'], on_end=values['on_end'],
        plays=0 if for_ever else values['loop'], first=first, stop=stop)


def reconnect_policy(values: Mapping[str, Any]) -> ReconnectPolicy:
    """Return the policy for outages of a camera or stream from the parameters."""
    return ReconnectPolicy(values['read_timeout'], _parse_reconnect(values['reconnect']))


def output_settings(values: Mapping[str, Any]) -> OutputSettings:
    """Return the output settings that the parameters describe."""
    return OutputSettings(
        values['encoding'], values['flip'], values['rotate'], values['jpeg_quality'])


def camera_request(
    values: Mapping[str, Any], controls: tuple[tuple[str, int], ...],
) -> CameraRequest:
    """Return the camera request that the parameters and the control values describe."""
    return CameraRequest(values['width'], values['height'], values['fps'], values['fourcc'],
                         values['encoding'], controls)
