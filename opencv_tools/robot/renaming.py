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

"""Names that are valid in the other format, and the original names of converted robots."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

from opencv_tools.robot.lumping import with_massless
from opencv_tools.robot.model import (
    Axis, Extension, FrameId, Joint, Link, Robot, RobotFrame, Shape, WORLD)
from opencv_tools.robot.names import allowed_name, flat_name, Names
from opencv_tools.robot.xml.document import DescriptionError, detached
from opencv_tools.robot.xml.report import Report

_Named = TypeVar('_Named', Robot, Link, Joint, RobotFrame, Shape)
_Names = Mapping[FrameId, str]


def with_valid_sdf_names(robot: Robot, report: Report) -> Robot:
    """
    Return a robot with names that SDF allows, and with a name for each visual and collision.

    SDF requires unique names and reserves ``world``, ``__name__`` and names with ``::``. The
    original names are kept for the round trip.
    """
    name = Names({WORLD}).kept(allowed_name(robot.name), '_model')
    if name != robot.name:
        _warn_renamed(report, 'robot', robot.name, 0, name)
        robot = _with_original_name(robot, name)
    taken = Names({WORLD})
    names: dict[FrameId, str] = {}
    for frame, owner in robot.frame_owners():
        if isinstance(owner, Link) and owner.is_world:
            continue
        name = taken.kept(allowed_name(owner.name), f'_{frame.kind}')
        if name != owner.name:
            names[frame] = name
            _warn_renamed(report, frame.kind, owner.name, owner.line, name)
    robot = renamed(robot, names, keep=True)
    return replace(robot, links=tuple(_with_shape_names(link, report) for link in robot.links))


def _warn_renamed(report: Report, kind: str, name: str, line: int, new: str) -> None:
    report.warn(kind, name, line,
                f'renamed to {new!r}, because SDF requires unique names and reserves some')


def with_valid_urdf_names(robot: Robot, report: Report) -> Robot:
    """Return a robot without ``::`` in its names, because tf and other tools do not read it."""
    message = 'renamed to {!r}, because URDF does not support nested models'
    if '::' in robot.name:
        name = flat_name(robot.name)
        report.warn('model', robot.name, 0, message.format(name))
        robot = replace(robot, name=name)
    names: dict[FrameId, str] = {}
    taken: dict[str, Names] = defaultdict(Names)
    for frame, _ in robot.frame_owners():
        taken[frame.kind].add(frame.name)
    for frame, owner in robot.frame_owners():
        if '::' in owner.name:
            name = taken[frame.kind].kept(flat_name(owner.name), f'_{frame.kind}')
            names[frame] = name
            if not name.endswith('__model__'):
                report.warn(frame.kind, owner.name, owner.line, message.format(name))
    return renamed(robot, names)


def with_original_names(robot: Robot) -> Robot:
    """
    Return a robot from before the conversion to SDF: its names, and links without mass.

    It is undone in the order of `lumping.without_massless` and `with_valid_sdf_names`.

    :raises DescriptionError: an original name is also the name of another element.
    """
    robot = with_massless(robot)
    names = {frame: name for frame, owner in robot.frame_owners()
             if (name := owner.extension.marks.get('name'))}
    taken: set[FrameId] = set()
    for frame, owner in robot.frame_owners():
        original = _new_id(frame, names)
        if original in taken:
            raise DescriptionError(
                f'urdf:name={original.name!r} is also the name of another {frame.kind}; change '
                'one of them', source=robot.source, line=owner.line, tag=frame.kind)
        taken.add(original)
    robot, = _restored((renamed(robot, names),))
    return replace(robot, joints=_restored(robot.joints), frames=_restored(robot.frames),
                   links=tuple(map(_with_original_shape_names, _restored(robot.links))))


def _with_original_shape_names(link: Link) -> Link:
    """Return a link with the original names of its shapes, also in its contact sensors."""
    names = {shape.name: original_name(shape) for shape in link.collisions}
    return replace(link, visuals=_restored(link.visuals), collisions=_restored(link.collisions),
                   extension=_with_contacts(link.extension, names))


def renamed(robot: Robot, names: _Names, *, keep: bool = False) -> Robot:
    """
    Return a robot with links, joints and frames renamed, also where others refer to them.

    :param keep: whether to keep the original names for the round trip.
    """
    if not names:
        return robot

    def rename(kind: str, owner: _Named) -> _Named:
        name = names.get(FrameId(kind, owner.name), owner.name)
        if name == owner.name or not keep:
            return replace(owner, name=name)
        return _with_original_name(owner, name)

    def axis(old: Axis) -> Axis:
        return replace(old, mimic=old.mimic and replace(
            old.mimic, joint=names.get(FrameId('joint', old.mimic.joint), old.mimic.joint)))

    def link_name(name: str) -> str:
        return names.get(FrameId('link', name), name)

    robot = replace(
        robot,
        canonical_link=link_name(robot.canonical_link),
        links=tuple(rename('link', link) for link in robot.links),
        joints=tuple(replace(
            rename('joint', joint), parent=link_name(joint.parent), child=link_name(joint.child),
            axes=tuple(map(axis, joint.axes))) for joint in robot.joints),
        frames=tuple(rename('frame', frame) for frame in robot.frames))
    return robot.map_frame_ids(lambda frame: _new_id(frame, names))


def _new_id(frame: FrameId, names: _Names) -> FrameId:
    return FrameId(frame.kind, names.get(frame, frame.name))


def _with_shape_names(link: Link, report: Report) -> Link:
    """
    Return a link with a unique name for each visual and collision.

    Collisions keep their names before visuals, because contact sensors refer to collisions.
    """
    shapes = {'collision': link.collisions, 'visual': link.visuals}
    used = {name for element in (link.extension.sdf if link.extension.sdf is not None else ())
            if element.tag != 'plugin' and (name := element.get('name'))}
    # A made-up name must differ from all original names, also from those of later shapes.
    taken = Names((*used, *(shape.name for owners in shapes.values() for shape in owners)))
    result: dict[str, list[Shape]] = {'collision': [], 'visual': []}
    new_collisions: dict[str, str] = {}
    for tag, owners in shapes.items():
        for shape in owners:
            name = allowed_name(shape.name)
            if not name or name == WORLD or name in used:
                name = taken.new(f'{link.name}_{tag}')
            if tag == 'collision' and shape.name:
                new_collisions.setdefault(shape.name, name)
            if shape.name and name != shape.name:
                report.warn(tag, shape.name, shape.line,
                            f'renamed to {name!r}, because SDF requires unique names in a link')
                shape = _with_original_name(shape, name)
            taken.add(name)
            used.add(name)
            result[tag].append(replace(shape, name=name))
    return replace(link, visuals=tuple(result['visual']), collisions=tuple(result['collision']),
                   extension=_with_contacts(link.extension, new_collisions))


def _with_contacts(extension: Extension, names: Mapping[str, str]) -> Extension:
    """Return the extension of a link with the collisions of its contact sensors renamed."""
    if extension.sdf is None or all(old == new for old, new in names.items()):
        return extension
    root = detached(extension.sdf)
    for collision in root.iterfind('sensor/contact/collision'):
        name = (collision.text or '').strip()
        collision.text = names.get(name, collision.text)
    return extension.with_sdf(root)


def _with_original_name(owner: _Named, name: str) -> _Named:
    """Return an object with a new name, and with its original name in its extension."""
    return replace(owner, name=name, extension=owner.extension.marked({'name': owner.name}))


def original_name(owner: _Named) -> str:
    """Return the name of an object in URDF."""
    return owner.extension.marks.get('name') or owner.name


def _restored(owners: tuple[_Named, ...]) -> tuple[_Named, ...]:
    """Return objects with their original names, which are removed from their extensions."""
    return tuple(
        replace(owner, name=name, extension=owner.extension.marked({'name': None}))
        if (name := owner.extension.marks.get('name')) else owner for owner in owners)
