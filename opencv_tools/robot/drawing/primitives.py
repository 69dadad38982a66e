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

from collections.abc import Iterable, Sequence
import math

from opencv_tools.robot.frames.listing import Listing, transform_of
from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Geometry, Sphere
from opencv_tools.robot.model import Robot
from opencv_tools.robot.pose import Vector

Point = tuple[float, float]

AXIS_COLORS = ('#d62728', '#2ca02c', '#1f5fd6')  # x, y, z
UNITS: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
TEXT_COLOR, GREY, PALE = '#222222', '#777777', '#bbbbbb'
SHAPE_COLORS = {'visual': '#7a5fb5', 'collision': '#e08a1e'}

_CIRCLE = [(math.cos(angle), math.sin(angle))
           for angle in (2 * math.pi * step / 24 for step in range(25))]


def placed_lines(robot: Robot, listing: Listing) -> dict[str, list[list[Vector]]]:
    """Return the outlines of all visuals and collisions in the root link, by their kinds."""
    found: dict[str, list[list[Vector]]] = {'visual': [], 'collision': []}
    for link in robot.links:
        listed = listing['links'][link.name]
        for kind, shapes in (('visual', link.visuals), ('collision', link.collisions)):
            for shape, entry in zip(shapes, listed[f'{kind}s']):
                pose = transform_of(entry['pose'])
                found[kind] += [list(map(pose.apply, line)) for line in outline(shape.geometry)]
    return found


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
