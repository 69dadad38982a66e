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

"""Parameter table of ``img_subscriber``, and the recorder that follows from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from opencv_tools.image.picture_size import MAX_PIXELS
from opencv_tools.recording.failure_log import Log
from opencv_tools.recording.folder import RecordingError
from opencv_tools.recording.image_encoder import EncoderSettings
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.numbering import ON_EXISTS
from opencv_tools.recording.open_sink import check_format, open_sink
from opencv_tools.recording.recorder import QUEUE_SIZE, Recorder
from opencv_tools.recording.selection import Limits
from opencv_tools.ros.parameters import Parameter, ParameterError
from opencv_tools.ros.subscriber.topic_discovery import TRANSPORTS

MODES = ('continuous', 'on_request')

# Smallest and largest queue of the middleware for a busy subscriber, in frames.
_LEAST_DEPTH = 10
_LARGEST_DEPTH = 1000


def _check_file_name(template: str) -> None:
    check_format(FileNames(template).suffix)


def _check_folder(text: str) -> None:
    if not text:
        raise ValueError('set it to a folder')


#: Parameters of ``img_subscriber``, in the order of ``--help``.
PARAMETERS = (
    Parameter('output_dir', 'frames', 'Folder of the recorded files; created if it does not exist',
              check=_check_folder),
    Parameter('file_name', '{seq:06d}.png', 'Template of the file names, with {seq}, {stamp}, '
              '{sec}, {nanosec}, {frame_id}, {encoding} or {topic}; the extension selects the '
              'format, and .mp4, .mkv and .avi record a video', check=_check_file_name),
    Parameter('transport', 'auto', 'Image transport to subscribe to; auto uses compressed if no '
              'raw images are published', choices=TRANSPORTS),
    Parameter('max_pixels', MAX_PIXELS, 'Maximum number of pixels of a frame; a larger frame is '
              'refused before it is decoded', minimum=1, maximum=2**31),
    Parameter('mode', 'continuous', 'Recording mode; continuous writes every frame, on_request '
              'one frame for each call of ~/save', choices=MODES),
    Parameter('convert', 'auto', 'Conversion of Bayer and YUV frames to colour in images and '
              'videos', choices=('auto', 'never')),
    Parameter('jpeg_quality', 95, 'JPEG quality of .jpg files, from 1 (smallest) to 100 (best)',
              minimum=1, maximum=100),
    Parameter('png_compression', 1, 'Compression level of .png files, from 0 (none) and 1 '
              '(fastest) to 9 (smallest)', maximum=9),
    Parameter('crf', 23, 'Constant rate factor of videos, from 0 (best) to 51 (smallest)',
              maximum=51),
    Parameter('every_n', 1, 'Write every n-th frame', minimum=1, maximum=10**9, ends=True),
    Parameter('max_rate', 0.0, 'Maximum rate of the written frames in Hz; 0 for no limit',
              maximum=1e6, ends=True),
    Parameter('max_frames', 0, 'Number of recorded frames after which the node exits; 0 for no '
              'limit', maximum=10**9, ends=True),
    Parameter('max_duration', 0.0, 'Duration of the recording in seconds, counted from the first '
              'frame; 0 for no limit', maximum=1e9, ends=True),
    Parameter('max_bytes', 0, 'Maximum size of all files together in bytes, after which the node '
              'exits; 0 for no limit', maximum=10**18, ends=True),
    Parameter('ring', False, 'Delete the oldest files at the limits max_frames, max_duration and '
              'max_bytes instead of exiting', ends=True),
    Parameter('queue_size', QUEUE_SIZE, 'Maximum number of frames that wait to be written',
              minimum=1, maximum=100_000),
    Parameter('writers', 0, 'Number of threads that write; 0 for one per processor', maximum=256),
    Parameter('on_overflow', 'drop', 'Action when the queue is full; drop removes its oldest '
              'frame, block pauses the reception', choices=('drop', 'block')),
    Parameter('on_exists', 'continue', 'Action when files of an earlier recording exist; continue '
              'numbers the new files after them', choices=ON_EXISTS),
    Parameter('sync', False, 'Flush each file to disk before renaming it to its final name'),
    Parameter('timeout', 0.0, 'Seconds without a frame after which the node exits with an error; '
              '0 for no limit', maximum=1e9, ends=True),
)


def limits(values: Mapping[str, Any]) -> Limits:
    """
    Return the limits of the recording that the parameters describe.

    :param values: parameter values by name.
    :raises ParameterError: ``ring`` is set without a limit.
    """
    found = Limits(values['max_frames'], values['max_duration'], values['max_bytes'],
                   values['ring'])
    if found == Limits(ring=True):
        raise ParameterError('parameter ring is True without a limit: set max_frames, '
                             'max_duration or max_bytes as well')
    return found


def subscription_depth(values: Mapping[str, Any]) -> int | None:
    """
    Return the number of frames that the middleware keeps for the subscription.

    It is the size of the queue. With ``on_overflow:=block`` the middleware keeps every frame, and
    a reliable publisher that can wait does so when its own queue is full.

    :param values: parameter values by name.
    :returns: the depth in frames; None to keep every frame.
    """
    if values['on_overflow'] == 'block':
        return None
    return max(_LEAST_DEPTH, min(int(values['queue_size']), _LARGEST_DEPTH))


def open_recorder(
    values: Mapping[str, Any], bounds: Limits, log: Log, on_full: Callable[[], object],
) -> tuple[Path, Recorder[Any]]:
    """
    Create the recorder that the parameters describe.

    :param values: parameter values by name.
    :param bounds: limits of the recording, from ``limits``.
    :param log: log for failures.
    :param on_full: called on any thread when the recording reaches its limits.
    :returns: the output folder and the recorder.
    :raises RecordingError: the output folder cannot be used.
    """
    try:
        folder = Path(values['output_dir']).expanduser().absolute()
    except FileNotFoundError as err:
        raise RecordingError(
            f"output_dir {values['output_dir']} cannot be used: the working directory was "
            'removed; set output_dir to an absolute path') from err
    names = FileNames(values['file_name'])
    settings = EncoderSettings(names.suffix, values['convert'] == 'auto', values['jpeg_quality'],
                               values['png_compression'], values['crf'])
    files = open_sink(folder, names, settings, values['on_exists'], bounds, values['sync'])
    return folder, Recorder(files, log, values['queue_size'], values['writers'],
                            values['on_overflow'] == 'block', on_full)
