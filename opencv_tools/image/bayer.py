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

"""Demosaicing: conversion of Bayer patterns to gray, RGB and BGR, as OpenCV's cvtColor does."""

from __future__ import annotations

from dataclasses import dataclass, KW_ONLY
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.blocks import row_blocks, write_columns

# Weights of red, green and blue times 2**14, as in OpenCV's demosaicing to gray.
_GRAY_WEIGHTS = {'r': 4899, 'g': 9617, 'b': 1868}


def bayer_to_color(image: NDArray[Any], pattern: str, target: str) -> NDArray[Any]:
    """
    Convert a Bayer mosaic to colours or gray by bilinear interpolation.

    A missing colour is the mean of the nearest pixels that have this colour: ``(a + b + 1) >> 1``
    of two, ``(a + b + c + d + 2) >> 2`` of four. Gray is the weighted sum of the unrounded means.
    The first and last columns, then the first and last rows, are copies of their neighbours. In
    an image with fewer than 3 rows or columns all values are 0, also alpha.

    :param image: contiguous (h, w) array of uint8 or uint16 in native byte order.
    :param pattern: colours of the first two pixels of the first two rows, such as ``'rggb'``.
    :param target: channels in order: ``'y'``, ``'rgb'``, ``'bgr'``, ``'rgba'`` or ``'bgra'``.
    :returns: a new contiguous array of the same type: (h, w) for ``'y'``, (h, w, c) otherwise.
    """
    height, width = image.shape
    colors = np.empty((height, width, len(target)), image.dtype)
    if height < 3 or width < 3:
        colors[...] = 0
    else:
        # A quarter of the width, because each intermediate array has a quarter of the pixels.
        for rows in row_blocks(height - 2, width // 4):
            _fill_inner(image[rows.start:rows.stop + 2], colors[rows.start:rows.stop + 2],
                        pattern if rows.start % 2 == 0 else pattern[2:] + pattern[:2], target)
        colors[:, 0] = colors[:, 1]
        colors[:, -1] = colors[:, -2]
        colors[0] = colors[1]
        colors[-1] = colors[-2]
        if target.endswith('a'):
            colors[..., 3] = np.iinfo(image.dtype).max
    return colors[..., 0] if target == 'y' else colors


def _fill_inner(
    mosaic: NDArray[Any], colors: NDArray[Any], pattern: str, target: str,
) -> None:
    """
    Write the colours of all rows except the first and the last one.

    The first and last columns get meaningless values, which the caller overwrites.

    :param mosaic: (h, w) array with at least 3 rows and columns.
    :param colors: (h, w, c) output array.
    :param pattern: colours of the first two pixels of the first two rows of ``mosaic``.
    :param target: channels in order, as for ``bayer_to_color``.
    """
    rows = len(mosaic)
    fill = _fill_gray if target == 'y' else _fill_colors
    planes = [_split_columns(mosaic[parity::2]) for parity in (0, 1)]
    width = planes[0][0].shape[1]
    # The first even row has no odd row above it and is not filled. All odd rows have an even row
    # above them.
    for parity, count in ((0, (rows - 2) // 2), (1, (rows - 1) // 2)):
        colors_of_row = pattern[2 * parity:2 * parity + 2]
        present = colors_of_row.strip('g')
        missing = 'b' if present == 'r' else 'r'
        above_and_below = planes[1 - parity]
        vertical = [_flat(plane, 0, count) + _flat(plane, 1, count) for plane in above_and_below]
        filled = []
        for column, site in enumerate(colors_of_row):
            own, other = (_flat(planes[parity][index], 1 - parity, count)
                          for index in (column, 1 - column))
            values = fill(_Pixels(
                site, present, missing, own, across=_horizontal_sum(other, column),
                vertical=vertical[column],
                diagonal=_horizontal_sum(vertical[1 - column], column)), target)
            filled.append([value.reshape(count, width) for value in values])
        write_columns(filled, colors[2 - parity:-1:2])


def _split_columns(rows: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the even and the odd columns, of equal width, in a type that holds sums of four."""
    if rows.shape[1] % 2:
        rows = np.pad(rows, ((0, 0), (0, 1)))
    pairs = rows.view(f'<u{2 * rows.itemsize}')
    bits = pairs.dtype.type(8 * rows.itemsize)
    return pairs & pairs.dtype.type(np.iinfo(rows.dtype).max), pairs >> bits


def _flat(plane: NDArray[Any], first: int, count: int) -> NDArray[Any]:
    """
    Return consecutive rows of a plane as one flat array.

    Values of neighbouring rows then meet at the row ends only, in the first and last columns.
    """
    return plane[first:first + count].reshape(-1)


def _horizontal_sum(other: NDArray[Any], column: int) -> NDArray[Any]:
    """
    Return the sum of the left and the right neighbour of each pixel of some columns.

    :param other: flat values of the other columns, which contain these neighbours.
    :param column: 0 for sums of the even columns, 1 for sums of the odd columns.
    """
    total = np.empty_like(other)
    total[slice(1) if column == 0 else slice(-1, None)] = 0
    np.add(other[:-1], other[1:], out=total[1:] if column == 0 else total[:-1])
    return total


@dataclass(frozen=True)
class _Pixels:
    """
    The pixels with one colour of the mosaic, as flat arrays.

    :param site: colour of the pixels in the mosaic.
    :param present: the colour other than green in the rows of the pixels.
    :param missing: the colour that is missing in the rows of the pixels.
    :param own: values of the pixels.
    :param vertical: sums of the upper and lower neighbours.
    """

    site: str
    present: str
    missing: str
    own: NDArray[Any]
    _: KW_ONLY
    across: NDArray[Any]
    vertical: NDArray[Any]
    diagonal: NDArray[Any]


def _fill_colors(pixels: _Pixels, target: str) -> list[NDArray[Any]]:
    """Return the channels of a target, except alpha."""
    if pixels.site == 'g':
        means = {'g': pixels.own, pixels.present: _mean(pixels.across, 1),
                 pixels.missing: _mean(pixels.vertical, 1)}
    else:
        means = {pixels.site: pixels.own, 'g': _mean(pixels.across + pixels.vertical, 2),
                 pixels.missing: _mean(pixels.diagonal, 2)}
    return [means[channel] for channel in target[:3]]


def _fill_gray(pixels: _Pixels, _: str) -> list[NDArray[Any]]:
    """Return the gray, as the only channel."""
    site, own = pixels.site, pixels.own
    if site == 'g':
        shift = 15
        sums = {'g': own, pixels.present: pixels.across, pixels.missing: pixels.vertical}
    else:
        shift = 16
        sums = {site: own, 'g': pixels.across + pixels.vertical, pixels.missing: pixels.diagonal}
    # The pixel itself has the weight of two or four neighbours, because the others are sums.
    weights = {**_GRAY_WEIGHTS, site: _GRAY_WEIGHTS[site] << (shift - 14)}
    # Without dtype, numpy 1 chooses the type by value and multiplies in 16 bits.
    gray = np.multiply(own, np.uint32(weights[site]), dtype=np.uint32)
    gray += np.uint32(1 << (shift - 1))
    product = np.empty_like(gray)
    for channel in {*sums} - {site}:
        np.multiply(sums[channel], np.uint32(weights[channel]), out=product, dtype=np.uint32)
        np.add(gray, product, out=gray)
    np.right_shift(gray, np.uint32(shift), out=gray)
    return [gray.astype(own.dtype)]


def _mean(total: NDArray[Any], bits: int) -> NDArray[Any]:
    """Return sums divided by ``2**bits``, rounded half up."""
    mean: NDArray[Any] = total + total.dtype.type(1 << (bits - 1))
    np.right_shift(mean, mean.dtype.type(bits), out=mean)
    return mean
