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

from dataclasses import replace

from lxml import etree
from opencv_tools.robot.joint_kinds import SDF_TYPES
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import Frame, FrameId, MODEL, Robot, WORLD
from opencv_tools.robot.sdf.fragments import frame_to_element
from opencv_tools.robot.sdf.joint_writer import write_joint
from opencv_tools.robot.sdf.link_writer import write_link, WriteContext
from opencv_tools.robot.sdf.values import FRAMES, poses_in, written_version
from opencv_tools.robot.xml.document import DescriptionError, Element
from opencv_tools.robot.xml.passthrough import (
    embed_foreign, merge_unread, namespaces, URDF_NAMESPACE)
from opencv_tools.robot.xml.report import Report


def write_sdf(robot: Robot, report: Report, *, version: str = '1.11',
              relative: bool = False) -> Element:
    """
    Write a robot as SDF.

    :param robot: a robot with valid SDF names; see `renaming.with_valid_sdf_names`.
    :param report: receives what this version of SDF does not support.
    :param version: 1.4 to 1.12.
    :param relative: whether each link is placed relative to its parent link, which keeps the
        numbers of a URDF; otherwise relative to the model frame.
    :raises DescriptionError: the version is invalid or does not support the request, or the robot
        has no links, or moves the world.
    """
    output = written_version(version)
    if relative and output < FRAMES:
        raise DescriptionError(f'relative poses are not supported by SDF {version}; use version '
                               f'{FRAMES} or newer, or poses in the model frame')
    context = WriteContext(Kinematics(robot), output, relative, report)
    _check_links(robot, context)
    root = etree.Element('sdf', version=str(output),
                         nsmap=namespaces(robot.extension_elements(), 'urdf'))
    model = etree.SubElement(root, 'model', name=robot.name)
    _set_canonical_link(model, robot, context)
    for link in robot.links:
        if not link.is_world:
            write_link(model, link, context)
    for joint in robot.joints:
        write_joint(model, joint, context)
    substitutes = _substitute_frames(robot)
    for frame in robot.frames:
        attached_to = substitutes.get(frame.attached_to, frame.attached_to)
        _write_frame(model, replace(frame, attached_to=attached_to), context)
    merge_unread(model, robot.extension.sdf)
    embed_foreign(model, robot.extension.urdf, 'urdf', report, robot.name, 0)
    if output < FRAMES:
        for pose in poses_in(root):  # poses of extensions have the attribute of newer versions
            if (name := pose.attrib.pop('relative_to', None)) is not None:
                pose.set('frame', name)
    return root


def _check_links(robot: Robot, context: WriteContext) -> None:
    if all(link.is_world for link in robot.links):
        raise DescriptionError(f'robot {robot.name!r} has no links', source=robot.source)
    joint = context.kinematics.parent_joint.get(WORLD)
    if joint and any(link.is_world for link in robot.links):
        raise DescriptionError(f"joint {joint.name!r} has the child 'world', which is not "
                               'supported by SDF; make the world its parent',
                               source=robot.source, line=joint.line, tag='joint')


def _set_canonical_link(model: Element, robot: Robot, context: WriteContext) -> None:
    first = next(link.name for link in robot.links if not link.is_world)
    if robot.canonical_link and context.version >= FRAMES:
        model.set('canonical_link', robot.canonical_link)
    elif robot.canonical_link not in ('', first):
        context.report.warn('model', robot.name, 0, 'canonical_link is not supported by SDF '
                            f'{context.version}; the canonical link becomes {first!r}')


def _write_frame(model: Element, frame: Frame, context: WriteContext) -> None:
    element = frame_to_element(frame, context.kinematics)
    context.write_extension(element, frame)
    if context.version < FRAMES:
        element.tag = f'{{{URDF_NAMESPACE}}}frame'
        context.report.warn('frame', frame.name, frame.line, 'not supported by SDF '
                            f'{context.version}; preserved as <urdf:frame>')
    model.append(element)


def _substitute_frames(robot: Robot) -> dict[FrameId, FrameId]:
    """Return the frames that SDF does not support, each with a frame that moves with it."""
    links = {FrameId('link', link.name): MODEL for link in robot.links if link.is_world}
    joints = {FrameId('joint', joint.name): FrameId('link', joint.child)
              for joint in robot.joints if joint.type not in SDF_TYPES}
    return links | joints
