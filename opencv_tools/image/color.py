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

"""Image colours: one encoding turned into another, in the arithmetic of OpenCV."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.encodings import Encoding

# ITU-R BT.601 weights of red, green and blue, scaled by 2**15 as OpenCV's cvtColor has them.
_GRAY_WEIGHTS = {'r': 9798, 'g': 19235, 'b': 3735}
_GRAY_SHIFT = 15


class ConversionError(ValueError):
    """A conversion between two encodings that makes no sense or is not known."""


def convert(
    image: NDArray[Any], source: Encoding, target: Encoding,
) -> NDArray[Any]:
    """
    Convert an image from one encoding to another: colours first, then depth.

    :param image: array of shape (h, w) or (h, w, c), of any byte order; it is not changed.
    :param source: the encoding of the image.
    :param target: the wanted encoding.
    :returns: a fresh contiguous array in native byte order, (h, w) for one channel.
    :raises ConversionError: no such conversion; the texts are those of cv_bridge.
    """
    _check_conversion(source, target)
    native = np.asarray(image, np.dtype(source.dtype))
    if source.order and target.order and source.order != target.order:
        native = _reorder(native, source.order, target.order)
    converted = np.ascontiguousarray(_change_depth(native, source, target))
    return np.copy(converted) if np.may_share_memory(converted, image) else converted


def _check_conversion(source: Encoding, target: Encoding) -> None:
    """
    Refuse what cannot be converted.

    :raises ConversionError: no such conversion; the texts are those of cv_bridge.
    """
    if source.name == target.name:
        return
    if source.order and target.order:
        return
    if _is_named(source) and _is_named(target):
        raise ConversionError(
            f'Unsupported conversion from [{source.name}] to [{target.name}]')
    if not _is_named(source) and _is_named(target):
        raise ConversionError(f'[{source.name}] is not a color format. but [{target.name}] is. '
                              'The conversion does not make sense')
    if source.channels != target.channels:
        raise ConversionError(
            f'[{source.name}] is a color format but [{target.name}] is not so they must have '
            'the same OpenCV type, CV_8UC3, CV16UC1 ....' if _is_named(source) else
            f'[{source.name}] and [{target.name}] do not have the same number of channel')


def _is_named(encoding: Encoding) -> bool:
    """Tell a named encoding, which says what its channels mean, from a generic type."""
    return encoding.name[0].islower()


def _reorder(image: NDArray[Any], source: str, target: str) -> NDArray[Any]:
    """Turn channels in one order into another; a new alpha channel is opaque."""
    if target == 'y':
        return _gray(image, source)
    reordered = np.empty((*image.shape[:2], len(target)), image.dtype)
    for index, channel in enumerate(target):
        if source == 'y' and channel != 'a':
            reordered[..., index] = image
        elif channel in source:
            reordered[..., index] = image[..., source.index(channel)]
        else:
            reordered[..., index] = np.iinfo(image.dtype).max
    return reordered


def _gray(image: NDArray[Any], source: str) -> NDArray[Any]:
    """Weigh the colours of every pixel: ``(9798 R + 19235 G + 3735 B + 2**14) >> 15``."""
    weighed = np.full(image.shape[:2], 1 << (_GRAY_SHIFT - 1), np.uint32)
    for channel, weight in _GRAY_WEIGHTS.items():
        weighed += np.multiply(
            image[..., source.index(channel)], np.uint32(weight), dtype=np.uint32)
    weighed >>= np.uint32(_GRAY_SHIFT)
    return weighed.astype(image.dtype)


def _change_depth(
    image: NDArray[Any], source: Encoding, target: Encoding,
) -> NDArray[Any]:
    """
    Change the type of every channel.

    Between 8 and 16 bits the whole range is kept, by the factor 257 that maps 255 to 65535;
    any other change keeps the numbers, rounded half to even and saturated as OpenCV does.
    """
    depths = (source.dtype, target.dtype)
    if depths == ('uint8', 'uint16'):
        widened: NDArray[Any] = np.multiply(image, np.uint16(257), dtype=np.uint16)
        return widened
    if depths == ('uint16', 'uint8'):
        narrowed = image.astype(np.uint32)
        narrowed += np.uint32(128)
        narrowed //= np.uint32(257)
        return narrowed.astype(np.uint8)
    wanted = np.dtype(target.dtype)
    if wanted == image.dtype or wanted.kind == 'f':
        return image.astype(wanted, copy=False)
    if image.dtype.kind == 'f':
        int32 = np.iinfo(np.int32)
        nearest = np.rint(image.astype(np.float64))
        inside = (nearest >= int32.min) & (nearest <= int32.max)  # False for NaN
        image = np.where(inside, nearest, int32.min)
    limits = np.iinfo(wanted)
    saturated: NDArray[Any] = image.astype(np.int64).clip(limits.min, limits.max)
    return saturated.astype(wanted)
