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
A robot, written as URDF, with ``<gazebo>`` blocks for what only SDF has.

URDF has no link poses. Everything in a link is placed in the frame of its parent joint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import TypeVar

from lxml import etree
from opencv_tools.robot.geometry import Capsule
from opencv_tools.robot.joint_kinds import URDF_TYPES, WITHOUT_AXIS
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import (
    Axis, FrameId, INERTIA, Joint, Limit, Link, MODEL, Robot, RobotFrame, Shape, WORLD)
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.fragments import AXES, axis_to_element, frame_to_element
from opencv_tools.robot.sdf.values import GAZEBO, MODEL_FRAME, NEWEST
from opencv_tools.robot.urdf.materials import material_element, MaterialNames, with_lights
from opencv_tools.robot.urdf.poses import in_joint_frame
from opencv_tools.robot.urdf.settings import take_settings
from opencv_tools.robot.urdf.versions import OLDEST
from opencv_tools.robot.xml.document import detached, Element, line_of, local_name
from opencv_tools.robot.xml.numbers import number_text, numbers_text, UNLIMITED, value_text
from opencv_tools.robot.xml.passthrough import (
    embed_foreign, merge_unread, namespaces, report_preserved, SDF_TAG)
from opencv_tools.robot.xml.report import Report

_Owner = TypeVar('_Owner', Robot, Link, Joint)


def take_blocks(robot: Robot, report: Report) -> tuple[Robot, Mapping[FrameId, Sequence[Element]]]:
    """Return a robot without what ``<gazebo>`` has, and the contents of the blocks by owner."""
    robot, settings = take_settings(robot, report)
    kinematics, blocks = Kinematics(robot), dict[FrameId, Sequence[Element]]()
    frames = {MODEL_FRAME: MODEL}
    for frame, owner in robot.frame_owners():
        frames.setdefault(owner.name, frame)

    def taken(frame: FrameId, owner: _Owner) -> _Owner:
        tags, sdf = GAZEBO[frame.kind], owner.extension.sdf
        values: Sequence[Element] = settings.get(frame, ())
        if frame.kind == 'joint' and frame.name in kinematics.child_joints:
            tags = frozenset()  # the block belongs to the link with this name
        elif frame == MODEL and WORLD in kinematics.child_joints:
            tags -= {'pose'}  # the joint to the world has it
        children: list[Element] = [] if sdf is None else [
            child for child in sdf if child.tag in tags]
        blocks[frame] = [*(
            in_joint_frame(child, frame.name, kinematics, frames, report)
            if frame.kind == 'link' else detached(child) for child in children), *values]
        for child in (*children, *values):
            report.preserve(str(child.tag), owner.name, line_of(child),
                            'not supported by URDF; preserved in <gazebo>')
        if sdf is None or not children:
            return owner
        rest = detached(sdf)
        rest[:] = [child for child in rest if child.tag not in tags]
        return replace(owner, extension=owner.extension.with_sdf(rest))

    return replace(taken(MODEL, robot),
                   links=tuple(taken(FrameId('link', one.name), one) for one in robot.links),
                   joints=tuple(taken(FrameId('joint', one.name), one) for one in robot.joints)
                   ), blocks


@dataclass(frozen=True)
class _WriteContext:
    """Facts of the whole robot that its elements are written with."""

    kinematics: Kinematics
    report: Report
    materials: MaterialNames
    version: str


def write_urdf(robot: Robot, report: Report, version: str = OLDEST) -> Element:
    """
    Write a robot.

    :param robot: robot with one root link.
    :param version: the version of URDF; 1.0 has cylinders for capsules.
    :returns: the element ``<robot>``.
    """
    robot, blocks = take_blocks(robot, report)
    context = _WriteContext(Kinematics(robot), report, MaterialNames.of(robot), version)
    root = etree.Element('robot', name=robot.name,
                         nsmap=namespaces(robot.extension_elements(), 'sdf'))
    if robot.canonical_link:
        root.set(f'{SDF_TAG}canonical_link', robot.canonical_link)
        report_preserved(report, 'sdf', robot.name, 0, '@canonical_link')
    for link in robot.links:
        _link_element(root, link, context)
    for joint in robot.joints:
        _joint_element(root, joint, context)
    for frame in robot.frames:
        _frame_element(root, frame, context)
    for owner, elements in blocks.items():
        if elements:
            etree.SubElement(root, 'gazebo', {'reference': owner.name} if owner.name else {}
                             ).extend(elements)
    merge_unread(root, robot.extension.urdf)
    embed_foreign(root, robot.extension.sdf, 'sdf', report, robot.name, 0)
    return root


def _link_element(root: Element, link: Link, context: _WriteContext) -> None:
    kinematics = context.kinematics
    link_frame = kinematics.urdf_frame(link.name)
    element = etree.SubElement(root, 'link', name=link.name)
    if link.inertial:
        inertial = etree.SubElement(element, 'inertial')
        _origin_element(inertial, kinematics.within(link_frame, link.inertial.placement))
        etree.SubElement(inertial, 'mass', value=number_text(link.inertial.mass))
        etree.SubElement(inertial, 'inertia',
                         dict(zip(INERTIA, map(number_text, link.inertial.inertia))))
    for tag, shapes in (('visual', link.visuals), ('collision', link.collisions)):
        for shape in shapes:
            _shape_element(element, tag, shape, link, context)
    if link_frame.kind == 'link':
        _preserve_pose(element, kinematics.between(MODEL, link_frame), link, context.report)
    merge_unread(element, link.extension.urdf)
    embed_foreign(element, link.extension.sdf, 'sdf', context.report, link.name, link.line)


def _joint_element(root: Element, joint: Joint, context: _WriteContext) -> None:
    kinematics, report = context.kinematics, context.report
    frame, child = FrameId('joint', joint.name), FrameId('link', joint.child)
    joint_type = joint.type if joint.type in URDF_TYPES else 'floating'
    element = etree.SubElement(root, f'{SDF_TAG}joint' if joint.is_loop else 'joint',
                               name=joint.name, type=joint_type)
    if joint.is_loop:
        report.warn('joint', joint.name, joint.line, 'closes a loop of links, which URDF does not '
                    'support; preserved as <sdf:joint> for the conversion back')
    _origin_element(element, kinematics.between(kinematics.urdf_frame(joint.parent), frame))
    etree.SubElement(element, 'parent', link=joint.parent)
    etree.SubElement(element, 'child', link=joint.child)
    if joint_type not in WITHOUT_AXIS and joint.axes:
        _axis_elements(element, joint_type, joint.axes[0])
    _preserve_pose(element, kinematics.between(child, frame), joint, report)
    merge_unread(element, joint.extension.urdf)
    sdf = joint.extension.sdf
    if joint.type != joint_type:
        report.warn('joint', joint.name, joint.line, f'{joint.type} joints are not supported by '
                    'URDF; written as a floating joint')
        element.set(f'{SDF_TAG}type', joint.type)
        sdf = _with_axes(joint)
    embed_foreign(element, sdf, 'sdf', report, joint.name, joint.line)


def _frame_element(root: Element, frame: RobotFrame, context: _WriteContext) -> None:
    element = frame_to_element(frame, context.kinematics.between(
        frame.attached_to, FrameId('frame', frame.name)))
    merge_unread(element, frame.extension.sdf)
    embed_foreign(element, frame.extension.urdf, 'urdf', Report(), frame.name, frame.line)
    element.tag = f'{SDF_TAG}frame'
    root.append(element)
    report_preserved(context.report, 'sdf', frame.name, frame.line, 'frame')


def _preserve_pose(element: Element, pose: Pose, owner: Link | Joint, report: Report) -> None:
    """Write a pose that URDF cannot express. Only loop joints need it if it is the identity."""
    if not pose.is_identity or (isinstance(owner, Joint) and owner.is_loop):
        etree.SubElement(element, f'{SDF_TAG}pose').text = numbers_text(pose.xyz + pose.rpy)
    if not pose.is_identity:
        report_preserved(report, 'sdf', owner.name, owner.line, 'pose')


def _axis_elements(element: Element, joint_type: str, axis: Axis) -> None:
    etree.SubElement(element, 'axis', xyz=numbers_text(axis.xyz))
    has_position_limits = joint_type in ('revolute', 'prismatic')
    limit = axis.limit or Limit()
    if has_position_limits or math.isfinite(limit.effort) or math.isfinite(limit.velocity):
        names = [*(('lower', 'upper') if has_position_limits else ()), 'effort', 'velocity']
        etree.SubElement(element, 'limit', {
            name: number_text(max(-UNLIMITED, min(getattr(limit, name), UNLIMITED)))
            for name in names})
    if axis.dynamics:
        etree.SubElement(element, 'dynamics', {
            name: number_text(value) for name, value in vars(axis.dynamics).items()
            if value is not None})
    if axis.mimic:
        mimic = etree.SubElement(element, 'mimic', joint=axis.mimic.joint)
        if axis.mimic.multiplier != 1:
            mimic.set('multiplier', number_text(axis.mimic.multiplier))
        if axis.mimic.offset:
            mimic.set('offset', number_text(axis.mimic.offset))


def _with_axes(joint: Joint) -> Element:
    """Return the SDF of a joint whose type URDF does not have, with its axes."""
    element = etree.Element('joint')
    for axis, tag in zip(joint.axes, AXES):
        element.append(axis_to_element(axis, tag, NEWEST))
    merge_unread(element, joint.extension.sdf, marked=True)
    return element


def _origin_element(parent: Element, pose: Pose) -> None:
    """Write ``<origin>``, unless it is the identity."""
    if not pose.is_identity:
        etree.SubElement(parent, 'origin', xyz=numbers_text(pose.xyz), rpy=numbers_text(pose.rpy))


def _shape_element(parent: Element, tag: str, shape: Shape, link: Link, context: _WriteContext
                   ) -> None:
    """Write a visual or a collision. A shape without a geometry of URDF is preserved."""
    name, report = shape.name or link.name, context.report
    element = etree.SubElement(parent, tag if shape.geometry else f'{SDF_TAG}{tag}',
                               {'name': shape.name} if shape.name else {})
    _origin_element(element, context.kinematics.within(
        context.kinematics.urdf_frame(link.name), shape.placement))
    if shape.geometry:
        kind, parent = shape.geometry, etree.SubElement(element, 'geometry')
        if isinstance(kind, Capsule) and context.version == OLDEST:
            etree.SubElement(parent, f'{SDF_TAG}capsule', {
                key: number_text(value) for key, value in vars(kind).items()})
            kind = kind.cylinder
            report.warn('capsule', name, shape.line, 'not supported by URDF 1.0; written as a '
                        'cylinder of the same length')
            report_preserved(report, 'sdf', name, shape.line, 'capsule')
        geometry = etree.Element(type(kind).__name__.lower())
        parent.insert(0, geometry)  # parsers read the first child
        for field, value in vars(kind).items():
            if value is not None:
                geometry.set('filename' if field == 'uri' else field, value_text(value))
    else:
        report.warn(tag, name, shape.line, f'{_missing_geometry(shape)}; preserved as '
                    f'<sdf:{tag}> for the conversion back')
    sdf = shape.extension.sdf
    if shape.material:
        material_element(element, shape.material, shape, link, context.materials, report)
        sdf = with_lights(sdf, shape.material)
    merge_unread(element, shape.extension.urdf)
    embed_foreign(element, sdf, 'sdf', report, name, shape.line)


def _missing_geometry(shape: Shape) -> str:
    """Return why a shape has no geometry of URDF."""
    geometry = shape.extension.find_sdf('geometry')
    if geometry is None or not len(geometry):
        return 'has no geometry, which URDF requires'
    return f'<{local_name(geometry[0])}> is not supported by URDF'
