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

"""What the pictures of a robot are made of: outlines of shapes, and labels that do not collide."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib import import_module
import math
from typing import Any

from opencv_tools.robot.pose import Transform, Vector, ZERO
from opencv_tools.robot.shapes import Box, Capsule, Cylinder, Geometry, Sphere
from opencv_tools.robot.xml import DescriptionError

Point = tuple[float, float]
_Rectangle = tuple[float, float, float, float]  # left, bottom, right, top

AXIS_COLORS = ('#d62728', '#2ca02c', '#1f5fd6')  # x, y, z
UNITS: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
DARK, GREY, PALE = '#222222', '#777777', '#bbbbbb'
SHAPE_COLORS = {'visual': '#7a5fb5', 'collision': '#e08a1e'}

_TURN = [2 * math.pi * step / 24 for step in range(25)]
# Where a label may stand, nearest first: how far from its point, in points, and at which angle.
_PLACES = [(distance, math.radians(angle)) for distance in (8, 14, 22, 34, 50, 72, 100, 140)
           for angle in (25, -25, 155, 205, 60, -60, 120, 240, 90, 270)]


def matplotlib_module(name: str = '') -> Any:
    """
    Import a module of matplotlib, which nothing but pictures needs.

    :raises DescriptionError: it is not installed.
    """
    return _module(f'matplotlib.{name}' if name else 'matplotlib')


def toolkit_module(name: str) -> Any:
    """Import a module of what draws in three dimensions, as `matplotlib_module` does."""
    return _module(f'mpl_toolkits.mplot3d.{name}')


def _module(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as err:
        raise DescriptionError('a picture needs matplotlib; `pip install matplotlib` or `sudo apt '
                               'install python3-matplotlib`') from err


def plain(text: str) -> str:
    """Write a text so that matplotlib reads no formula in it."""
    return text.replace('$', r'\$')


def outline(geometry: Geometry | None) -> list[list[Vector]]:
    """Give lines that show a shape, in its own frame; none for those whose size is not known."""
    if isinstance(geometry, Box):
        x, y, z = (length / 2 for length in geometry.size)
        faces = [[(a, b, c) for a, b in ((-x, -y), (x, -y), (x, y), (-x, y), (-x, -y))]
                 for c in (-z, z)]
        return [*faces, *([low, high] for low, high in zip(*faces))]
    if isinstance(geometry, Sphere):
        return _rings(geometry.radius, (0.0,)) + _arcs(geometry.radius, 0.0, 0.0)
    if isinstance(geometry, (Cylinder, Capsule)):
        half, radius = geometry.length / 2, geometry.radius
        lines = _rings(radius, (-half, half)) + [
            [(a, b, -half), (a, b, half)]
            for a, b in ((radius, 0.0), (0.0, radius), (-radius, 0.0), (0.0, -radius))]
        return lines + (_arcs(radius, -half, half) if isinstance(geometry, Capsule) else [])
    return []


def _rings(radius: float, heights: Iterable[float]) -> list[list[Vector]]:
    return [[(radius * math.cos(angle), radius * math.sin(angle), height) for angle in _TURN]
            for height in heights]


def _arcs(radius: float, low: float, high: float) -> list[list[Vector]]:
    """Give two great circles through the poles, their halves apart from each other."""
    circle = [(radius * math.cos(angle), radius * math.sin(angle)) for angle in _TURN]
    return [[(a, 0.0, c + (high if c >= 0 else low)) for a, c in circle],
            [(0.0, a, c + (high if c >= 0 else low)) for a, c in circle]]


def moved(lines: Iterable[Iterable[Vector]], transform: Transform) -> list[list[Vector]]:
    """Move lines in space."""
    return [[transform.apply(point) for point in line] for line in lines]


def hull(points: Iterable[Point]) -> list[Point]:
    """Give the convex polygon round points, against the clock (Andrew's monotone chain)."""
    ordered = sorted(set(points))
    halves = []
    for some in (ordered, ordered[::-1]):
        half: list[Point] = []
        for point in some:
            while len(half) > 1 and _turn(half[-2], half[-1], point) <= 0:
                half.pop()
            half.append(point)
        halves.append(half[:-1])
    return halves[0] + halves[1] or ordered


def _turn(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def reach(points: Sequence[Vector], least: float) -> tuple[Vector, Vector]:
    """Give the middle of points and how far they are from it along each axis."""
    columns = list(zip(*(points or [ZERO])))
    x, y, z = ((min(column) + max(column)) / 2 for column in columns)
    a, b, c = (max((max(column) - min(column)) / 2, least) for column in columns)
    return (x, y, z), (a, b, c)


class Labels:
    """Texts beside points of a picture, each where nothing else is."""

    def __init__(self, axes: Any) -> None:
        """
        Begin with nothing in the way.

        :param axes: with its limits set, in a figure that has been laid out once.
        """
        self._axes = axes
        self._renderer = axes.figure.canvas.get_renderer()
        self._scale = axes.figure.dpi / 72
        self._taken: list[_Rectangle] = []

    def avoid(self, start: Point, end: Point) -> None:
        """Keep labels off a line."""
        (a, b), (c, d) = self._axes.transData.transform([start, end])
        steps = max(1, int(math.hypot(c - a, d - b) / (8 * self._scale)))
        margin = 1.5 * self._scale
        for step in range(steps + 1):
            x, y = a + (c - a) * step / steps, b + (d - b) * step / steps
            self._taken.append((x - margin, y - margin, x + margin, y + margin))

    def avoid_text(self, text: Any) -> None:
        """Keep labels off another text."""
        box = text.get_window_extent(self._renderer)
        self._taken.append((box.x0, box.y0, box.x1, box.y1))

    def place(self, text: str, point: Point, **style: Any) -> None:
        """Write a text as near to a point as there is room, with a line to it if it is far."""
        label = self._axes.annotate(
            plain(text), point, xytext=(0, 0), textcoords='offset points', va='center',
            annotation_clip=False, zorder=20, bbox={
                'facecolor': 'white', 'edgecolor': 'none', 'alpha': 0.6, 'pad': 0.5}, **style)
        # Without the line to its point, which is what an annotation itself would add.
        box = matplotlib_module('text').Text.get_window_extent(label, self._renderer)
        x, y = self._axes.transData.transform(point)
        choices = [self._rectangle(x, y, distance, angle, box.width, box.height)
                   for distance, angle in _PLACES]
        costs = [sum(_common(choice, other) for other in self._taken) + self._outside(choice)
                 for choice in choices]
        best = min(range(len(choices)), key=costs.__getitem__)
        distance, angle = _PLACES[best]
        label.set_position((distance * math.cos(angle), distance * math.sin(angle)))
        label.set_horizontalalignment('left' if math.cos(angle) > -1e-9 else 'right')
        self._taken.append(choices[best])
        if distance > 14:
            self._axes.annotate(
                '', point, xytext=label.get_position(), textcoords='offset points',
                annotation_clip=False, zorder=19,
                arrowprops={'arrowstyle': '-', 'color': PALE, 'lw': 0.7, 'shrinkA': 0})

    def _rectangle(self, x: float, y: float, distance: float, angle: float, width: float,
                   height: float) -> _Rectangle:
        left = x + distance * self._scale * math.cos(angle)
        middle = y + distance * self._scale * math.sin(angle)
        if math.cos(angle) <= -1e-9:
            left -= width
        return left, middle - height / 2, left + width, middle + height / 2

    def _outside(self, box: _Rectangle) -> float:
        """Tell how much of a label is out of the picture; that is worse than over a line."""
        view = self._axes.bbox
        area = (box[2] - box[0]) * (box[3] - box[1])
        return 3 * (area - _common(box, (view.x0, view.y0, view.x1, view.y1)))


def _common(one: _Rectangle, other: _Rectangle) -> float:
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    return width * height if width > 0 and height > 0 else 0.0
