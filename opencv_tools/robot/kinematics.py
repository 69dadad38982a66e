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

"""Where the frames of a robot are, at zero and at any position of its joints."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from opencv_tools.robot.model import FrameId, Joint, MODEL, Placement, Robot
from opencv_tools.robot.pose import (
    IDENTITY, normalised, Pose, rotation_about, rotation_of_rpy, Transform, Vector, ZERO)
from opencv_tools.robot.xml.document import DescriptionError


class Kinematics:
    """The frames of a robot, each placed in another one, and the tree of its links."""

    def __init__(self, robot: Robot) -> None:
        """
        Lay out the frames.

        :param robot: its links and joints fit each other, as the readers see to.
        """
        self.robot = robot
        self._placements = {frame: thing.placement for frame, thing in robot.framed()}
        self._poses: dict[FrameId, Transform] = {MODEL: IDENTITY}
        self._origins: dict[FrameId, FrameId] = {MODEL: MODEL}
        self._steps: dict[tuple[FrameId, FrameId], Transform] = {}
        self.joint_above = {joint.child: joint for joint in robot.joints if not joint.is_loop}
        self.joints_below: dict[str, list[Joint]] = {link.name: [] for link in robot.links}
        for joint in self.joint_above.values():
            self.joints_below[joint.parent].append(joint)

    @property
    def roots(self) -> list[str]:
        """Name the links that no joint places."""
        return [link.name for link in self.robot.links if link.name not in self.joint_above]

    def links_below(self, roots: Iterable[str]) -> list[str]:
        """Name links and all that hang on them, each after the one it hangs on."""
        names = list(roots)
        for name in names:
            names.extend(joint.child for joint in self.joints_below[name])
        return names

    def pose(self, frame: FrameId) -> Transform:
        """
        Give where a frame is in the model, with every joint at zero.

        :raises DescriptionError: it is placed in a frame that there is not, or in itself.
        """
        chain = []
        while frame not in self._poses:
            chain.append(frame)
            frame = self._placed_in(frame)
            if len(chain) > len(self._placements):
                raise self._error(f'{_text(frame)} is placed relative to itself, by way of others')
        for step in reversed(chain):
            placement = self._placements[step]
            self._poses[step] = self._poses[placement.relative_to] @ placement.pose.transform()
        return self._poses[chain[0] if chain else frame]

    def placed(self, placement: Placement) -> Transform:
        """Give where a placement is in the model, with every joint at zero."""
        return self.pose(placement.relative_to) @ placement.pose.transform()

    def between(self, base: FrameId, frame: FrameId) -> Pose:
        """
        Give where a frame is in another one, with every joint at zero.

        :returns: the numbers as they were written, where they were written in that other frame.
        """
        return self.within(base, Placement(Pose(), frame))

    def within(self, base: FrameId, placement: Placement) -> Pose:
        """Give where a placement is in a frame, by `between`'s rule."""
        origin, home = self._origin(placement.relative_to), self._origin(base)
        if origin == home:
            return placement.pose
        if placement.pose.is_identity and origin != MODEL:
            written = self._placements[origin]
            if self._origin(written.relative_to) == home:
                return written.pose
        return (self.pose(base).inverse() @ self.placed(placement)).pose()

    def at(self, positions: Mapping[str, Sequence[float]]) -> dict[FrameId, Transform]:
        """
        Give where links, joints and frames are in the model, the root where it is at zero.

        :param positions: of each joint by name, as many numbers as its ``kind.dof``; where none
            are given the joint is at zero. What mimics has to be in it: see `with_mimics`.
        :returns: a joint's frame is the one that it moves; that of a joint that closes a loop
            moves with the child.
        """
        poses = {FrameId('link', name): self.pose(FrameId('link', name)) for name in self.roots}
        for name in self.links_below(self.roots):
            link = FrameId('link', name)
            for joint in self.joints_below[name]:
                frame, child = FrameId('joint', joint.name), FrameId('link', joint.child)
                poses[frame] = (poses[link] @ self._step(link, frame)
                                @ joint_transform(joint, positions.get(joint.name, ())))
                poses[child] = poses[frame] @ self._step(frame, child)
        for joint in self.robot.joints:
            if joint.is_loop:
                frame, child = FrameId('joint', joint.name), FrameId('link', joint.child)
                poses[frame] = poses[child] @ self._step(child, frame)
        for frame, link in (self.carriers().items() if self.robot.frames else ()):
            poses[frame] = poses[link] @ self._step(link, frame)
        return poses

    def _step(self, base: FrameId, frame: FrameId) -> Transform:
        """Give `between` as a transform, worked out once."""
        if (base, frame) not in self._steps:
            self._steps[base, frame] = self.between(base, frame).transform()
        return self._steps[base, frame]

    def carriers(self) -> dict[FrameId, FrameId]:
        """Give the link that each of the robot's own frames moves with."""
        robot = self.robot
        bodies = [link.name for link in robot.links if not link.is_world]
        canonical = robot.canonical_link or (bodies or [link.name for link in robot.links])[0]
        above = {FrameId('frame', frame.name): frame.attached_to for frame in robot.frames}
        above.update((FrameId('joint', joint.name), FrameId('link', joint.child))
                     for joint in robot.joints)
        above[MODEL] = FrameId('link', canonical)
        carriers: dict[FrameId, FrameId] = {}
        for own in robot.frames:
            chain = [FrameId('frame', own.name)]
            while chain[-1] in above and chain[-1] not in carriers:
                chain.append(above[chain[-1]])
                if len(chain) > len(above) + 1:
                    raise self._error(f'{_text(chain[0])} is attached to itself, by way of others')
            link = carriers.get(chain[-1], chain[-1])
            if link.kind != 'link' or link.name not in self.joints_below:
                raise self._error(f'there is no {_text(link)} to attach {_text(chain[0])} to')
            carriers.update((frame, link) for frame in chain if frame.kind == 'frame')
        return carriers

    def _placed_in(self, frame: FrameId) -> FrameId:
        try:
            return self._placements[frame].relative_to
        except KeyError:
            raise self._error(f'there is no {_text(frame)} to be placed relative to') from None

    def _origin(self, frame: FrameId) -> FrameId:
        """Name the first of the frames that lie exactly where a frame does."""
        chain = []
        while frame not in self._origins:
            chain.append(frame)
            placed_in = self._placed_in(frame)
            if not self._placements[frame].pose.is_identity:
                self._origins[frame] = frame
            elif len(chain) > len(self._placements):
                raise self._error(f'{_text(frame)} is placed relative to itself, by way of others')
            else:
                frame = placed_in
        for step in chain:
            self._origins[step] = self._origins[frame]
        return self._origins[frame]

    def _error(self, message: str) -> DescriptionError:
        return DescriptionError(message, source=self.robot.source)


def joint_transform(joint: Joint, position: Sequence[float]) -> Transform:
    """
    Give where the moving frame of a joint is in its frame at zero.

    :param position: radians for turns, metres for shifts; a ball joint's roll, pitch and yaw, a
        floating one's x, y, z and those, and a planar one's two shifts in its plane and turn.
        Empty for zero.
    """
    kind = joint.kind.name
    if not position or not joint.kind.dof:
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
        one, other = _plane(axes[0])
        return (Transform(translation=_scaled_axis(one, position[0]))
                @ Transform(translation=_scaled_axis(other, position[1]))
                @ Transform(rotation_about(axes[0], position[2])))
    x, y, z = position[:3] if kind == 'floating' else ZERO
    roll, pitch, yaw = position[-3:]
    return Transform(rotation_of_rpy((roll, pitch, yaw)), (x, y, z))


def with_mimics(robot: Robot, positions: Mapping[str, Sequence[float]]
                ) -> dict[str, Sequence[float]]:
    """
    Give the positions of all joints: those that mimic follow, whatever was given for them.

    :raises DescriptionError: joints mimic each other in a circle.
    """
    joints = {joint.name: joint for joint in robot.joints}
    result = dict(positions)
    done = {joint.name for joint in robot.joints if not any(axis.mimic for axis in joint.axes)}
    for first in joints:
        # A leader is worked out before those that follow it; a stack, for chains can be long.
        stack: dict[str, None] = {} if first in done else {first: None}
        while stack:
            name = next(reversed(stack))
            leaders = [axis.mimic.joint for axis in joints[name].axes if axis.mimic]
            leader = next((leader for leader in leaders
                           if leader in joints and leader not in done), None)
            if leader is None:
                result[name] = _following(joints[name], result)
                done.add(name)
                stack.popitem()
            elif leader in stack:
                circle = [*stack][[*stack].index(leader):]
                raise DescriptionError(f'mimics itself, by way of {", ".join(sorted(circle))}',
                                       source=robot.source, line=joints[name].line, tag='joint')
            else:
                stack[leader] = None
    return result


def _following(joint: Joint, positions: Mapping[str, Sequence[float]]) -> tuple[float, ...]:
    """Give the position of a joint that mimics, from those that it follows."""
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


def _plane(normal: Vector) -> tuple[Vector, Vector]:
    """Give two directions across a normal, the same for the same normal."""
    x, y, z = normalised(normal)
    # 0.55 because no axis that people write lies near it: rounding must not change the choice.
    one = (0.0, z, -y) if abs(x) < 0.55 else (-z, 0.0, x)
    return one, (y * one[2] - z * one[1], z * one[0] - x * one[2], x * one[1] - y * one[0])


def _text(frame: FrameId) -> str:
    return f'{frame.kind} {frame.name!r}' if frame.name else 'model frame'
