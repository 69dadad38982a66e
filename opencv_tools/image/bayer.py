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

"""Image mosaics: bayer patterns turned into gray, RGB and BGR, as OpenCV's cvtColor does it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.blocks import row_blocks
from opencv_tools.image.columns import write_columns

# Weights of red, green and blue, scaled by 2**14 as OpenCV's demosaicing to gray has them.
_GRAY_WEIGHTS = {'r': 4899, 'g': 9617, 'b': 1868}


def bayer_to_color(image: NDArray[Any], pattern: str, target: str) -> NDArray[Any]:
    """
    Fill in the colours that a mosaic lacks, each from the nearest pixels that have it.

    Where two neighbours have it, the mean ``(a + b + 1) >> 1``; where four have it, the mean
    ``(a + b + c + d + 2) >> 2``. Gray weighs the sums before they are rounded. The outermost
    columns, then the outermost rows, are those beside them; in an image that is nothing but
    outermost ones everything is 0, alpha too.

    :param image: contiguous (h, w) array of uint8 or uint16 in native byte order.
    :param pattern: colours of the first two rows' first two pixels, such as ``'rggb'``.
    :param target: channels in order: ``'y'``, ``'rgb'``, ``'bgr'``, ``'rgba'`` or ``'bgra'``.
    :returns: a fresh contiguous array of the same type, (h, w) for ``'y'``.
    """
    height, width = image.shape
    colors = np.empty((height, width, len(target)), image.dtype)
    if height < 3 or width < 3:
        colors[...] = 0
    else:
        for rows in row_blocks(height - 2, width // 4):  # each array has a quarter of the pixels
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
    Fill in all but the outermost rows; what the outermost columns get is of no use.

    :param mosaic: (h, w) array, both at least 3.
    :param colors: (h, w, c) array, written to.
    """
    rows = len(mosaic)
    fill = _fill_gray if target == 'y' else _fill_colors
    planes = [_split_columns(mosaic[parity::2]) for parity in (0, 1)]
    width = planes[0][0].shape[1]
    # Even rows stand between two odd ones from the second on, odd rows from the first.
    for parity, count in ((0, (rows - 2) // 2), (1, (rows - 1) // 2)):
        colors_of_row = pattern[2 * parity:2 * parity + 2]
        present = colors_of_row.strip('g')
        lacking = 'b' if present == 'r' else 'r'
        above_and_below = planes[1 - parity]
        vertical = [_flat(plane, 0, count) + _flat(plane, 1, count) for plane in above_and_below]
        filled = []
        for column, site in enumerate(colors_of_row):
            own, other = (_flat(planes[parity][index], 1 - parity, count)
                          for index in (column, 1 - column))
            values = fill(site, present, lacking, target, own, _beside(other, column),
                          vertical[column], _beside(vertical[1 - column], column))
            filled.append([value.reshape(count, width) for value in values])
        write_columns(filled, colors[2 - parity:-1:2])


def _split_columns(rows: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Give the even and the odd columns, of equal width, as integers that hold sums of four."""
    if rows.shape[1] % 2:
        rows = np.pad(rows, ((0, 0), (0, 1)))
    pairs = rows.view(f'<u{2 * rows.itemsize}')
    bits = pairs.dtype.type(8 * rows.itemsize)
    return pairs & pairs.dtype.type(np.iinfo(rows.dtype).max), pairs >> bits


def _flat(plane: NDArray[Any], first: int, count: int) -> NDArray[Any]:
    """Give some rows of a plane as one: that a row's ends touch matters to no inner column."""
    return plane[first:first + count].reshape(-1)


def _beside(other: NDArray[Any], column: int) -> NDArray[Any]:
    """Add the left and the right neighbours, which stand in the other columns."""
    total = np.empty_like(other)
    total[slice(1) if column == 0 else slice(-1, None)] = 0
    np.add(other[:-1], other[1:], out=total[1:] if column == 0 else total[:-1])
    return total


def _fill_colors(
    site: str, present: str, lacking: str, target: str,
    own: NDArray[Any], across: NDArray[Any], vertical: NDArray[Any], diagonal: NDArray[Any],
) -> list[NDArray[Any]]:
    """Give the three colours of pixels whose own colour is ``site``."""
    if site == 'g':
        means = {'g': own, present: _mean(across, 1), lacking: _mean(vertical, 1)}
    else:
        means = {site: own, 'g': _mean(across + vertical, 2), lacking: _mean(diagonal, 2)}
    return [means[channel] for channel in target[:3]]


def _fill_gray(
    site: str, present: str, lacking: str, _: str,
    own: NDArray[Any], across: NDArray[Any], vertical: NDArray[Any], diagonal: NDArray[Any],
) -> list[NDArray[Any]]:
    """Give the gray of pixels whose own colour is ``site``, from sums not yet rounded."""
    if site == 'g':
        shift = 15
        sums = {'g': own, present: across, lacking: vertical}
    else:
        shift = 16
        sums = {site: own, 'g': across + vertical, lacking: diagonal}
    # The pixel's own colour counts as often as the two or four neighbours of another.
    weights = {**_GRAY_WEIGHTS, site: _GRAY_WEIGHTS[site] << (shift - 14)}
    # Without dtype numpy 1 looks at the numbers and multiplies in 16 bits.
    gray = np.multiply(own, np.uint32(weights[site]), dtype=np.uint32)
    gray += np.uint32(1 << (shift - 1))
    product = np.empty_like(gray)
    for channel in {*sums} - {site}:
        np.multiply(sums[channel], np.uint32(weights[channel]), out=product, dtype=np.uint32)
        np.add(gray, product, out=gray)
    np.right_shift(gray, np.uint32(shift), out=gray)
    return [gray.astype(own.dtype)]


def _mean(total: NDArray[Any], bits: int) -> NDArray[Any]:
    """Divide by a power of two, rounding half up."""
    mean: NDArray[Any] = total + total.dtype.type(1 << (bits - 1))
    np.right_shift(mean, mean.dtype.type(bits), out=mean)
    return mean
