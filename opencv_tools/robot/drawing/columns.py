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

"""Columns of texts beside a drawing, with lines to their points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from opencv_tools.robot.drawing.figure import size_of
from opencv_tools.robot.drawing.primitives import GREY, PALE, plain, Point, TEXT_COLOR

_LINE_GAP, _ENTRY_GAP = 0.03, 0.08  # inches


@dataclass(frozen=True)
class Entry:
    """A bold title and grey numbers for a point of the drawing."""

    title: str
    numbers: str
    point: Point
    on_left: bool = False


class Column:
    """A column of entries, each near the height of its point."""

    def __init__(self, axes: Any, entries: Sequence[Entry]) -> None:
        self._axes, self._points = axes, [entry.point for entry in entries]
        self._texts = [[axes.text(0, 0, plain(text), fontsize=8, color=color, va='top',
                                  fontweight=weight, linespacing=1.15)
                        for text, color, weight in ((entry.title, TEXT_COLOR, 'bold'),
                                                    (entry.numbers, GREY, 'normal')) if text]
                       for entry in entries]
        self._sizes = [[size_of(text) for text in texts] for texts in self._texts]
        self._heights = [sum(high for _, high in sizes) + _LINE_GAP for sizes in self._sizes]
        self.width = max((wide for sizes in self._sizes for wide, _ in sizes), default=0.0)
        self.height = sum(self._heights) + _ENTRY_GAP * len(self._heights)

    def lay_out(self, x: float, side: int, height: float, to_inches: Callable[[Point], Point]
                ) -> None:
        """
        Place the texts and draw their lines.

        :param x: edge of the column beside the drawing, in inches.
        :param side: -1 for a column left of the drawing, 1 for a column right of it.
        :param height: height of the drawing in inches.
        :param to_inches: returns the position of a point in inches.
        """
        points = [to_inches(point) for point in self._points]
        order = sorted(range(len(points)), key=lambda index: -points[index][1])
        middles = _spread([points[index][1] for index in order],
                          [self._heights[index] + _ENTRY_GAP for index in order], height)
        for index, middle in zip(order, middles):
            y = middle + self._heights[index] / 2
            for text, (_, high) in zip(self._texts[index], self._sizes[index]):
                text.set_position((x, y))
                text.set_horizontalalignment('left' if side > 0 else 'right')
                y -= high + _LINE_GAP
            self._axes.plot([x - side * 0.05, points[index][0]], [middle, points[index][1]],
                            color=PALE, lw=0.7, zorder=3)


def _spread(targets: Sequence[float], heights: Sequence[float], top: float) -> list[float]:
    """Return the middles of boxes that do not overlap, near their targets, from top to bottom."""
    middles: list[float] = []
    for middle, height in zip(targets, heights):
        middles.append(min(middle, top - height / 2))
        top = middles[-1] - height / 2
    bottom = 0.0
    for index in reversed(range(len(middles))):
        middles[index] = max(middles[index], bottom + heights[index] / 2)
        bottom = middles[index] + heights[index] / 2
    return middles
