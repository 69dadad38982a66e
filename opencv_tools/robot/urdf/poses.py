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
Poses in URDF, and poses of SDF elements in a link, such as sensors, in both formats.

In URDF the frame of a link is that of its parent joint.
"""

from __future__ import annotations

from collections.abc import Mapping

from lxml import etree
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import FrameId, Placement
from opencv_tools.robot.pose import Pose, rotation_of_quaternion, Transform, ZERO
from opencv_tools.robot.sdf.values import pose_of, POSED
from opencv_tools.robot.xml.document import (
    DescriptionError, detached, Element, line_of, TrackedElement)
from opencv_tools.robot.xml.numbers import numbers, numbers_text, vector
from opencv_tools.robot.xml.passthrough import SDF_TAG
from opencv_tools.robot.xml.report import Report

# Rounding error of a pose that was transformed there and back.
_ROUNDING = 1e-12


def origin_of(element: TrackedElement) -> Pose:
    """Read the ``<origin>`` of an element; the default is the identity."""
    origin = element.find('origin')
    if origin is None:
        return Pose()
    xyz = vector(origin.get('xyz'), origin, 'xyz') if 'xyz' in origin else ZERO
    rpy = vector(origin.get('rpy'), origin, 'rpy') if 'rpy' in origin else ZERO
    if 'quat_xyzw' not in origin:
        return Pose(xyz, rpy)
    x, y, z, w = numbers(origin.get('quat_xyzw'), 4, origin, 'quat_xyzw')
    if 'rpy' in origin:
        raise DescriptionError('has quat_xyzw= and rpy=; give one of them', origin)
    if not any((x, y, z, w)):
        raise DescriptionError("quat_xyzw='0 0 0 0' is not a rotation; give a quaternion that is "
                               'not zero', origin)
    return Transform(rotation_of_quaternion((w, x, y, z)), xyz).pose()


def preserved_pose(element: TrackedElement) -> Pose | None:
    """Read the pose that the URDF writer preserved, if there is one."""
    pose = element.find(f'{SDF_TAG}pose')
    return None if pose is None else pose_of(pose)


def in_link_frame(element: Element, offset: Pose | None) -> Element:
    """Return an element of SDF with its pose in its link instead of the parent joint."""
    pose = element.find('pose')
    if not offset or element.tag not in POSED or (pose is not None and pose.attrib):
        return element
    in_link = (offset.transform() @ pose_of(pose).transform()).pose()
    element = detached(element)
    if max(map(abs, in_link.xyz + in_link.rpy)) >= _ROUNDING:
        _set_pose(element, in_link)
    elif (pose := element.find('pose')) is not None:
        element.remove(pose)
        element.text = element.text if len(element) else None
    return element


def in_joint_frame(element: Element, link: str, kinematics: Kinematics,
                   frames: Mapping[str, FrameId], report: Report) -> Element:
    """
    Return an element of SDF with its pose in the parent joint instead of its link.

    :param frames: frames by the names that poses of SDF use.
    """
    element = detached(element)
    if element.tag not in POSED:
        return element
    pose, link_frame, owner = (
        element.find('pose'), kinematics.urdf_frame(link), FrameId('link', link))
    if (pose is None or not pose.attrib) and kinematics.between(owner, link_frame).is_identity:
        return element
    name = '' if pose is None else pose.get('relative_to', pose.get('frame', ''))
    if name and name not in frames:
        report.warn(str(element.tag), link, line_of(element), f'<pose> is relative to {name!r}, '
                    'which does not exist; it is read as relative to the link')
    placement = Placement(pose_of(pose), frames.get(name, owner))
    _set_pose(element, kinematics.within(link_frame, placement))
    return element


def _set_pose(element: Element, pose: Pose) -> None:
    """Write the ``<pose>`` of an element of SDF in place of its former one."""
    child = element.find('pose')
    if child is None:
        child = etree.Element('pose')
        element.insert(0, child)
    child.attrib.clear()
    child.text = numbers_text(pose.xyz + pose.rpy)
