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

"""Conversion between gray, RGB and BGR channels, with and without alpha."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.blocks import row_blocks

# ITU-R BT.601 weights of red, green and blue times 2**15, as in OpenCV's cvtColor.
_GRAY_WEIGHTS = {'r': 9798, 'g': 19235, 'b': 3735}
_GRAY_SHIFT = 15


def reorder(image: NDArray[Any], source: str, target: str) -> NDArray[Any]:
    """
    Convert an image from one order of channels to another. A new alpha channel is opaque.

    :param image: contiguous (h, w) or (h, w, c) array of uint8 or uint16 in native byte order.
    :param source: channels of the image in order: ``'y'``, ``'rgb'``, ``'bgr'``, ``'rgba'`` or
        ``'bgra'``.
    :param target: channels of the result in order; one of the same values, but not ``source``.
    :returns: a new contiguous array of the same type: (h, w) for ``'y'``, (h, w, c) otherwise.
    """
    if target == 'y':
        return _weigh_to_gray(image, source)
    reordered = np.empty((*image.shape[:2], len(target)), image.dtype)
    pixels = image.reshape(-1, len(source))
    result = reordered.reshape(-1, len(target))
    if image.dtype == np.uint8 and len(pixels) > 2:
        _copy_words(pixels, result, source, target)
    else:
        for block in row_blocks(len(pixels), 1):
            _copy_channels(pixels[block], result[block], source, target)
    return reordered


def _copy_channels(
    source: NDArray[Any], target: NDArray[Any], source_order: str, target_order: str,
) -> None:
    """Copy pixels between arrays of shape (n, c), one channel at a time."""
    for index, channel in enumerate(target_order):
        if source_order == 'y' and channel != 'a':
            target[:, index] = source[:, 0]
        elif channel in source_order:
            target[:, index] = source[:, source_order.index(channel)]
        else:
            target[:, index] = np.iinfo(target.dtype).max


def _copy_words(
    source: NDArray[Any], target: NDArray[Any], source_order: str, target_order: str,
) -> None:
    """
    Copy 8-bit pixels as words of four bytes, which needs one copy instead of one a channel.

    A word consists of a pixel of three bytes and the byte after the pixel. To swap red and blue,
    the bytes of the word are swapped, and the word has the byte before the pixel instead. In both
    cases the extra byte is written after the pixel. The next word or the alpha channel overwrites
    it, because numpy copies one dimension from the first to the last element. The first and the
    last pixel may have no such neighbour, so they are copied channel by channel.

    :param source: contiguous (n, 1), (n, 3) or (n, 4) array of uint8, n > 2.
    :param target: contiguous (n, 3) or (n, 4) output array of uint8.
    :param source_order: channels of ``source`` in order.
    :param target_order: channels of ``target`` in order.
    """
    inner = (len(source) - 2,)
    read = source.shape[1]
    written = target.shape[1]
    target_words: NDArray[Any] = np.ndarray(inner, '<u4', target, written, (written,))
    if source_order == 'y':
        for block in row_blocks(*inner, 1):
            words = source[1:-1, 0][block].astype('<u4')
            target_words[block] = np.multiply(words, np.uint32(0x01010101), out=words)
    elif source_order[0] == target_order[0]:
        target_words[...] = np.ndarray(inner, '<u4', source, read, (read,))
    else:
        target_words[...] = np.ndarray(inner, '>u4', source, read - 1, (read,))
    if written == read == 4:
        target[:, 3] = source[:, 3]
    elif written == 4:
        whole_words = target.reshape(-1).view('<u4')
        for block in row_blocks(len(whole_words), 1):
            whole_words[block] |= np.uint32(0xff000000)
    for edge in (slice(1), slice(-1, None)):
        _copy_channels(source[edge], target[edge], source_order, target_order)


def _weigh_to_gray(image: NDArray[Any], order: str) -> NDArray[Any]:
    """Return the gray of each pixel: ``(9798 R + 19235 G + 3735 B + 2**14) >> 15``."""
    gray = np.empty(image.shape[:2], image.dtype)
    weigh = _weigh_uint8 if image.dtype == np.uint8 else _weigh_uint16
    weights = [_GRAY_WEIGHTS[channel] for channel in order[:3]]
    pixels = image.reshape(-1, len(order))
    result = gray.reshape(-1)
    for block in row_blocks(len(pixels), 1):
        weigh(pixels[block], result[block], weights)
    return gray


def _weigh_uint16(source: NDArray[Any], target: NDArray[Any], weights: list[int]) -> None:
    weighed = np.full(len(source), 1 << (_GRAY_SHIFT - 1), np.uint32)
    for index, weight in enumerate(weights):
        channel = source[:, index].astype(np.uint32)
        weighed += np.multiply(channel, np.uint32(weight), out=channel)
    weighed >>= np.uint32(_GRAY_SHIFT)
    target[...] = weighed


def _weigh_uint8(source: NDArray[Any], target: NDArray[Any], weights: list[int]) -> None:
    """
    Write the gray of 8-bit pixels, in 16-bit arithmetic.

    numpy computes with 16 bits four times as fast as with 32 bits. Each weight is split into
    ``256 * high + low``, so that the sums of both parts fit into 16 bits. The gray is exactly
    ``(64 + sum of high parts + (sum of low parts >> 8)) >> 7``. The first two channels are read
    as one number ``pair``, and ``weight * first`` is computed as
    ``weight * (pair - 256 * second)``. Overflows of 16 bits cancel out.

    :param source: (n, c) array of uint8.
    :param target: (n,) output array of uint8.
    :param weights: weights of the first three channels times 2**15.
    """
    pair = source[:, :2].view('<u2')[:, 0].astype(np.uint16)
    second = pair >> np.uint16(8)
    third = source[:, 2].astype(np.uint16)
    product = np.empty_like(pair)
    sums = []
    for parts in ([weight & 255 for weight in weights], [weight >> 8 for weight in weights]):
        total = pair * np.uint16(parts[0])
        for channel, part in ((second, parts[1] - 256 * parts[0]), (third, parts[2])):
            np.multiply(channel, np.uint16(part & 0xffff), out=product)
            np.add(total, product, out=total)
        sums.append(total)
    low, high = sums
    low >>= np.uint16(8)
    high += low
    high += np.uint16(64)
    high >>= np.uint16(7)
    target[...] = high
