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

"""Mirroring of images, and rotation by multiples of 90 degrees."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.encodings import Encoding, find_encoding
from opencv_tools.image.errors import ConversionError

#: Step of the rows and of the columns for each mirroring; -1 reverses the order.
FLIPS = {'none': (1, 1), 'horizontal': (1, -1), 'vertical': (-1, 1), 'both': (-1, -1)}
ROTATIONS = (0, 90, 180, 270)


def orient(
    image: NDArray[Any], encoding: Encoding, flip: str, degrees: int,
) -> tuple[NDArray[Any], Encoding]:
    """
    Mirror an image, then rotate it.

    :param image: (h, w) or (h, w, c) array, which is not changed.
    :param flip: one of ``FLIPS``; ``'horizontal'`` swaps left and right.
    :param degrees: clockwise rotation in degrees, one of ``ROTATIONS``.
    :returns: a view of the image, (w, h) or (w, h, c) for 90 and 270 degrees, and its encoding;
        for a Bayer image the encoding with the new pattern.
    :raises ConversionError: the encoding is YUV, whose pixels share their chroma.
    """
    if flip == 'none' and not degrees:
        return image, encoding
    if encoding.kind == 'yuv':
        raise ConversionError(f'a {encoding.name} image cannot be flipped or rotated, because its '
                              'pixels share their chroma; set encoding to bgr8 or mono8')
    if encoding.kind == 'bayer':
        height, width = image.shape[:2]
        cells = np.tile(np.array(list(encoding.order)).reshape(2, 2), (2, 2))
        cells = _turn(cells[:2 + height % 2, :2 + width % 2], flip, degrees)
        order = ''.join(cells[:2, :2].flat)
        encoding = find_encoding(encoding.name.replace(encoding.order, order))
    return _turn(image, flip, degrees), encoding


def turned_axes(flip: str, degrees: int) -> NDArray[Any]:
    """
    Return the matrix by which ``orient`` transforms directions in an image.

    :param flip: one of ``FLIPS``.
    :param degrees: clockwise rotation in degrees, one of ``ROTATIONS``.
    :returns: (2, 2) orthogonal float64 matrix of -1.0, 0.0 and 1.0; maps a direction (x, y) of
        the image to the direction in the mirrored and rotated image.
    """
    rows, columns = FLIPS[flip]
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    return np.linalg.matrix_power(quarter, degrees // 90) @ np.diag([columns, rows]) + 0.0


def _turn(image: NDArray[Any], flip: str, degrees: int) -> NDArray[Any]:
    rows, columns = FLIPS[flip]
    return np.rot90(image[::rows, ::columns], -degrees // 90)
