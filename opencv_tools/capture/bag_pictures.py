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

"""Selected pictures of a topic of a bag, decoded in their order."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing, suppress
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.bags.compression import decompressed_message
from opencv_tools.bags.open_bag import Bag
from opencv_tools.bags.reading import BagMessage, BagTopic
from opencv_tools.capture.bag import read_picture
from opencv_tools.capture.bag_video import BagVideo
from opencv_tools.capture.frame import CapturedFrame, Recorded
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.capture.settings import CaptureSettings
from opencv_tools.image.compressed_depth import DEPTH_ENCODINGS
from opencv_tools.image.errors import ConversionError, EncodingError, ImageError

_SETTINGS = CaptureSettings(encoding='bgr8')
#: What to do with images that data sets have no place for.
OTHER_IMAGES = ('--image takes colours and mono8, --depth takes 16UC1, mono16 and 32FC1; publish '
                'other images as one of these, or leave the topic out')


def bag_pictures(bag: Bag, topic: BagTopic, messages: Sequence[int], is_depth: bool = False,
                 kept: int = 1) -> Generator[OutputImage | str, None, None]:
    """
    Yield pictures of a topic, decoded and, unless they are depth, converted to ``bgr8``.

    :param bag: the bag; it may be read by others at the same time.
    :param messages: increasing numbers of messages among those of the topic, from 0.
    :param kept: number of pictures that the caller needs beside the last one.
    :returns: an iterator over the picture of each message, or why it cannot be decoded. A picture
        is valid until ``kept`` others and the next one are decoded.
    :raises BagError: a file cannot be read as a bag.
    :raises OSError: a file cannot be read.
    """
    reader, video = copy(bag), BagVideo(topic.type_name)  # the copy has its own open file
    numbers, memory = iter(messages), _Memory(kept + 1)
    wanted, place = next(numbers, None), 0
    with closing(reader):
        for item in reader.messages([topic]):
            if wanted is None:
                return
            if not isinstance(item, BagMessage):
                video.restart()
                continue
            if place == wanted:
                yield _decoded(topic, item, video, None if is_depth else memory)
                wanted = next(numbers, None)
            elif video.needs_skipped:
                with suppress(ImageError, OSError):  # of a frame that is not wanted
                    video.skip(decompressed_message(item.load()), item.number)
            place += 1


class _Memory:
    """Arrays that pictures use in turn, because new memory takes time at the first use."""

    def __init__(self, count: int) -> None:
        self._arrays: list[NDArray[Any]] = [np.empty((0, 0, 3), np.uint8)] * count
        self._number = 0

    def lend(self, height: int, width: int, _: Any) -> NDArray[Any]:
        """Lend the array that does not have the last picture."""
        if self._arrays[self._number].shape[:2] != (height, width):
            self._arrays[self._number] = np.empty((height, width, 3), np.uint8)
        return self._arrays[self._number]

    def keep(self) -> None:
        """Keep the picture that was written to the lent array."""
        self._number = (self._number + 1) % len(self._arrays)


def _decoded(topic: BagTopic, item: BagMessage, video: BagVideo, memory: _Memory | None,
             ) -> OutputImage | str:
    try:
        serialized = decompressed_message(item.load())
        wire, image, encoding = read_picture(topic.type_name, serialized, video, item.number)
    except (ImageError, OSError) as err:
        video.restart()
        return _reason(err)
    declared = getattr(wire, 'format', encoding).partition(';')[0]
    if memory and declared in DEPTH_ENCODINGS:
        return f'{declared} has more than 8 bits a pixel; if it is depth, use --depth'
    if memory:
        picture = OutputImage(CapturedFrame(image, encoding), _SETTINGS)
        picture.lend = memory.lend
    else:  # the message has the format of compressed depth
        picture = OutputImage(CapturedFrame(image, encoding, recorded=Recorded(
            message=wire, topic=topic.name, log_ns=item.log_ns)), CaptureSettings())
    try:
        if not picture.image.size:  # decoded here, once
            return 'it has no pixels'
    except ImageError as err:
        return _reason(err)
    if memory:
        memory.keep()
    return picture


def _reason(err: Exception) -> str:
    """Return why a message is not decoded, and what to do if it has no other encoding."""
    is_other = isinstance(err, (ConversionError, EncodingError))
    return f'{err}; {OTHER_IMAGES}' if is_other else str(err)
