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

"""How the frames of a source are requested, paced and converted."""

from __future__ import annotations

from dataclasses import dataclass
import math

from opencv_tools.base.parameter_fields import parameter, rate_parameter
from opencv_tools.capture.frame import MAX_RATE
from opencv_tools.capture.v4l2.modes import CameraRequest
from opencv_tools.image.compressed_depth import DEPTH_CODECS, FARTHEST
from opencv_tools.image.orientation import FLIPS, ROTATIONS
from opencv_tools.image.picture_formats import COMPRESSED_FORMATS

ON_END = ('stop', 'loop', 'hold')


def check_reconnect(text: str) -> float:
    """
    Return the seconds to wait for a disconnected camera: forever, never or a number.

    :raises ValueError: the text is something else; the message is the remedy.
    """
    named = {'forever': math.inf, 'never': 0.0}
    try:
        seconds = named[text] if text in named else float(text)
    except ValueError:
        seconds = math.nan
    if not seconds >= 0:
        raise ValueError('set it to forever, never or a number of seconds')
    return seconds


@dataclass(frozen=True, kw_only=True)
class CaptureSettings(CameraRequest):
    """
    Settings of a source and its frames, which are parameters of a publisher.

    ``encoding`` is the sensor_msgs/Image encoding of the published images, too.
    """

    publish_rate: float = rate_parameter(
        0.0, 'Frame rate of the published images in Hz; 0 for the rate of the source', MAX_RATE,
        changeable=True)
    flip: str = parameter(
        'none', 'Mirroring of the images', choices=tuple(FLIPS), changeable=True,
        other_names=('flip_horizontal', 'flip_vertical'))
    rotate: int = parameter(
        0, 'Clockwise rotation of the images in degrees, applied after flip', choices=ROTATIONS,
        changeable=True)
    jpeg_quality: int = parameter(
        95, 'JPEG quality of video_frames/compressed, from 1 (smallest) to 100 (best)',
        bounds=(1, 100), changeable=True)
    compressed_format: str = parameter(
        'auto', 'Codec of video_frames/compressed: jpeg, which reduces images to 8 bits without '
        'alpha, png, or auto for png where jpeg would reduce an image', choices=COMPRESSED_FORMATS,
        changeable=True)
    depth_format: str = parameter(
        'png', 'Codec of video_frames/compressedDepth: png, which more readers know, or rvl, '
        'which is faster', choices=DEPTH_CODECS, changeable=True)
    depth_max: float = parameter(
        10.0, 'Depth in metres up to which video_frames/compressedDepth has 32FC1 images; what is '
        'farther becomes NaN', bounds=FARTHEST, changeable=True)
    read_timeout: float = parameter(
        2.0, 'Seconds without a frame after which a camera or stream is reopened',
        bounds=(0.1, 1e6), changeable=True)
    reconnect: str = parameter(
        'forever', 'How long to wait for a disconnected camera: forever, never, or seconds',
        check=check_reconnect, ends=True, changeable=True)
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

    @property
    def plays(self) -> int:
        """Count of the plays of a file before ``on_end`` applies; 0 for endless."""
        return 0 if self.on_end == 'loop' and self.loop == 1 else self.loop

    @property
    def reconnect_seconds(self) -> float:
        """Seconds after which an unavailable source is an error; infinity to retry forever."""
        return check_reconnect(self.reconnect)
