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

"""JSON-compatible listing of the frames of a robot in its root link."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
import math
from typing import Any

from opencv_tools.robot.kinematics import Kinematics, with_mimics
from opencv_tools.robot.model import (
    Axis, FrameId, Joint, Limit, Link, MODEL, Placement, Robot, Shape)
from opencv_tools.robot.pose import normalised, rotation_of_quaternion, Transform
from opencv_tools.robot.trees import shortened
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.numbers import UNLIMITED
from opencv_tools.robot.xml.report import Report

Listing = Mapping[str, Any]


def frames(robot: Robot, positions: Mapping[str, float], report: Report | None = None
           ) -> dict[str, Any]:
    """
    Return the poses of all links, shapes, inertials, joints and frames in the root link.

    :param positions: joint positions by name, in radians or metres. Mimic joints follow; the
        other joints are at zero.
    :param report: gets a warning for each position outside the limits.
    :returns: a value for `json.dumps`. A ``pose`` is x, y, z, qw, qx, qy, qz in the first root
        link. ``in_model``, ``in_parent`` and ``in_child`` are xyz and rpy at zero, in the model
        and in both links of a joint; they have the numbers of the file if the file has this pose.
        ``moved`` is whether a joint above the link is not at zero. ``frames`` exists only if the
        robot has frames beside those of links and joints.
    :raises DescriptionError: a position is not possible, or frames or mimics have a cycle.
    """
    if not robot.links:
        raise DescriptionError('has no links; frames are listed in the root link',
                               source=robot.source, tag='robot')
    _check_positions(robot, positions, report or Report())
    poses = _Poses(robot, positions)
    roots = [poses.root, *(name for name in poses.kinematics.roots if name != poses.root)]
    result: dict[str, Any] = {
        'robot': robot.name,
        'root': poses.root,
        'links': {name: poses.link(name) for name in poses.kinematics.subtree(roots)},
        'joints': {joint.name: poses.joint(joint) for joint in robot.joints},
    }
    if robot.frames:
        result['frames'] = {
            frame.name: {'attached_to': frame.attached_to.name,
                         'pose': poses.pose(FrameId('frame', frame.name))}
            for frame in robot.frames}
    return result


class _Poses:
    """Poses in the root link at some joint positions."""

    def __init__(self, robot: Robot, positions: Mapping[str, float]) -> None:
        self.kinematics = Kinematics(robot)
        self._source = robot.source
        self._links = {link.name: link for link in robot.links}
        self._positions = with_mimics(
            robot, {name: (value,) for name, value in positions.items()})
        poses = self.kinematics.forward(self._positions)
        # The first root link that is not an empty world without joints.
        roots = self.kinematics.roots or [robot.links[0].name]
        self.root = next((name for name in roots if self.kinematics.child_joints[name]
                          or not self._links[name].is_world), roots[0])
        to_root = poses[FrameId('link', self.root)].inverse()
        self._poses = {frame: to_root @ pose for frame, pose in poses.items()}
        self._moved = self._moved_links()

    def _moved_links(self) -> set[str]:
        """Return the names of the links below a joint that is not at zero."""
        names: set[str] = set()
        for name in self.kinematics.subtree(self.kinematics.roots):
            joint = self.kinematics.parent_joint.get(name)
            if joint and (joint.parent in names or any(self._positions.get(joint.name, ()))):
                names.add(name)
        return names

    def link(self, name: str) -> dict[str, Any]:
        link, joint = self._links[name], self.kinematics.parent_joint.get(name)
        inertial = link.inertial
        return {
            'parent': joint.parent if joint else None,
            'pose': self.pose(FrameId('link', name)),
            'moved': name in self._moved,
            'in_model': self._pose_at_zero(MODEL, FrameId('link', name)),
            'visuals': [self._shape(link, shape) for shape in link.visuals],
            'collisions': [self._shape(link, shape) for shape in link.collisions],
            'inertial': inertial and {
                'mass': inertial.mass,
                'pose': self._placement_pose(link, inertial.placement),
                'inertia': list(inertial.inertia),
            },
        }

    def joint(self, joint: Joint) -> dict[str, Any]:
        axes, dof = joint.axes[:joint.kind.axes], joint.kind.dof
        limit = joint.limit if joint.has_position_limits else Limit()
        frame = FrameId('joint', joint.name)
        position = (*self._positions.get(joint.name, ()), *([0.0] * dof))
        return {
            'type': joint.type, 'parent': joint.parent, 'child': joint.child,
            'axis': self._axis(joint, axes[0]) if axes else None,
            'pose': self.pose(frame),
            'position': list(position[:dof]),
            'in_parent': self._pose_at_zero(FrameId('link', joint.parent), frame),
            'in_child': self._pose_at_zero(FrameId('link', joint.child), frame),
            'lower': limit.lower if limit.lower > -UNLIMITED else None,
            'upper': limit.upper if limit.upper < UNLIMITED else None,
        }

    def pose(self, frame: FrameId) -> list[float]:
        return self._numbers(self._poses[frame])

    def _pose_at_zero(self, base: FrameId, frame: FrameId) -> dict[str, list[float]]:
        pose = self.kinematics.between(base, frame)
        self._check_finite(pose.xyz)
        return {'xyz': [value + 0.0 for value in pose.xyz],
                'rpy': [value + 0.0 for value in pose.rpy]}

    def _shape(self, link: Link, shape: Shape) -> dict[str, Any]:
        return {'name': shape.name, 'pose': self._placement_pose(link, shape.placement)}

    def _placement_pose(self, link: Link, placement: Placement) -> list[float]:
        frame = FrameId('link', link.name)
        offset = self.kinematics.within(frame, placement).transform()
        return self._numbers(self._poses[frame] @ offset)

    def _axis(self, joint: Joint, axis: Axis) -> list[float]:
        # The first axis moves with the parent: a second axis may rotate the child about it.
        parent, frame = FrameId('link', joint.parent), FrameId('joint', joint.name)
        pose = (self._poses[frame] if joint.is_loop else
                self._poses[parent] @ self.kinematics.between(parent, frame).transform())
        x, y, z = normalised(axis.xyz)
        return [value + 0.0 for value in pose.rotate((x, y, z))]

    def _numbers(self, transform: Transform) -> list[float]:
        numbers = [value + 0.0 for value in (*transform.translation, *transform.quaternion())]
        self._check_finite(numbers)
        return numbers

    def _check_finite(self, numbers: Sequence[float]) -> None:
        if not all(map(math.isfinite, numbers)):
            raise DescriptionError('a pose is too far away for floating-point numbers',
                                   source=self._source, tag='robot')


def _check_positions(robot: Robot, positions: Mapping[str, float], report: Report) -> None:
    """Check that each position is possible, and warn if it is outside the limits."""
    joints = {joint.name: joint for joint in robot.joints}
    movable = {name: joint for name, joint in joints.items()
               if joint.kind.dof == 1 and not joint.is_loop
               and not any(axis.mimic for axis in joint.axes)}
    for name, value in positions.items():
        if name not in movable:
            raise DescriptionError(
                f'{_why_not_movable(name, joints.get(name))}; {_alternatives(joints, movable)}',
                source=robot.source, tag='joint')
        if not math.isfinite(value):
            raise DescriptionError(f'position of {name!r} is {value}; give a finite number',
                                   source=robot.source, tag='joint')
        joint = joints[name]
        limit = joint.limit
        if joint.type != 'continuous' and not limit.lower <= value <= limit.upper:
            report.warn('joint', name, joint.line, f'position {value:.6g} is outside the limits '
                        f'{limit.lower:.6g} to {limit.upper:.6g}')


def _why_not_movable(name: str, joint: Joint | None) -> str:
    if joint is None:
        return f'joint {name!r} does not exist'
    if joint.is_loop:
        return f'joint {name!r} closes a loop and follows the other joints'
    leader = next((axis.mimic.joint for axis in joint.axes if axis.mimic), None)
    if leader is not None:
        return f'joint {name!r} mimics {leader!r}; move {leader!r} instead'
    return f'joint {name!r} is {joint.type}, not of one degree of freedom'


def _alternatives(joints: Mapping[str, Joint], movable: Iterable[str]) -> str:
    names = ', '.join(map(repr, movable))
    if names:
        return f'the movable joints are {names}'
    some = any(joint.kind.dof for joint in joints.values())
    none = f'the robot has no {"joint of one degree of freedom" if some else "movable joint"}'
    return f'{none}; its joints are {shortened([*joints])}' if joints else none


def parent_joints(listing: Listing) -> dict[str, str]:
    """Return the name of each link's parent joint; the other joints close loops."""
    result: dict[str, str] = {}
    for name, joint in listing['joints'].items():
        if listing['links'][joint['child']]['parent'] == joint['parent']:
            result.setdefault(joint['child'], name)
    return result


def depth_first(listing: Listing) -> Iterator[tuple[str, int]]:
    """Return the names of all links in depth-first order, each with its depth."""
    children: dict[str | None, list[str]] = {}
    for name, link in listing['links'].items():
        children.setdefault(link['parent'], []).append(name)
    stack = [(name, 0) for name in reversed(children.get(None, ()))]
    while stack:
        name, depth = stack.pop()
        yield name, depth
        stack.extend((child, depth + 1) for child in reversed(children.get(name, ())))


def transform_of(pose: Sequence[float]) -> Transform:
    """Return a pose of the listing as a transform."""
    x, y, z, qw, qx, qy, qz = pose
    return Transform(rotation_of_quaternion((qw, qx, qy, qz)), (x, y, z))
