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

"""SDF read as a robot: any version, models inside models, and includes, made one flat model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from lxml import etree
from opencv_tools.robot.kinematics import check_mimic_cycles, Kinematics
from opencv_tools.robot.model import (
    Extension, Frame, FrameId, Joint, Link, MODEL, Placement, Robot, WORLD)
from opencv_tools.robot.pose import IDENTITY, Pose, Transform
from opencv_tools.robot.sdf.fragments import frame_from_element
from opencv_tools.robot.sdf.includes import first_file, ModelLoader
from opencv_tools.robot.sdf.joint_reader import marked_loops, read_joint, with_axes
from opencv_tools.robot.sdf.link_reader import Place, read_link
from opencv_tools.robot.sdf.names import FRAME_TAGS, FrameRegistry, JOINTS
from opencv_tools.robot.sdf.scopes import Scope, scopes_of
from opencv_tools.robot.sdf.values import flag, pose_element, pose_of
from opencv_tools.robot.xml.document import (
    DescriptionError, Element, line_of, local_name, source_of)
from opencv_tools.robot.xml.passthrough import extract_foreign
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.tracked import detached, TrackedElement

# What is read of an <include>, or of another one that overrides it.
_INCLUDE = ('uri', 'name', 'pose', 'placement_frame')
# What an <include> says about the model instead of the model itself.
_OVERRIDES = ('pose', 'static')


def read_sdf(root: Element, report: Report, *, model: str = '', search: Sequence[str] = ()
             ) -> Robot:
    """
    Read a robot from SDF.

    :param root: the ``<sdf>``.
    :param report: takes what is left out, and what is kept in another way.
    :param model: the model, where there are several.
    :param search: folders with models that are included.
    :raises DescriptionError: it is no robot that could be read.
    """
    if local_name(root) != 'sdf':
        raise DescriptionError('is not SDF, whose root is <sdf>', root)
    scopes = scopes_of(root, ModelLoader(search, report), model, report)
    if not any(scope.element.take_all('link') for scope in scopes):
        raise DescriptionError(f'model {scopes[0].part.name!r} has no links', scopes[0].element)
    names = FrameRegistry(scopes)
    folder = str(first_file(root).parent)
    places = [Place(scope, names, report, folder) for scope in scopes]
    robot = Robot(scopes[0].part.name, *_parts(places), source=source_of(root))
    canonical = names.link_of(MODEL)
    if canonical != robot.links[0].name or scopes[0].element.get('canonical_link'):
        robot = replace(robot, canonical_link=canonical)
    _check_placements(robot, names)
    robot = _placed_by_frames(robot, scopes, names)
    in_world = _in_world(robot, scopes[0], names)
    robot = _with_axes(_with_world(robot, in_world), places)
    links = tuple(link.name for link in robot.links)
    robot = replace(robot, joints=marked_loops(robot.joints, links, canonical),
                    extension=_model_rest(places[0], in_world))
    check_mimic_cycles(robot)
    return robot


def _parts(places: Sequence[Place]
           ) -> tuple[tuple[Link, ...], tuple[Joint, ...], tuple[Frame, ...]]:
    """Read all links, joints and frames; the world is a link if a joint is fastened to it."""
    links: list[Link] = []
    joints: list[Joint] = []
    frames: list[Frame] = []
    around = {place.scope.frame: place for place in places}
    for place in places:
        element, scope = place.scope.element, place.scope
        links.extend(read_link(child, place) for child in element.take_all('link'))
        joints.extend(read_joint(child, place) for child in element.take_all(*JOINTS))
        if scope.parent is not None:
            frames.append(_model_frame(place, around[scope.parent.frame]))
            _note_rest(place)
        frames.extend(_frame(child, place) for child in element.take_all(*FRAME_TAGS))
    if any(joint.parent == WORLD for joint in joints):
        links.append(Link(WORLD, Placement(Pose(), MODEL)))
    return tuple(links), tuple(joints), tuple(frames)


def _frame(element: TrackedElement, place: Place) -> Frame:
    def lookup(name: str, holder: TrackedElement) -> FrameId:
        what = 'relative_to' if holder.tag == 'pose' else 'attached_to'
        return place.names.lookup(place.scope, name, holder, what)

    frame = frame_from_element(element, lookup, place.scope.frame)
    return replace(frame, name=place.scope.qualified(frame.name),
                   placement=place.placement(element, frame.attached_to),
                   extension=place.carried(element))


def _model_frame(place: Place, around: Place) -> Frame:
    """Give the frame of a model inside another one."""
    scope = place.scope
    return Frame(scope.frame.name, FrameId('link', place.names.link_of(scope.frame)),
                 around.placement(scope.part.placed_by, around.scope.frame),
                 line=line_of(scope.element))


def _note_rest(place: Place) -> None:
    """Note what is left out of a model that is no longer a model."""
    part = place.scope.part
    kept = extract_foreign(part.element, 'urdf')
    for one in (part.element, *part.includes):
        one.take_all(*_INCLUDE)
    for found in (place.rest(part.element), kept, *map(place.rest, part.includes)):
        for child in () if found is None else found:
            # A model is not static anyway.
            if child.tag != 'static' or flag(child.text, child):
                place.report.warn(local_name(child), part.name, line_of(child),
                                  'left out, it belongs to a model inside the model')


def _check_placements(robot: Robot, names: FrameRegistry) -> None:
    """
    See to it that every frame is placed in the model in the end.

    :raises DescriptionError: one is placed in itself.
    """
    placed_in = {frame: thing.placement.relative_to for frame, thing in robot.frame_owners()}
    good = {MODEL}
    for start in placed_in:
        chain: dict[FrameId, None] = {}
        frame = start
        while frame not in good:
            if frame in chain:
                raise DescriptionError(f'{frame.name!r} is placed relative to itself, by way of '
                                       f'{", ".join(repr(one.name) for one in chain)}',
                                       names.elements.get(frame))
            chain[frame] = None
            frame = placed_in[frame]
        good.update(chain)


def _placed_by_frames(robot: Robot, scopes: Sequence[Scope], names: FrameRegistry) -> Robot:
    """Place the models whose pose is that of a frame in them; the innermost ones first."""
    for scope in reversed(scopes[1:]):
        if not scope.part.placement_frame:
            continue
        inverse = _placement_frame(robot, scope, names).inverse()
        robot = replace(robot, frames=tuple(
            replace(frame, placement=Placement(
                (frame.placement.pose.transform() @ inverse).pose(), frame.placement.relative_to))
            if frame.name == scope.frame.name else frame for frame in robot.frames))
    return robot


def _placement_frame(robot: Robot, scope: Scope, names: FrameRegistry) -> Transform:
    """Give where in a model the frame is that the model's pose places."""
    name = scope.part.placement_frame
    if not name:
        return IDENTITY
    frame = names.lookup(scope, name, scope.element, 'placement_frame')
    return Kinematics(robot).between(scope.frame, frame).transform()


def _in_world(robot: Robot, scope: Scope, names: FrameRegistry) -> Pose:
    """Give where the model is in the world; in its origin if that is relative to what is gone."""
    pose = scope.part.placed_by.element.find('pose')
    placed = _placement_frame(robot, scope, names)
    if pose is not None and pose.get('relative_to'):
        return Pose()
    written = pose_of(pose)
    return written if placed == IDENTITY else (written.transform() @ placed.inverse()).pose()


def _with_world(robot: Robot, in_world: Pose) -> Robot:
    """Place the world, if joints are fastened to it."""
    if robot.links[-1].name != WORLD or in_world.is_identity:
        return robot
    placement = Placement(in_world.transform().inverse().pose(), MODEL)
    return replace(robot, links=(*robot.links[:-1],
                                 replace(robot.links[-1], placement=placement)))


def _with_axes(robot: Robot, places: Sequence[Place]) -> Robot:
    elements = ((element, place) for place in places
                for element in place.scope.element.take_all(*JOINTS))
    kinematics = Kinematics(robot)
    return replace(robot, joints=tuple(
        with_axes(joint, element, place, kinematics)
        for joint, (element, place) in zip(robot.joints, elements)))


def _model_rest(place: Place, in_world: Pose) -> Extension:
    """
    Keep what else there is of the model, with what an include says about it instead.

    :param in_world: where the model's own frame is in the world.
    """
    part = place.scope.part
    kept, rest = extract_foreign(part.element, 'urdf'), place.rest(part.element)
    if rest is None:
        rest = etree.Element('model')
    for include in reversed(part.includes):
        for child in include.element.iterchildren('*'):
            tag = local_name(child)
            if tag in _OVERRIDES:
                for old in rest.findall(tag):
                    rest.remove(old)
            if tag in (*_OVERRIDES, 'plugin'):
                rest.append(detached(child))
            elif tag not in _INCLUDE:
                place.report.warn(tag, part.name, line_of(child), 'left out of the <include>')
    _resolve_model_pose(rest, place, in_world)
    return Extension(urdf=kept, sdf=rest if len(rest) or rest.attrib else None)


def _resolve_model_pose(rest: Element, place: Place, in_world: Pose) -> None:
    """Say where the model is without any name, which may be another one in what is written."""
    name = place.scope.part.name
    for pose in rest.findall('pose'):
        if other := pose.get('relative_to'):
            place.report.warn('pose', name, line_of(place.scope.part.placed_by),
                              f'left out, it is relative to {other!r}, outside the model')
            rest.remove(pose)
    if frame := place.scope.part.placement_frame:
        for pose in rest.findall('pose'):
            rest.remove(pose)
        pose_element(rest, in_world)
        place.report.preserve('pose', name, line_of(place.scope.element),
                           f'it placed {frame!r}; now it places the model itself')
