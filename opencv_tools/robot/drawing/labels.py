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

"""Labels of points in a picture that do not overlap, near their points or in columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from typing import Any

from opencv_tools.robot.drawing.figure import matplotlib_module, size_of, text_box
from opencv_tools.robot.drawing.primitives import GREY, PALE, plain, Point, TEXT_COLOR

# Positions of a label relative to its point, the best first: distance in points, and angle.
_POSITIONS = [(distance, math.radians(angle))
              for distance in (8, 14, 22, 34, 50, 72, 100, 140, 200, 280, 400)
              for angle in (25, -25, 155, 205, 60, -60, 120, 240, 90, 270)]
_GAP = 5.0  # pixels between two texts in a row
_LINE_GAP, _ENTRY_GAP = 0.03, 0.08  # inches, in a column
_NEAR = 14  # greatest distance in points without a line from the label to its point


class Labels:
    """Labels of points in axes, each beside other texts and if possible beside lines."""

    def __init__(self, axes: Any, bounds: Any = None) -> None:
        """
        Create an empty set of labels.

        :param axes: axes with final limits, in a figure that has been laid out.
        :param bounds: bounding box of all labels in pixels; by default that of the axes.
        """
        self._axes = axes
        self._bounds = bounds or axes.bbox
        self._scale = axes.figure.dpi / 72
        self._line_points: list[Point] = []
        self._texts: list[Any] = []

    def avoid_line(self, start: Point, end: Point) -> None:
        """Keep labels off a line if possible."""
        (a, b), (c, d) = self._axes.transData.transform([start, end])
        steps = max(1, int(math.hypot(c - a, d - b) / (4 * self._scale)))
        self._line_points += [(a + (c - a) * step / steps, b + (d - b) * step / steps)
                              for step in range(steps + 1)]

    def avoid_text(self, text: Any) -> None:
        """Keep labels off another text."""
        self._texts.append(text_box(text))

    def place_if_free(self, text: str, point: Point, offset: Point, **style: Any) -> None:
        """Write a label at an offset in points, unless it would overlap another text."""
        label = self._axes.annotate(
            plain(text), point, xytext=offset, textcoords='offset points', ha='center',
            va='center', annotation_clip=False, **style)
        label.update_positions(self._axes.figure.canvas.get_renderer())
        box = text_box(label)
        if self._overlaps(box):
            label.remove()
        else:
            self._texts.append(box)

    def place(self, text: str, point: Point, **style: Any) -> None:
        """Write a label near a point, with a line to the point if it is not close."""
        label = self._axes.annotate(
            plain(text), point, xytext=(0, 0), textcoords='offset points', va='center',
            annotation_clip=False, zorder=20, bbox={
                'facecolor': 'white', 'edgecolor': 'none', 'alpha': 0.6, 'pad': 0.5}, **style)
        size = text_box(label)
        distance, angle = min(_POSITIONS, key=lambda position: self._cost(
            self._box(point, position, size.width, size.height)))
        self._texts.append(self._box(point, (distance, angle), size.width, size.height))
        offset = (distance * math.cos(angle), distance * math.sin(angle))
        label.set_position(offset)
        label.set_horizontalalignment(_alignment(angle))
        if distance > _NEAR:
            self._axes.annotate(
                '', point, xytext=offset, textcoords='offset points', annotation_clip=False,
                zorder=19, arrowprops={'arrowstyle': '-', 'color': PALE, 'lw': 0.7, 'shrinkA': 0})

    def _box(self, point: Point, position: tuple[float, float], width: float, height: float
             ) -> Any:
        (x, y), (distance, angle) = self._axes.transData.transform(point), position
        left = x + distance * self._scale * math.cos(angle)
        middle = y + distance * self._scale * math.sin(angle)
        if _alignment(angle) == 'right':
            left -= width
        return matplotlib_module('transforms').Bbox.from_bounds(
            left, middle - height / 2, width, height)

    def _cost(self, box: Any) -> tuple[bool, int, int]:
        """Return what a position covers; `min` prefers the first of equal positions."""
        bounds = self._bounds
        outside = not (bounds.x0 <= box.x0 and box.x1 <= bounds.x1
                       and bounds.y0 <= box.y0 and box.y1 <= bounds.y1)
        return (outside, self._overlaps(box),
                box.padded(1.5 * self._scale).count_contains(self._line_points))

    def _overlaps(self, box: Any) -> int:
        wide = matplotlib_module('transforms').Bbox.from_extents(
            box.x0 - _GAP, box.y0, box.x1 + _GAP, box.y1)
        return int(wide.count_overlaps(self._texts))


def _alignment(angle: float) -> str:
    return 'left' if math.cos(angle) > -1e-9 else 'right'


@dataclass(frozen=True)
class Entry:
    """
    A bold title and grey numbers for a point of the drawing.

    :param rank: entries with a lower rank remain if there is no room for all.
    """

    title: str
    numbers: str
    point: Point
    on_left: bool = False
    rank: int = 0


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
