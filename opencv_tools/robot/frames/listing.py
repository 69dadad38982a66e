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

"""A listing of all frames of a robot in the frame of its root link, as JSON has it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
import math
from typing import Any

from opencv_tools.robot.kinematics import Kinematics, with_mimics
from opencv_tools.robot.model import (
    Axis, FrameId, Joint, Limit, Link, MODEL, Placement, Robot, Shape)
from opencv_tools.robot.pose import normalised, Pose, rotation_of_quaternion, Transform
from opencv_tools.robot.trees import shortened
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.numbers import UNLIMITED
from opencv_tools.robot.xml.report import Report


def frames(robot: Robot, positions: Mapping[str, float], report: Report | None = None
           ) -> dict[str, Any]:
    """
    List where all links, what they have, and joints are, in the frame of the root link.

    :param positions: of joints by name, in radians or metres; the others are at zero, or where
        the joints are that they mimic.
    :param report: where to note a position outside the limits.
    :returns: what is valid JSON. A pose is x, y, z, qw, qx, qy, qz in the frame of the root link;
        with several roots the first one counts. ``in_model``, ``in_parent`` and ``in_child`` are
        xyz and rpy at zero, in the model's frame and in those of the two links of a joint; what
        is written so in the file has the numbers of the file. ``moved`` says whether a joint
        above the link is not at zero. ``frames`` is there only if the robot has any beside links
        and joints.
    :raises DescriptionError: a joint is not there, or cannot be put by one number; or frames or
        mimics go round in a circle.
    """
    if not robot.links:
        raise DescriptionError('has no link, so there is no root to place anything in',
                               source=robot.source, tag='robot')
    _check(robot, positions, report or Report())
    listing = _Listing(robot, positions)
    result: dict[str, Any] = {
        'robot': robot.name,
        'root': listing.root,
        'links': {name: listing.link(name) for name in listing.kinematics.subtree(
            [listing.root, *(name for name in listing.kinematics.roots if name != listing.root)])},
        'joints': {joint.name: listing.joint(joint) for joint in robot.joints},
    }
    if robot.frames:
        result['frames'] = {
            frame.name: {'attached_to': frame.attached_to.name,
                         'pose': listing.pose(FrameId('frame', frame.name))}
            for frame in robot.frames}
    return result


class _Listing:
    """Poses of a robot in its root link's frame, at some positions of its joints."""

    def __init__(self, robot: Robot, positions: Mapping[str, float]) -> None:
        self.kinematics = Kinematics(robot)
        self._links = {link.name: link for link in robot.links}
        moved = with_mimics(robot, {name: (value,) for name, value in positions.items()})
        poses = self.kinematics.forward(moved)
        self.root = self._first_root(robot)
        home = poses[FrameId('link', self.root)].inverse()
        self._poses = {frame: home @ pose for frame, pose in poses.items()}
        self._source = robot.source
        self._positions = moved
        self._moved = self._moved_links()

    def _first_root(self, robot: Robot) -> str:
        """Name the first root, but not a world that nothing is fastened to."""
        roots = self.kinematics.roots or [robot.links[0].name]
        return next((name for name in roots if self.kinematics.child_joints[name]
                     or not self._links[name].is_world), roots[0])

    def _moved_links(self) -> set[str]:
        """Name the links below a joint that is not at zero."""
        names: set[str] = set()
        for name in self.kinematics.subtree(self.kinematics.roots):
            above = self.kinematics.parent_joint.get(name)
            if above and (above.parent in names or any(self._positions.get(above.name, ()))):
                names.add(name)
        return names

    def link(self, name: str) -> dict[str, Any]:
        link, above = self._links[name], self.kinematics.parent_joint.get(name)
        inertial = link.inertial
        return {
            'parent': above.parent if above else None,
            'pose': self.pose(FrameId('link', name)),
            'moved': name in self._moved,
            'in_model': self._written(MODEL, FrameId('link', name)),
            'visuals': [self._shape(link, shape) for shape in link.visuals],
            'collisions': [self._shape(link, shape) for shape in link.collisions],
            'inertial': inertial and {
                'mass': inertial.mass,
                'pose': self._placed(link, inertial.placement),
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
            'in_parent': self._written(FrameId('link', joint.parent), frame),
            'in_child': self._written(FrameId('link', joint.child), frame),
            'lower': limit.lower if limit.lower > -UNLIMITED else None,
            'upper': limit.upper if limit.upper < UNLIMITED else None,
        }

    def pose(self, frame: FrameId) -> list[float]:
        return self._numbers(self._poses[frame])

    def _written(self, base: FrameId, frame: FrameId) -> dict[str, list[float]]:
        """Return where a frame is in another one at zero, in the words of both formats."""
        pose = self.kinematics.between(base, frame)
        self._check_finite(pose.xyz)
        return {'xyz': [value + 0.0 for value in pose.xyz],
                'rpy': [value + 0.0 for value in pose.rpy]}

    def _shape(self, link: Link, shape: Shape) -> dict[str, Any]:
        return {'name': shape.name, 'pose': self._placed(link, shape.placement)}

    def _placed(self, link: Link, placement: Placement) -> list[float]:
        frame = FrameId('link', link.name)
        offset = self.kinematics.within(frame, placement).transform()
        return self._numbers(self._poses[frame] @ offset)

    def _axis(self, joint: Joint, axis: Axis) -> list[float]:
        # A joint's first axis does not move with the child, which its second one may turn.
        parent, frame = FrameId('link', joint.parent), FrameId('joint', joint.name)
        turn = (self._poses[frame] if joint.is_loop else
                self._poses[parent] @ self.kinematics.between(parent, frame).transform())
        x, y, z = normalised(axis.xyz)
        return [value + 0.0 for value in turn.rotate((x, y, z))]

    def _numbers(self, transform: Transform) -> list[float]:
        numbers = [value + 0.0 for value in (*transform.translation, *transform.quaternion())]
        self._check_finite(numbers)
        return numbers

    def _check_finite(self, numbers: Sequence[float]) -> None:
        if not all(map(math.isfinite, numbers)):
            raise DescriptionError('something is further away than a number can tell',
                                   source=self._source, tag='robot')


def _check(robot: Robot, positions: Mapping[str, float], report: Report) -> None:
    """Refuse positions that no joint can be put to, and note those it should not be put to."""
    joints = {joint.name: joint for joint in robot.joints}
    movable = {name: joint for name, joint in joints.items()
               if joint.kind.dof == 1 and not joint.is_loop
               and not any(axis.mimic for axis in joint.axes)}
    for name, value in positions.items():
        if name not in movable:
            raise DescriptionError(f'{_why_not(name, joints.get(name))}; '
                                   f'{_choice(joints, movable)}',
                                   source=robot.source, tag='joint')
        if not math.isfinite(value):
            raise DescriptionError(f'{name!r} cannot be put to {value}; give a finite number',
                                   source=robot.source, tag='joint')
        joint = joints[name]
        limit = joint.limit
        if joint.type != 'continuous' and not limit.lower <= value <= limit.upper:
            report.warn('joint', name, joint.line, f'{value:.6g} is outside its limits, '
                        f'{limit.lower:.6g} to {limit.upper:.6g}')


def _why_not(name: str, joint: Joint | None) -> str:
    if joint is None:
        return f'there is no joint {name!r}'
    if joint.is_loop:
        return f'joint {name!r} closes a loop, so the other joints say where it is'
    leader = next((axis.mimic.joint for axis in joint.axes if axis.mimic), None)
    if leader is not None:
        return f'joint {name!r} mimics {leader!r}; put that one'
    return f'joint {name!r} is {joint.type}, which one number does not put anywhere'


def _choice(joints: Mapping[str, Joint], movable: Iterable[str]) -> str:
    names = ', '.join(map(repr, movable))
    if names:
        return f'the movable joints are {names}'
    some = any(joint.kind.dof for joint in joints.values())
    none = f'the robot has no {"joint that one number moves" if some else "movable joint"}'
    return f'{none}; its joints are {shortened([*joints])}' if joints else none


def parent_joints(listing: Mapping[str, Any]) -> dict[str, str]:
    """Return the joint above each link, by the link's name; the other joints close loops."""
    above: dict[str, str] = {}
    for name, joint in listing['joints'].items():
        if listing['links'][joint['child']]['parent'] == joint['parent']:
            above.setdefault(joint['child'], name)
    return above


def joint_places(listing: Mapping[str, Any]) -> dict[str, Transform]:
    """Return where the joints of the tree are, each at its origin in its parent link."""
    joints, links = listing['joints'], listing['links']
    places = {}
    for name in parent_joints(listing).values():
        xyz, rpy = joints[name]['in_parent'].values()
        origin = Pose((xyz[0], xyz[1], xyz[2]), (rpy[0], rpy[1], rpy[2])).transform()
        places[name] = transform_of(links[joints[name]['parent']]['pose']) @ origin
    return places


def depth_first(listing: Mapping[str, Any]) -> Iterator[tuple[str, int]]:
    """Return all links in the order of a tree, each with the number of links above it."""
    below: dict[str | None, list[str]] = {}
    for name, link in listing['links'].items():
        below.setdefault(link['parent'], []).append(name)
    stack = [(name, 0) for name in reversed(below.get(None, ()))]
    while stack:
        name, depth = stack.pop()
        yield name, depth
        stack.extend((child, depth + 1) for child in reversed(below.get(name, ())))


def transform_of(pose: Sequence[float]) -> Transform:
    """Return a pose of the listing as a transform."""
    x, y, z, *quaternion = pose
    w, i, j, k = quaternion
    return Transform(rotation_of_quaternion((w, i, j, k)), (x, y, z))
