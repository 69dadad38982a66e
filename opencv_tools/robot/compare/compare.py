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

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
import math
import random

from opencv_tools.robot.compare.dynamics import ENERGY, whole_properties
from opencv_tools.robot.compare.properties import format_pair, random_position
from opencv_tools.robot.compare.side import Item, Key, Poses, shapes_of, Side
from opencv_tools.robot.kinematics import with_mimics
from opencv_tools.robot.model import MODEL, Robot
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.output import aligned

_HEADING = ('element', 'name', 'property', 'a', 'b', 'difference')
# The tolerance of these properties is always relative, because robots have very small values.
_RELATIVE = ('mass', 'inertia', ENERGY)
# Positions at which the robots as a whole are compared, and how much more their sums may differ
# than their numbers.
_WHOLES, _SUMS = 4, 1000


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


def differences(a: Robot, b: Robot, *, samples: int = 20, tolerance: float = 1e-9,
                seed: int = 0, everything: bool = False) -> list[Difference]:
    """
    Return the differences between two robots, in the order of the first robot.

    The last ones are of the robots as a whole, see `dynamics.whole_properties`.

    Links, joints and frames are matched by name. A name ``a::b`` of SDF matches ``a__b``, and a
    name that a conversion changed matches the original name. Visuals and collisions of a link are
    matched by name if all have unique names in both robots, else by their order. A frame that
    only one robot has, an empty link ``world`` and names of materials are no difference.

    :param samples: number of random joint positions within the limits at which poses are
        compared, in addition to zero. Poses are relative to the first root link of both robots.
    :param tolerance: greatest difference of lengths in metres, angles in radians and other numbers
        up to 1. It is relative for larger numbers, for masses and for moments of inertia.
    :param everything: whether all other elements are compared too, such as friction, sensors and
        plugins, and the presence of frames.
    :raises DescriptionError: the frames or mimics of a robot have a cycle, or poses are too large.
    """
    sides = Side(a), Side(b)
    base, skipped, ordered = _common_base(*sides), _skipped_worlds(*sides), ordered_shapes(*sides)
    items = [side.items(base, skipped, ordered, everything) for side in sides]
    found: dict[Key, list[Difference]] = {key: [] for side in items for key in side}
    for key, result in found.items():
        if key in items[0] and key in items[1]:
            result.extend(_property_differences(key, items[0][key], items[1][key], tolerance))
        elif _presence_matters(key, sides, everything):
            one, other = (_presence(side.get(key)) for side in items)
            result.append(_difference(key, 'presence', one, other))
    equal = [key for key in items[0] if key in items[1]]
    generator, wholes = random.Random(seed), list[list[Poses]]()
    for sample in range(samples + 1):
        # At zero, mimic joints are not moved: formats place links without regard to mimics.
        positions = _positions(*sides, generator) if sample else ({}, {})
        poses = [side.poses(base, values) for side, values in zip(sides, positions)]
        if sample < _WHOLES:
            wholes.append(poses)
        name = 'pose at random positions' if sample else 'pose at zero'
        different = dict(_pose_differences(equal, name, items, poses, tolerance))
        for key, difference in different.items():
            found[key].append(difference)
        equal = [key for key in equal if key not in different]
    velocities = defaultdict[str, list[float]](
        lambda: [generator.uniform(-1, 1) for _ in range(6)])
    whole, whole_b = (Item(MODEL, properties=whole_properties(side, places, velocities))
                      for side, places in zip(sides, zip(*wholes)))
    return [*(difference for result in found.values() for difference in result),
            *_property_differences(('robot', ''), whole, whole_b, _SUMS * tolerance)]


def table(found: Sequence[Difference], most: int | None = None) -> str:
    """
    Return a heading, one line for each difference, and the number of differences.

    :param most: greatest number of lines for differences; None for all.
    :returns: the lines, or an empty string if there are no differences.
    """
    if not found:
        return ''
    rows = [(row.element, row.name, row.property, row.a, row.b,
             f'{row.size:.3g}' if row.size else '') for row in found[:most]]
    lines = [aligned([_HEADING, *rows])]
    if len(found) > len(rows):
        lines.append(f'... and {len(found) - len(rows)} more; --all shows them')
    return '\n'.join([*lines, '1 difference' if len(found) == 1 else f'{len(found)} differences'])


def _common_base(a: Side, b: Side) -> str:
    """Return the base of all poses: the first root link of both robots, or else the first link."""
    common = [key for key in a.links if key in b.links
              and not a.is_unused_world(key) and not b.is_unused_world(key)]
    roots_a, roots_b = set(a.kinematics.roots), set(b.kinematics.roots)
    roots = (key for key in common
             if a.links[key].name in roots_a and b.links[key].name in roots_b)
    return next(roots, common[0] if common else '')


def ordered_shapes(a: Side, b: Side) -> set[Key]:
    """Return the links whose visuals or collisions lack unique names, by element and name."""
    return {(element, key) for side in (a, b) for key, link in side.links.items()
            for element, shapes in shapes_of(link)
            if len({shape.name for shape in shapes if shape.name}) < len(shapes)}


def _skipped_worlds(a: Side, b: Side) -> set[str]:
    """Return the empty world links that only one robot has or that no joint uses."""
    return {key for side, other in ((a, b), (b, a)) for key, link in side.links.items()
            if link.is_world and (key not in other.links or side.is_unused_world(key))}


def _presence_matters(key: Key, sides: tuple[Side, Side], everything: bool) -> bool:
    """Return whether a missing object is a difference; contents of a missing link are not."""
    element, name = key
    if element == 'frame':
        return everything
    link = name if element == 'inertial' else name.rpartition('/')[0]
    return element in ('link', 'joint') or all(link in side.links for side in sides)


def _presence(item: Item | None) -> str:
    """Return whether an object is there; of an inertial the mass, which may be a default."""
    if item is None:
        return 'no'
    mass = item.properties.get('mass')
    return f'{mass[0]:g} kg' if isinstance(mass, tuple) else 'yes'


def _positions(a: Side, b: Side, generator: random.Random
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


def _pose_differences(keys: Iterable[Key], name: str, items: Sequence[Mapping[Key, Item]],
                      poses: Sequence[Poses], tolerance: float
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


def _property_differences(key: Key, item_a: Item, item_b: Item, tolerance: float
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
