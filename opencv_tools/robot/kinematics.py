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

"""Poses of the frames of a robot at zero and at any joint positions."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from typing import TypeVar

from opencv_tools.robot.model import FrameId, Joint, MODEL, Placement, Robot
from opencv_tools.robot.pose import (
    IDENTITY, normalised, Pose, rotation_about, rotation_of_rpy, Transform, Vector, ZERO)
from opencv_tools.robot.xml.document import DescriptionError

_Node = TypeVar('_Node', bound=Hashable)
Positions = Mapping[str, Sequence[float]]  # by name of the joint


def resolve_chain(start: _Node, step: Callable[[_Node], _Node | None]) -> list[_Node]:
    """
    Return a node and all nodes that follow it.

    :param step: returns the next node, or None at the end of the chain.
    :raises graphlib.CycleError: the chain returns to one of its nodes; ``args[1]`` is the cycle.
    """
    chain, node = {start: None}, step(start)
    while node is not None:
        if node in chain:
            nodes = [*chain, node]
            raise CycleError('nodes are in a cycle', nodes[nodes.index(node):])
        chain[node] = None
        node = step(node)
    return [*chain]


def cycle_text(err: CycleError) -> str:
    """Return the names of a cycle's nodes, such as ``'a' -> 'b' -> 'a'``; some if it is long."""
    names = [repr(node.name if isinstance(node, FrameId) else node) for node in err.args[1]]
    return ' -> '.join(names if len(names) < 8 else [*names[:5], '...', names[-1]])


class Kinematics:
    """Poses of the frames of a robot, and the tree of its links."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._placements = {frame: owner.placement for frame, owner in robot.frame_owners()}
        self._poses: dict[FrameId, Transform] = {MODEL: IDENTITY}
        self._origins: dict[FrameId, FrameId] = {MODEL: MODEL}
        self._steps: dict[tuple[FrameId, FrameId], Transform] = {}
        self.parent_joint = {joint.child: joint for joint in robot.joints if not joint.is_loop}
        self.child_joints: dict[str, list[Joint]] = {link.name: [] for link in robot.links}
        for joint in self.parent_joint.values():
            self.child_joints[joint.parent].append(joint)

    @property
    def roots(self) -> list[str]:
        """Names of the links without a parent joint."""
        return [link.name for link in self.robot.links if link.name not in self.parent_joint]

    def subtree(self, roots: Iterable[str]) -> list[str]:
        """Return the names of links and all their descendants, parents first."""
        names = list(roots)
        for name in names:
            names.extend(joint.child for joint in self.child_joints[name])
        return names

    def pose(self, frame: FrameId) -> Transform:
        """
        Return the pose of a frame in the model, with every joint at zero.

        :raises DescriptionError: a frame is missing, or the placements have a cycle.
        """
        if frame not in self._poses:
            chain = _chain(self.robot, 'placement', frame, lambda name: (
                None if name in self._poses else self._placement(name).relative_to))
            for name in reversed(chain[:-1]):
                placement = self._placements[name]
                self._poses[name] = self._poses[placement.relative_to] @ placement.pose.transform()
        return self._poses[frame]

    def urdf_frame(self, link: str) -> FrameId:
        """Return the frame of a link in URDF, which is that of its parent joint."""
        joint = self.parent_joint.get(link)
        return FrameId('joint', joint.name) if joint else FrameId('link', link)

    def placement_pose(self, placement: Placement) -> Transform:
        """Return the pose of a placement in the model, with every joint at zero."""
        return self.pose(placement.relative_to) @ placement.pose.transform()

    def between(self, base: FrameId, frame: FrameId) -> Pose:
        """
        Return the pose of a frame in another frame, with every joint at zero.

        :returns: the numbers of the file, if the file places the frame in that other frame.
        """
        return self.within(base, Placement(Pose(), frame))

    def within(self, base: FrameId, placement: Placement) -> Pose:
        """Return the pose of a placement in a frame, in the manner of `between`."""
        origin, base_origin = self._origin(placement.relative_to), self._origin(base)
        if origin == base_origin:
            return placement.pose
        if placement.pose.is_identity and origin != MODEL:
            written = self._placements[origin]
            if self._origin(written.relative_to) == base_origin:
                return written.pose
        return (self.pose(base).inverse() @ self.placement_pose(placement)).pose()

    def forward(self, positions: Positions) -> dict[FrameId, Transform]:
        """
        Return the poses of links, joints and frames in the model, by forward kinematics.

        The roots stay at their poses of zero.

        :param positions: values of each joint, as many as its degrees of freedom; joints that
            are missing are at zero. `with_mimics` adds the positions of mimic joints.
        :returns: poses by frame. The frame of a joint is the frame that moves with its child.
        """
        poses = {FrameId('link', name): self.pose(FrameId('link', name)) for name in self.roots}
        for name in self.subtree(self.roots):
            link = FrameId('link', name)
            for joint in self.child_joints[name]:
                frame, child = FrameId('joint', joint.name), FrameId('link', joint.child)
                poses[frame] = (poses[link] @ self._step(link, frame)
                                @ joint_transform(joint, positions.get(joint.name, ())))
                poses[child] = poses[frame] @ self._step(frame, child)
        for joint in self.robot.joints:
            if joint.is_loop:
                frame, child = FrameId('joint', joint.name), FrameId('link', joint.child)
                poses[frame] = poses[child] @ self._step(child, frame)
        for frame, link in attached_links(self.robot).items():
            poses[frame] = poses[link] @ self._step(link, frame)
        return poses

    def _step(self, base: FrameId, frame: FrameId) -> Transform:
        """Return `between` as a transform, computed once."""
        if (base, frame) not in self._steps:
            self._steps[base, frame] = self.between(base, frame).transform()
        return self._steps[base, frame]

    def _placement(self, frame: FrameId) -> Placement:
        try:
            return self._placements[frame]
        except KeyError:
            raise DescriptionError(f'{frame.kind} {frame.name!r} does not exist, but a placement '
                                   'is relative to it', source=self.robot.source) from None

    def _origin(self, frame: FrameId) -> FrameId:
        """Return the first of the frames that coincide with a frame by identity placements."""
        def next_frame(name: FrameId) -> FrameId | None:
            if name in self._origins:
                return None
            placement = self._placement(name)
            return placement.relative_to if placement.pose.is_identity else None

        if frame not in self._origins:
            chain = _chain(self.robot, 'placement', frame, next_frame)
            origin = self._origins.get(chain[-1], chain[-1])
            self._origins.update(dict.fromkeys(chain, origin))
        return self._origins[frame]


def attached_links(robot: Robot) -> dict[FrameId, FrameId]:
    """
    Return the link that each of ``robot.frames`` moves with.

    :raises DescriptionError: a frame is attached to itself, or to nothing.
    """
    if not robot.frames:
        return {}
    names = {link.name for link in robot.links}
    bodies = [link.name for link in robot.links if not link.is_world]
    canonical = robot.canonical_link or (bodies or [link.name for link in robot.links])[0]
    attached_to = {FrameId('frame', frame.name): frame.attached_to for frame in robot.frames}
    attached_to.update((FrameId('joint', joint.name), FrameId('link', joint.child))
                       for joint in robot.joints)
    attached_to[MODEL] = FrameId('link', canonical)
    links: dict[FrameId, FrameId] = {}
    for frame in robot.frames:
        chain = _chain(robot, 'attachment', FrameId('frame', frame.name), lambda name: (
            None if name in links else attached_to.get(name)))
        link = links.get(chain[-1], chain[-1])
        if link.kind != 'link' or link.name not in names:
            raise DescriptionError(f'frame {frame.name!r} is attached to {link.kind} '
                                   f'{link.name!r}, which does not exist', source=robot.source)
        links.update((name, link) for name in chain if name.kind == 'frame')
    return links


def _chain(robot: Robot, relation: str, start: FrameId,
           step: Callable[[FrameId], FrameId | None]) -> list[FrameId]:
    try:
        return resolve_chain(start, step)
    except CycleError as err:
        raise DescriptionError(f'{relation} cycle: {cycle_text(err)}', source=robot.source
                               ) from err


def joint_transform(joint: Joint, position: Sequence[float]) -> Transform:
    """
    Return the transform from the frame of a joint at a position to its frame at zero.

    :param position: angles in radians and distances in metres; of a ball joint roll, pitch and
        yaw; of a floating joint x, y, z, roll, pitch and yaw; of a planar joint two distances in
        the plane and an angle. Empty for zero.
    """
    kind = joint.kind.name
    if not position or kind == 'fixed':
        return IDENTITY
    axes = [axis.xyz for axis in joint.axes] or [(0.0, 0.0, 1.0)]
    if kind == 'revolute':
        return Transform(rotation_about(axes[0], position[0]))
    if kind == 'universal':
        return (Transform(rotation_about(axes[0], position[0]))
                @ Transform(rotation_about(axes[-1], position[1])))
    if kind == 'prismatic':
        return Transform(translation=_scaled_axis(axes[0], position[0]))
    if kind == 'planar':
        u, v = plane(axes[0])
        return (Transform(translation=_scaled_axis(u, position[0]))
                @ Transform(translation=_scaled_axis(v, position[1]))
                @ Transform(rotation_about(axes[0], position[2])))
    x, y, z = position[:3] if kind == 'floating' else ZERO
    roll, pitch, yaw = position[-3:]
    return Transform(rotation_of_rpy((roll, pitch, yaw)), (x, y, z))


def with_mimics(robot: Robot, positions: Positions) -> dict[str, Sequence[float]]:
    """
    Return joint positions with those of mimic joints computed from the joints that they follow.

    :raises DescriptionError: joints mimic each other in a cycle.
    """
    result = dict(positions)
    for joint in check_mimic_cycles(robot):
        if any(axis.mimic for axis in joint.axes):
            result[joint.name] = _mimic_position(joint, result)
    return result


def check_mimic_cycles(robot: Robot) -> list[Joint]:
    """
    Check that no joint mimics itself, directly or through other joints.

    :returns: all joints, each after the joints that it mimics.
    :raises DescriptionError: there is such a cycle.
    """
    joints = {joint.name: joint for joint in robot.joints}
    leaders = {joint.name: [axis.mimic.joint for axis in joint.axes
                            if axis.mimic and axis.mimic.joint in joints]
               for joint in robot.joints}
    try:
        return [joints[name] for name in TopologicalSorter(leaders).static_order()]
    except CycleError as err:
        err.args[1].reverse()  # each joint before the joint that it mimics
        raise DescriptionError(f'mimic cycle: {cycle_text(err)}', source=robot.source,
                               line=joints[err.args[1][0]].line, tag='joint') from err


def _mimic_position(joint: Joint, positions: Positions) -> tuple[float, ...]:
    position = [*positions.get(joint.name, ())]
    position += [0.0] * (joint.kind.dof - len(position))
    for index, axis in enumerate(joint.axes[:len(position)]):
        if axis.mimic:
            leader = (positions.get(axis.mimic.joint) or (0.0,))[0]
            position[index] = axis.mimic.multiplier * leader + axis.mimic.offset
    return tuple(position)


def _scaled_axis(axis: Vector, distance: float) -> Vector:
    x, y, z = normalised(axis)
    return (x * distance, y * distance, z * distance)


def plane(normal: Vector) -> tuple[Vector, Vector]:
    """Return two directions across a normal, the same for the same normal."""
    x, y, z = normalised(normal)
    # No usual axis has a component near 0.55, so rounding does not change the choice.
    u = (0.0, z, -y) if abs(x) < 0.55 else (-z, 0.0, x)
    return u, (y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0])
