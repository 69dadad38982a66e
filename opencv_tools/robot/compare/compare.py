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

"""
Whether two descriptions mean the same robot, in whatever format and words they were written.

All is compared by what it means: placed in space, at zero and with the joints moved.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
import math
import random

from opencv_tools.robot.compare.properties import (
    axis_properties, Facts, geometry_properties, is_continuous, of_material, texts)
from opencv_tools.robot.compare.sampling import random_position
from opencv_tools.robot.kinematics import Kinematics, with_mimics
from opencv_tools.robot.model import (
    FrameId, Inertial, Joint, Link, MODEL, Placement, Robot, Shape)
from opencv_tools.robot.pose import IDENTITY, Transform, turned_tensor
from opencv_tools.robot.renaming import flat_name, with_original_names

Key = tuple[str, str]  # element and name
_Positions = dict[str, Sequence[float]]

# Compared by their own size however small: there is much light and little in a robot.
_RELATIVE = ('mass', 'inertia')


@dataclass(frozen=True)
class Difference:
    """
    One thing that is not the same.

    :param element: ``link``, ``inertial``, ``visual``, ``collision``, ``joint`` or ``frame``.
    :param name: of the element; of what a link has, ``link/name`` or ``link/number``.
    :param what: ``presence``, ``pose at zero``, ``type``, ``upper``, ...
    :param a: what the first robot has, as text.
    :param b: what the second one has.
    :param size: by how much: metres or radians, whichever is more, of a pose; the largest
        difference of numbers; 0 where there are none.
    """

    element: str
    name: str
    what: str
    a: str
    b: str
    size: float = 0.0


@dataclass(frozen=True)
class _Item:
    """Something that is compared: where it is placed, and what else is said of it."""

    frame: FrameId
    offset: Transform = IDENTITY
    facts: Facts = field(default_factory=dict)


def differences(a: Robot, b: Robot, *, samples: int = 20, tolerance: float = 1e-9,
                seed: int = 0) -> list[Difference]:
    """
    Tell in what two robots differ, in the order of the first one.

    Links, joints and frames are found by name, where ``a::b`` of SDF is ``a__b`` and a name that
    a conversion changed is the one before. Visuals and collisions of a link are found by name
    where all have one of their own in both robots, else by their order. A frame that only one
    robot has, an empty link ``world`` and names of materials are no difference.

    :param samples: at how many random positions of the joints, within their limits, poses are
        compared beside zero. They are compared relative to the first root of both robots.
    :param tolerance: how far lengths in metres, angles in radians and other numbers up to 1 may
        be apart, and larger ones and masses and moments of inertia by this part of them.
    :param seed: of the random positions.
    :raises DescriptionError: the frames or mimics of one go round in a circle.
    """
    sides = _Side(with_original_names(a)), _Side(with_original_names(b))
    base, skipped, ordered = _common_base(*sides), _without_world(*sides), _ordered(*sides)
    items = [side.items(base, skipped, ordered) for side in sides]
    found: dict[Key, list[Difference]] = {key: [] for one in items for key in one}
    for key, some in found.items():
        if key in items[0] and key in items[1]:
            some.extend(_of_facts(key, items[0][key], items[1][key], tolerance))
        elif _is_told(key, sides, skipped):
            there = ['yes' if key in one else 'no' for one in items]
            some.append(Difference(*key, 'presence', there[0], there[1]))
    placed = [key for key in items[0] if key in items[1]]
    generator = random.Random(seed)
    for sample in range(samples + 1):
        # Zero is where the formats place all; what mimics with an offset is elsewhere even there.
        positions = _positions(*sides, generator) if sample else ({}, {})
        poses = [side.poses(base, where) for side, where in zip(sides, positions)]
        worst = _worst(placed, items, poses, tolerance)
        for key, (size, places) in worst.items():
            when = 'pose at random positions' if sample else 'pose at zero'
            found[key].append(Difference(*key, when, *places, size))
        # What is elsewhere once need not be looked at again: it would say the same.
        placed = [key for key in placed if key not in worst]
    return [difference for some in found.values() for difference in some]


class _Side:
    """One of both robots, with its objects by the names that both have in common."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.kinematics = Kinematics(robot)
        self.links = dict(zip(_keys(link.name for link in robot.links), robot.links))
        self.joints = dict(zip(_keys(joint.name for joint in robot.joints), robot.joints))
        self.frames = dict(zip(_keys(frame.name for frame in robot.frames), robot.frames))

    def items(self, base: str, skipped: set[str], ordered: set[Key]) -> dict[Key, _Item]:
        """Give all that is compared, by element and name."""
        home = self.kinematics.pose(self._frame(base)).inverse()
        items = {}
        for key, link in self.links.items():
            if key in skipped:
                continue
            items['link', key] = _Item(FrameId('link', link.name))
            if link.inertial:
                items['inertial', key] = self._of_inertial(link, link.inertial, home)
            for element, shapes in (('visual', link.visuals), ('collision', link.collisions)):
                names = (map(str, range(len(shapes))) if (element, key) in ordered
                         else (shape.name for shape in shapes))
                items.update(((element, f'{key}/{name}'), self._of_shape(link, shape))
                             for name, shape in zip(names, shapes))
        for key, joint in self.joints.items():
            items['joint', key] = _Item(FrameId('joint', joint.name), IDENTITY,
                                        self._of_joint(joint, home))
        for key, frame in self.frames.items():
            items['frame', key] = _Item(FrameId('frame', frame.name))
        return items

    def poses(self, base: str, positions: Mapping[str, Sequence[float]]
              ) -> dict[FrameId, Transform]:
        """Give where links, joints and frames are in the base that both robots have."""
        poses = self.kinematics.forward(positions)
        home = poses.get(self._frame(base), IDENTITY).inverse()
        return {frame: home @ pose for frame, pose in poses.items()}

    def is_loose_world(self, key: str) -> bool:
        """Tell whether this is a link that says nothing: a world that nothing is fastened to."""
        link = self.links[key]
        return link.is_world and not self.kinematics.child_joints[link.name]

    def _frame(self, base: str) -> FrameId:
        return FrameId('link', self.links[base].name) if base else MODEL

    def _offset(self, link: Link, placement: Placement) -> Transform:
        return self.kinematics.within(FrameId('link', link.name), placement).transform()

    def _of_inertial(self, link: Link, inertial: Inertial, home: Transform) -> _Item:
        frame = FrameId('link', link.name)
        # Only its centre is placed: the frame of the moments may be any, so they are turned.
        offset = self._offset(link, inertial.placement)
        turned = home @ self.kinematics.pose(frame) @ offset
        return _Item(frame, Transform(translation=offset.translation), {
            'mass': (inertial.mass,), 'inertia': turned_tensor(inertial.inertia, turned.rotation)})

    def _of_shape(self, link: Link, shape: Shape) -> _Item:
        return _Item(FrameId('link', link.name), self._offset(link, shape.placement),
                     {**geometry_properties(shape), **of_material(shape.material)})

    def _of_joint(self, joint: Joint, home: Transform) -> Facts:
        turn = home @ self.kinematics.pose(FrameId('joint', joint.name))
        endless = is_continuous(joint)
        facts: Facts = {
            'type': 'continuous' if endless else joint.type,
            'parent': flat_name(joint.parent), 'child': flat_name(joint.child),
            'closes a loop': 'yes' if joint.is_loop else 'no'}
        for index, axis in enumerate(joint.axes[:joint.kind.axes]):
            suffix = '' if index == 0 else ' of axis2'
            facts.update((f'{what}{suffix}', fact)
                         for what, fact in axis_properties(axis, turn).items()
                         if not (endless and what in ('lower', 'upper')))
        return facts


def _keys(names: Iterable[str]) -> list[str]:
    """Give names as both formats have them; as they are where that would make two the same."""
    written = list(names)
    keys = list(map(flat_name, written))
    return keys if len(set(keys)) == len(set(written)) else written


def _common_base(a: _Side, b: _Side) -> str:
    """Name what all is placed relative to: the first root, or else link, of both."""
    common = [key for key in a.links if key in b.links
              and not a.is_loose_world(key) and not b.is_loose_world(key)]
    roots = set(a.kinematics.roots), set(b.kinematics.roots)
    both = (key for key in common
            if a.links[key].name in roots[0] and b.links[key].name in roots[1])
    return next(both, common[0] if common else '')


def _ordered(a: _Side, b: _Side) -> set[Key]:
    """Name the links whose visuals and collisions have not all got a name of their own."""
    return {(element, key) for side in (a, b) for key, link in side.links.items()
            for element, shapes in (('visual', link.visuals), ('collision', link.collisions))
            if len({shape.name for shape in shapes if shape.name}) < len(shapes)}


def _without_world(a: _Side, b: _Side) -> set[str]:
    """Name the link that stands for the world, where it is in one only or nothing needs it."""
    return {key for side, other in ((a, b), (b, a)) for key, link in side.links.items()
            if link.is_world and (key not in other.links or side.is_loose_world(key))}


def _is_told(key: Key, sides: tuple[_Side, _Side], skipped: set[str]) -> bool:
    """Tell whether it matters that one has not got this: what a missing link has does not."""
    element, name = key
    if element == 'frame':
        return False
    link = name if element == 'inertial' else name.rpartition('/')[0]
    return element in ('link', 'joint') or all(link in side.links for side in sides)


def _positions(a: _Side, b: _Side, generator: random.Random
               ) -> tuple[_Positions, _Positions]:
    """
    Choose positions, the same for joints of one name; zero for one of another kind in b.

    Joints that mimic follow.
    """
    result: tuple[_Positions, _Positions] = ({}, {})
    for key in sorted({*a.joints, *b.joints}):
        joints = [side.joints.get(key) for side in (a, b)]
        first = joints[0] or joints[1]
        if first is None:
            continue
        position = random_position(first, generator)
        for chosen, joint in zip(result, joints):
            if joint and joint.kind == first.kind:
                chosen[joint.name] = position
    return with_mimics(a.robot, result[0]), with_mimics(b.robot, result[1])


def _worst(placed: Iterable[Key], items: Sequence[Mapping[Key, _Item]],
           poses: Sequence[Mapping[FrameId, Transform]], tolerance: float
           ) -> dict[Key, tuple[float, tuple[str, str]]]:
    """Give what is not at one place, by how much, and both places."""
    worst = {}
    for key in placed:
        one, other = (pose[item[key].frame] @ item[key].offset
                      for pose, item in zip(poses, items))
        distance = math.dist(one.translation, other.translation)
        reach = max(1.0, math.hypot(*one.translation), math.hypot(*other.translation))
        # The sine of half the angle between them, times 2 sqrt 2; exact where it is small, unlike
        # the cosine.
        half = math.dist(one.rotation, other.rotation) / math.sqrt(8.0)
        angle = 2 * math.asin(min(1.0, half))
        if key[0] == 'inertial':
            angle = 0.0  # the moments are compared as they are in space
        if distance > tolerance * reach or angle > tolerance:
            worst[key] = max(distance, angle), texts(_numbers(one), _numbers(other))
    return worst


def _numbers(transform: Transform) -> tuple[float, ...]:
    pose = transform.pose()
    return (*pose.xyz, *pose.rpy)


def _of_facts(key: Key, one: _Item, other: _Item, tolerance: float) -> Iterable[Difference]:
    for what in {**one.facts, **other.facts}:
        a, b = one.facts.get(what, 'none'), other.facts.get(what, 'none')
        size = 0.0
        if isinstance(a, tuple) and isinstance(b, tuple):
            size = max(abs(x - y) for x, y in zip(a, b))
            scale = max(map(abs, a + b)) if what in _RELATIVE else max(1.0, *map(abs, a + b))
            if size <= tolerance * scale:
                continue
        if a != b:
            yield Difference(*key, what, *texts(a, b), size)
