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

"""Conversion of images between types of numbers, as OpenCV's convertTo does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.blocks import row_blocks

# Factor between the ranges of 8 and 16 bits: 65535 = 257 * 255.
_RANGE_FACTOR = 257

_Conversion = Callable[[NDArray[Any], NDArray[Any]], None]


def change_depth(image: NDArray[Any], dtype: str) -> NDArray[Any]:
    """
    Convert the type of all channels.

    Conversions between 8 and 16 bits scale the range: they multiply by 257, or divide by 257 and
    round. All other conversions keep the numbers. Floats are rounded half to even; NaN and floats
    outside of int32 become -2**31 first. Numbers out of range become the nearest valid number.

    :param image: (h, w) or (h, w, c) array in native byte order, which is not changed.
    :param dtype: numpy name of the new type, such as ``'uint8'``.
    :returns: a new contiguous array; ``image`` itself if it already has the type.
    """
    target = np.dtype(dtype)
    if image.dtype == target:
        return image
    changed = np.empty(image.shape, target)
    convert = _find_conversion(image.dtype, target)
    # NaN and infinity are valid results and need no warning: 1e300 becomes infinity in float32.
    with np.errstate(over='ignore', invalid='ignore'):
        for rows in row_blocks(*image.shape[:2]):
            convert(image[rows], changed[rows])
    return changed


def _find_conversion(source: np.dtype[Any], target: np.dtype[Any]) -> _Conversion:
    """Return the function that converts numbers of one type to another type."""
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
    # For x = 257 q + r the sum is 256 q + r + 127. Its upper byte is q for r < 129, else q + 1.
    nearest = source // np.uint16(_RANGE_FACTOR)
    np.subtract(source, nearest, out=nearest)
    np.add(nearest, np.uint16(127), out=nearest)
    np.right_shift(nearest, np.uint16(8), out=nearest)
    target[...] = nearest
