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

"""What the text of the parameter ``source`` stands for."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
import difflib
import glob
import os
from pathlib import Path
import stat

import cv2
from opencv_tools.capture.frame import CaptureError, Source, UnavailableError
from opencv_tools.capture.modes import CameraRequest, NO_WISHES, USUAL_SIZE
from opencv_tools.capture.pattern import parse_pattern, PatternSource
from opencv_tools.capture.sequence import natural_order, PICTURE_SUFFIXES, PictureSequence
from opencv_tools.capture.stream import StreamSource
from opencv_tools.capture.v4l2 import CameraSource
from opencv_tools.capture.video import frame_count, open_video, VideoSource
from opencv_tools.image.text import MAX_PATH, printable
from opencv_tools.regular_files import describe_kind

# How much of a name has to be as in ``pattern`` for it to be mistyped: 0.0 nothing, 1.0 all.
_CLOSE = 0.8


def check_source(text: str) -> None:
    """
    Refuse a text that can be no source at all.

    :raises ValueError: it is empty, or a pattern that is written wrongly.
    """
    if not text:
        raise ValueError('give a camera, a file, a folder, a URL or pattern')
    if _is_pattern(text):
        parse_pattern(text)


def is_camera(text: str) -> bool:
    """Tell whether a source is a camera of this machine, be it plugged in or not."""
    if text.isdecimal():
        return True
    path = Path(text).expanduser()
    try:
        return stat.S_ISCHR(path.stat().st_mode)
    except OSError:
        with suppress(OSError):  # of a working folder that was removed
            path = path.resolve()
        return path.is_relative_to('/dev')


def open_source(
    text: str, request: CameraRequest = NO_WISHES, timeout: float = 2.0,
) -> Source:
    """
    Open a source.

    :param text: a device number, a device's path, a video file, a picture file, a folder or glob
        of pictures, a stream's URL, or ``pattern[:WIDTHxHEIGHT[@FPS]]``.
    :param request: what is wanted of a camera.
    :param timeout: seconds after which a silent stream is given up.
    :returns: the source, opened; ``live`` tells which kind it is.
    :raises UnavailableError: a camera or stream cannot be opened now.
    :raises CaptureError: it cannot be opened at all.
    :raises ValueError: see :func:`check_source`.
    """
    check_source(text)
    if _is_pattern(text):
        return PatternSource(parse_pattern(text))
    if is_camera(text):
        device = Path(f'/dev/video{int(text)}' if text.isdecimal() else text).expanduser()
        return CameraSource(device, request)
    if _is_url(text):
        return _open_url(text, timeout)
    return _open_path(_path(text))


def expected_size(text: str, request: CameraRequest = NO_WISHES) -> tuple[int, int] | None:
    """
    Tell how large the frames of a source will be, before it is opened to be shown.

    :param text: as for :func:`open_source`.
    :param request: what is wanted of a camera, which may give something else.
    :returns: width and height; None for a stream, and for a pipe, which can be read once.
    :raises CaptureError: a file cannot be read.
    :raises ValueError: see :func:`check_source`.
    """
    if _is_pattern(text):
        spec = parse_pattern(text)
        return spec.width, spec.height
    if is_camera(text):
        return request.width or USUAL_SIZE[0], request.height or USUAL_SIZE[1]
    if _is_url(text) or _path(text).is_fifo():
        return None
    source = open_source(text)
    try:
        frame = None if source.live else source.read()
    finally:
        source.close()
    return (frame.image.shape[1], frame.image.shape[0]) if frame else None


def _is_pattern(text: str) -> bool:
    return text == 'pattern' or text.startswith('pattern:')


def _path(text: str) -> Path:
    return Path(text.removeprefix('file://')).expanduser()


def _is_url(text: str) -> bool:
    return '://' in text.removeprefix('file://')


def _open_url(url: str, timeout: float) -> Source:
    """Open a stream, or a file on a web server, which has a number of frames."""
    milliseconds = max(1, int(timeout * 1000))
    try:
        capture = open_video(url, cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, milliseconds,
                             cv2.CAP_PROP_READ_TIMEOUT_MSEC, milliseconds)
    except CaptureError as err:
        raise UnavailableError(str(err)) from err
    return VideoSource(url, capture) if frame_count(capture) else StreamSource(url, capture)


def _open_path(path: Path) -> Source:
    """Open what lies at a path: a folder, a picture, a video, or a glob of pictures."""
    shown = printable(path, MAX_PATH)
    try:
        mode = path.stat().st_mode
    except OSError as err:
        matches = [Path(match) for match in glob.glob(str(path))]
        if matches:
            return PictureSequence(_pictures(matches), str(path))
        hint = _suggestion(path) if isinstance(err, FileNotFoundError) else ''
        raise CaptureError(f'{shown} cannot be opened: {err.strerror}{hint}') from err
    if not os.access(path, os.R_OK):
        raise CaptureError(f'no permission to read {shown}; check its owner and mode')
    if stat.S_ISDIR(mode):
        return PictureSequence(_pictures(path.iterdir()), str(path))
    is_picture = path.suffix.lower() in PICTURE_SUFFIXES
    kind = describe_kind(mode)
    if kind and (is_picture or not stat.S_ISFIFO(mode)):  # a video may come through a pipe
        raise CaptureError(f'{shown} is {kind}; give a file or a folder')
    if is_picture:
        return PictureSequence([path], str(path))
    return VideoSource(str(path), open_video(str(path)))


def _suggestion(path: Path) -> str:
    """Return a hint to ``pattern``, where that may have been meant by a file that is missing."""
    name, colon, size = str(path).partition(':')
    is_close = difflib.get_close_matches(name, ['pattern'], cutoff=_CLOSE)
    return f'; did you mean pattern{colon}{size}?' if is_close else ''


def _pictures(paths: Iterable[Path]) -> list[Path]:
    """Keep the picture files, in natural order."""
    return sorted((path for path in paths
                   if path.suffix.lower() in PICTURE_SUFFIXES and path.is_file()),
                  key=natural_order)
