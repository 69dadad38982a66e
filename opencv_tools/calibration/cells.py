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

"""Cells of an image, in which corners are counted, and their places in words."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_CELLS = 8  # along the longer side
_ROWS = ('upper', '', 'lower')
_COLUMNS = ('left', '', 'right')


def cell_grid(size: tuple[int, int]) -> tuple[int, int]:
    """Return the rows and columns of the cells of an image of a width and a height."""
    columns, rows = (max(3, round(_CELLS * side / max(size))) for side in size)
    return rows, columns


def cells_of(
    positions: NDArray[Any], size: tuple[int, int],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows and columns of the cells of (n, 2) positions in pixels."""
    grid = np.array(cell_grid(size)[::-1])
    cells = np.clip(((positions + 0.5) * grid / np.array(size)).astype(np.int64), 0, grid - 1)
    return cells[:, 1], cells[:, 0]


def place_in_words(row: Any, column: Any, shape: tuple[int, ...]) -> str:
    """Return the place of a cell in words: ``upper left``, ``left`` or ``middle``."""
    words = [names[int((place + 0.5) / count * 3)]
             for names, place, count in zip((_ROWS, _COLUMNS), (row, column), shape)]
    return ' '.join(filter(None, words)) or 'middle'


def most_common_place(cells: NDArray[np.bool_]) -> str:
    """Return the part of the image with most of the selected cells, in words; '' for none."""
    places = [place_in_words(row, column, cells.shape) for row, column in zip(*np.nonzero(cells))]
    return max(dict.fromkeys(places), key=places.count, default='')
