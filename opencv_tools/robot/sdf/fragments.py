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

"""The parts of SDF that a URDF may carry: axes and frames, and elements of ``<gazebo>``."""

from __future__ import annotations

from collections.abc import Callable
import math

from lxml import etree
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import Axis, Dynamics, Frame, FrameId, Limit, Mimic, MODEL, Placement
from opencv_tools.robot.pose import normalised, Vector, ZERO
from opencv_tools.robot.sdf.value_rules import flaw_of, looked_at
from opencv_tools.robot.sdf.values import (
    MIMIC, MODEL_FRAME, pose_element, pose_of, text_element, Version)
from opencv_tools.robot.xml.document import (
    AnyElement, DescriptionError, Element, ElementT, line_of, required_name)
from opencv_tools.robot.xml.numbers import limit_number, number, number_text, numbers_text, vector
from opencv_tools.robot.xml.passthrough import URDF_NAMESPACE

AXES = ('axis', 'axis2')
_XYZ = f'{{{URDF_NAMESPACE}}}xyz'
# What turns a direction into the joint's frame; None where it is in it already.
Turn = Callable[[Vector], Vector] | None


def axis_from_element(element: AnyElement, turn: Turn = None, *, kind: str = '') -> Axis:
    """
    Read an axis.

    :param kind: type of the joint; the positions of a continuous one have no limits.
    :param turn: what turns its direction into the joint's frame, where it is in another one.
    :raises DescriptionError: it has no direction, or a number that is none.
    """
    child = element.find('xyz')
    xyz: Vector = (0.0, 0.0, 1.0) if child is None else vector(child.text, child)
    if xyz == ZERO:
        raise DescriptionError('the axis is 0 0 0, which is no direction',
                               element if child is None else child)
    xyz = turn(xyz) if turn else xyz
    if child is not None and child.get(_XYZ):
        written = vector(child.get(_XYZ), child, 'urdf:xyz')
        # Someone may have changed the axis since; what was written says nothing then.
        if written != ZERO and math.dist(normalised(written), normalised(xyz)) < 1e-9:
            xyz = written
    limit, dynamics, mimic = map(element.find, ('limit', 'dynamics', 'mimic'))
    return Axis(xyz, None if limit is None else _limit(limit, kind),
                None if dynamics is None else _dynamics(dynamics),
                None if mimic is None else _plain_mimic(mimic))


def _plain_mimic(element: AnyElement) -> Mimic:
    values = {tag: number(child.text, child) for tag in ('multiplier', 'offset', 'reference')
              if (child := element.find(tag)) is not None}
    multiplier = values.get('multiplier', 1.0)
    reference = values.get('reference', 0.0)
    return Mimic(element.get('joint', ''), multiplier,
                 values.get('offset', 0.0) - (multiplier * reference if reference else 0.0))


def _limit(element: AnyElement, kind: str) -> Limit:
    values = {}
    positions = () if kind == 'continuous' else ('lower', 'upper')
    for tag in (*positions, 'effort', 'velocity'):
        child = element.find(tag)
        if child is not None:
            values[tag] = limit_number(child.text, child)
    lower, upper = values.get('lower', -math.inf), values.get('upper', math.inf)
    kept = {tag: _negative(element, tag) for tag in ('effort', 'velocity')}
    effort, velocity = (_limit_or_inf(values[tag]) if tag in values else kept[tag] for tag in kept)
    return Limit(lower, upper, effort, velocity)


def _limit_or_inf(value: float) -> float:
    """Give an effort or a velocity, which is not enforced where it is negative."""
    return math.inf if value < 0 else abs(value)


def _negative(limit: AnyElement, tag: str) -> float:
    """Read the negative number by which URDF said that there is no limit."""
    text = limit.get(f'{{{URDF_NAMESPACE}}}{tag}', 'inf')
    value = limit_number(text, limit, f'urdf:{tag}')
    return value if value < 0 else math.inf


def _dynamics(element: AnyElement) -> Dynamics:
    return Dynamics(*(None if child is None else number(child.text, child)
                      for child in map(element.find, ('damping', 'friction'))))


def axis_to_element(axis: Axis, tag: str, version: Version,
                    direction: Vector | None = None) -> Element:
    """
    Write an axis, of unit length.

    :param tag: ``axis`` or ``axis2``.
    :param direction: the axis in the frame that this version wants it in; None for the joint's.
    """
    element = etree.Element(tag)
    unit = normalised(axis.xyz if direction is None else direction)
    xyz = text_element(element, 'xyz', numbers_text(unit))
    if unit != axis.xyz:
        xyz.set(f'{{{URDF_NAMESPACE}}}xyz', numbers_text(axis.xyz))
    if axis.limit is not None:
        _limit_element(element, axis.limit)
    if axis.dynamics is not None:
        _dynamics_element(element, axis.dynamics)
    if axis.mimic is not None and version >= MIMIC:
        mimic = etree.SubElement(element, 'mimic', joint=axis.mimic.joint)
        text_element(mimic, 'multiplier', number_text(axis.mimic.multiplier))
        text_element(mimic, 'offset', number_text(axis.mimic.offset))
        text_element(mimic, 'reference', '0')
    return element


def _limit_element(axis: Element, limit: Limit) -> None:
    element = etree.SubElement(axis, 'limit')
    for tag in ('lower', 'upper', 'effort', 'velocity'):
        value = getattr(limit, tag)
        # No limit is what SDF means where it has none.
        if tag in ('effort', 'velocity') and value < 0:
            element.set(f'{{{URDF_NAMESPACE}}}{tag}', number_text(value))
        elif math.isfinite(value):
            text_element(element, tag, number_text(value))


def _dynamics_element(axis: Element, dynamics: Dynamics) -> None:
    element = etree.SubElement(axis, 'dynamics')
    for tag in ('damping', 'friction'):
        value = getattr(dynamics, tag)
        if value is not None:
            text_element(element, tag, number_text(value))


def frame_from_element(element: ElementT, lookup: Callable[[str, ElementT], FrameId],
                       model: FrameId = MODEL) -> Frame:
    """
    Read a frame.

    :param lookup: gives the frame of a name; it is asked with the element that has the name.
    :param model: the frame of the model that it stands in.
    """
    name = element.get('attached_to') or MODEL_FRAME
    home = model if name == MODEL_FRAME else lookup(name, element)
    pose = element.find('pose')
    start = home if pose is None else _named_frame(pose, lookup, model, home)
    return Frame(required_name(element), home, Placement(pose_of(pose), start),
                 line=line_of(element))


def _named_frame(pose: ElementT, lookup: Callable[[str, ElementT], FrameId], model: FrameId,
                 default: FrameId) -> FrameId:
    name = pose.get('relative_to')
    if not name:
        return default
    return model if name == MODEL_FRAME else lookup(name, pose)


def frame_to_element(frame: Frame, kinematics: Kinematics) -> Element:
    """Write a frame, placed in what it is attached to."""
    home = frame.attached_to
    element = etree.Element('frame', name=frame.name)
    if home != MODEL:
        element.set('attached_to', home.name)
    pose_element(element, kinematics.between(home, FrameId('frame', frame.name)))
    return element


def fragment_flaw(element: Element) -> str:
    """Return what the parser of SDF refuses of an element and of those inside it, or nothing."""
    return next(filter(None, map(flaw_of, (element, *looked_at(element)))), '')
