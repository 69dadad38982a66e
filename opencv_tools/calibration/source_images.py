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

"""Images of a source with an end: image files, a folder, a video or a bag."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray
from opencv_tools.base.text import without_password
from opencv_tools.base.units import NANO
from opencv_tools.capture.errors import BrokenFrameError
from opencv_tools.capture.frame import FileSource
from opencv_tools.capture.image_files import ImageFileSource
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.capture.settings import CaptureSettings
from opencv_tools.capture.source import is_camera, is_pattern, names_bag, open_source
from opencv_tools.image.errors import ImageError

_RATE = 10.0  # frames of a video that are searched in a second
_LARGEST = 1 << 27  # pixels
_GRAY = CaptureSettings(encoding='mono8')


@dataclass(frozen=True, kw_only=True)
class Image:
    """
    A frame of a source.

    :param name: name of its file, or its number in the source.
    :param pixels: (h, w) uint8 image.
    :param seconds: time in the video or bag; None for image files.
    """

    name: str
    pixels: NDArray[Any]
    seconds: float | None


def open_files(text: str, topic: str = '') -> FileSource:
    """
    Open a source that has an end.

    :param text: as for ``open_source``.
    :param topic: topic of the images of a bag; '' for the only one.
    :raises CaptureError: the source cannot be opened.
    :raises ValueError: the text names no source, or one without an end.
    """
    shown = without_password(text)
    if topic and not names_bag(text):
        raise ValueError(f'the topic {topic!r:.80} is for a bag, but {shown!r:.80} is none: leave '
                         "the topic out, or give files such as 'drive/*.mcap'")
    if not (is_camera(text) or is_pattern(text)):
        source = open_source(text, bag_topic=topic)
        if not source.live:
            return source
        source.close()
    raise ValueError(f'the source {shown!r:.80} has no end: give image files, a folder, a '
                     'video or a bag, which img_subscriber records')


def check_pairs(sources: Sequence[FileSource]) -> None:
    """
    Check that the image files of two cameras can be paired by their order.

    :raises ValueError: their numbers differ.
    """
    counts = [source.count for source in sources if isinstance(source, ImageFileSource)]
    if len(set(counts)) > 1:
        raise ValueError(f'the left camera has {counts[0]} images, the right one {counts[1]}: '
                         'give the same number, in the same order')


def read_images(source: FileSource, warn: Callable[[str], object]) -> Iterator[Image]:
    """
    Yield the images of a source; those of a video at most 10 times a second.

    :param warn: called with a sentence for each image that cannot be read.
    :raises CaptureError: the source has failed.
    """
    every = max(1, round(source.rate / _RATE))
    paths = source.paths if isinstance(source, ImageFileSource) else ()
    number = -1
    with closing(source):
        for warning in source.warnings:
            warn(warning)
        while True:
            number += 1
            try:
                if number % every:
                    if not source.skip():
                        return
                    continue
                frame = source.read()
                if frame is None:
                    return
                pixels = OutputImage(frame, _GRAY).image
            except (BrokenFrameError, ImageError) as err:
                warn(f'an image was not read: {err}')
                continue
            if not 0 < pixels.size <= _LARGEST:
                warn(f'an image was left out: it has {pixels.size} pixels')
                continue
            seconds = None if paths else number / (source.rate or _RATE)
            if frame.recorded:
                seconds = frame.recorded.time_ns / NANO
            elif frame.position is not None and not paths:
                seconds = frame.position
            yield Image(name=paths[number].name if paths else f'frame {number}', pixels=pixels,
                        seconds=seconds)
