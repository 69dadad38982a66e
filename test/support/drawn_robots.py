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

"""Drawn robots, and the lines, marks and texts of their pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import functools
from itertools import pairwise
import math
from typing import Any

import numpy as np
from opencv_tools.robot.drawing.plot import draw
from opencv_tools.robot.drawing.primitives import SHAPE_COLORS, TEXT_COLOR
from opencv_tools.robot.frames.listing import frames
from opencv_tools.robot.geometry import Box, Geometry, Mesh, Sphere
from opencv_tools.robot.model import Axis, FrameId, Joint, Link, MODEL, Placement, Robot, Shape
from opencv_tools.robot.pose import Pose, Vector
import pytest


def on(link: str, pose: Pose = Pose()) -> Placement:  # noqa: B008
    return Placement(pose, FrameId('link', link))


BASE = Box((0.7, 0.3, 0.1))


def tutorial(geometry: Geometry | None = BASE, name: str = 'base_link') -> Robot:
    visual = Shape(name='',
                   placement=on(name, Pose((-0.1, 0.0, 0.0), (math.pi / 2, 0.0, math.pi / 2))),
                   geometry=Mesh('package://my_robot/meshes/robot_base.stl'))
    collision = Shape(name='', placement=on(name, Pose((0.0, 0.0, -0.15))), geometry=geometry)
    return Robot(name='my_robot',
                 links=(Link(name='base_footprint', placement=Placement(Pose(), MODEL)),
                        Link(name=name,
                             placement=Placement(Pose(), FrameId('joint', 'base_joint')),
                             visuals=(visual,), collisions=(collision,))),
                 joints=(Joint(name='base_joint', type='fixed', parent='base_footprint',
                               child=name,
                               placement=on('base_footprint', Pose((0.0, 0.0, 0.2)))),))


def chain(count: int, pose: Pose = Pose((0.1, 0.0, 0.1), (0.0, 0.3, 0.5))) -> Robot:  # noqa: B008
    names = [f'link_{index}' for index in range(count)]
    return Robot(name='chain',
                 links=(Link(name=names[0], placement=Placement(Pose(), MODEL)),
                        *(Link(name=name,
                               placement=Placement(Pose(), FrameId('joint', f'to_{name}')))
                          for name in names[1:])),
                 joints=tuple(Joint(name=f'to_{child}', type='continuous', parent=parent,
                                    child=child, placement=on(parent, pose),
                                    axes=(Axis((0.0, 0.0, 1.0)),))
                              for parent, child in pairwise(names)))


ARM = Robot(name='arm',
            links=(Link(name='base', placement=Placement(Pose(), MODEL),
                        visuals=(Shape(name='', placement=on('base', Pose((0.0, 0.0, 0.05))),
                                       geometry=Box((0.2, 0.2, 0.1))),)),
                   Link(name='arm', placement=Placement(Pose(), FrameId('joint', 'elbow'))),
                   Link(name='tool', placement=Placement(Pose(), FrameId('joint', 'slide')),
                        collisions=(Shape(name='', placement=on('tool', Pose((0.1, 0.0, 0.0))),
                                          geometry=Sphere(0.05)),))),
            joints=(Joint(name='elbow', type='continuous', parent='base', child='arm',
                          placement=on('base', Pose((0.0, 0.0, 0.4))),
                          axes=(Axis((0.0, 1.0, 0.0)),)),
                    Joint(name='slide', type='prismatic', parent='arm', child='tool',
                          placement=on('arm', Pose((0.0, 0.0, 0.5))),
                          axes=(Axis((0.0, 0.0, 1.0)),))))
UPRIGHT = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
BENT = ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))


@dataclass(frozen=True)
class Layout:
    """
    Where all of the arm is, at some positions of its joints, and how it is drawn.

    :param tool: where the link of this name is.
    :param center: of the sphere on it.
    :param axes: of the two links that move.
    :param middle: of what the view in space shows, and how far it reaches from there.
    :param lengths: of the axes of a frame in space and in the side view.
    :param sizes: in the side view: from where to where, the colour, and the text and its place.
    """

    positions: dict[str, float]
    tool: Vector
    center: Vector
    axes: Sequence[Vector]
    middle: Vector
    reach: Vector
    lengths: tuple[float, float]
    sizes: Sequence[tuple[tuple[float, float, float, float], str, str, tuple[float, float]]]
    box: tuple[float, float, float, float]
    unit: float

    @property
    def places(self) -> dict[str, tuple[Vector, Sequence[Vector]]]:
        moved = ', moved' if self.positions else ''
        return {'base': ((0.0, 0.0, 0.0), UPRIGHT), f'arm{moved}': ((0.0, 0.0, 0.4), self.axes),
                f'tool{moved}': (self.tool, self.axes)}


VISUAL, COLLISION = SHAPE_COLORS['visual'], SHAPE_COLORS['collision']
LAYOUTS = pytest.mark.parametrize('layout', [
    Layout({}, (0.0, 0.0, 0.9), (0.1, 0.0, 0.9), UPRIGHT, (0.025, 0.02125, 0.52125),
           (0.2189250, 0.2189250, 0.5473125), (0.1425, 0.152), (
               ((-0.29, 0.0, -0.29, 0.4), TEXT_COLOR, '0.4', (-0.2995, 0.2)),
               ((-0.385, 0.4, -0.385, 0.9), TEXT_COLOR, '0.5', (-0.3945, 0.65)),
               ((-0.48, 0.0, -0.48, 0.05), VISUAL, '0.05', (-0.4895, 0.025)),
               ((0.0, 1.178, 0.1, 1.178), COLLISION, '0.1', (0.05, 1.1875))),
           (-0.1, 0.15, 0.0, 0.95), 0.95),
    Layout({'elbow': math.pi / 2, 'slide': 0.1}, (0.6, 0.0, 0.4), (0.6, 0.0, 0.3), BENT,
           (0.30625, 0.00625, 0.2), (0.4265625, 0.170625, 0.21), (0.1125, 0.12), (
               ((-0.25, 0.0, -0.25, 0.4), TEXT_COLOR, '0.4', (-0.2575, 0.2)),
               ((0.0, 0.58, 0.5, 0.58), TEXT_COLOR, '0.5', (0.25, 0.5875)),
               ((0.5, 0.64, 0.6, 0.64), TEXT_COLOR, '0.1', (0.55, 0.6475)),
               ((-0.325, 0.0, -0.325, 0.05), VISUAL, '0.05', (-0.3325, 0.025)),
               ((-0.4, 0.4, -0.4, 0.3), COLLISION, '0.1', (-0.4075, 0.35))),
           (-0.1, 0.65, 0.0, 0.4), 0.75)], ids=['at zero', 'moved'])


def drawn(robot: Robot, positions: dict[str, float] | None = None) -> list[Any]:
    """Return the axes of a picture of a robot, which tests share and must not change."""
    return _drawn(robot, tuple((positions or {}).items()))


@functools.cache
def _drawn(robot: Robot, items: tuple[tuple[str, float], ...]) -> list[Any]:
    positions = dict(items)
    return list(draw(robot, frames(robot, positions)).axes)


def near(one: Any, other: Any) -> bool:
    """Return whether two lists have the same points."""
    one, other = np.array(one, float), np.array(other, float)
    return one.shape == other.shape and bool(np.abs(one - other).max(initial=0.0) < 1e-9)


def marks(axes: Any, marker: str) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for line in axes.lines if line.get_marker() == marker
            for x, y in zip(*line.get_data())]


def arrows(axes: Any, style: str, color: str) -> list[tuple[float, ...]]:
    """Return the starts and ends of arrows."""
    return [(*one.xyann, *one.xy) for one in axes.texts
            if (getattr(one, 'arrowprops', None) or {}).get('arrowstyle') == style
            and one.arrowprops['color'] == color]


def named(axes: Any) -> dict[str, tuple[float, float]]:
    """Return the points of labels by the first lines of the labels."""
    return {one.get_text().split('\n')[0]: getattr(one, 'xy', one.get_position())
            for one in axes.texts if one.get_text()}
