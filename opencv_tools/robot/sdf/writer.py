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

"""Robots written as SDF: a model whose links are placed in it, or each in the link above it."""

from __future__ import annotations

from dataclasses import replace

from lxml import etree
from opencv_tools.robot.joint_kinds import SDF_TYPES
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import Frame, FrameId, Link, MODEL, Robot, WORLD
from opencv_tools.robot.sdf.fragments import frame_to_element
from opencv_tools.robot.sdf.joint_writer import joint_element
from opencv_tools.robot.sdf.link_writer import inertial_element, shape_element
from opencv_tools.robot.sdf.values import (
    FRAMES, pose_element, poses_in, Version, version_text, written_version)
from opencv_tools.robot.xml.document import DescriptionError, Element
from opencv_tools.robot.xml.passthrough import (
    embed_foreign, merge_unread, namespaces, URDF_NAMESPACE)
from opencv_tools.robot.xml.report import Report


def write_sdf(robot: Robot, report: Report, *, version: str = '1.11',
              relative: bool = False) -> Element:
    """
    Write a robot as SDF.

    :param robot: its names are those that SDF allows; see `names.with_valid_sdf_names`.
    :param report: takes what SDF, or this version of it, has no word for.
    :param version: 1.4 to 1.12.
    :param relative: whether each link is placed in the one above it, so that all numbers of a URDF
        stay as they are; else in the model's frame.
    :raises DescriptionError: there is no such version, this one cannot say what is asked for, or
        the robot is none that SDF can have.
    """
    wanted = written_version(version)
    if relative and wanted < FRAMES:
        raise DescriptionError(f'SDF {version} has no relative_to; ask for version '
                               f'{version_text(FRAMES)} or newer, or for poses in the model frame')
    kinematics = Kinematics(robot)
    _check(robot, kinematics)
    root = etree.Element('sdf', version=version_text(wanted),
                         nsmap=namespaces(robot.extension_elements(), 'urdf'))
    model = etree.SubElement(root, 'model', name=robot.name)
    if robot.canonical_link:
        _set_canonical_link(model, robot, wanted, report)
    for link in robot.links:
        if not link.is_world:
            _link_element(model, link, kinematics, wanted, relative, report)
    for joint in robot.joints:
        joint_element(model, joint, kinematics, wanted, report)
    stand_ins = _stand_ins(robot)
    for frame in robot.frames:
        home = stand_ins.get(frame.attached_to, frame.attached_to)
        _add_frame(model, replace(frame, attached_to=home), kinematics, wanted, report)
    merge_unread(model, robot.extension.sdf)
    embed_foreign(model, robot.extension.urdf, 'urdf', report, robot.name, 0)
    if wanted < FRAMES:
        _rename_references(root)
    return root


def _check(robot: Robot, kinematics: Kinematics) -> None:
    if all(link.is_world for link in robot.links):
        raise DescriptionError(f'robot {robot.name!r} has no links', source=robot.source)
    above = kinematics.parent_joint.get(WORLD)
    if above and any(link.is_world for link in robot.links):
        raise DescriptionError(f'joint {above.name!r} has the world as its child, which SDF '
                               'forbids; make the world its parent', source=robot.source,
                               line=above.line, tag='joint')


def _set_canonical_link(model: Element, robot: Robot, version: Version, report: Report) -> None:
    first = next(link.name for link in robot.links if not link.is_world)
    if version >= FRAMES:
        model.set('canonical_link', robot.canonical_link)
    elif robot.canonical_link != first:
        report.warn('model', robot.name, 0,
                    f'SDF {version_text(version)} has no canonical_link; it is {first!r} there')


def _link_element(model: Element, link: Link, kinematics: Kinematics, version: Version,
                  relative: bool, report: Report) -> None:
    element = etree.SubElement(model, 'link', name=link.name)
    frame = FrameId('link', link.name)
    above = kinematics.parent_joint.get(link.name) if relative else None
    home = FrameId('link', above.parent) if above and above.parent != WORLD else MODEL
    pose_element(element, kinematics.between(home, frame), home.name)
    if link.inertial is not None:
        inertial_element(element, link.inertial,
                         kinematics.within(frame, link.inertial.placement))
    for tag, shapes in (('collision', link.collisions), ('visual', link.visuals)):
        for shape in shapes:
            pose = kinematics.within(frame, shape.placement)
            shape_element(element, tag, shape, pose, version, report)
    merge_unread(element, link.extension.sdf)
    embed_foreign(element, link.extension.urdf, 'urdf', report, link.name, link.line)


def _add_frame(model: Element, frame: Frame, kinematics: Kinematics, version: Version,
               report: Report) -> None:
    element = frame_to_element(frame, kinematics)
    merge_unread(element, frame.extension.sdf)
    embed_foreign(element, frame.extension.urdf, 'urdf', report, frame.name, frame.line)
    if version < FRAMES:
        element.tag = f'{{{URDF_NAMESPACE}}}frame'
        report.warn('frame', frame.name, frame.line,
                    f'SDF {version_text(version)} has no such frames; kept as <urdf:frame>')
    model.append(element)


def _stand_ins(robot: Robot) -> dict[FrameId, FrameId]:
    """Give the frames that SDF does not have, each with the one that moves as it does."""
    links = {FrameId('link', link.name): MODEL for link in robot.links if link.is_world}
    joints = {FrameId('joint', joint.name): FrameId('link', joint.child)
              for joint in robot.joints if joint.type not in SDF_TYPES}
    return links | joints


def _rename_references(root: Element) -> None:
    """Name the frames of poses that were carried as SDF before 1.7 has them."""
    for pose in poses_in(root):
        name = pose.attrib.pop('relative_to', None)
        if name is not None:
            pose.set('frame', name)
