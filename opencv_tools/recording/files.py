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

"""What frames are written to: a file each, or a video."""

from __future__ import annotations

from collections.abc import Callable
import errno
from pathlib import Path
import time
from typing import Any

from opencv_tools.image.text import printable
from opencv_tools.recording.folder import Folder, RecordingError
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.numbering import Numbering
from opencv_tools.recording.picture_files import PictureFiles
from opencv_tools.recording.recorder import Files
from opencv_tools.recording.selection import Limits
from opencv_tools.recording.video import check_video, FORMATS as VIDEO_FORMATS
from opencv_tools.recording.video_files import VideoFiles
from opencv_tools.recording.video_picture import VideoError
from opencv_tools.recording.writers import Format, FORMATS as PICTURE_FORMATS


# What helps against errors of a folder whose own words name no cure.
_REMEDIES = {
    errno.EEXIST: 'it is no folder, but a file or a link that leads to none; name another folder',
    errno.ELOOP: 'a link in it leads back to itself; name another folder',
    errno.ENAMETOOLONG: 'it is too long for the file system; name a folder with a shorter path',
}


def check_format(suffix: str) -> None:
    """
    Refuse a format that is not known, or that cannot be written on this machine.

    :param suffix: file name extension with its dot, in lower case.
    :raises ValueError: nothing here writes such files, or what writes videos is not installed.
    """
    known = (*PICTURE_FORMATS, *VIDEO_FORMATS)
    if suffix not in known:
        raise ValueError(f'the extension is one of {", ".join(known)}')
    if suffix in VIDEO_FORMATS:
        check_video()


def open_files(
    path: Path, names: FileNames, wanted: Format, on_exists: str, limits: Limits, sync: bool,
    monotonic: Callable[[], float] = time.monotonic,
) -> Files[Any]:
    """
    Make ready what frames are written to.

    :param path: the folder, which is made when it is missing.
    :param names: names of the files.
    :param wanted: what frames become.
    :param on_exists: what is done about files that are there already.
    :param limits: how much is recorded.
    :param sync: have each file on the disk before it gets its name.
    :param monotonic: returns seconds of a clock that only goes on, by which a video that cannot
        be written is tried again.
    :returns: files for a recorder.
    :raises RecordingError: the folder cannot be written to, files that are there are in the way,
        or videos cannot be written here.
    """
    is_video = wanted.suffix in VIDEO_FORMATS
    if is_video and limits.ring:
        raise RecordingError(f'a ring deletes the oldest files, and a {wanted.suffix} is one file '
                             'of many frames; set the extension of file_name to .png or .jpg')
    try:
        if is_video:
            check_video()
    except VideoError as err:
        raise RecordingError(str(err)) from err
    folder = _open_folder(path, sync)
    try:
        numbering = Numbering(names, folder, on_exists)
        if is_video:
            return VideoFiles(folder, numbering, wanted, limits, monotonic)
        return PictureFiles(folder, numbering, wanted, limits, sync)
    except OSError as err:
        folder.close()
        raise RecordingError(f'output_dir {path} cannot be used: {err.strerror}') from err
    except RecordingError:
        folder.close()
        raise


def _open_folder(path: Path, sync: bool) -> Folder:
    """
    Open a folder.

    :raises RecordingError: it cannot be used; the message says what helps.
    """
    try:
        return Folder(path, sync)
    except RecordingError as err:
        number = getattr(err.__cause__, 'errno', None)
        if number not in _REMEDIES:
            raise
        raise RecordingError(
            f'output_dir {printable(path)} cannot be used: {_REMEDIES[number]}') from err
