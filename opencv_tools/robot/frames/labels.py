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

"""Texts in a picture that neither lie on one another nor leave the picture."""

from __future__ import annotations

from collections.abc import Iterator
import math
from typing import Any

from opencv_tools.robot.frames.drawing import matplotlib_module, PALE, plain, Point

Rectangle = tuple[float, float, float, float]  # left, bottom, right, top, in pixels

# Places of a label near its point, the best first: the distance in points, and the angle.
_PLACES = [(distance, math.radians(angle)) for distance in (8, 14, 22, 34, 50, 72, 100, 140)
           for angle in (25, -25, 155, 205, 60, -60, 120, 240, 90, 270)]
_ROOM = 5.0  # pixels between two texts in a row
_NEAR = 14  # points up to which no line leads from a label to its point


class Labels:
    """Texts beside points of a picture, each where nothing else is."""

    def __init__(self, axes: Any, bounds: Rectangle | None = None) -> None:
        """
        Begin with nothing in the way.

        :param axes: with its limits set, in a figure that has been laid out once.
        :param bounds: of all labels; those of the axes where none are given.
        """
        view = axes.bbox
        self._axes = axes
        self._bounds = bounds or (view.x0, view.y0, view.x1, view.y1)
        self._renderer = axes.figure.canvas.get_renderer()
        self._scale = axes.figure.dpi / 72
        self._lines: list[Rectangle] = []
        self._texts: list[Rectangle] = []

    def avoid(self, start: Point, end: Point) -> None:
        """Keep labels off a line, where there is room."""
        (a, b), (c, d) = self._axes.transData.transform([start, end])
        steps = max(1, int(math.hypot(c - a, d - b) / (8 * self._scale)))
        margin = 1.5 * self._scale
        for step in range(steps + 1):
            x, y = a + (c - a) * step / steps, b + (d - b) * step / steps
            self._lines.append((x - margin, y - margin, x + margin, y + margin))

    def avoid_text(self, text: Any) -> None:
        """Keep labels off another text."""
        self._texts.append(self._box(text))

    def place_if_free(self, text: str, point: Point, offset: Point, **style: Any) -> None:
        """Write a text in the middle of one place, but not on another text."""
        label = self._axes.annotate(
            plain(text), point, xytext=offset, textcoords='offset points', ha='center',
            va='center', annotation_clip=False, **style)
        label.update_positions(self._renderer)
        place = self._box(label)
        if self._covered(place):
            label.remove()
        else:
            self._texts.append(place)

    def place(self, text: str, point: Point, **style: Any) -> None:
        """Write a text as near to a point as there is room, with a line to it if it is far."""
        label = self._axes.annotate(
            plain(text), point, xytext=(0, 0), textcoords='offset points', va='center',
            annotation_clip=False, zorder=20, bbox={
                'facecolor': 'white', 'edgecolor': 'none', 'alpha': 0.6, 'pad': 0.5}, **style)
        box = matplotlib_module('text').Text.get_window_extent(label, self._renderer)
        x, y = self._axes.transData.transform(point)
        choices = [self._beside(x, y, distance, angle, box.width, box.height)
                   for distance, angle in _PLACES]
        free = [index for index, choice in enumerate(choices)
                if not self._covered(choice) and not self._outside(choice)]
        costs = {index: sum(_common(choices[index], line) for line in self._lines)
                 for index in free}
        if free:
            best = min(free, key=costs.__getitem__)
            distance, angle = _PLACES[best]
            place = choices[best]
            position = (distance * math.cos(angle), distance * math.sin(angle))
            left = math.cos(angle) > -1e-9
        else:
            place = min(self._everywhere(box.width, box.height), default=choices[0], key=(
                lambda one: (self._covered(one), math.hypot(
                    max(one[0] - x, 0.0, x - one[2]), (one[1] + one[3]) / 2 - y))))
            left = place[0] + place[2] > 2 * x
            position = ((place[0 if left else 2] - x) / self._scale,
                        ((place[1] + place[3]) / 2 - y) / self._scale)
        label.set_position(position)
        label.set_horizontalalignment('left' if left else 'right')
        self._texts.append(place)
        if math.hypot(*position) > _NEAR + 1e-9:
            self._axes.annotate(
                '', point, xytext=position, textcoords='offset points',
                annotation_clip=False, zorder=19,
                arrowprops={'arrowstyle': '-', 'color': PALE, 'lw': 0.7, 'shrinkA': 0})

    def _box(self, text: Any) -> Rectangle:
        # Without the line to its point, which an annotation would add.
        box = matplotlib_module('text').Text.get_window_extent(text, self._renderer)
        return box.x0, box.y0, box.x1, box.y1

    def _beside(self, x: float, y: float, distance: float, angle: float, width: float,
                height: float) -> Rectangle:
        left = x + distance * self._scale * math.cos(angle)
        middle = y + distance * self._scale * math.sin(angle)
        if math.cos(angle) <= -1e-9:
            left -= width
        return left, middle - height / 2, left + width, middle + height / 2

    def _everywhere(self, width: float, height: float) -> Iterator[Rectangle]:
        """Return places in all of the picture, in steps of half a label."""
        left, bottom, right, top = self._bounds
        for row in range(int(2 * (top - bottom) / height) - 1):
            y = bottom + row * height / 2
            for column in range(int(4 * (right - left) / width) - 3):
                x = left + column * width / 4
                yield x, y, x + width, y + height

    def _covered(self, box: Rectangle) -> float:
        """Return the area that a label and some room beside it share with other texts."""
        wide = (box[0] - _ROOM, box[1], box[2] + _ROOM, box[3])
        return sum(_common(wide, other) for other in self._texts)

    def _outside(self, box: Rectangle) -> bool:
        left, bottom, right, top = self._bounds
        return box[0] < left or box[1] < bottom or box[2] > right or box[3] > top


def _common(one: Rectangle, other: Rectangle) -> float:
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    return width * height if width > 0 and height > 0 else 0.0
