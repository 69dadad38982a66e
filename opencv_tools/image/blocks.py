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

"""Parts of an image: blocks of rows that fit into the cache, and even and odd columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

# A few arrays with 2 bytes per pixel fit into 1 MB of cache. Each numpy call costs only 0.5
# microseconds. Half or twice as many pixels make little difference.
BLOCK_PIXELS = 80_000


def row_blocks(height: int, width: int) -> Iterator[slice]:
    """
    Divide an image into blocks of whole rows.

    :param width: number of pixels in a row.
    :returns: slices of rows, from top to bottom.
    """
    rows = max(1, BLOCK_PIXELS // max(1, width))
    for first in range(0, height, rows):
        yield slice(first, min(first + rows, height))


def write_columns(
    values: Sequence[Sequence[NDArray[Any]] | NDArray[Any]], target: NDArray[Any],
) -> None:
    """
    Write the channels of all columns, or of the even and the odd columns.

    Pairs of bytes are written as one word, which takes half the time of single bytes.

    :param values: one item for all columns, or one for the even and one for the odd columns. An
        item has an (h, n) array of integers for each channel. The values must fit the type of
        ``target``; columns beyond its width are ignored.
    :param target: (h, w, c) output array with contiguous rows; channels beyond those of
        ``values`` are not changed.
    """
    channels = len(values[0])
    even_and_odd = len(values) == 2 and not target.shape[1] % 2
    if not even_and_odd or channels != target.shape[2] or target.dtype != np.uint8:
        for first, planes in enumerate(values):
            columns = target[:, first::len(values)]
            for index, plane in enumerate(planes):
                columns[..., index] = plane[:, :columns.shape[1]]
        return
    rows, width, _ = target.shape
    words = target.reshape(rows, width * channels).view('<u2').reshape(rows, width // 2, channels)
    planes = [*values[0], *values[1]]
    for index, (low, high) in enumerate(zip(planes[::2], planes[1::2])):
        word = high << high.dtype.type(8)
        np.bitwise_or(word, low, out=word)
        words[..., index] = word
