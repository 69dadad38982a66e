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

"""Joints of the live robot, and their positions in a transform between two links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
import operator
from typing import Any, cast

from opencv_tools.robot.kinematics import plane
from opencv_tools.robot.pose import Matrix, normalised, Transform, Vector


@dataclass(frozen=True, kw_only=True)
class LiveJoint:
    """A joint of the robot."""

    number: int
    name: str
    kind: str
    links: tuple[str, str]
    axis: Vector
    step: Transform
    child_step: Transform


def joints_of(robot: Mapping[str, Any]) -> list[LiveJoint]:
    """Return the movable joints of a robot in a document, see `robot.view.document`."""
    links = [link['name'] for link in robot['links']]
    return [LiveJoint(
        number=number, name=joint['name'], kind=joint['kind'],
        links=(links[joint['parent']], links[joint['child']]),
        axis=cast('Vector', tuple((joint['axes'] or [[0.0, 0.0, 1.0]])[0])),
        step=_transform(joint['step']), child_step=_transform(joint['child_step']))
        for number, joint in enumerate(robot['joints']) if joint['spans'] and not joint['loop']]


def _transform(numbers: Sequence[float]) -> Transform:
    return Transform(cast('Matrix', tuple(numbers[:9])), cast('Vector', tuple(numbers[9:])))


def joint_position(kind: str, axis: Vector, moved: Transform) -> list[float]:
    """
    Return the position of a joint of URDF, the inverse of `robot.kinematics.joint_transform`.

    :param kind: ``revolute``, ``prismatic``, ``planar`` or ``floating``.
    :param axis: axis of length 1.
    :param moved: frame of the joint in its frame at zero; motion across the joint is ignored.
    """
    def along(direction: Vector, vector: Vector) -> float:
        return math.fsum(map(operator.mul, direction, vector))

    a, b, c, d, e, f, g, h, i = moved.rotation
    angle = math.atan2(along(axis, (h - f, c - g, d - b)), a + e + i - 1)
    if kind == 'revolute':
        return [angle]
    if kind == 'prismatic':
        return [along(axis, moved.translation)]
    if kind == 'planar':
        sides = (cast('Vector', normalised(side)) for side in plane(axis))
        return [*(along(side, moved.translation) for side in sides), angle]
    pose = moved.pose()
    return [*pose.xyz, *pose.rpy]
