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

"""Colours, outlines of shapes, curves and texts of pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
import math

from opencv_tools.robot.frames.listing import Listing, transform_of
from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Geometry, Sphere
from opencv_tools.robot.model import Robot, Shape
from opencv_tools.robot.pose import Transform, Vector

Point = tuple[float, float]

AXIS_COLORS = ('#d62728', '#2ca02c', '#1f5fd6')  # x, y, z
UNITS: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
TEXT_COLOR, GREY, PALE = '#222222', '#777777', '#bbbbbb'
SHAPE_COLORS = {'visual': '#7a5fb5', 'collision': '#e08a1e'}

_CIRCLE = [(math.cos(angle), math.sin(angle))
           for angle in (2 * math.pi * step / 24 for step in range(25))]


@dataclass(frozen=True)
class PlacedShape:
    """A visual or collision and its pose in the root link."""

    kind: str
    shape: Shape
    pose: Transform

    @property
    def lines(self) -> list[list[Vector]]:
        """Outline of the shape in the root link."""
        return transformed(outline(self.shape.geometry), self.pose)


def placed_shapes(robot: Robot, listing: Listing) -> Iterator[PlacedShape]:
    """Return all visuals and collisions of a robot."""
    for link in robot.links:
        listed = listing['links'][link.name]
        for kind, shapes in (('visual', link.visuals), ('collision', link.collisions)):
            for shape, entry in zip(shapes, listed[f'{kind}s']):
                yield PlacedShape(kind, shape, transform_of(entry['pose']))


def plain(text: str, longest: int = 60) -> str:
    """Return a text with formulas of matplotlib escaped and long lines shortened."""
    lines = [line if len(line) <= longest else f'{line[:longest - 3]}...'
             for line in text.split('\n')]
    return '\n'.join(lines).replace('$', r'\$')


def pose_text(xyz: Sequence[float], rpy: Sequence[float], separator: str = '\n') -> str:
    """Return the position and the orientation of a pose as text."""
    return separator.join(
        ' '.join([name, *(f'{round(value, 9) + 0.0:.4g}' for value in values)])
        for name, values in (('xyz', xyz), ('rpy', rpy)))


def bezier_curve(start: Point, end: Point, bend: float) -> list[Point]:
    """
    Return points of a quadratic Bezier curve, without its ends.

    :param bend: offset of the control point to the left of the middle, as a fraction of the
        distance between the ends.
    """
    (a, b), (c, d) = start, end
    x, y = 0.5 * (a + c) - bend * (d - b), 0.5 * (b + d) + bend * (c - a)
    return [(((1 - t) ** 2 * a + 2 * t * (1 - t) * x + t ** 2 * c),
             ((1 - t) ** 2 * b + 2 * t * (1 - t) * y + t ** 2 * d))
            for t in (step / 20 for step in range(1, 20))]


def outline(geometry: Geometry | None) -> list[list[Vector]]:
    """Return lines that show a geometry in its own frame; none if its size is not known."""
    if isinstance(geometry, Box):
        x, y, z = (length / 2 for length in geometry.size)
        faces = [[(a, b, c) for a, b in ((-x, -y), (x, -y), (x, y), (-x, y), (-x, -y))]
                 for c in (-z, z)]
        return [*faces, *([low, high] for low, high in zip(*faces))]
    if isinstance(geometry, Sphere):
        return _rings(geometry.radius, (0.0,)) + _arcs(geometry.radius, 0.0)
    if isinstance(geometry, (Cylinder, Capsule)):
        half, radius = geometry.length / 2, geometry.radius
        lines = _rings(radius, (-half, half)) + [
            [(a, b, -half), (a, b, half)]
            for a, b in ((radius, 0.0), (0.0, radius), (-radius, 0.0), (0.0, -radius))]
        return lines + (_arcs(radius, half) if isinstance(geometry, Capsule) else [])
    return []


def _rings(radius: float, heights: Iterable[float]) -> list[list[Vector]]:
    return [[(radius * x, radius * y, height) for x, y in _CIRCLE] for height in heights]


def _arcs(radius: float, half: float) -> list[list[Vector]]:
    """Return two great circles through the poles, with the hemispheres moved apart."""
    arc = [(radius * x, radius * z + (half if z >= 0 else -half)) for x, z in _CIRCLE]
    return [[(x, 0.0, z) for x, z in arc], [(0.0, x, z) for x, z in arc]]


def transformed(lines: Iterable[Iterable[Vector]], transform: Transform) -> list[list[Vector]]:
    """Return lines transformed to another frame."""
    return [[transform.apply(point) for point in line] for line in lines]


def hull(points: Iterable[Point]) -> list[Point]:
    """Return the convex hull of points, anticlockwise (Andrew's monotone chain)."""
    ordered = sorted(set(points))
    halves = []
    for part in (ordered, ordered[::-1]):
        half: list[Point] = []
        for point in part:
            while len(half) > 1 and _cross(half[-2], half[-1], point) <= 0:
                half.pop()
            half.append(point)
        halves.append(half[:-1])
    return halves[0] + halves[1] or ordered


def _cross(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def scaled(vector: Vector, length: float) -> Vector:
    """Return a vector multiplied by a number."""
    return (vector[0] * length, vector[1] * length, vector[2] * length)
