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

"""Robots that are compared."""

from __future__ import annotations

from dataclasses import replace
import math
from typing import Any

from opencv_tools.robot.compare.compare import Difference
from opencv_tools.robot.geometry import Box, Material
from opencv_tools.robot.model import (
    Axis, Dynamics, FrameId, Inertial, Joint, Limit, Link, Mimic, MODEL, Placement, Robot, Shape)
from opencv_tools.robot.pose import Pose

HALF = math.pi / 2
RED = (1.0, 0.0, 0.0, 1.0)


def on(link: str, pose: Pose = Pose()) -> Placement:  # noqa: B008
    return Placement(pose, FrameId('link', link))


def shape(link: str, name: str = '', **changes: Any) -> Shape:
    return replace(Shape(name=name, placement=on(link, Pose((0.1, 0.0, 0.0))),
                         geometry=Box((1.0, 2.0, 3.0))), **changes)


def urdf() -> Robot:
    """Create an arm with placements of URDF and one element of each kind."""
    arm = Link(name='arm', placement=Placement(Pose(), FrameId('joint', 'turn')),
               inertial=Inertial(on('arm', Pose((0.0, 0.0, 0.5), (0.0, 0.0, HALF))), 2.0,
                                 (1.0, 0.0, 0.0, 2.0, 0.0, 3.0)),
               visuals=(shape('arm', material=Material(name='red', color=RED)),),
               collisions=(shape('arm'),))
    return Robot(name='robot',
                 links=(Link(name='base', placement=Placement(Pose(), MODEL)), arm,
                        Link(name='hand', placement=Placement(Pose(), FrameId('joint', 'slide')))),
                 joints=(Joint(name='turn', type='revolute', parent='base', child='arm',
                               placement=on('base', Pose((1.0, 0.0, 0.0), (HALF, 0, 0))),
                               axes=(Axis((0.0, 0.0, 2.0), Limit(-1.0, 2.0, 3.0, 4.0),
                                          Dynamics(0.5, 0.25)),)),
                         Joint(name='slide', type='prismatic', parent='arm', child='hand',
                               placement=on('arm', Pose((0.0, 0.0, 1.0))),
                               axes=(Axis((1.0, 0.0, 0.0), Limit(0.0, 0.5),
                                          mimic=Mimic('turn', 0.1, 0.2)),))))


def absent(element: str, name: str) -> Difference:
    return Difference(element=element, name=name, property='presence', a='yes', b='no')


def with_joint(robot: Robot, which: str, **changes: Any) -> Robot:
    return replace(robot, joints=tuple(replace(joint, **changes) if joint.name == which else joint
                                       for joint in robot.joints))


def with_axis(robot: Robot, name: str, **changes: Any) -> Robot:
    joint = next(joint for joint in robot.joints if joint.name == name)
    return with_joint(robot, name, axes=(replace(joint.axes[0], **changes),))


def free(type_: str, axes: tuple[Axis, ...], pose: Pose = Pose()) -> Robot:  # noqa: B008
    links = tuple(Link(name=name, placement=Placement(Pose(), MODEL)) for name in 'ab')
    return Robot(name='free', links=links,
                 joints=(Joint(name='j', type=type_, parent='a', child='b',
                               placement=on('b', pose), axes=axes),))
