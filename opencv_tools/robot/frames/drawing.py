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

"""Parts of the pictures of a robot: colours, outlines of shapes, and texts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib import import_module
import math
from typing import Any

from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Geometry, Sphere
from opencv_tools.robot.pose import Transform, Vector, ZERO
from opencv_tools.robot.xml.document import DescriptionError

Point = tuple[float, float]

AXIS_COLORS = ('#d62728', '#2ca02c', '#1f5fd6')  # x, y, z
UNITS: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
DARK, GREY, PALE = '#222222', '#777777', '#bbbbbb'
SHAPE_COLORS = {'visual': '#7a5fb5', 'collision': '#e08a1e'}

_TURN = [2 * math.pi * step / 24 for step in range(25)]


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


def plain(text: str, longest: int = 60) -> str:
    """Write a text so that matplotlib reads no formula in it, with longer lines cut off."""
    lines = [line if len(line) <= longest else f'{line[:longest - 3]}...'
             for line in text.split('\n')]
    return '\n'.join(lines).replace('$', r'\$')


def numbers(xyz: Sequence[float], rpy: Sequence[float], between: str = '\n') -> str:
    """Write a pose in two parts, with what stands between them."""
    parts = (' '.join(f'{round(value, 9) + 0.0:.4g}' for value in part) for part in (xyz, rpy))
    return between.join(f'{name} {part}' for name, part in zip(('xyz', 'rpy'), parts))


def bent(start: Point, end: Point, bend: float) -> list[Point]:
    """
    Return points of a parabola (a Bezier curve), without its ends.

    :param bend: how far to the left of the middle its control point is, as a part of the
        distance.
    """
    (a, b), (c, d) = start, end
    x, y = 0.5 * (a + c) - bend * (d - b), 0.5 * (b + d) + bend * (c - a)
    parts = [step / 20 for step in range(1, 20)]
    return [(((1 - part) ** 2 * a + 2 * part * (1 - part) * x + part ** 2 * c),
             ((1 - part) ** 2 * b + 2 * part * (1 - part) * y + part ** 2 * d))
            for part in parts]


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
