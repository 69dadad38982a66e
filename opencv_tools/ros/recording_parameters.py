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

"""The parameters of ``img_subscriber``, and what they mean to the recording room."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from opencv_tools.image.picture_size import MAX_PIXELS
from opencv_tools.recording.files import check_format, open_files
from opencv_tools.recording.folder import RecordingError
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.numbering import ON_EXISTS
from opencv_tools.recording.recorder import QUEUE_SIZE, Recorder
from opencv_tools.recording.selection import Limits
from opencv_tools.recording.trouble import Log
from opencv_tools.recording.writers import Format
from opencv_tools.ros.frame_sources import TRANSPORTS
from opencv_tools.ros.parameters import Parameter, ParameterError

MODES = ('continuous', 'on_request')

# Frames that the middleware keeps for a subscriber that is busy, at least and at most.
_LEAST_DEPTH = 10
_LARGEST_DEPTH = 1000


def _check_file_name(template: str) -> None:
    check_format(FileNames(template).suffix)


def _check_folder(text: str) -> None:
    if not text:
        raise ValueError('name a folder')


#: What ``img_subscriber`` can be told.
PARAMETERS = (
    Parameter('output_dir', 'frames', 'folder to write to, made when missing',
              check=_check_folder, fixed=True),
    Parameter('file_name', '{seq:06d}.png', 'names of the files, with {seq}, {stamp}, {sec}, '
              '{nanosec}, {frame_id}, {encoding} or {topic}; the extension is the format, '
              'and .mp4, .mkv and .avi are videos', check=_check_file_name, fixed=True),
    Parameter('transport', 'auto', 'which topic is received; auto takes the compressed one where '
              'there is no other', choices=TRANSPORTS, fixed=True),
    Parameter('max_pixels', MAX_PIXELS, 'a frame with more is refused before it is decoded',
              minimum=1, maximum=2**31, fixed=True),
    Parameter('mode', 'continuous', 'write every frame, or one for each call of ~/save',
              choices=MODES, fixed=True),
    Parameter('convert', 'auto', 'bayer and yuv frames to colour where pictures are written',
              choices=('auto', 'never'), fixed=True),
    Parameter('jpeg_quality', 95, 'of .jpg files', minimum=1, maximum=100, fixed=True),
    Parameter('png_compression', 1, 'of .png files; 0 packs nothing, 1 is the quickest',
              maximum=9, fixed=True),
    Parameter('crf', 23, 'of videos, from 0, the best, to 51, the smallest', maximum=51,
              fixed=True),
    Parameter('every_n', 1, 'write one of so many frames', minimum=1, maximum=10**9,
              fixed=True, ends=True),
    Parameter('max_rate', 0.0, 'frames per second to write at most; 0 for all', maximum=1e6,
              fixed=True, ends=True),
    Parameter('max_frames', 0, 'end after so many frames; 0 for no end', maximum=10**9,
              fixed=True, ends=True),
    Parameter('max_duration', 0.0, 'end so many seconds after the first frame; 0 for no end',
              maximum=1e9, fixed=True, ends=True),
    Parameter('max_bytes', 0, 'end before the files take more; 0 for no end', maximum=10**18,
              fixed=True, ends=True),
    Parameter('ring', False, 'at these limits do not end, but delete the oldest files',
              fixed=True, ends=True),
    Parameter('queue_size', QUEUE_SIZE, 'frames that may wait to be written', minimum=1,
              maximum=100_000, fixed=True),
    Parameter('writers', 0, 'threads that write; 0 for one a processor', maximum=256, fixed=True),
    Parameter('on_overflow', 'drop', 'when the queue is full, drop its oldest frame or block '
              'the reception', choices=('drop', 'block'), fixed=True),
    Parameter('on_exists', 'continue', 'what is done about files that are there',
              choices=ON_EXISTS, fixed=True),
    Parameter('sync', False, 'have each file on the disk before it gets its name', fixed=True),
    Parameter('timeout', 0.0, 'give up after so many seconds without a frame; 0 to wait for ever',
              maximum=1e9, fixed=True, ends=True),
)


def limits(values: Mapping[str, Any]) -> Limits:
    """
    Gather from the parameters how much is recorded.

    :raises ParameterError: a ring without a limit.
    """
    found = Limits(values['max_frames'], values['max_duration'], values['max_bytes'],
                   values['ring'])
    if found == Limits(ring=True):
        raise ParameterError('parameter ring is True: give max_frames, max_duration or '
                             'max_bytes as well, so that it has a size')
    return found


def reception_depth(values: Mapping[str, Any]) -> int | None:
    """
    Return how many frames the middleware keeps until they are taken.

    They are as many as the queue holds. With ``on_overflow:=block`` the middleware keeps every
    frame, and a publisher that can wait does so when it holds too many.

    :param values: of the parameters.
    :returns: the number; None for every frame.
    """
    if values['on_overflow'] == 'block':
        return None
    return max(_LEAST_DEPTH, min(int(values['queue_size']), _LARGEST_DEPTH))


def open_recorder(
    values: Mapping[str, Any], bounds: Limits, log: Log, on_full: Callable[[], object],
) -> tuple[Path, Recorder[Any]]:
    """
    Make ready what records as the parameters say.

    :param values: of the parameters.
    :param bounds: what ``limits`` gathered from them.
    :param log: where trouble is told.
    :param on_full: told, on any thread, that the files are as large as they may get.
    :returns: the folder, and the recorder.
    :raises RecordingError: the folder cannot be written to.
    """
    try:
        folder = Path(values['output_dir']).expanduser().absolute()
    except FileNotFoundError as err:
        raise RecordingError(f"output_dir {values['output_dir']} cannot be used: the working "
                             'folder was removed; name a whole path') from err
    names = FileNames(values['file_name'])
    wanted = Format(names.suffix, values['convert'] == 'auto', values['jpeg_quality'],
                    values['png_compression'], values['crf'])
    files = open_files(folder, names, wanted, values['on_exists'], bounds, values['sync'])
    return folder, Recorder(files, log, values['queue_size'], values['writers'],
                            values['on_overflow'] == 'block', on_full)
