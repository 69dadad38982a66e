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

"""Images of another size, whose pixels stay at their places."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, sqrt
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.viewer.region import Region

# Factor above which a mean of all pixels is needed against false patterns.
_AREA_FACTOR = 2
# Pixels of a picture of depths or labels at most, a few more than 3840 x 2160.
_MAX_PICKED = 2**23


@dataclass(frozen=True, kw_only=True)
class Reduction:
    """
    How a JPEG was decoded at a reduced size.

    :param factor: pixels of the image for one that was decoded, along each axis. The last ones
        are for fewer pixels if the size is no multiple.
    :param size: width and height of the image.
    :param is_reversed: whether the columns and the rows have been reversed since.
    """

    factor: int
    size: tuple[int, int]
    is_reversed: tuple[bool, bool]


def scale(image: NDArray[Any], width: int) -> NDArray[Any]:
    """Return an image of bytes with another width."""
    rows, columns = image.shape[:2]
    if width == columns:
        return image
    size = width, max(1, round(rows * width / columns))
    method = cv2.INTER_AREA if columns > _AREA_FACTOR * width else cv2.INTER_LINEAR
    return cv2.resize(np.ascontiguousarray(image), size, interpolation=method)


def pick(image: NDArray[Any], width: int) -> NDArray[Any]:
    """
    Return every n-th pixel, because a mean of depths or labels has no meaning.

    :param width: largest width; a large image has an even smaller one, for its memory.
    """
    rows, columns = image.shape[:2]
    step = max(-(-columns // width), ceil(sqrt(rows * columns / _MAX_PICKED)))
    return image[::step, ::step]


def scale_reduced(
    decoded: NDArray[Any], region: Region, width: int, reduction: Reduction,
) -> NDArray[Any]:
    """
    Return a part of an image that was decoded at a reduced size, with another width.

    :param decoded: (h, w, 3) uint8 array.
    :param region: part of the image in its own pixels.
    :param width: width of the result, at most that of the decoded part.
    """
    factor, sides = reduction.factor, (region.width, region.height)
    counts = decoded.shape[1::-1]
    # Pixel of the image at which the decoded ones begin; before the first one if reversed.
    begins = [size - count * factor if is_reversed else 0 for size, count, is_reversed in zip(
        reduction.size, counts, reduction.is_reversed, strict=True)]
    edges = [(low - begin, low + side - begin) for low, side, begin in zip(
        (region.x, region.y), sides, begins, strict=True)]
    (left, right), (top, bottom) = (
        (low // factor, -(-high // factor)) for low, high in edges)
    part = decoded[top:bottom, left:right]
    if not any(edge % factor for axis in edges for edge in axis):
        return scale(part, width)
    size = width, max(1, round(region.height * width / region.width))
    steps = [max(1, int(side / factor / length))
             for side, length in zip(sides, size, strict=True)]
    part = _mean(part, *steps)
    matrix = np.zeros((2, 3))
    for axis, (edge, side, length, step) in enumerate(zip(
            edges, sides, size, steps, strict=True)):
        ratio = side / length / factor / step
        matrix[axis, axis] = ratio
        matrix[axis, 2] = (edge[0] % factor) / factor / step + ratio / 2 - 0.5
    return cv2.warpAffine(part, matrix, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                          borderMode=cv2.BORDER_REPLICATE)


def _mean(image: NDArray[Any], across: int, down: int) -> NDArray[Any]:
    """Return the mean of blocks of pixels; edges are repeated for the last blocks."""
    rows, columns = image.shape[:2]
    if across == down == 1:
        return np.ascontiguousarray(image)
    filled = cv2.copyMakeBorder(
        np.ascontiguousarray(image), 0, -rows % down, 0, -columns % across, cv2.BORDER_REPLICATE)
    return cv2.resize(filled, (filled.shape[1] // across, filled.shape[0] // down),
                      interpolation=cv2.INTER_AREA)
