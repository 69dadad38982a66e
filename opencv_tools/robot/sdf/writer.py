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

"""Writer of SDF: a model with links placed in the model frame or relative to their parents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path

from lxml import etree
from opencv_tools.robot.geometry import Capsule
from opencv_tools.robot.joint_kinds import SDF_TYPES
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import (
    FrameId, INERTIA, Joint, Link, MODEL, Placement, Robot, RobotFrame, Shape, WORLD)
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.fragments import AXES, axis_to_element, frame_to_element
from opencv_tools.robot.sdf.includes import first_file, search_folders
from opencv_tools.robot.sdf.inertia import auto_inertial, is_same_inertial, without_auto
from opencv_tools.robot.sdf.values import (
    AUTO_INERTIA, CAPSULE, MATERIAL_COLORS, MIMIC, MODEL_FRAME, number_element, OLDEST_WRITTEN,
    pose_element, text_element, Version, written_version)
from opencv_tools.robot.xml.document import DescriptionError, Element
from opencv_tools.robot.xml.numbers import number_text, numbers_text, value_text
from opencv_tools.robot.xml.passthrough import (
    embed_foreign, merge_unread, namespaces, URDF_JOINT_TYPE, URDF_TAG)
from opencv_tools.robot.xml.report import Report


@dataclass(frozen=True)
class _WriteContext:
    """Facts of the whole robot that its elements are written with."""

    kinematics: Kinematics
    version: Version
    relative: bool  # whether each link is placed relative to its parent link
    report: Report
    folders: Sequence[Path]  # where meshes are searched

    def placed(self, placement: Placement, pose: Pose, kinds: Sequence[str] = ('frame',)
               ) -> tuple[Pose, str]:
        """
        Return a pose and the name of the frame that it is relative to.

        :param pose: the pose without such a name.
        :param kinds: kinds of frames in which the numbers of the file are kept. Links without
            mass are frames.
        """
        frame = placement.relative_to
        if frame.kind in kinds and frame.name != WORLD:
            return placement.pose, frame.name or MODEL_FRAME
        return pose, ''

    def write_extension(
            self, element: Element, written: RobotFrame | Joint | Link | Shape) -> None:
        """Write what the model does not represent: merge SDF, and embed URDF."""
        merge_unread(element, written.extension.sdf)
        embed_foreign(element, written.extension.urdf, 'urdf', self.report, written.name,
                      written.line)


def write_sdf(robot: Robot, report: Report, *, version: str = '1.11',
              relative: bool = False) -> Element:
    """
    Write a robot as SDF.

    :param robot: a robot with valid SDF names; see `renaming.with_valid_sdf_names`.
    :param report: receives what this version of SDF does not support.
    :param version: 1.7 to 1.12.
    :param relative: whether each link is placed relative to its parent link, which keeps the
        numbers of a URDF; otherwise relative to the model frame.
    :raises DescriptionError: the version is invalid, or the robot has no links, or moves the
        world.
    """
    output = written_version(version)
    context = _WriteContext(Kinematics(robot), output, relative, report,
                            search_folders(first_file(robot.source).parent))
    _check_links(robot, context)
    root = etree.Element('sdf', version=str(output),
                         nsmap=namespaces(robot.extension_elements(), 'urdf'))
    model = etree.SubElement(root, 'model', name=robot.name)
    if robot.canonical_link:
        model.set('canonical_link', robot.canonical_link)
    for link in robot.links:
        if not link.is_world:
            _write_link(model, link, context)
    for joint in robot.joints:
        _write_joint(model, joint, context)
    substitutes = _substitute_frames(robot)
    for frame in robot.frames:
        attached_to = substitutes.get(frame.attached_to, frame.attached_to)
        marks = () if frame.extension.urdf is None else frame.extension.urdf.attrib
        is_former = any(str(name).startswith(URDF_TAG) for name in marks)
        kinds = ('frame', 'link', 'model') if is_former else ()
        element = frame_to_element(replace(frame, attached_to=attached_to), *context.placed(
            frame.placement, context.kinematics.between(
                attached_to, FrameId('frame', frame.name)), kinds))
        context.write_extension(element, frame)
        model.append(element)
    merge_unread(model, robot.extension.sdf)
    embed_foreign(model, robot.extension.urdf, 'urdf', report, robot.name, 0)
    return root


def _check_links(robot: Robot, context: _WriteContext) -> None:
    if all(link.is_world for link in robot.links):
        raise DescriptionError(f'robot {robot.name!r} has no links', source=robot.source)
    joint = context.kinematics.parent_joint.get(WORLD)
    if joint and any(link.is_world for link in robot.links):
        raise DescriptionError(f"joint {joint.name!r} has the child 'world', which is not "
                               'supported by SDF; make the world its parent',
                               source=robot.source, line=joint.line, tag='joint')


def _substitute_frames(robot: Robot) -> dict[FrameId, FrameId]:
    """Return the frames that SDF does not support, each with a frame that moves with it."""
    links = {FrameId('link', link.name): MODEL for link in robot.links if link.is_world}
    joints = {FrameId('joint', joint.name): FrameId('link', joint.child)
              for joint in robot.joints if joint.type not in SDF_TYPES}
    return links | joints


def _write_link(model: Element, link: Link, context: _WriteContext) -> None:
    element = etree.SubElement(model, 'link', name=link.name)
    frame, kinematics = FrameId('link', link.name), context.kinematics
    joint = kinematics.parent_joint.get(link.name) if context.relative else None
    base = FrameId('link', joint.parent) if joint and joint.parent != WORLD else MODEL
    if joint and joint.placement.relative_to.kind == 'frame':
        base = joint.placement.relative_to
    pose, former = context.placed(link.placement, kinematics.between(base, frame),
                                  ('frame',) if context.relative else ())
    pose_element(element, pose, former or base.name)
    link = _write_inertial(element, link, context)
    for tag, shapes in (('collision', link.collisions), ('visual', link.visuals)):
        for shape in shapes:
            child = etree.SubElement(element, tag, name=shape.name)
            pose_element(child, *context.placed(
                shape.placement, kinematics.within(frame, shape.placement)))
            _write_geometry(child, shape, context)
            _write_material(child, shape, context)
            context.write_extension(child, shape)
    context.write_extension(element, link)


def _write_inertial(parent: Element, link: Link, context: _WriteContext) -> Link:
    """Write an inertial, and return the link; without ``auto`` if the written numbers count."""
    frame, kinematics, inertial = FrameId('link', link.name), context.kinematics, link.inertial
    if inertial is None:
        return link
    auto = auto_inertial(link, kinematics, Report(), context.folders)
    if auto:
        is_same = is_same_inertial(auto, inertial, frame, kinematics)
        if is_same and context.version >= AUTO_INERTIA:
            return link  # `write_extension` writes it, and SDF computes the same numbers
        reason = f'not supported by SDF {context.version}' if is_same else (
            'its numbers are not those of the collisions and their density')
        context.report.warn('inertial', link.name, link.line, f'auto="true" is omitted: {reason}')
        link = without_auto(link)
    element = etree.SubElement(parent, 'inertial')
    pose_element(element, kinematics.within(frame, inertial.placement))
    number_element(element, 'mass', inertial.mass)
    moments = etree.SubElement(element, 'inertia')
    for tag, value in zip(INERTIA, inertial.inertia):
        number_element(moments, tag, value)
    return link


def _write_geometry(element: Element, shape: Shape, context: _WriteContext) -> None:
    geometry = shape.geometry
    if geometry is None and shape.extension.find_sdf('geometry') is not None:
        return  # a geometry that only SDF has; `write_extension` writes it
    parent = etree.SubElement(element, 'geometry')
    if geometry is None:
        etree.SubElement(parent, 'empty')
        return
    if isinstance(geometry, Capsule) and context.version < CAPSULE:
        etree.SubElement(parent, f'{URDF_TAG}capsule',
                         radius=number_text(geometry.radius), length=number_text(geometry.length))
        geometry = geometry.cylinder
        context.report.warn('capsule', shape.name, shape.line,
                            f'not supported by SDF {context.version}; written as a cylinder of '
                            'the same length, and preserved as <urdf:capsule>')
    element = etree.SubElement(parent, type(geometry).__name__.lower())
    for tag, value in vars(geometry).items():
        if value is not None:
            text_element(element, tag, value_text(value))


def _write_material(visual: Element, shape: Shape, context: _WriteContext) -> None:
    material = shape.material
    if material is None:
        return
    element = etree.SubElement(visual, 'material')
    if material.name:
        element.set(f'{URDF_TAG}name', material.name)
    for tag, field in MATERIAL_COLORS.items():
        color = getattr(material, field)
        if color is not None:
            text_element(element, tag, numbers_text(color))
    if material.texture:
        metal = etree.SubElement(etree.SubElement(element, 'pbr'), 'metal')
        text_element(metal, 'albedo_map', material.texture)


def _write_joint(model: Element, joint: Joint, context: _WriteContext) -> None:
    """Write a joint into a model; in the namespace of URDF if SDF does not support its type."""
    kinematics, version = context.kinematics, context.version
    prefix = '' if joint.type in SDF_TYPES else URDF_TAG
    element = etree.SubElement(model, f'{prefix}joint', name=joint.name, type=joint.type)
    is_unlimited = (joint.limit.lower, joint.limit.upper) == (-math.inf, math.inf)
    if joint.type == 'revolute' and is_unlimited:  # its reader would change the type
        element.set(URDF_JOINT_TYPE, joint.type)
    if prefix:
        context.report.warn('joint', joint.name, joint.line,
                            f'{joint.type} joints are not supported by SDF; preserved as '
                            f'<urdf:joint>, and link {joint.child!r} is not connected')
    text_element(element, 'parent', joint.parent)
    text_element(element, 'child', joint.child)
    frame, child = FrameId('joint', joint.name), FrameId('link', joint.child)
    if joint.child != WORLD and not (pose := kinematics.between(child, frame)).is_identity:
        pose_element(element, *context.placed(joint.placement, pose))
    for tag, axis in zip(AXES, joint.axes):
        is_joint = not axis.mimic or axis.mimic.joint not in {
            one.name for one in kinematics.robot.frames}
        element.append(axis_to_element(axis, tag, version if is_joint else OLDEST_WRITTEN))
        if axis.mimic and (version < MIMIC or not is_joint):
            mimic = etree.SubElement(
                element, f'{URDF_TAG}mimic', joint=axis.mimic.joint,
                multiplier=number_text(axis.mimic.multiplier),
                offset=number_text(axis.mimic.offset))
            if tag != AXES[0]:
                mimic.set('axis', tag)
            note, why = (context.report.preserve, f'not supported by SDF {version};') if (
                is_joint) else (context.report.warn, f'{axis.mimic.joint!r} is a frame in SDF;')
            note('mimic', joint.name, joint.line, f'{why} preserved as <urdf:mimic>')
    context.write_extension(element, joint)
