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

"""Blocks of rows: an image worked through in parts whose intermediate arrays stay in the cache."""

from __future__ import annotations

from collections.abc import Iterator

# A few arrays of 2 bytes a pixel stay in a megabyte of cache, and the half microsecond that every
# call of numpy takes is spread over enough pixels. Half or twice as many make little difference.
BLOCK_PIXELS = 80_000


def row_blocks(height: int, width: int) -> Iterator[slice]:
    """
    Cut an image into blocks of whole rows.

    :param height: rows of the image.
    :param width: pixels a row.
    :returns: slices of rows, from top to bottom.
    """
    rows = max(1, BLOCK_PIXELS // max(1, width))
    for first in range(0, height, rows):
        yield slice(first, min(first + rows, height))
