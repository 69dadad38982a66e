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

"""Image depth: numbers of one type turned into another, as OpenCV's convertTo does it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.blocks import row_blocks

# 65535 = 257 * 255: the factor between the ranges of 8 and of 16 bits.
_RANGE_FACTOR = 257

_Conversion = Callable[[NDArray[Any], NDArray[Any]], None]


def change_depth(image: NDArray[Any], dtype: str) -> NDArray[Any]:
    """
    Change the type of every channel.

    Between 8 and 16 bits, signed or not, the range is kept: times 257, or divided by 257 and
    rounded. Any other change keeps the numbers, rounded half to even; a number that is not within
    int32, NaN among them, counts as -2**31. What the new type cannot hold becomes its nearest.

    :param image: array of shape (h, w) or (h, w, c) in native byte order; it is not changed.
    :param dtype: numpy name of the wanted type, such as ``'uint8'``.
    :returns: a fresh contiguous array, or ``image`` itself when it has the type already.
    """
    wanted = np.dtype(dtype)
    if image.dtype == wanted:
        return image
    changed = np.empty(image.shape, wanted)
    convert = _find_conversion(image.dtype, wanted)
    # NaN is nothing to warn of, nor is infinity, which is float32's nearest to 1e300.
    with np.errstate(over='ignore', invalid='ignore'):
        for rows in row_blocks(*image.shape[:2]):
            convert(image[rows], changed[rows])
    return changed


def _find_conversion(source: np.dtype[Any], target: np.dtype[Any]) -> _Conversion:
    """Choose what writes the numbers of one array, as another type, to another array."""
    if target.kind == 'f':
        return _cast
    if source.kind == 'f':
        return _round
    sizes = (source.itemsize, target.itemsize)
    if sizes == (1, 2):
        return _widen_bytes if source.kind + target.kind == 'uu' else _widen
    if sizes == (2, 1):
        return _narrow_words if source.kind + target.kind == 'uu' else _narrow
    return _saturate


def _cast(source: NDArray[Any], target: NDArray[Any]) -> None:
    target[...] = source


def _round(source: NDArray[Any], target: NDArray[Any]) -> None:
    int32 = np.iinfo(np.int32)
    nearest = np.rint(source, dtype=np.float64)
    outside = ~((nearest >= int32.min) & (nearest <= int32.max))  # True for NaN
    nearest[outside] = int32.min
    limits = np.iinfo(target.dtype)
    target[...] = np.clip(nearest, limits.min, limits.max, out=nearest)


def _saturate(source: NDArray[Any], target: NDArray[Any]) -> None:
    limits = np.iinfo(target.dtype)
    target[...] = np.clip(source.astype(np.int64), limits.min, limits.max)


def _widen(source: NDArray[Any], target: NDArray[Any]) -> None:
    _saturate(np.multiply(source, np.int32(_RANGE_FACTOR), dtype=np.int32), target)


def _narrow(source: NDArray[Any], target: NDArray[Any]) -> None:
    shifted = np.add(source, np.int32(_RANGE_FACTOR // 2), dtype=np.int32)
    _saturate(np.floor_divide(shifted, np.int32(_RANGE_FACTOR)), target)


def _widen_bytes(source: NDArray[Any], target: NDArray[Any]) -> None:
    target[...] = source
    np.multiply(target, np.uint16(_RANGE_FACTOR), out=target)


def _narrow_words(source: NDArray[Any], target: NDArray[Any]) -> None:
    # With x = 257 q + r this is 256 q + r + 127, whose upper byte is q, or q + 1 from r = 129 on.
    nearest = source // np.uint16(_RANGE_FACTOR)
    np.subtract(source, nearest, out=nearest)
    np.add(nearest, np.uint16(127), out=nearest)
    np.right_shift(nearest, np.uint16(8), out=nearest)
    target[...] = nearest
