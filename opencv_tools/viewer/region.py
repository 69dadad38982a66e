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

"""A part of an image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Region:
    """
    A part of an image in its pixels.

    :param x: first column.
    :param y: first row.
    """

    x: int
    y: int
    width: int
    height: int

    @property
    def values(self) -> tuple[int, int, int, int]:
        """First column, first row, width and height."""
        return self.x, self.y, self.width, self.height

    def crop(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return a view of this part of a (h, w) or (h, w, c) array."""
        return image[self.y:self.y + self.height, self.x:self.x + self.width]


def region_within(wanted: Region | None, width: int, height: int) -> Region:
    """
    Return the part of an image that a page gets.

    Its edges are even, because the colours of Bayer and YUV images repeat after two pixels.

    :param wanted: part that the page requests; None for the whole image.
    :param width: width of the image in pixels.
    :param height: height of the image in pixels.
    :returns: the part within the image; the whole image if the requested part is outside.
    """
    if wanted is None or wanted.x >= width or wanted.y >= height:
        return Region(x=0, y=0, width=width, height=height)
    left, top = wanted.x & ~1, wanted.y & ~1
    right = min(width, wanted.x + wanted.width + 1 & ~1)
    bottom = min(height, wanted.y + wanted.height + 1 & ~1)
    return Region(x=left, y=top, width=right - left, height=bottom - top)
