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

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

from opencv_tools.robot.drawing.figure import matplotlib_module, size_of, text_box
from opencv_tools.robot.drawing.primitives import GREY, PALE, plain, Point, TEXT_COLOR

# Offsets of a label from its point in points: ten directions, then the same further away.
_OFFSETS = [(distance * math.cos(math.radians(angle)), distance * math.sin(math.radians(angle)))
            for distance in (8, 14, 22, 34, 50, 72, 100, 140, 200, 280, 400)
            for angle in (25, -25, 155, 205, 60, -60, 120, 240, 90, 270)]
_GAP = 5.0  # pixels between two texts in a row
_LINE_GAP, _ENTRY_GAP = 0.03, 0.08  # inches, in a column
_NEAR = 14.5  # distance in points; labels further away have a line to their point


class Labels:
    """
    Labels of points in axes, each beside other texts and if possible beside lines.

    :param axes: axes with final limits, in a figure that has been laid out.
    :param bounds: bounding box of all labels in pixels; by default that of the axes.
    """

    def __init__(self, axes: Any, bounds: Any = None) -> None:
        self._axes = axes
        self._bounds = bounds or axes.bbox
        self._scale = axes.figure.dpi / 72
        self._lines: list[Any] = []
        self._texts: list[Any] = []

    def avoid_line(self, *points: Point) -> None:
        """Keep labels off a line if possible."""
        self._lines.append(matplotlib_module('path').Path(self._axes.transData.transform(points)))

    def avoid_text(self, text: Any) -> None:
        """Keep labels off another text."""
        self._texts.append(text_box(text))

    def place_if_free(self, text: str, point: Point, offset: Point, **style: Any) -> None:
        """Write a label at an offset in points, unless it would overlap another text."""
        label = self._annotate(text, point, offset, ha='center', **style)
        box = text_box(label)
        if self._overlaps(box):
            label.remove()
        else:
            self._texts.append(box)

    def place(self, text: str, point: Point, **style: Any) -> None:
        """
        Write a label at the first free position near a point, with a line if it is not close.

        A position is free within the bounds, beside texts and beside lines. If there is none, the
        label covers lines, then texts, and only at last it reaches beyond the bounds.
        """
        label = self._annotate(text, point, _OFFSETS[0], zorder=20, bbox={
            'facecolor': 'white', 'edgecolor': 'none', 'alpha': 0.6, 'pad': 0.5}, **style)
        boxes = {offset: _move(label, offset) for offset in _OFFSETS}
        inside = [offset for offset, box in boxes.items() if self._is_inside(box)] or _OFFSETS
        apart = [offset for offset in inside if not self._overlaps(boxes[offset])] or inside
        offset = next((offset for offset in apart if not self._covers_line(boxes[offset])),
                      apart[0])
        self._texts.append(_move(label, offset))
        if math.hypot(*offset) > _NEAR:
            self._annotate('', point, offset, zorder=19, arrowprops={
                'arrowstyle': '-', 'color': PALE, 'lw': 0.7, 'shrinkA': 0})

    def _annotate(self, text: str, point: Point, offset: Point, **style: Any) -> Any:
        label = self._axes.annotate(plain(text), point, offset, textcoords='offset points',
                                    va='center', annotation_clip=False, **style)
        label.update_positions(self._axes.figure.canvas.get_renderer())
        return label

    def _is_inside(self, box: Any) -> bool:
        return all(self._bounds.contains(*corner) for corner in (box.p0, box.p1))

    def _covers_line(self, box: Any) -> bool:
        wide = box.padded(1.5 * self._scale)
        return any(line.intersects_bbox(wide, filled=False) for line in self._lines)

    def _overlaps(self, box: Any) -> bool:
        wide = matplotlib_module('transforms').Bbox.from_extents(
            box.x0 - _GAP, box.y0, box.x1 + _GAP, box.y1)
        return bool(wide.count_overlaps(self._texts))


def _move(label: Any, offset: Point) -> Any:
    """Move a label to an offset from its point, and return its bounding box in pixels."""
    label.set_position(offset)
    label.set_horizontalalignment('left' if offset[0] > -1e-9 else 'right')
    return text_box(label)


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
        self._axes = axes
        self._entries = sorted(entries, key=lambda entry: -entry.point[1])
        self._texts = [[axes.text(0, 0, plain(text), fontsize=8, color=color, va='top',
                                  fontweight=weight, linespacing=1.15)
                        for text, color, weight in ((entry.title, TEXT_COLOR, 'bold'),
                                                    (entry.numbers, GREY, 'normal')) if text]
                       for entry in self._entries]
        self._sizes = [[size_of(text) for text in texts] for texts in self._texts]
        self._heights = [sum(high for _, high in sizes) + _LINE_GAP for sizes in self._sizes]
        self.width = max((wide for sizes in self._sizes for wide, _ in sizes), default=0.0)
        self.height = sum(self._heights) + _ENTRY_GAP * len(self._heights)

    def lay_out(self, x: float, side: int, ends: Point, scale: float) -> None:
        """
        Place the texts and draw their lines.

        :param side: -1 for a column left of the drawing, 1 for a column right of it.
        :param scale: inches for each unit of the axes.
        """
        middles = _spread([entry.point[1] for entry in self._entries],
                          [(height + _ENTRY_GAP) / scale for height in self._heights], *ends)
        for index, (entry, middle) in enumerate(zip(self._entries, middles)):
            y = middle + self._heights[index] / 2 / scale
            for text, (_, high) in zip(self._texts[index], self._sizes[index]):
                text.set_position((x, y))
                text.set_horizontalalignment('left' if side > 0 else 'right')
                y -= (high + _LINE_GAP) / scale
            self._axes.plot([x - side * 0.05 / scale, entry.point[0]], [middle, entry.point[1]],
                            color=PALE, lw=0.7, zorder=3)


def _spread(targets: Sequence[float], heights: Sequence[float], bottom: float, top: float
            ) -> list[float]:
    """Return the middles of boxes that do not overlap, near their targets, from top to bottom."""
    middles: list[float] = []
    for middle, height in zip(targets, heights):
        middles.append(min(middle, top - height / 2))
        top = middles[-1] - height / 2
    for index in reversed(range(len(middles))):
        middles[index] = max(middles[index], bottom + heights[index] / 2)
        bottom = middles[index] + heights[index] / 2
    return middles
