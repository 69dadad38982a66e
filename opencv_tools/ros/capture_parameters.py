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

"""The parameters of ``img_publisher``, and what they mean to the capture room."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

from opencv_tools.capture.frame import MAX_RATE
from opencv_tools.capture.grabber import ReconnectPolicy
from opencv_tools.capture.modes import CameraRequest
from opencv_tools.capture.pixel_formats import check_fourcc
from opencv_tools.capture.player import ON_END, PlaybackSettings
from opencv_tools.capture.rendition import OutputSettings
from opencv_tools.capture.source import check_source
from opencv_tools.image.encodings import ENCODINGS
from opencv_tools.image.orientation import FLIPS, ROTATIONS
from opencv_tools.ros.calibration_file import check_camera_name
from opencv_tools.ros.parameters import Parameter, ParameterError
from opencv_tools.ros.stamps import STAMPS


def _parse_reconnect(text: str) -> float:
    """
    Read for how many seconds a camera that is away is waited for.

    :raises ValueError: it is neither forever, never nor a number.
    """
    named = {'forever': math.inf, 'never': 0.0}
    try:
        seconds = named[text] if text in named else float(text)
    except ValueError:
        seconds = math.nan
    if not seconds >= 0:
        raise ValueError('give forever, never or a number of seconds')
    return seconds


def _check_camera_name(name: str) -> None:
    if name:
        check_camera_name(name)


#: What ``img_publisher`` can be told.
PARAMETERS = (
    Parameter('source', '0', 'device number, device path, video file, picture file, folder or '
              'glob of pictures, stream URL, or pattern[:WIDTHxHEIGHT[@FPS]]', check=check_source,
              fixed=True),
    Parameter('publish_rate', 10.0, "frames per second; 0 for the source's own rate",
              maximum=MAX_RATE),
    Parameter('encoding', 'bgr8', "encoding of the messages; '' for the source's own",
              choices=(*ENCODINGS, '')),
    Parameter('frame_id', 'camera', 'coordinate frame of the camera, for the header'),
    Parameter('width', 0, 'of a camera, in pixels; 0 for the usual 640', maximum=1 << 16),
    Parameter('height', 0, 'of a camera, in pixels; 0 for the usual 480', maximum=1 << 16),
    Parameter('fps', 0.0, 'frames per second asked of a camera; 0 for the usual 30',
              maximum=MAX_RATE),
    Parameter('fourcc', '', 'pixel format asked of a camera, such as YUYV or MJPG',
              check=check_fourcc),
    Parameter('flip', 'none', 'how frames are mirrored', choices=tuple(FLIPS)),
    Parameter('rotate', 0, 'degrees that frames are turned clockwise, after mirroring',
              choices=ROTATIONS),
    Parameter('jpeg_quality', 95, 'of video_frames/compressed', minimum=1, maximum=100),
    Parameter('stamp', 'capture', 'what the stamp is the time of', choices=STAMPS),
    Parameter('stamp_offset', 0.0, 'seconds added to the stamp', minimum=-1e6, maximum=1e6),
    Parameter('read_timeout', 2.0, 'seconds without a frame after which a camera is opened anew',
              minimum=0.1, maximum=1e6),
    Parameter('reconnect', 'forever', 'how long a camera that is away is waited for: forever, '
              'never or a number of seconds', check=_parse_reconnect, ends=True),
    Parameter('camera_info_url', '', 'calibration: file:// or package://, with ${NAME} and '
              '${ROS_HOME}; empty for file://${ROS_HOME}/camera_info/${NAME}.yaml', fixed=True),
    Parameter('camera_name', '', "the ${NAME} of the calibration; empty for the namespace's, or "
              'camera', check=_check_camera_name, fixed=True),
    Parameter('on_end', 'stop', 'what follows the last frame of a file', choices=ON_END,
              fixed=True, ends=True),
    Parameter('loop', 1, 'how often a file is played; 0 for ever, as with on_end:=loop',
              maximum=10**9, fixed=True, ends=True),
    Parameter('start_frame', 0, 'number of the first frame of a file to show, from 0',
              maximum=10**9, fixed=True),
    Parameter('stop_frame', 0, 'number of the frame of a file to end before; 0 for its end',
              maximum=10**9, fixed=True, ends=True),
    Parameter('max_frames', 0, 'end after so many frames; 0 for no end', maximum=10**9,
              fixed=True, ends=True),
    Parameter('wait_for_subscribers', 0, 'start only when so many subscribers are there',
              maximum=1000, fixed=True),
)

#: Those for which a camera has to be opened anew.
OPENING = frozenset(('width', 'height', 'fps', 'fourcc'))

#: The one that frames of the camera as it is open may not be convertible to.
ENCODING = 'encoding'


def playback_settings(values: Mapping[str, Any]) -> PlaybackSettings:
    """
    Gather from the parameters how a source is shown.

    :raises ParameterError: two of them contradict each other.
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
    """Gather from the parameters how frames are wanted."""
    return OutputSettings(
        values['encoding'], values['flip'], values['rotate'], values['jpeg_quality'])


def camera_request(
    values: Mapping[str, Any], controls: tuple[tuple[str, int], ...],
) -> CameraRequest:
    """Gather from the parameters what is wanted of a camera."""
    return CameraRequest(values['width'], values['height'], values['fps'], values['fourcc'],
                         values['encoding'], controls)
