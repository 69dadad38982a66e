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

"""Columns of texts beside a drawing, each with a line to its point."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from opencv_tools.robot.frames.drawing import DARK, GREY, PALE, plain, Point
from opencv_tools.robot.frames.figures import size_of


@dataclass(frozen=True)
class Entry:
    """A text in a column beside the drawing, with a line to its point."""

    title: str
    numbers: str
    point: Point
    on_left: bool = False


class Column:
    """Texts one above the other beside a drawing, each near the height of its point."""

    def __init__(self, axes: Any, entries: Sequence[Entry]) -> None:
        self._axes, self._points = axes, [entry.point for entry in entries]
        self._texts = [[axes.text(0, 0, plain(text), fontsize=8, color=color, va='top',
                                  fontweight=weight, linespacing=1.15)
                        for text, color, weight in ((entry.title, DARK, 'bold'),
                                                    (entry.numbers, GREY, 'normal')) if text]
                       for entry in entries]
        self._sizes = [[size_of(text) for text in texts] for texts in self._texts]
        self._heights = [sum(high for _, high in sizes) + 0.03 for sizes in self._sizes]
        self.width = max((wide for sizes in self._sizes for wide, _ in sizes), default=0.0)
        self.height = sum(self._heights) + 0.08 * len(self._heights)

    def lay_out(self, x: float, side: int, height: float, at: Callable[[Point], Point]) -> None:
        """
        Place the texts, and draw a line from each to its point.

        :param x: where the column begins, in inches, on the side of the drawing.
        :param side: -1 for a column on the left of the drawing, 1 for one on its right.
        :param at: returns the place of a point in inches.
        """
        spots = [at(point) for point in self._points]
        order = sorted(range(len(spots)), key=lambda index: -spots[index][1])
        tops = _spread([spots[index][1] for index in order],
                       [self._heights[index] + 0.08 for index in order], height)
        for index, middle in zip(order, tops):
            y = middle + self._heights[index] / 2
            for text, (_, high) in zip(self._texts[index], self._sizes[index]):
                text.set_position((x, y))
                text.set_horizontalalignment('left' if side > 0 else 'right')
                y -= high + 0.03
            self._axes.plot([x - side * 0.05, spots[index][0]], [middle, spots[index][1]],
                            color=PALE, lw=0.7, zorder=3)


def _spread(wanted: Sequence[float], heights: Sequence[float], top: float) -> list[float]:
    """Return middles near the wanted ones, from top to bottom, of boxes that do not overlap."""
    middles: list[float] = []
    for middle, height in zip(wanted, heights):
        middles.append(min(middle, top - height / 2))
        top = middles[-1] - height / 2
    bottom = 0.0
    for index in reversed(range(len(middles))):
        middles[index] = max(middles[index], bottom + heights[index] / 2)
        bottom = middles[index] + heights[index] / 2
    return middles
