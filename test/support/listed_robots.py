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

"""Robots whose frames are listed."""

from __future__ import annotations

import math

from opencv_tools.robot.geometry import Box
from opencv_tools.robot.model import (
    Axis, FrameId, Inertial, Joint, Limit, Link, Mimic, MODEL, Placement, Robot, Shape)
from opencv_tools.robot.pose import Pose

HALF = math.pi / 2


def on(link: str, pose: Pose = Pose()) -> Placement:  # noqa: B008
    return Placement(pose, FrameId('link', link))


def tutorial() -> Robot:
    """Create the robot of the tutorial with a wheel and a pusher that mimics the wheel."""
    visual = Shape(name='', placement=on('base_link', Pose((-0.1, 0.0, 0.0), (HALF, 0.0, HALF))),
                   geometry=None)
    collision = Shape(name='box', placement=on('base_link', Pose((0.0, 0.0, -0.15))),
                      geometry=Box((0.7, 0.3, 0.1)))
    return Robot(name='my_robot',
                 links=(Link(name='base_footprint', placement=Placement(Pose(), MODEL)),
                        Link(name='base_link',
                             placement=Placement(Pose(), FrameId('joint', 'base_joint')),
                             inertial=Inertial(on('base_link', Pose((0.0, 0.5, 0.0))), 2.5,
                                               (1.0, 0.1, 0.2, 2.0, 0.3, 3.0)), visuals=(visual,),
                             collisions=(collision,)),
                        Link(name='wheel', placement=Placement(Pose(), FrameId('joint', 'turn'))),
                        Link(name='pusher',
                             placement=Placement(Pose(), FrameId('joint', 'push')))),
                 joints=(Joint(name='base_joint', type='fixed', parent='base_footprint',
                               child='base_link',
                               placement=on('base_footprint', Pose((0.0, 0.0, 0.2)))),
                         Joint(name='turn', type='continuous', parent='base_link', child='wheel',
                               placement=on('base_link', Pose((0.0, 1.0, 0.0), (-HALF, 0.0, 0.0))),
                               axes=(Axis((0.0, 0.0, 3.0)),)),
                         Joint(name='push', type='prismatic', parent='base_link', child='pusher',
                               placement=on('base_link'),
                               axes=(Axis((1.0, 0.0, 0.0), Limit(-0.5, math.inf),
                                          mimic=Mimic('turn', 0.5, 0.25)),))))


def shifted() -> Robot:
    """Create a robot with a joint away from its link and a root link away from the model."""
    return Robot(name='shifted',
                 links=(Link(name='base', placement=Placement(Pose((0.0, 1.0, 0.0)), MODEL)),
                        Link(name='arm', placement=Placement(Pose((0.5, 1.0, 0.3)), MODEL))),
                 joints=(Joint(name='hinge', type='revolute', parent='base', child='arm',
                               placement=on('arm', Pose((-0.3, 0.0, 0.0))),
                               axes=(Axis((0.0, 1.0, 0.0)),)),))
