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

"""Names that the other format accepts, and those of before where they are known."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container, Iterator, Mapping
from dataclasses import replace
import itertools
from typing import TypeVar

from lxml import etree
from opencv_tools.robot.model import (
    Axis, Extension, Frame, FrameId, Joint, Link, Robot, Shape, WORLD)
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.tracked import detached

Named = TypeVar('Named', Robot, Link, Joint, Frame, Shape)
_Names = Mapping[FrameId, str]


def with_valid_sdf_names(robot: Robot, report: Report) -> Robot:
    """
    Give a robot, its links, joints and frames names that SDF allows, and shapes any at all.

    SDF has each name but once, and keeps ``world``, ``__name__`` and what has ``::`` in it for
    itself. The names of before are kept for the way back.
    """
    name = free_name(allowed_name(robot.name), {WORLD}, '_model')
    if name != robot.name:
        _note(report, 'robot', robot.name, 0, name)
        robot = replace(robot, name=name,
                        extension=_keeping_name('robot', robot.name, robot.extension))
    taken = {WORLD}
    names: dict[FrameId, str] = {}
    for frame, thing in robot.frame_owners():
        if isinstance(thing, Link) and thing.is_world:
            continue
        name = free_name(allowed_name(thing.name), taken, f'_{frame.kind}')
        taken.add(name)
        if name != thing.name:
            names[frame] = name
            _note(report, frame.kind, thing.name, thing.line, name)
    robot = renamed(robot, names, keep=True)
    return replace(robot, links=tuple(_with_shape_names(link, report) for link in robot.links))


def _note(report: Report, kind: str, name: str, line: int, new: str) -> None:
    report.warn(kind, name, line, 'SDF wants each name once and has some for itself; it is called '
                f'{new!r} there')


def with_valid_urdf_names(robot: Robot, report: Report) -> Robot:
    """Return a robot without ``::`` in its names, because tf and other tools do not read it."""
    if '::' in robot.name:
        name = flat_name(robot.name)
        report.warn('model', robot.name, 0, f'URDF has no nested models; it is called {name!r} '
                    'there')
        robot = replace(robot, name=name)
    names: dict[FrameId, str] = {}
    taken: dict[str, set[str]] = defaultdict(set)
    for frame, _ in robot.frame_owners():
        taken[frame.kind].add(frame.name)
    for frame, thing in robot.frame_owners():
        if '::' in thing.name:
            name = free_name(flat_name(thing.name), taken[frame.kind], f'_{frame.kind}')
            taken[frame.kind].add(name)
            names[frame] = name
            if not name.endswith('__model__'):
                report.warn(frame.kind, thing.name, thing.line, 'URDF has no nested models; it is '
                            f'called {name!r} there')
    return renamed(robot, names)


def with_original_names(robot: Robot) -> Robot:
    """
    Give what `with_valid_sdf_names` renamed the names of before.

    :raises DescriptionError: one of them is taken.
    """
    names = {frame: own for frame, thing in robot.frame_owners()
             if (own := _own_name(thing.extension))}
    taken: set[FrameId] = set()
    for frame, thing in robot.frame_owners():
        named = _id(frame, names)
        if named in taken:
            raise DescriptionError(f'urdf:name={named.name!r} is the name of another {frame.kind} '
                                   'too', source=robot.source, line=thing.line, tag=frame.kind)
        taken.add(named)
    robot, = _without_own_names((renamed(robot, names),))
    return replace(
        robot, joints=_without_own_names(robot.joints), frames=_without_own_names(robot.frames),
        links=tuple(map(_with_own_shape_names, _without_own_names(robot.links))))


def _with_own_shape_names(link: Link) -> Link:
    """Return a link whose shapes have the names of before, in its contact sensors too."""
    own_names = {shape.name: own for shape in link.collisions
                 if (own := _own_name(shape.extension))}
    return replace(link, visuals=_without_own_names(link.visuals),
                   collisions=_without_own_names(link.collisions),
                   extension=_with_contacts(link.extension, own_names))


def flat_name(name: str) -> str:
    """Write a name of a nested model without ``::``."""
    return name.replace('::', '__')


def renamed(robot: Robot, names: _Names, *, keep: bool = False) -> Robot:
    """
    Rename links, joints and frames wherever they are named.

    :param keep: whether the names of before are kept for the way back.
    """
    if not names:
        return robot

    def named(kind: str, thing: Named) -> Named:
        new = names.get(FrameId(kind, thing.name))
        if new is None:
            return thing
        carried = _keeping_name(kind, thing.name, thing.extension) if keep else thing.extension
        return replace(thing, name=new, extension=carried)

    def axis(one: Axis) -> Axis:
        mimic = one.mimic
        return replace(one, mimic=mimic and replace(
            mimic, joint=names.get(FrameId('joint', mimic.joint), mimic.joint)))

    def link_name(old: str) -> str:
        return names.get(FrameId('link', old), old)

    robot = replace(
        robot,
        canonical_link=link_name(robot.canonical_link),
        links=tuple(named('link', link) for link in robot.links),
        joints=tuple(replace(
            named('joint', joint), parent=link_name(joint.parent), child=link_name(joint.child),
            axes=tuple(map(axis, joint.axes))) for joint in robot.joints),
        frames=tuple(replace(named('frame', frame), attached_to=_id(frame.attached_to, names))
                     for frame in robot.frames))
    return robot.map_placements(lambda placement: replace(
        placement, relative_to=_id(placement.relative_to, names)))


def _id(frame: FrameId, names: _Names) -> FrameId:
    return FrameId(frame.kind, names.get(frame, frame.name))


def allowed_name(name: str) -> str:
    """Take from a name what SDF keeps for itself."""
    name = flat_name(name)
    if len(name) > 3 and name.startswith('__') and name.endswith('__'):
        name = name.strip('_') or 'unnamed'
    return name


def free_name(name: str, taken: Container[str], suffix: str) -> str:
    """Give a name that is not taken: as it is, with a suffix, or with a number too."""
    return name if name not in taken else next_free(numbered(name + suffix), taken)


def numbered(name: str) -> Iterator[str]:
    """Return a name as it is, and then with the numbers from 1."""
    yield name
    for number in itertools.count(1):
        yield f'{name}_{number}'


def next_free(names: Iterator[str], taken: Container[str]) -> str:
    """Return the next name that is not taken."""
    return next(name for name in names if name not in taken)


def _with_shape_names(link: Link, report: Report) -> Link:
    """
    Give each visual and collision of a link a name that no other there has.

    Of two of one name the visual gives way, for contact sensors name collisions.
    """
    shapes = {'collision': link.collisions, 'visual': link.visuals}
    others = {name for part in (link.extension.sdf if link.extension.sdf is not None else ())
              if part.tag != 'plugin' and (name := part.get('name'))}
    # What has a name of its own comes first, so that none that is made up takes it.
    taken = {*others, *(shape.name for things in shapes.values() for shape in things)}
    seen = set(others)
    result: dict[str, tuple[Shape, ...]] = {}
    collisions: dict[str, str] = {}  # new names by those of before
    for tag, things in shapes.items():
        named, made_up = [], numbered(f'{link.name}_{tag}')
        for shape in things:
            name = allowed_name(shape.name)
            if not name or name == WORLD or name in seen:
                name = next_free(made_up, taken)
            if tag == 'collision' and shape.name:
                collisions.setdefault(shape.name, name)
            if shape.name and name != shape.name:
                report.warn(tag, shape.name, shape.line, 'SDF wants each name once in a link; it '
                            f'is called {name!r} there')
                shape = replace(shape, extension=_keeping_name(tag, shape.name, shape.extension))
            taken.add(name)
            seen.add(name)
            named.append(replace(shape, name=name))
        result[tag] = tuple(named)
    return replace(link, visuals=result['visual'], collisions=result['collision'],
                   extension=_with_contacts(link.extension, collisions))


def _with_contacts(extension: Extension, names: Mapping[str, str]) -> Extension:
    """Rename the collisions that the contact sensors of a link name."""
    if extension.sdf is None or all(old == new for old, new in names.items()):
        return extension
    rest = detached(extension.sdf)
    for collision in rest.iterfind('sensor/contact/collision'):
        name = (collision.text or '').strip()
        collision.text = names.get(name, collision.text)
    return replace(extension, sdf=rest)


def _keeping_name(tag: str, name: str, extension: Extension) -> Extension:
    rest = etree.Element(tag) if extension.urdf is None else detached(extension.urdf)
    rest.set('name', name)
    return replace(extension, urdf=rest)


def _own_name(extension: Extension) -> str:
    return '' if extension.urdf is None else extension.urdf.get('name', '')


def _without_own_names(things: tuple[Named, ...]) -> tuple[Named, ...]:
    """Give shapes the names of before, and take from all what kept them."""
    result = []
    for thing in things:
        own = _own_name(thing.extension)
        if own and thing.extension.urdf is not None:
            rest = detached(thing.extension.urdf)
            del rest.attrib['name']
            kept = rest if len(rest) or rest.attrib else None
            thing = replace(thing, name=own, extension=replace(thing.extension, urdf=kept))
        result.append(thing)
    return tuple(result)
