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

"""A robot as URDF: what hangs on a joint is written in the joint's frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math

from lxml import etree
from opencv_tools.robot.joint_kinds import URDF_TYPES, WITHOUT_AXIS
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import Axis, FrameId, Joint, Limit, Link, MODEL, Placement, Robot
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.fragments import AXES, axis_to_element, frame_to_element
from opencv_tools.robot.sdf.values import MODEL_FRAME, NEWEST, pose_of
from opencv_tools.robot.trees import select_root
from opencv_tools.robot.urdf.link_writer import (
    inertial_element, Materials, origin_element, shape_element)
from opencv_tools.robot.xml.document import Element, line_of
from opencv_tools.robot.xml.numbers import number_text, numbers_text, UNLIMITED
from opencv_tools.robot.xml.passthrough import (
    embed_foreign, merge_unread, namespaces, report_preserved, SDF_NAMESPACE)
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.schema import GAZEBO, POSED
from opencv_tools.robot.xml.tracked import detached

_SDF = f'{{{SDF_NAMESPACE}}}'


@dataclass(frozen=True)
class _WriteContext:
    """What the parts of a robot are written with."""

    kinematics: Kinematics
    report: Report
    materials: Materials
    frames: Mapping[str, FrameId]  # by the names that poses of SDF are relative to

    def home(self, link: str) -> FrameId:
        """Give the frame that URDF means by a link: that of the joint above it."""
        above = self.kinematics.parent_joint.get(link)
        return FrameId('joint', above.name) if above else FrameId('link', link)

    def offset(self, link: str) -> Pose:
        """Give where that frame is in the link's own one."""
        return self.kinematics.between(FrameId('link', link), self.home(link))


def write_urdf(robot: Robot, report: Report) -> Element:
    """
    Write a robot.

    :returns: the element ``<robot>``.
    :raises DescriptionError: several of its links hang on nothing.
    """
    robot = select_root(robot, '', report)
    kinematics = Kinematics(robot)
    target = _WriteContext(kinematics, report, Materials.of(robot), _frames_by_name(robot))
    root = etree.Element('robot', name=robot.name,
                         nsmap=namespaces(robot.extension_elements(), 'sdf'))
    if robot.canonical_link:
        root.set(f'{_SDF}canonical_link', robot.canonical_link)
        report_preserved(report, 'sdf', robot.name, 0, '@canonical_link')
    for link in robot.links:
        _link_element(root, link, target)
    for joint in robot.joints:
        _joint_element(root, joint, target)
    for frame in robot.frames:
        element = frame_to_element(frame, kinematics)
        merge_unread(element, frame.extension.sdf)
        embed_foreign(element, frame.extension.urdf, 'urdf', Report(), frame.name, frame.line)
        element.tag = f'{_SDF}frame'
        root.append(element)
        report_preserved(report, 'sdf', frame.name, frame.line, 'frame')
    _gazebo_elements(root, robot, target)
    merge_unread(root, robot.extension.urdf)
    embed_foreign(root, _without(robot.extension.sdf, GAZEBO['model']), 'sdf', report,
                  robot.name, 0)
    return root


def _frames_by_name(robot: Robot) -> dict[str, FrameId]:
    names = {MODEL_FRAME: MODEL}
    for frame, thing in robot.frame_owners():
        names.setdefault(thing.name, frame)
    return names


def _link_element(root: Element, link: Link, target: _WriteContext) -> None:
    kinematics, home = target.kinematics, target.home(link.name)
    element = etree.SubElement(root, 'link', name=link.name)
    if link.inertial:
        inertial_element(element, link.inertial, kinematics.within(home, link.inertial.placement))
    for tag, shapes in (('visual', link.visuals), ('collision', link.collisions)):
        for shape in shapes:
            shape_element(element, tag, shape, kinematics.within(home, shape.placement), link,
                          target.materials, target.report)
    if home.kind == 'link':
        _note_pose(element, kinematics.between(MODEL, home), link.name, link.line, target.report)
    merge_unread(element, link.extension.urdf)
    embed_foreign(element, _without(link.extension.sdf, GAZEBO['link']), 'sdf', target.report,
                  link.name, link.line)


def _note_pose(element: Element, pose: Pose, name: str, line: int, report: Report) -> None:
    """Keep a pose that URDF has no word for."""
    if not pose.is_identity:
        etree.SubElement(element, f'{_SDF}pose').text = numbers_text(pose.xyz + pose.rpy)
        report_preserved(report, 'sdf', name, line, 'pose')


def _joint_element(root: Element, joint: Joint, target: _WriteContext) -> None:
    kinematics, report = target.kinematics, target.report
    frame, child = FrameId('joint', joint.name), FrameId('link', joint.child)
    kind = joint.type if joint.type in URDF_TYPES else 'floating'
    element = etree.SubElement(root, f'{_SDF}joint' if joint.is_loop else 'joint',
                               name=joint.name, type=kind)
    if joint.is_loop:
        report.warn('joint', joint.name, joint.line, 'closes a loop of links, of which URDF has '
                    'none; kept as <sdf:joint>, which only the way back reads')
    origin_element(element, kinematics.between(target.home(joint.parent), frame))
    etree.SubElement(element, 'parent', link=joint.parent)
    etree.SubElement(element, 'child', link=joint.child)
    if kind not in WITHOUT_AXIS and joint.axes:
        _axis_elements(element, kind, joint.axes[0])
    pose = kinematics.between(child, frame)
    if joint.is_loop and pose.is_identity:
        etree.SubElement(element, f'{_SDF}pose').text = numbers_text(pose.xyz + pose.rpy)
    _note_pose(element, pose, joint.name, joint.line, report)
    merge_unread(element, joint.extension.urdf)
    rest = joint.extension.sdf
    if joint.type != kind:
        report.warn('joint', joint.name, joint.line, f'URDF has no {joint.type} joints; it is a '
                    'floating one there')
        element.set(f'{_SDF}type', joint.type)
        rest = _with_axes(joint)
    embed_foreign(element, _without(rest, _in_gazebo(joint.name, 'joint', target)), 'sdf', report,
          joint.name, joint.line)


def _axis_elements(element: Element, kind: str, axis: Axis) -> None:
    etree.SubElement(element, 'axis', xyz=numbers_text(axis.xyz))
    reach = kind in ('revolute', 'prismatic')
    limit = axis.limit or Limit()
    if reach or math.isfinite(limit.effort) or math.isfinite(limit.velocity):
        names = ('lower', 'upper', 'effort', 'velocity') if reach else ('effort', 'velocity')
        etree.SubElement(element, 'limit', {
            name: _limit_text(getattr(limit, name)) for name in names})
    if axis.dynamics:
        values = {'damping': axis.dynamics.damping, 'friction': axis.dynamics.friction}
        etree.SubElement(element, 'dynamics', {
            name: number_text(value) for name, value in values.items() if value is not None})
    if axis.mimic:
        mimic = etree.SubElement(element, 'mimic', joint=axis.mimic.joint)
        if axis.mimic.multiplier != 1:
            mimic.set('multiplier', number_text(axis.mimic.multiplier))
        if axis.mimic.offset:
            mimic.set('offset', number_text(axis.mimic.offset))


def _limit_text(value: float) -> str:
    return number_text(math.copysign(UNLIMITED, value) if math.isinf(value) else value)


def _with_axes(joint: Joint) -> Element:
    """Give all that SDF says of a joint that URDF has no type for, the axes too."""
    holder = etree.Element('joint')
    for axis, tag in zip(joint.axes, AXES):
        holder.append(axis_to_element(axis, tag, NEWEST))
    merge_unread(holder, joint.extension.sdf, marked=True)
    return holder


def _without(rest: Element | None, tags: frozenset[str]) -> Element | None:
    """Leave out what a ``<gazebo>`` block has."""
    if rest is None or not any(part.tag in tags for part in rest):
        return rest
    copy = detached(rest)
    for part in list(copy):
        if part.tag in tags:
            copy.remove(part)
    return copy if len(copy) or copy.attrib else None


def _in_gazebo(name: str, kind: str, target: _WriteContext) -> frozenset[str]:
    """Tell what of an object goes into a ``<gazebo>`` block: of two of one name, the link's."""
    if kind == 'joint' and name in target.kinematics.child_joints:
        return frozenset()
    return GAZEBO[kind]


def _gazebo_elements(root: Element, robot: Robot, target: _WriteContext) -> None:
    """Write elements of SDF where Gazebo takes them from a file of URDF."""
    things = [(MODEL, robot.extension.sdf),
              *((FrameId('link', link.name), link.extension.sdf) for link in robot.links),
              *((FrameId('joint', joint.name), joint.extension.sdf) for joint in robot.joints)]
    for owner, rest in things:
        tags = _in_gazebo(owner.name, owner.kind, target)
        parts = [] if rest is None else [part for part in rest if part.tag in tags]
        if parts:
            block = etree.SubElement(root, 'gazebo',
                                     {} if owner == MODEL else {'reference': owner.name})
            block.extend(_in_home(part, owner, target) for part in parts)
        for part in parts:
            target.report.preserve(str(part.tag), owner.name or robot.name, line_of(part),
                                'URDF has no word for it; kept in <gazebo>, which Gazebo reads')


def _in_home(part: Element, owner: FrameId, target: _WriteContext) -> Element:
    """Give an element of SDF with its pose in the frame that URDF means by its link."""
    part = detached(part)
    if owner.kind != 'link' or part.tag not in POSED:
        return part
    pose = part.find('pose')
    offset = target.offset(owner.name)
    if offset.is_identity and (pose is None or not pose.attrib):
        return part
    name = '' if pose is None else pose.get('relative_to', pose.get('frame', ''))
    if name not in target.frames and name:
        target.report.warn(str(part.tag), owner.name, line_of(part),
                           f'its pose is relative to {name!r}, which is not there; it is taken as '
                           'relative to the link')
    placement = Placement(pose_of(pose), target.frames.get(name, owner))
    here = target.kinematics.within(target.home(owner.name), placement)
    if pose is None:
        pose = etree.Element('pose')
        part.insert(0, pose)
    pose.attrib.clear()
    pose.text = numbers_text(here.xyz + here.rpy)
    return part
