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
    visual = Shape('', on('base_link', Pose((-0.1, 0.0, 0.0), (HALF, 0.0, HALF))), None)
    collision = Shape('box', on('base_link', Pose((0.0, 0.0, -0.15))), Box((0.7, 0.3, 0.1)))
    return Robot('my_robot', (
        Link('base_footprint', Placement(Pose(), MODEL)),
        Link('base_link', Placement(Pose(), FrameId('joint', 'base_joint')),
             Inertial(on('base_link', Pose((0.0, 0.5, 0.0))), 2.5, (1.0, 0.1, 0.2, 2.0, 0.3, 3.0)),
             (visual,), (collision,)),
        Link('wheel', Placement(Pose(), FrameId('joint', 'turn'))),
        Link('pusher', Placement(Pose(), FrameId('joint', 'push')))), (
        Joint('base_joint', 'fixed', 'base_footprint', 'base_link',
              on('base_footprint', Pose((0.0, 0.0, 0.2)))),
        Joint('turn', 'continuous', 'base_link', 'wheel',
              on('base_link', Pose((0.0, 1.0, 0.0), (-HALF, 0.0, 0.0))), (Axis((0.0, 0.0, 3.0)),)),
        Joint('push', 'prismatic', 'base_link', 'pusher', on('base_link'), (
            Axis((1.0, 0.0, 0.0), Limit(-0.5, math.inf), mimic=Mimic('turn', 0.5, 0.25)),))))


def shifted() -> Robot:
    """Create a robot with a joint away from its link and a root link away from the model."""
    return Robot('shifted', (
        Link('base', Placement(Pose((0.0, 1.0, 0.0)), MODEL)),
        Link('arm', Placement(Pose((0.5, 1.0, 0.3)), MODEL))), (
        Joint('hinge', 'revolute', 'base', 'arm', on('arm', Pose((-0.3, 0.0, 0.0))),
              (Axis((0.0, 1.0, 0.0)),)),))
