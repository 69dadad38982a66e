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

"""The pictures of the rows of a bag, decoded once each, in the order of the rows."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from contextlib import closing, suppress
from copy import copy
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.bags.bag import Bag
from opencv_tools.bags.compression import decompressed_message
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.reading import BagMessage, BagTopic
from opencv_tools.capture.bag import read_picture
from opencv_tools.capture.bag_video import BagVideo
from opencv_tools.capture.frame import CapturedFrame
from opencv_tools.capture.output_image import OutputImage, OutputSettings
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.tracks import Track
from opencv_tools.image.errors import ImageError
from opencv_tools.image.text import printable

_SETTINGS = OutputSettings(encoding='bgr8')


def row_pictures(bag: Bag, name: str, track: Track, samples: Iterable[int],
                 ) -> Generator[tuple[int, OutputImage], None, None]:
    """
    Yield the picture of each row.

    :param bag: the bag; it may be read by others at the same time.
    :param name: name of the camera, for errors.
    :param track: samples of the camera.
    :param samples: number of the sample of each row; no number is smaller than the one before.
    :returns: an iterator over the number of the sample that is shown and its picture, whose
        ``image`` is (h, w, 3) BGR. A picture that cannot be decoded is replaced by the one before.
    :raises DatasetError: no picture can be decoded before the first row, a picture cannot be
        converted, or its size is another one.
    """
    rows = list(samples)
    wanted = sorted(set(rows))
    pictures = _pictures(bag, track.topic, track.messages[wanted])
    current = -1
    shown: tuple[int, OutputImage] | None = None
    size: tuple[int, int] | None = None
    reason = ''
    with closing(pictures):
        for sample in rows:
            if sample != current:
                current, picture = sample, next(pictures, 'it is missing')
                if isinstance(picture, str):
                    reason = picture
                elif picture.size != (size or picture.size):
                    raise DatasetError(f'{name} changes its size from {size} to {picture.size}; '
                                       'all pictures of a camera must have one size')
                else:
                    shown, size = (sample, picture), picture.size
            if shown is None:
                raise DatasetError(f'{name} has no picture for the first row: message '
                                   f'{track.messages[sample]} of {printable(track.topic.name)} '
                                   f'cannot be decoded: {reason}')
            yield shown


def _pictures(bag: Bag, topic: BagTopic, messages: NDArray[np.int64],
              ) -> Generator[OutputImage | str, None, None]:
    """Yield the picture of each message in a list of numbers, or why it cannot be decoded."""
    reader, video = copy(bag), BagVideo(topic.type_name)  # the copy has its own open file
    numbers = iter(messages.tolist())
    wanted = next(numbers, None)
    place = 0
    try:
        with closing(reader):
            for item in reader.messages([topic]):
                if wanted is None:
                    return
                if not isinstance(item, BagMessage):
                    video.restart()
                    continue
                if place == wanted:
                    yield _decoded(topic, item, video)
                    wanted = next(numbers, None)
                elif video.needs_skipped:
                    with suppress(BagError, ImageError, OSError):  # of a frame that is not wanted
                        video.skip(decompressed_message(item.load()), item.number)
                place += 1
    except (BagError, OSError) as err:
        raise DatasetError(str(err)) from err


def _decoded(topic: BagTopic, item: BagMessage, video: BagVideo) -> OutputImage | str:
    try:
        serialized = decompressed_message(item.load())
        _, image, encoding = read_picture(topic.type_name, serialized, video, item.number)
        picture = OutputImage(CapturedFrame(image, encoding), _SETTINGS)
    except (BagError, ImageError, OSError) as err:
        video.restart()
        return str(err)
    try:
        _ = picture.image  # decoded here, once
    except ImageError as err:
        return str(err)
    return picture


def luma(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the brightness of an image in BGR, (h, w)."""
    gray: Any = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return gray


def fingerprint(gray: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """
    Return a small picture, by which ``--check`` recognises a frame of a video.

    :param gray: (h, w) brightness.
    :returns: (64,) mean of each of 8 x 8 parts.
    """
    small: Any = cv2.resize(gray, (8, 8), interpolation=cv2.INTER_AREA)
    return small.ravel()
