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

"""The sources that the parameter ``source`` can name."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing, suppress
import difflib
import glob
import os
from pathlib import Path
import stat

from opencv_tools.bags.open_bag import BAG_SUFFIXES, is_bag
from opencv_tools.base.regular_files import describe_kind, natural_order, user_path
from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.capture.bag import BagSource
from opencv_tools.capture.container import known_count, open_container
from opencv_tools.capture.errors import CaptureError, UnavailableError
from opencv_tools.capture.frame import Source
from opencv_tools.capture.image_files import IMAGE_SUFFIXES, ImageFileSource
from opencv_tools.capture.opencv_video import (
    check_pictures, frame_count, open_video, OpenCvStream, OpenCvVideo)
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.capture.pattern import parse_pattern, PatternSource
from opencv_tools.capture.settings import CaptureSettings
from opencv_tools.capture.stream import AvStream, STREAM_SCHEMES, StreamSource
from opencv_tools.capture.urls import check_url
from opencv_tools.capture.v4l2.camera import CameraSource
from opencv_tools.capture.v4l2.modes import CameraRequest, DEFAULT_REQUEST, DEFAULT_SIZE
from opencv_tools.capture.video import VideoSource
from opencv_tools.image.errors import VideoError
from opencv_tools.opencv import cv2

# Similarity to the word ``pattern`` from which a name counts as a typing error, 0.0 to 1.0.
_CLOSE = 0.8


def check_source(text: str) -> None:
    """
    Check that a text can name a source.

    :param text: as for :func:`open_source`.
    :raises ValueError: the text is empty, an invalid pattern or an invalid URL.
    """
    if not text:
        raise ValueError('give a camera, a file, a folder, a bag, a URL or pattern')
    if is_pattern(text):
        parse_pattern(text)
    elif _is_url(text):
        check_url(text)


def is_pattern(text: str) -> bool:
    """Return whether a source is a test pattern, which has no end."""
    return text == 'pattern' or text.startswith('pattern:')


def is_camera(text: str) -> bool:
    """Return whether a source is a camera of this machine, connected or not."""
    if text.isdecimal():
        return True
    path = user_path(text)
    try:
        return stat.S_ISCHR(path.stat().st_mode)
    except OSError:
        with suppress(OSError):  # the working directory was removed
            # Path.resolve raises RuntimeError for a loop of links before Python 3.13.
            path = Path(os.path.realpath(path))
        return path.is_relative_to('/dev')


def names_bag(text: str) -> bool:
    """Return whether a source is a bag, which may not exist."""
    if is_pattern(text) or _is_url(text):
        return False
    path = _path(text)
    return is_bag(path) or _are_bags(_matches(path))


def describe_opening(text: str) -> str:
    """Return why opening a source may take long, as a bag without an index; '' if it does not."""
    return f'Reading {text} from its begin to its end' if names_bag(text) else ''


def open_source(
    text: str, request: CameraRequest = DEFAULT_REQUEST, timeout: float = 2.0,
    bag_topic: str | None = '',
) -> Source:
    """
    Open a source.

    :param text: device number, device path, video file, bag, image file, folder, glob pattern of
        image files or of bags, stream URL, or ``pattern[:depth][:WIDTHxHEIGHT[@FPS]]``.
    :param timeout: timeout in seconds for opening a stream and for reading from it.
    :param bag_topic: topic of the images of a bag; '' for the only one, None for any.
    :returns: the open source; ``live`` is True for a camera or stream.
    :raises UnavailableError: the camera or stream cannot be opened now.
    :raises CaptureError: the source cannot be opened.
    :raises ValueError: the text is empty, an invalid pattern or an invalid URL.
    """
    check_source(text)
    if is_pattern(text):
        return PatternSource(parse_pattern(text))
    if is_camera(text):
        device = user_path(f'/dev/video{int(text)}' if text.isdecimal() else text)
        return CameraSource(device, request)
    if _is_url(text):
        return _open_url(text, timeout)
    return _open_path(_path(text), bag_topic)


def expected_size(
    text: str, request: CameraRequest = DEFAULT_REQUEST, bag_topic: str = '',
) -> tuple[int, int] | None:
    """
    Return the expected size of the frames of a source.

    A file is opened and its first frame is read. A camera is not opened.

    :param text: as for :func:`open_source`.
    :param request: requested camera settings; the camera may send another size.
    :param bag_topic: topic of the images of a bag; '' for the only one.
    :returns: width and height in pixels; None for a stream, for an empty source, and for a named
        pipe, which can be read only once.
    :raises CaptureError: a file cannot be read.
    :raises ImageError: the first frame cannot be read.
    :raises ValueError: the text is empty, an invalid pattern or an invalid URL.
    """
    if is_pattern(text):
        spec = parse_pattern(text)
        return spec.width, spec.height
    if is_camera(text):
        return request.width or DEFAULT_SIZE[0], request.height or DEFAULT_SIZE[1]
    if _is_url(text) or _path(text).is_fifo():
        return None
    with closing(open_source(text, bag_topic=bag_topic)) as source:
        frame = None if source.live else source.read()
    return None if frame is None else OutputImage(frame, CaptureSettings()).size


def _path(text: str) -> Path:
    return user_path(text.removeprefix('file://'))


def _is_url(text: str) -> bool:
    return '://' in text.removeprefix('file://')


def _open_url(url: str, timeout: float) -> Source:
    """Open a stream, or a video file on a web server, which has a known number of frames."""
    is_stream = url.partition(':')[0].lower() in STREAM_SCHEMES
    milliseconds = max(1, int(timeout * 1000))
    try:
        try:
            container = open_container(url, timeout)
        except VideoError:  # no PyAV
            capture = open_video(url, cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, milliseconds,
                                 cv2.CAP_PROP_READ_TIMEOUT_MSEC, milliseconds)
            if not is_stream and frame_count(capture):
                return OpenCvVideo(url, capture)
            return StreamSource(url, OpenCvStream(capture))
        if not is_stream and known_count(container):
            return VideoSource(url, container, timeout)
        return StreamSource(url, AvStream(url, container))
    except CaptureError as err:
        raise UnavailableError(str(err)) from err


def _open_path(path: Path, bag_topic: str | None) -> Source:
    """Open a bag, a folder, an image file, a video file or the matches of a glob pattern."""
    shown = printable(path, MAX_PATH)
    try:
        mode = path.stat().st_mode
    except OSError as err:
        matches = _matches(path)
        if _are_bags(matches):
            return BagSource(path, bag_topic, matches)
        if matches:
            return ImageFileSource(_image_files(matches), str(path))
        hint = _suggestion(path) if isinstance(err, FileNotFoundError) else ''
        raise CaptureError(f'{shown} cannot be opened: {err.strerror}{hint}') from err
    if not os.access(path, os.R_OK):
        raise CaptureError(f'no permission to read {shown}; check its owner and mode')
    if is_bag(path):
        return BagSource(path, bag_topic)
    if stat.S_ISDIR(mode):
        return _open_folder(path)
    is_image_file = path.suffix.lower() in IMAGE_SUFFIXES
    kind = describe_kind(mode)
    if kind and (is_image_file or not stat.S_ISFIFO(mode)):  # a video may come through a pipe
        raise CaptureError(f'{shown} is {kind}; give a file or a folder')
    if is_image_file:
        return ImageFileSource([path], str(path))
    try:
        return VideoSource(str(path), open_container(str(path)))
    except VideoError:  # no PyAV
        warning = check_pictures(str(path)) if stat.S_ISREG(mode) else ''
        return OpenCvVideo(str(path), open_video(str(path)), warning)


def _matches(path: Path) -> list[Path]:
    """Return the files that a glob pattern matches; none for a path, also of a broken link."""
    return [Path(match) for match in glob.glob(str(path)) if match != str(path)]


def _are_bags(paths: list[Path]) -> bool:
    return bool(paths) and all(map(is_bag, paths))


def _open_folder(path: Path) -> ImageFileSource:
    """Open the image files of a folder; an error names the pattern of bags in it."""
    images = _image_files(path.iterdir())
    bags = sorted(file.suffix for file in path.iterdir()
                  if file.suffix.lower() in BAG_SUFFIXES and file.is_file())
    if bags and not images:
        shown = printable(path, MAX_PATH)
        raise CaptureError(f'{shown} has no image file, and its bags have no metadata.yaml; give '
                           f"one of them, or all as '{shown}/*{bags[0]}'")
    return ImageFileSource(images, str(path))


def _suggestion(path: Path) -> str:
    """Return a hint for a missing file whose name is similar to ``pattern``; '' otherwise."""
    name, colon, size = str(path).partition(':')
    is_close = difflib.get_close_matches(name, ['pattern'], cutoff=_CLOSE)
    return f'; did you mean pattern{colon}{size}?' if is_close else ''


def _image_files(paths: Iterable[Path]) -> list[Path]:
    """Return the image files among some paths, in natural order."""
    return sorted((path for path in paths
                   if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()),
                  key=natural_order)
