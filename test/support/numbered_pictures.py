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

"""Pictures that show their number, also after JPEG."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]

_BLOCK = 8  # pixels, as in JPEG
_BITS = 20  # of a number, which are the columns of blocks
_ROWS = 15
_UPRIGHT_ROWS = 8  # the rows below have the complement
_LIGHT, _NOISE = 192, 64


def picture(number: int, scale: int = 1) -> Pixels:
    """Return the picture of a number in bgr8, 160x120 for a scale of 1."""
    side = _BLOCK * scale
    blocks = np.kron(_rows(number) * np.uint8(_LIGHT), np.ones((side, side), np.uint8))
    return blocks[..., None] + _noise(scale)


def number_of(image: Pixels, *, is_exact: bool = True) -> int:
    """
    Return the number that a picture shows, or -1 if any part of it shows something else.

    :param image: the picture in bgr8.
    :param is_exact: whether every pixel must be right, which JPEG does not keep.
    """
    scale = len(image) // (_BLOCK * _ROWS)
    side = _BLOCK * scale
    if not scale or image.shape != (side * _ROWS, side * _BITS, 3):
        return -1
    rows = image.reshape(_ROWS, side, _BITS, side, 3).mean(axis=(1, 3, 4)) > 128
    number = int(rows[0] @ (1 << np.arange(_BITS)))
    is_whole = np.array_equal(rows, _rows(number) == 1) and (
        not is_exact or np.array_equal(image, picture(number, scale)))
    return number if is_whole else -1


def _rows(number: int) -> Pixels:
    """Return the bits of the upper rows and their complement in the lower rows."""
    bits = (number >> np.arange(_BITS)) & 1
    lower = np.arange(_ROWS)[:, None] >= _UPRIGHT_ROWS
    return (bits ^ lower).astype(np.uint8)


@cache
def _noise(scale: int) -> Pixels:
    """Return noise, so that a PNG file of many pixels takes long to write."""
    side = _BLOCK * scale
    shape = side * _ROWS, side * _BITS, 3
    return np.random.default_rng(1).integers(0, _NOISE, shape, np.uint8)
