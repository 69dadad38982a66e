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
Comparison of two robots by meaning, whatever their formats and names of elements.

Poses are compared in space, at zero and at random joint positions.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import math
import random
import sys

from opencv_tools.image.text import printable
from opencv_tools.robot.compare.elements import element_properties
from opencv_tools.robot.compare.properties import (
    axis_properties, format_pair, geometry_properties, is_continuous, material_properties,
    Properties, random_position)
from opencv_tools.robot.kinematics import Kinematics, with_mimics
from opencv_tools.robot.model import (
    Frame, FrameId, Joint, Link, MODEL, Placement, Robot, Shape)
from opencv_tools.robot.pose import IDENTITY, rotated_tensor, Transform
from opencv_tools.robot.renaming import flat_name, with_original_names
from opencv_tools.robot.xml.document import DescriptionError

Key = tuple[str, str]  # element and name
_Poses = Mapping[FrameId, Transform]

_HEADING = ('element', 'name', 'property', 'a', 'b', 'difference')
# The tolerance of these properties is always relative, because robots have very small values.
_RELATIVE = ('mass', 'inertia')


@dataclass(frozen=True, kw_only=True)
class Difference:
    """
    A difference between two robots, with the values of both as text.

    :param element: ``link``, ``inertial``, ``visual``, ``collision``, ``joint``, ``frame`` or
        ``robot``.
    :param name: name of the element; for a shape, ``link/name`` or ``link/number``.
    :param property: ``presence``, ``pose at zero``, ``type``, ``upper`` or another property.
    :param size: size of the difference; for a pose in metres or radians, whichever is larger;
        0 for values that are not numbers.
    """

    element: str
    name: str
    property: str  # noqa: A003
    a: str
    b: str
    size: float = 0.0


@dataclass(frozen=True)
class _Item:
    """An object that is compared, with the frame in which it is fixed at an offset."""

    frame: FrameId
    offset: Transform = IDENTITY
    properties: Properties = field(default_factory=dict)


def differences(a: Robot, b: Robot, *, samples: int = 20, tolerance: float = 1e-9,
                seed: int = 0, everything: bool = False) -> list[Difference]:
    """
    Return the differences between two robots, in the order of the first robot.

    Links, joints and frames are matched by name. A name ``a::b`` of SDF matches ``a__b``, and a
    name that a conversion changed matches the original name. Visuals and collisions of a link are
    matched by name if all have unique names in both robots, else by their order. A frame that
    only one robot has, an empty link ``world`` and names of materials are no difference.

    :param samples: number of random joint positions within the limits at which poses are
        compared, in addition to zero. Poses are relative to the first root link of both robots.
    :param tolerance: greatest difference of lengths in metres, angles in radians and other numbers
        up to 1. It is relative for larger numbers, for masses and for moments of inertia.
    :param seed: seed of the random positions.
    :param everything: whether all other elements are compared too, such as friction, sensors and
        plugins, and the presence of frames.
    :raises DescriptionError: the frames or mimics of a robot have a cycle, or poses are too large.
    """
    sides = _Side(with_original_names(a)), _Side(with_original_names(b))
    base, skipped, ordered = _common_base(*sides), _skipped_worlds(*sides), _ordered(*sides)
    items = [side.items(base, skipped, ordered, everything) for side in sides]
    found: dict[Key, list[Difference]] = {key: [] for side in items for key in side}
    for key, result in found.items():
        if key in items[0] and key in items[1]:
            result.extend(_property_differences(key, items[0][key], items[1][key], tolerance))
        elif _presence_matters(key, sides, everything):
            present = ('yes', 'no') if key in items[0] else ('no', 'yes')
            result.append(_difference(key, 'presence', *present))
    equal = [key for key in items[0] if key in items[1]]
    generator = random.Random(seed)
    for sample in range(samples + 1):
        # At zero, mimic joints are not moved: formats place links without regard to mimics.
        positions = _positions(*sides, generator) if sample else ({}, {})
        poses = [side.poses(base, values) for side, values in zip(sides, positions)]
        name = 'pose at random positions' if sample else 'pose at zero'
        different = dict(_pose_differences(equal, name, items, poses, tolerance))
        for key, difference in different.items():
            found[key].append(difference)
        equal = [key for key in equal if key not in different]
    return [difference for result in found.values() for difference in result]


def table(found: Sequence[Difference], most: int | None = None) -> str:
    """
    Return a heading, one line for each difference, and the number of differences.

    :param most: greatest number of lines for differences; None for all.
    :returns: the lines, or an empty string if there are no differences.
    """
    if not found:
        return ''
    rows = [_HEADING, *(
        tuple(printable(cell, sys.maxsize) for cell in (
            row.element, row.name, row.property, row.a, row.b,
            f'{row.size:.3g}' if row.size else ''))
        for row in found[:most])]
    widths = [max(map(len, column)) for column in zip(*rows)]
    lines = ['  '.join(map(str.ljust, row, widths)).rstrip() for row in rows]
    if len(found) >= len(rows):
        lines.append(f'... and {len(found) - len(rows) + 1} more; --all shows them')
    return '\n'.join([*lines, '1 difference' if len(found) == 1 else f'{len(found)} differences'])


class _Side:
    """One of the two robots, with its objects by names that are the same in both formats."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.kinematics = Kinematics(robot)
        self.links = dict(zip(_keys(link.name for link in robot.links), robot.links))
        self.joints = dict(zip(_keys(joint.name for joint in robot.joints), robot.joints))
        self.frames = dict(zip(_keys(frame.name for frame in robot.frames), robot.frames))

    def items(self, base: str, skipped: set[str], ordered: set[Key], everything: bool
              ) -> dict[Key, _Item]:
        """Return all objects that are compared, by element and name."""
        def kept(owner: Robot | Link | Joint | Frame | Shape) -> Properties:
            return element_properties(owner.extension) if everything else {}

        to_base = self.kinematics.pose(self._base_frame(base)).inverse()
        items = {}
        if everything:
            items['robot', ''] = _Item(self._base_frame(base), IDENTITY, {
                'name': self.robot.name, **kept(self.robot)})
        for key, link in self.links.items():
            if key in skipped:
                continue
            frame = FrameId('link', link.name)
            items['link', key] = _Item(frame, IDENTITY, kept(link))
            if link.inertial:
                # The axes of the moments are arbitrary, so the moments are rotated into the base.
                offset = self._offset(link, link.inertial.placement)
                rotation = (to_base @ self.kinematics.pose(frame) @ offset).rotation
                items['inertial', key] = _Item(frame, Transform(translation=offset.translation), {
                    'mass': (link.inertial.mass,),
                    'inertia': rotated_tensor(link.inertial.inertia, rotation)})
            for element, shapes in _shapes(link):
                names = (map(str, range(len(shapes))) if (element, key) in ordered
                         else (shape.name for shape in shapes))
                for name, shape in zip(names, shapes):
                    items[element, f'{key}/{name}'] = _Item(
                        frame, self._offset(link, shape.placement),
                        {**geometry_properties(shape), **material_properties(shape.material),
                         **kept(shape)})
        for key, joint in self.joints.items():
            items['joint', key] = _Item(
                FrameId('joint', joint.name), IDENTITY,
                {**self._joint_properties(joint, to_base), **kept(joint)})
        for key, other in self.frames.items():
            items['frame', key] = _Item(FrameId('frame', other.name), IDENTITY, kept(other))
        return items

    def poses(self, base: str, positions: Mapping[str, Sequence[float]]) -> _Poses:
        """Return the poses of links, joints and frames in the base link."""
        poses = self.kinematics.forward(positions)
        to_base = poses.get(self._base_frame(base), IDENTITY).inverse()
        return {frame: to_base @ pose for frame, pose in poses.items()}

    def is_unused_world(self, key: str) -> bool:
        """Return whether a link is an empty world without joints to other links."""
        link = self.links[key]
        return link.is_world and not self.kinematics.child_joints[link.name]

    def _base_frame(self, base: str) -> FrameId:
        return FrameId('link', self.links[base].name) if base else MODEL

    def _offset(self, link: Link, placement: Placement) -> Transform:
        return self.kinematics.within(FrameId('link', link.name), placement).transform()

    def _joint_properties(self, joint: Joint, to_base: Transform) -> Properties:
        pose = to_base @ self.kinematics.pose(FrameId('joint', joint.name))
        continuous = is_continuous(joint)
        properties: Properties = {
            'type': 'continuous' if continuous else joint.type,
            'parent': flat_name(joint.parent), 'child': flat_name(joint.child),
            'closes a loop': 'yes' if joint.is_loop else 'no'}
        for index, axis in enumerate(joint.axes[:joint.kind.axes]):
            suffix = ' of axis2' if index else ''
            properties.update((f'{name}{suffix}', value)
                              for name, value in axis_properties(axis, pose).items()
                              if not (continuous and name in ('lower', 'upper')))
        return properties


def _shapes(link: Link) -> tuple[tuple[str, tuple[Shape, ...]], ...]:
    return ('visual', link.visuals), ('collision', link.collisions)


def _keys(names: Iterable[str]) -> list[str]:
    """Return names as both formats write them; unchanged names if that would make two equal."""
    originals = list(names)
    keys = list(map(flat_name, originals))
    return keys if len(set(keys)) == len(set(originals)) else originals


def _common_base(a: _Side, b: _Side) -> str:
    """Return the base of all poses: the first root link of both robots, or else the first link."""
    common = [key for key in a.links if key in b.links
              and not a.is_unused_world(key) and not b.is_unused_world(key)]
    roots_a, roots_b = set(a.kinematics.roots), set(b.kinematics.roots)
    roots = (key for key in common
             if a.links[key].name in roots_a and b.links[key].name in roots_b)
    return next(roots, common[0] if common else '')


def _ordered(a: _Side, b: _Side) -> set[Key]:
    """Return the links whose visuals or collisions lack unique names, by element and name."""
    return {(element, key) for side in (a, b) for key, link in side.links.items()
            for element, shapes in _shapes(link)
            if len({shape.name for shape in shapes if shape.name}) < len(shapes)}


def _skipped_worlds(a: _Side, b: _Side) -> set[str]:
    """Return the empty world links that only one robot has or that no joint uses."""
    return {key for side, other in ((a, b), (b, a)) for key, link in side.links.items()
            if link.is_world and (key not in other.links or side.is_unused_world(key))}


def _presence_matters(key: Key, sides: tuple[_Side, _Side], everything: bool) -> bool:
    """Return whether a missing object is a difference; contents of a missing link are not."""
    element, name = key
    if element == 'frame':
        return everything
    link = name if element == 'inertial' else name.rpartition('/')[0]
    return element in ('link', 'joint') or all(link in side.links for side in sides)


def _positions(a: _Side, b: _Side, generator: random.Random
               ) -> tuple[dict[str, Sequence[float]], dict[str, Sequence[float]]]:
    """
    Return random joint positions of both robots.

    Joints that have one name and one kind in both robots get the same position. Mimic joints get
    the positions that follow from the joints that they mimic.
    """
    positions: tuple[dict[str, Sequence[float]], ...] = {}, {}
    for key in sorted({*a.joints, *b.joints}):
        joints = [side.joints.get(key) for side in (a, b)]
        first = next(joint for joint in joints if joint)
        position = random_position(first, generator)
        for chosen, joint in zip(positions, joints):
            if joint and joint.kind == first.kind:
                chosen[joint.name] = position
    return with_mimics(a.robot, positions[0]), with_mimics(b.robot, positions[1])


def _pose_differences(keys: Iterable[Key], name: str, items: Sequence[Mapping[Key, _Item]],
                      poses: Sequence[_Poses], tolerance: float
                      ) -> Iterator[tuple[Key, Difference]]:
    for key in keys:
        a, b = (pose[item[key].frame] @ item[key].offset for pose, item in zip(poses, items))
        distance = math.dist(a.translation, b.translation)
        if not math.isfinite(distance):
            raise DescriptionError(f'{key[0]} {key[1]!r} is too far away for floating-point '
                                   'numbers')
        scale = max(1.0, math.hypot(*a.translation), math.hypot(*b.translation))
        # The distance of two rotation matrices is sin(angle / 2) * sqrt(8). Unlike the cosine,
        # it is exact for small angles.
        sine = math.dist(a.rotation, b.rotation) / math.sqrt(8.0)
        # The rotation of an inertial is part of its moments.
        angle = 0.0 if key[0] == 'inertial' else 2 * math.asin(min(1.0, sine))
        if distance > tolerance * scale or angle > tolerance:
            texts = format_pair(*((*pose.xyz, *pose.rpy) for pose in (a.pose(), b.pose())))
            yield key, _difference(key, name, *texts, size=max(distance, angle))


def _property_differences(key: Key, item_a: _Item, item_b: _Item, tolerance: float
                          ) -> Iterator[Difference]:
    for name in {**item_a.properties, **item_b.properties}:
        a, b = (item.properties.get(name, 'none') for item in (item_a, item_b))
        size = 0.0
        if isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b):
            size = max(abs(x - y) for x, y in zip(a, b))
            scale = max(0.0 if name in _RELATIVE else 1.0, *map(abs, a + b))
            if size <= tolerance * scale:
                continue
        if a != b:
            yield _difference(key, name, *format_pair(a, b), size=size)


def _difference(key: Key, name: str, a: str, b: str, size: float = 0.0) -> Difference:
    return Difference(element=key[0], name=key[1], property=name, a=a, b=b, size=size)
