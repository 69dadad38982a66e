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

from collections.abc import Generator, Iterable, Iterator
from contextlib import closing
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.bags.bag import Bag
from opencv_tools.capture.bag_pictures import bag_pictures
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.tracks import Track
from opencv_tools.image.errors import ImageError
from opencv_tools.image.text import printable


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
    pictures = bag_pictures(bag, track.topic, track.messages[wanted].tolist())
    current = -1
    shown: tuple[int, OutputImage] | None = None
    size: tuple[int, int] | None = None
    reason = ''
    with closing(pictures):
        for sample in rows:
            if sample != current:
                current, picture = sample, _next(pictures)
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


def _next(pictures: Iterator[OutputImage | str]) -> OutputImage | str:
    try:
        return next(pictures, 'it is missing')
    except (ImageError, OSError) as err:
        raise DatasetError(str(err)) from err


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
