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

"""What a file of the other format may contain: axes, mimics, frames, and SDF in ``<gazebo>``."""

from __future__ import annotations

from collections.abc import Callable
import math

from lxml import etree
from opencv_tools.robot.geometry import Capsule, Geometry
from opencv_tools.robot.model import (
    Axis, Dynamics, FrameId, Limit, Mimic, MODEL, Placement, RobotFrame)
from opencv_tools.robot.pose import normalised, Pose, Vector, ZERO
from opencv_tools.robot.sdf.rules import find_flaw, parsed_elements
from opencv_tools.robot.sdf.values import (
    MIMIC, MODEL_FRAME, number_element, number_of, pose_element, pose_of, text_element, Version)
from opencv_tools.robot.xml.document import (
    AnyElement, DescriptionError, Element, ElementT, line_of, required_name, TrackedElement)
from opencv_tools.robot.xml.numbers import (
    limit_number, number, number_text, numbers_text, required_number, vector)
from opencv_tools.robot.xml.passthrough import URDF_TAG
from opencv_tools.robot.xml.report import Report

AXES = ('axis', 'axis2')
_XYZ = f'{URDF_TAG}xyz'
Rotation = Callable[[Vector], Vector]


def axis_from_element(element: AnyElement, rotation: Rotation | None = None, *,
                      joint_type: str = '') -> Axis:
    """
    Read an axis.

    :param rotation: rotates the direction into the joint frame; None if it is in that frame.
    :param joint_type: type of the joint; position limits of a continuous joint are not read.
    :raises DescriptionError: the direction is zero, or a number is invalid.
    """
    child = element.find('xyz')
    xyz: Vector = (0.0, 0.0, 1.0) if child is None else vector(child.text, child)
    if xyz == ZERO:
        raise DescriptionError("is '0 0 0'; give a non-zero direction", child)
    xyz = rotation(xyz) if rotation else xyz
    if child is not None and child.get(_XYZ):
        original = vector(child.get(_XYZ), child, 'urdf:xyz')
        # The original numbers count only if the direction was not edited since.
        if original != ZERO and math.dist(normalised(original), normalised(xyz)) < 1e-9:
            xyz = original
    limit, dynamics, mimic = map(element.find, ('limit', 'dynamics', 'mimic'))
    return Axis(xyz, None if limit is None else _limit(limit, joint_type),
                None if dynamics is None else Dynamics(*(
                    number_of(dynamics, tag, None) for tag in ('damping', 'friction'))),
                None if mimic is None else _mimic(mimic))


def _limit(element: AnyElement, joint_type: str) -> Limit:
    positions = () if joint_type == 'continuous' else ('lower', 'upper')
    values = {tag: limit_number(child.text, child) for tag in (*positions, 'effort', 'velocity')
              if (child := element.find(tag)) is not None}
    for tag in ('effort', 'velocity'):
        # A preserved negative number of a URDF means no limit.
        text = element.get(f'{URDF_TAG}{tag}', 'inf')
        negative = limit_number(text, element, f'urdf:{tag}')
        if tag not in values:
            values[tag] = negative if negative < 0 else math.inf
        else:  # SDF does not enforce a negative effort or velocity
            values[tag] = math.inf if values[tag] < 0 else abs(values[tag])
    return Limit(**values)


def _mimic(element: AnyElement) -> Mimic:
    multiplier = number_of(element, 'multiplier', 1.0)
    offset, reference = number_of(element, 'offset', 0.0), number_of(element, 'reference', 0.0)
    return Mimic(element.get('joint', ''), multiplier, offset - multiplier * reference)


def mimic_of_urdf(element: TrackedElement, joint: str) -> Mimic:
    """
    Read the numbers of a ``<mimic>`` of URDF, which are attributes.

    :param joint: name of the joint that is mimicked.
    """
    return Mimic(joint, number(element.get('multiplier', '1'), element, 'multiplier'),
                 number(element.get('offset', '0'), element, 'offset'))


def with_capsule(shape: Geometry | None, preserved: TrackedElement | None, report: Report,
                 name: str) -> Geometry | None:
    """
    Return a shape, or the capsule that a writer preserved beside the cylinder in its place.

    :param name: name for the warning of an edited cylinder.
    """
    if preserved is None:
        return shape
    capsule = Capsule(*(required_number(preserved, size) for size in ('radius', 'length')))
    if shape == capsule.cylinder:
        return capsule
    report.warn('capsule', name, line_of(preserved), 'is ignored: the shape in its place was '
                'edited')
    return shape


def axis_to_element(axis: Axis, tag: str, version: Version) -> Element:
    """
    Write an axis of unit length.

    :param tag: ``axis`` or ``axis2``.
    """
    element = etree.Element(tag)
    unit = normalised(axis.xyz)
    xyz = text_element(element, 'xyz', numbers_text(unit))
    if unit != axis.xyz:
        xyz.set(_XYZ, numbers_text(axis.xyz))
    if axis.limit is not None:
        _limit_element(element, axis.limit)
    if axis.dynamics is not None:
        dynamics = etree.SubElement(element, 'dynamics')
        for name, value in vars(axis.dynamics).items():
            if value is not None:
                number_element(dynamics, name, value)
    if axis.mimic is not None and version >= MIMIC:
        mimic = etree.SubElement(element, 'mimic', joint=axis.mimic.joint)
        number_element(mimic, 'multiplier', axis.mimic.multiplier)
        number_element(mimic, 'offset', axis.mimic.offset)
        number_element(mimic, 'reference', 0.0)
    return element


def _limit_element(axis: Element, limit: Limit) -> None:
    element = etree.SubElement(axis, 'limit')
    for tag, value in vars(limit).items():
        # An omitted value means no limit.
        if tag in ('effort', 'velocity') and value < 0:
            element.set(f'{URDF_TAG}{tag}', number_text(value))
        elif math.isfinite(value):
            number_element(element, tag, value)


def frame_from_element(
        element: ElementT, lookup: Callable[[str, ElementT], FrameId]) -> RobotFrame:
    """
    Read a frame.

    :param lookup: returns the frame of a name; its second argument is the element with the name.
    """
    def frame_of(holder: ElementT, attribute: str, default: FrameId) -> FrameId:
        name = holder.get(attribute)
        if not name:
            return default
        return MODEL if name == MODEL_FRAME else lookup(name, holder)

    attached_to, pose = frame_of(element, 'attached_to', MODEL), element.find('pose')
    base = attached_to if pose is None else frame_of(pose, 'relative_to', attached_to)
    return RobotFrame(name=required_name(element), attached_to=attached_to,
                      placement=Placement(pose_of(pose), base), line=line_of(element))


def frame_to_element(frame: RobotFrame, pose: Pose, relative_to: str = '') -> Element:
    """
    Write a frame.

    :param relative_to: frame of the pose; empty for the frame that the frame is attached to.
    """
    element = etree.Element('frame', name=frame.name)
    if frame.attached_to != MODEL:
        element.set('attached_to', frame.attached_to.name)
    pose_element(element, pose, '' if relative_to == frame.attached_to.name else relative_to)
    return element


def fragment_flaw(element: Element, *, is_exact: bool = False) -> str:
    """Return the first result of `find_flaw` for an element and its contents."""
    return next(filter(None, (find_flaw(one, is_exact=is_exact) for one in (
        element, *parsed_elements(element)))), '')
