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

"""Creation of the sink of a recording, after the files of killed recordings are finished."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import errno
from pathlib import Path
import time
from typing import Any, cast

from opencv_tools.bags.errors import BagError, check_mcap
from opencv_tools.bags.finishing import finish_and_count, finish_bag, has_footer
from opencv_tools.bags.open_bag import BAG_SUFFIXES
from opencv_tools.bags.writing import BAG_SUFFIX
from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.recording.bag_sink import BagSink
from opencv_tools.recording.errors import RecordingError, VideoError
from opencv_tools.recording.file_sink import FileSink
from opencv_tools.recording.folder import Finishers, Folder
from opencv_tools.recording.image_encoder import EncoderSettings, IMAGE_FORMATS
from opencv_tools.recording.image_sink import ImageSink
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.numbering import Numbering
from opencv_tools.recording.recorder import Sink
from opencv_tools.recording.selection import Limits
from opencv_tools.recording.video.format import VideoFormat
from opencv_tools.recording.video.writer import check_video, count_frames, VIDEO_FORMATS

_BAG_HEADER_BYTES = 64  # a bag that was cut off in its header is not longer


def finish_bags(folder: Folder) -> None:
    """
    Finish the bags of a folder whose recorders were killed.

    :param folder: output folder; its manifest gets the new size and digest of these bags.
    """
    for path in folder.path.glob(f'*{BAG_SUFFIX}'):
        with suppress(BagError, OSError):  # damaged, or without permission: it is left alone
            if not has_footer(path):
                folder.update_line(path.name, finish_bag(path))


def _finish_bag(path: Path) -> int | None:
    """Finish a bag; return the number of its images, 0 for an empty bag."""
    try:
        counts = finish_and_count(path)
        if counts is None:
            return 0 if path.stat().st_size <= _BAG_HEADER_BYTES else None
        # A bag of other messages only has a line without frames.
        return counts.images or (None if counts.messages else 0)
    except BagError:  # damaged, or the library of bags is not installed
        return None


#: What finishes a file with many frames.
FINISHERS: Finishers = {**dict.fromkeys(VIDEO_FORMATS, count_frames), BAG_SUFFIX: _finish_bag}


#: File name extensions of the formats that hold packets of video, without decoding.
KEEPS_PACKETS = ('.mkv', '.mp4', BAG_SUFFIX)

# Remedies for errors of the output folder, where the text of the system error names none.
_REMEDIES = {
    errno.EEXIST: 'it is a file or a broken link; set output_dir to a folder',
    errno.ELOOP: 'its path contains a loop of links; set output_dir to another folder',
    errno.ENAMETOOLONG: 'it is too long for the file system; set output_dir to a shorter path',
}


def check_format(suffix: str) -> None:
    """
    Check that files of a format can be written on this machine.

    :param suffix: file name extension with its dot, in lower case.
    :raises ValueError: the extension is unknown, or a library that it needs is not installed.
    """
    known = (*IMAGE_FORMATS, *VIDEO_FORMATS, BAG_SUFFIX)
    if suffix in BAG_SUFFIXES and suffix != BAG_SUFFIX:
        raise ValueError(f'bags are written as {BAG_SUFFIX}, not as {suffix}; use the extension '
                         f'{BAG_SUFFIX}')
    if suffix not in known:
        raise ValueError(f'the extension {suffix!r} is unknown; use one of {", ".join(known)}')
    if suffix in VIDEO_FORMATS:
        check_video()
    if suffix == BAG_SUFFIX:
        check_mcap()


def check_limits(suffix: str, limits: Limits) -> None:
    """
    Check that the limits of a recording suit its format.

    :param suffix: file name extension with its dot, in lower case.
    :raises ValueError: an image file is to be split.
    """
    if (limits.split_bytes or limits.split_seconds) and suffix in IMAGE_FORMATS:
        raise ValueError(f'a {suffix} file has one frame and cannot be split; remove split_bytes '
                         'and split_duration')


def open_bag_sink(path: Path, name: str) -> BagSink:
    """
    Create the sink of one bag, whose messages are written as they are, with a reserve on disk.

    :param path: output folder, created if it does not exist.
    :param name: name of the bag without its extension; it gets a number if the bag exists.
    :raises RecordingError: the folder cannot be used, or the library mcap is not installed.
    """
    names, limits = FileNames(f'{name}{BAG_SUFFIX}'), Limits(has_reserve=True)
    return cast(BagSink, open_sink(
        path, names, EncoderSettings(BAG_SUFFIX), 'continue', limits, sync=False))


def open_sink(
    path: Path, names: FileNames, settings: EncoderSettings, on_exists: str, limits: Limits,
    sync: bool, monotonic: Callable[[], float] = time.monotonic,
) -> Sink[Any]:
    """
    Create the sink that frames are written to.

    :param path: output folder, created if it does not exist.
    :param on_exists: handling of existing files, one of ``ON_EXISTS``.
    :param sync: whether each file is flushed to disk before it gets its final name.
    :param monotonic: monotonic clock in seconds, for the retries of a video or bag.
    :returns: the sink, for a recorder.
    :raises RecordingError: the folder cannot be used, existing files are in the way, or a library
        that the format needs is not installed.
    :raises ValueError: the limits do not suit the format.
    """
    check_limits(settings.suffix, limits)
    is_video, is_bag = settings.suffix in VIDEO_FORMATS, settings.suffix == BAG_SUFFIX
    try:
        check_format(settings.suffix)
        folder = Folder(path, sync, FINISHERS)
        try:
            if is_bag:
                finish_bags(folder)
            numbering = Numbering(names, folder, on_exists)
            if is_video:
                return FileSink(
                    folder, numbering, limits, VideoFormat(settings), monotonic)
            if is_bag:
                return BagSink(folder, numbering, settings, limits, monotonic)
            return ImageSink(folder, numbering, settings, limits)
        except (OSError, RecordingError):
            folder.close()
            raise
    except (BagError, VideoError) as err:
        raise RecordingError(str(err)) from err
    except OSError as err:
        shown, reason = printable(path, MAX_PATH), _REMEDIES.get(err.errno or 0, err.strerror)
        raise RecordingError(f'output_dir {shown} cannot be used: {reason}') from err
