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

"""Parameters of ``img_subscriber``."""

from __future__ import annotations

from dataclasses import dataclass

from opencv_tools.bags.writing import BAG_SUFFIX
from opencv_tools.base.arguments import check_range, COLORS
from opencv_tools.base.rate_limit import MAX_RATE
from opencv_tools.image.image_size import MAX_PIXELS
from opencv_tools.nodes.parameters import parameter, parameter_table, rate_parameter
from opencv_tools.nodes.settings import NodeSettings, priority_parameter
from opencv_tools.nodes.topic_patterns import check_patterns
from opencv_tools.recording.naming import check_folder, FileNames
from opencv_tools.recording.numbering import ON_EXISTS
from opencv_tools.recording.open_sink import check_format, check_limits, KEEPS_PACKETS
from opencv_tools.recording.recorder import QUEUE_SIZE
from opencv_tools.recording.selection import Limits
from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.topic_discovery import TRANSPORTS

# Smallest and largest queue of the middleware for a busy subscriber, in frames.
_LEAST_DEPTH = 10
_LARGEST_DEPTH = 1000


def _check_file_name(template: str) -> None:
    check_format(FileNames(template).suffix)


def _check_folder(text: str) -> None:
    if not text:
        raise ValueError('set it to a folder')
    check_folder(text)


@dataclass(frozen=True, kw_only=True)
class RecorderSettings(NodeSettings):
    """Values of the parameters of ``img_subscriber``, in the order of ``--help``."""

    output_dir: str = parameter(
        'frames', 'Folder of the recorded files; created if it does not exist',
        check=_check_folder)
    file_name: str = parameter(
        '{seq:06d}.png', 'Template of the file names, with {seq}, {stamp}, {sec}, {nanosec}, '
        '{frame_id}, {encoding} or {topic}; the extension selects the format; .mp4, .mkv and .avi '
        'record a video, .mcap a bag', check=_check_file_name)
    topics: str = parameter(
        '', 'Topics whose messages are recorded in the bag beside the frames, as names in which * '
        'stands for any characters; a list, or a text with blanks between them',
        check=check_patterns, words=True)
    transport: str = parameter(
        'auto', 'Image transport to subscribe to; auto uses shm if all publishers share frames, '
        'compressed if no raw images are published, and video, or compressedDepth for depth, if '
        'it is published on another machine', choices=tuple(TRANSPORTS))
    max_pixels: int = parameter(
        MAX_PIXELS, 'Maximum number of pixels of a frame; a larger frame is refused before it is '
        'decoded', bounds=(1, 2**31))
    mode: str = parameter(
        'continuous', 'Recording mode; continuous writes every frame, on_request one frame for '
        'each call of ~/save', choices=('continuous', 'on_request'))
    convert: str = parameter(
        'auto', 'Conversion of Bayer and YUV frames to colour in images and videos',
        choices=('auto', 'never'))
    lossy: bool = parameter(
        False, 'Whether images that a format cannot hold lose alpha and all but 8 bits, instead '
        'of being refused')
    range_low: float = parameter(
        0.0, 'With lossy, number that becomes black in images with one channel and more than 8 '
        'bits, such as depth: millimetres of 16UC1, metres of 32FC1', bounds=(-1e9, 1e9))
    range_high: float = parameter(
        0.0, 'With lossy, number that becomes white; 0 with range_low 0 to refuse such images',
        bounds=(-1e9, 1e9))
    colors: str = parameter(
        COLORS[0], 'Colours from range_low to range_high in pictures and videos; 0 and NaN stay '
        'black, unless range_low is negative', choices=COLORS)
    jpeg_quality: int = parameter(
        95, 'JPEG quality of .jpg files, from 1 (smallest) to 100 (best)', bounds=(1, 100))
    png_compression: int = parameter(
        1, 'Compression level of .png files, from 0 (none) and 1 (fastest) to 9 (smallest)',
        bounds=(0, 9))
    crf: int = parameter(
        23, 'Constant rate factor of videos, from 0 (best) to 51 (smallest)', bounds=(0, 51))
    every_n: int = parameter(1, 'Write every n-th frame', bounds=(1, 10**9), ends=True)
    max_rate: float = rate_parameter(
        0.0, 'Maximum rate of the written frames in Hz; 0 for no limit', MAX_RATE, ends=True)
    max_frames: int = parameter(
        0, 'Number of frames after which the node exits, whether they are written, dropped '
        'or failed; 0 for no limit',
        bounds=(0, 10**9), ends=True)
    max_duration: float = parameter(
        0.0, 'Duration of the recording in seconds, counted from the first frame or message of '
        'topics; 0 for no limit',
        bounds=(0, 1e9), ends=True)
    max_bytes: int = parameter(
        0, 'Maximum size of all files together in bytes, after which the node exits; 0 for no '
        'limit', bounds=(0, 10**18), ends=True)
    ring: bool = parameter(
        False, 'Delete the oldest files at the limits max_frames, max_duration and max_bytes '
        'instead of exiting', ends=True)
    split_bytes: int = parameter(
        0, 'Size of a video or bag in bytes, after which the next file begins; 0 for one file',
        bounds=(0, 10**18))
    split_duration: float = parameter(
        0.0, 'Duration of a video or bag in seconds, after which the next file begins; 0 for one '
        'file', bounds=(0, 1e9))
    queue_size: int = parameter(
        QUEUE_SIZE, 'Maximum number of frames that wait to be written', bounds=(1, 100_000))
    writers: int = parameter(
        0, 'Number of threads that write; 0 for one per processor', bounds=(0, 256))
    on_overflow: str = parameter(
        'drop', 'Action when the queue is full; drop removes its oldest frame, block pauses the '
        'reception', choices=('drop', 'block'))
    on_exists: str = parameter(
        'continue', 'Action when files of an earlier recording exist; continue numbers the new '
        'files after them', choices=ON_EXISTS)
    sync: bool = parameter(False, 'Flush each file to disk before renaming it to its final name')
    timeout: float = parameter(
        0.0, 'Seconds without a frame after which the node exits with an error; 0 for no limit',
        bounds=(0, 1e9), ends=True)
    priority: int = priority_parameter()

    def __post_init__(self) -> None:
        """
        Check values that depend on each other.

        :raises ParameterError: the values contradict each other.
        """
        if self.ring and not (self.max_frames or self.max_duration or self.max_bytes):
            raise ParameterError('parameter ring is True without a limit: set max_frames, '
                                 'max_duration or max_bytes as well')
        if self.topics and FileNames(self.file_name).suffix != BAG_SUFFIX:
            raise ParameterError(f'parameter topics is {self.topics}: only a bag has topics; set '
                                 f'file_name to a name with the extension {BAG_SUFFIX}')
        if self.range and not self.lossy:
            raise ParameterError(f'parameter range_high is {self.range_high:g}, but lossy is '
                                 'false: set lossy as well')
        suffix = FileNames(self.file_name).suffix
        if self.range and suffix in (BAG_SUFFIX, '.npy'):
            raise ParameterError(
                f'parameter range_high is {self.range_high:g}, but {suffix} keeps all numbers: '
                'leave the range out, or set file_name to a name such as depth.mp4')
        if self.colors != COLORS[0] and not self.range:
            raise ParameterError(
                f'parameter colors is {self.colors}, but has an effect with lossy and a range in '
                'pictures and videos only: set lossy, range_high, and file_name to a name with '
                'an extension such as .png or .mp4')
        try:
            if self.range:
                check_range(self.range_low, self.range_high, 'range_low', 'range_high')
            check_limits(suffix, self.limits)
        except ValueError as err:
            raise ParameterError(str(err)) from err

    @property
    def depth(self) -> int | None:
        """
        Return the number of frames that the middleware keeps; None to keep every frame.

        The number is the size of the queue. With ``on_overflow:=block`` the middleware keeps every
        frame, and a reliable publisher that can wait does so when its own queue is full.
        """
        if self.on_overflow == 'block':
            return None
        return max(_LEAST_DEPTH, min(self.queue_size, _LARGEST_DEPTH))

    @property
    def decodes_video(self) -> bool:
        """Whether video is decoded: for images and .avi, and for a part of the frames."""
        is_partial = self.every_n > 1 or self.max_rate > 0 or self.mode != 'continuous'
        return is_partial or FileNames(self.file_name).suffix not in KEEPS_PACKETS

    @property
    def range(self) -> tuple[float, float] | None:  # noqa: A003
        """Numbers that become black and white; None if none are given."""
        low, high = self.range_low, self.range_high
        return (low, high) if low or high else None

    @property
    def limits(self) -> Limits:
        """Return the limits of the recording."""
        return Limits(
            self.max_frames, self.max_duration, self.max_bytes, self.ring,
            split_seconds=self.split_duration, split_bytes=self.split_bytes)


#: Parameters of ``img_subscriber``.
PARAMETERS = parameter_table(RecorderSettings)
