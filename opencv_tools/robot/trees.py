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

"""The trees of links that a robot has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import FrameId, Joint, MODEL, Placement, Robot
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report


def select_root(robot: Robot, root: str, report: Report) -> Robot:
    """
    Give the part of a robot that hangs on one link, as URDF has it.

    :param root: the link; empty where the robot has one root only.
    :raises DescriptionError: it has several, or there is no such root.
    """
    kinematics = Kinematics(robot)
    roots = kinematics.roots
    if root and root not in roots:
        raise DescriptionError(f'--root {root!r} is no root; there is {shortened(roots)}',
                               source=robot.source)
    if not root and len(roots) > 1:
        raise DescriptionError(f'has {len(roots)} links that hang on nothing, a robot of URDF has '
                               f'one; choose by --root: {shortened(roots)}', source=robot.source)
    if len(roots) == 1:
        return robot
    links = {link.name: link for link in robot.links}
    for other in roots:
        if other != root:
            names = kinematics.subtree([other])
            report.warn('link', other, links[other].line, f'left out: {shortened(names)}')
    robot = _with_links(robot, set(kinematics.subtree([root])), kinematics)
    return replace(robot, joints=_drop_orphan_mimics(robot.joints, report))


def _with_links(robot: Robot, kept: set[str], kinematics: Kinematics) -> Robot:
    """Leave out links, and the joints and frames that are on them."""
    joints = tuple(joint for joint in robot.joints
                   if joint.child in kept and joint.parent in kept)
    links = tuple(link for link in robot.links if link.name in kept)
    attached = kinematics.attached_links()
    frames = tuple(frame for frame in robot.frames if frame.attached_to == MODEL
                   or attached[FrameId('frame', frame.name)].name in kept)
    there = {MODEL, *(FrameId('link', name) for name in kept),
             *(FrameId('joint', joint.name) for joint in joints),
             *(FrameId('frame', frame.name) for frame in frames)}

    def place(placement: Placement) -> Placement:
        if placement.relative_to in there:
            return placement
        return Placement(kinematics.placement_pose(placement).pose(), MODEL)

    canonical = robot.canonical_link if robot.canonical_link in kept else ''
    return replace(robot, links=links, joints=joints, frames=frames,
                   canonical_link=canonical).map_placements(place)


def _drop_orphan_mimics(joints: Sequence[Joint], report: Report) -> tuple[Joint, ...]:
    """Let no joint mimic one that is not there."""
    names = {joint.name for joint in joints}
    result = []
    for joint in joints:
        alone = tuple(replace(axis, mimic=None) if axis.mimic and axis.mimic.joint not in names
                      else axis for axis in joint.axes)
        if alone != joint.axes:
            report.warn('joint', joint.name, joint.line, 'mimics a joint that is left out; it is '
                        'free now')
        result.append(replace(joint, axes=alone))
    return tuple(result)


def shortened(names: Sequence[str]) -> str:
    """Name a few things, and say how many more there are."""
    few = ', '.join(map(repr, names[:5]))
    return f'{few} and {len(names) - 5} more' if len(names) > 5 else few
