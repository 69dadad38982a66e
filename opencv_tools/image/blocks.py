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

"""Division of an image into blocks of rows, so that intermediate arrays fit into the cache."""

from __future__ import annotations

from collections.abc import Iterator

# A few arrays with 2 bytes per pixel fit into 1 MB of cache. Each numpy call costs only 0.5
# microseconds. Half or twice as many pixels make little difference.
BLOCK_PIXELS = 80_000


def row_blocks(height: int, width: int) -> Iterator[slice]:
    """
    Divide an image into blocks of whole rows.

    :param height: number of rows.
    :param width: number of pixels in a row.
    :returns: slices of rows, from top to bottom.
    """
    rows = max(1, BLOCK_PIXELS // max(1, width))
    for first in range(0, height, rows):
        yield slice(first, min(first + rows, height))
