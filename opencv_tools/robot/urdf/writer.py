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
A robot, written as URDF.

URDF has no link poses. Everything in a link is placed in the frame of its parent joint.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math

from lxml import etree
from opencv_tools.robot.joint_kinds import URDF_TYPES, WITHOUT_AXIS
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import (
    Axis, Frame, FrameId, INERTIA, Joint, Limit, Link, MODEL, Placement, Robot, Shape)
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.fragments import AXES, axis_to_element, frame_to_element
from opencv_tools.robot.sdf.values import GAZEBO, MODEL_FRAME, NEWEST, pose_of, POSED
from opencv_tools.robot.urdf.gazebo import set_pose
from opencv_tools.robot.urdf.materials import material_element, MaterialNames, with_lights
from opencv_tools.robot.urdf.settings import take_settings
from opencv_tools.robot.xml.document import detached, Element, line_of, local_name
from opencv_tools.robot.xml.numbers import number_text, numbers_text, UNLIMITED, value_text
from opencv_tools.robot.xml.passthrough import (
    embed_foreign, merge_unread, namespaces, report_preserved, SDF_NAMESPACE)
from opencv_tools.robot.xml.report import Report

_SDF = f'{{{SDF_NAMESPACE}}}'


@dataclass(frozen=True)
class _WriteContext:
    """Facts of the whole robot that its elements are written with."""

    kinematics: Kinematics
    report: Report
    materials: MaterialNames
    frames: Mapping[str, FrameId]  # by the names that poses of SDF use

    def gazebo_tags(self, owner: FrameId) -> frozenset[str]:
        """Return the tags of an object's SDF that are written into a ``<gazebo>`` block."""
        # If a link and a joint have the same name, the block belongs to the link.
        is_shadowed = owner.kind == 'joint' and owner.name in self.kinematics.child_joints
        return frozenset() if is_shadowed else GAZEBO[owner.kind]


def write_urdf(robot: Robot, report: Report) -> Element:
    """
    Write a robot.

    :param robot: robot with one root link.
    :returns: the element ``<robot>``.
    """
    robot, settings = take_settings(robot, report)
    kinematics = Kinematics(robot)
    frames = {MODEL_FRAME: MODEL}
    for frame_id, owner in robot.frame_owners():
        frames.setdefault(owner.name, frame_id)
    context = _WriteContext(kinematics, report, MaterialNames.of(robot), frames)
    root = etree.Element('robot', name=robot.name,
                         nsmap=namespaces(robot.extension_elements(), 'sdf'))
    if robot.canonical_link:
        root.set(f'{_SDF}canonical_link', robot.canonical_link)
        report_preserved(report, 'sdf', robot.name, 0, '@canonical_link')
    for link in robot.links:
        _link_element(root, link, context)
    for joint in robot.joints:
        _joint_element(root, joint, context)
    for frame in robot.frames:
        _frame_element(root, frame, context)
    _gazebo_elements(root, robot, settings, context)
    merge_unread(root, robot.extension.urdf)
    embed_foreign(root, _without(robot.extension.sdf, GAZEBO['model']), 'sdf', report,
                  robot.name, 0)
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
    embed_foreign(element, _without(link.extension.sdf, GAZEBO['link']), 'sdf', context.report,
                  link.name, link.line)


def _joint_element(root: Element, joint: Joint, context: _WriteContext) -> None:
    kinematics, report = context.kinematics, context.report
    frame, child = FrameId('joint', joint.name), FrameId('link', joint.child)
    joint_type = joint.type if joint.type in URDF_TYPES else 'floating'
    element = etree.SubElement(root, f'{_SDF}joint' if joint.is_loop else 'joint',
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
        element.set(f'{_SDF}type', joint.type)
        sdf = _with_axes(joint)
    embed_foreign(element, _without(sdf, context.gazebo_tags(frame)), 'sdf', report, joint.name,
                  joint.line)


def _frame_element(root: Element, frame: Frame, context: _WriteContext) -> None:
    element = frame_to_element(frame, context.kinematics)
    merge_unread(element, frame.extension.sdf)
    embed_foreign(element, frame.extension.urdf, 'urdf', Report(), frame.name, frame.line)
    element.tag = f'{_SDF}frame'
    root.append(element)
    report_preserved(context.report, 'sdf', frame.name, frame.line, 'frame')


def _preserve_pose(element: Element, pose: Pose, owner: Link | Joint, report: Report) -> None:
    """Write a pose that URDF cannot express. Only loop joints need it if it is the identity."""
    if not pose.is_identity or (isinstance(owner, Joint) and owner.is_loop):
        etree.SubElement(element, f'{_SDF}pose').text = numbers_text(pose.xyz + pose.rpy)
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


def _without(unread: Element | None, tags: frozenset[str]) -> Element | None:
    """Return the SDF of an object without what is written into a ``<gazebo>`` block."""
    if unread is None or not any(child.tag in tags for child in unread):
        return unread
    copy = detached(unread)
    for child in list(copy):
        if child.tag in tags:
            copy.remove(child)
    return copy if len(copy) or copy.attrib else None


def _gazebo_elements(root: Element, robot: Robot, settings: Mapping[FrameId, list[Element]],
                     context: _WriteContext) -> None:
    """Write elements of SDF into ``<gazebo>`` blocks, from which Gazebo reads them."""
    owners: list[tuple[FrameId, Robot | Link | Joint]] = [
        (MODEL, robot), *((FrameId('link', link.name), link) for link in robot.links),
        *((FrameId('joint', joint.name), joint) for joint in robot.joints)]
    for frame, owner in owners:
        tags, unread = context.gazebo_tags(frame), owner.extension.sdf
        children = [] if unread is None else [child for child in unread if child.tag in tags]
        values = settings.get(frame, [])
        if children or values:
            block = etree.SubElement(root, 'gazebo', {} if frame == MODEL else {
                'reference': owner.name})
            block.extend(_in_joint_frame(child, frame, context) for child in children)
            block.extend(values)
        for child in (*children, *values):
            context.report.preserve(str(child.tag), owner.name, line_of(child),
                                    'not supported by URDF; preserved in <gazebo>')


def _in_joint_frame(element: Element, owner: FrameId, context: _WriteContext) -> Element:
    """Return an element of SDF with its pose in the frame of its link in URDF."""
    element = detached(element)
    if owner.kind != 'link' or element.tag not in POSED:
        return element
    pose, link_frame = element.find('pose'), context.kinematics.urdf_frame(owner.name)
    if (pose is None or not pose.attrib) and (
            context.kinematics.between(owner, link_frame).is_identity):
        return element
    name = '' if pose is None else pose.get('relative_to', pose.get('frame', ''))
    if name and name not in context.frames:
        context.report.warn(str(element.tag), owner.name, line_of(element),
                            f'<pose> is relative to {name!r}, which does not exist; it is read as '
                            'relative to the link')
    placement = Placement(pose_of(pose), context.frames.get(name, owner))
    set_pose(element, context.kinematics.within(link_frame, placement))
    return element


def _origin_element(parent: Element, pose: Pose) -> None:
    """Write ``<origin>``, unless it is the identity."""
    if not pose.is_identity:
        etree.SubElement(parent, 'origin', xyz=numbers_text(pose.xyz), rpy=numbers_text(pose.rpy))


def _shape_element(parent: Element, tag: str, shape: Shape, link: Link, context: _WriteContext
                   ) -> None:
    """Write a visual or a collision. A shape without a geometry of URDF is preserved."""
    name, report = shape.name or link.name, context.report
    element = etree.SubElement(parent, tag if shape.geometry else f'{{{SDF_NAMESPACE}}}{tag}',
                               {'name': shape.name} if shape.name else {})
    _origin_element(element, context.kinematics.within(
        context.kinematics.urdf_frame(link.name), shape.placement))
    if shape.geometry:
        geometry = etree.SubElement(etree.SubElement(element, 'geometry'),
                                    type(shape.geometry).__name__.lower())
        for field, value in vars(shape.geometry).items():
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
    unread = shape.extension.sdf
    geometry = None if unread is None else unread.find('geometry')
    if geometry is None or not len(geometry):
        return 'has no geometry, which URDF requires'
    return f'<{local_name(geometry[0])}> is not supported by URDF'
