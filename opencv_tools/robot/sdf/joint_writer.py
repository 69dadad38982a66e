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

"""Joints of SDF, written: their types, their axes, and what SDF has no word for."""

from __future__ import annotations

from dataclasses import replace
import math

from lxml import etree
from opencv_tools.robot.joint_kinds import SDF_TYPES
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import Axis, FrameId, Joint, Limit, Mimic, WORLD
from opencv_tools.robot.sdf.fragments import AXES, axis_to_element
from opencv_tools.robot.sdf.values import (
    CONTINUOUS, JOINT_AXES, MIMIC, pose_element, text_element, Version, version_text)
from opencv_tools.robot.xml.document import Element
from opencv_tools.robot.xml.numbers import number_text
from opencv_tools.robot.xml.passthrough import embed_foreign, merge_unread, URDF_NAMESPACE
from opencv_tools.robot.xml.report import Report


def joint_element(model: Element, joint: Joint, kinematics: Kinematics, version: Version,
                  report: Report) -> None:
    """Write a joint into a model; in the namespace of URDF where SDF has no such joint."""
    prefix = '' if joint.type in SDF_TYPES else f'{{{URDF_NAMESPACE}}}'
    element = etree.SubElement(model, f'{prefix}joint', name=joint.name)
    _set_type(element, joint, version, report)
    text_element(element, 'parent', joint.parent)
    text_element(element, 'child', joint.child)
    frame = FrameId('joint', joint.name)
    if joint.child != WORLD:
        pose_element(element, kinematics.between(FrameId('link', joint.child), frame))
    for tag, axis in zip(AXES, _axes(joint, version)):
        direction = None
        if version < JOINT_AXES:
            direction = kinematics.pose(frame).rotate(axis.xyz)
        element.append(axis_to_element(axis, tag, version, direction))
        if axis.mimic and version < MIMIC:
            _mimic_element(element, axis.mimic, tag)
            report.preserve('mimic', joint.name, joint.line,
                         f'SDF {version_text(version)} has no mimic; kept as <urdf:mimic>')
    merge_unread(element, joint.extension.sdf)
    if joint.type == 'continuous' and version < CONTINUOUS:
        _remove_positions(element, joint, version, report)
    embed_foreign(element, joint.extension.urdf, 'urdf', report, joint.name, joint.line)


def _set_type(element: Element, joint: Joint, version: Version, report: Report) -> None:
    """Name the type, or in older versions the one that means the same."""
    written = joint.type
    limits = joint.limit.lower, joint.limit.upper
    if joint.type == 'revolute' and limits == (-math.inf, math.inf):
        # Without limits it means a continuous one, which URDF has another word for.
        element.set(f'{{{URDF_NAMESPACE}}}type', joint.type)
    elif joint.type == 'continuous' and version < CONTINUOUS:
        written = 'revolute'  # without limits, which is the same
    elif joint.type == 'fixed' and version < JOINT_AXES:
        written = 'revolute'
        element.set(f'{{{URDF_NAMESPACE}}}type', joint.type)
        report.warn('joint', joint.name, joint.line,
                    f'SDF {version_text(version)} has no fixed joints; a revolute one with both '
                    'limits at 0 stands there')
    elif joint.type not in SDF_TYPES:
        report.warn('joint', joint.name, joint.line,
                    f'SDF has no {joint.type} joints; kept as <urdf:joint>, and link '
                    f'{joint.child!r} is placed where it is without any joint')
    element.set('type', written)


def _axes(joint: Joint, version: Version) -> tuple[Axis, ...]:
    if joint.type == 'fixed' and version < JOINT_AXES:
        return (Axis((0.0, 0.0, 1.0), Limit(0.0, 0.0)),)
    if joint.type == 'continuous' and version < CONTINUOUS:
        return tuple(replace(axis, limit=axis.limit and replace(
            axis.limit, lower=-math.inf, upper=math.inf)) for axis in joint.axes)
    return joint.axes


def _remove_positions(element: Element, joint: Joint, version: Version, report: Report) -> None:
    """Remove limits that mean nothing to a continuous joint, which is a revolute one here."""
    for limit in element.iterfind(f'{AXES[0]}/limit'):
        for number in list(limit.iterchildren('lower', 'upper')):
            limit.remove(number)
            report.warn(str(number.tag), joint.name, joint.line, f'{number.text!r} is left out: '
                        f'SDF {version_text(version)} has no continuous joints, and a '
                        'revolute one would be limited by it')


def _mimic_element(joint: Element, mimic: Mimic, tag: str) -> None:
    element = etree.SubElement(joint, f'{{{URDF_NAMESPACE}}}mimic', joint=mimic.joint)
    element.set('multiplier', number_text(mimic.multiplier))
    element.set('offset', number_text(mimic.offset))
    if tag != AXES[0]:
        element.set('axis', tag)
