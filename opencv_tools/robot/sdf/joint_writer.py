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

"""Writer of SDF joints: types, axes, and what a version does not support."""

from __future__ import annotations

from dataclasses import replace
import math

from lxml import etree
from opencv_tools.robot.joint_kinds import SDF_TYPES
from opencv_tools.robot.model import Axis, FrameId, Joint, Limit, WORLD
from opencv_tools.robot.sdf.fragments import AXES, axis_to_element
from opencv_tools.robot.sdf.link_writer import WriteContext
from opencv_tools.robot.sdf.values import (
    CONTINUOUS, JOINT_AXES, MIMIC, pose_element, text_element, Version)
from opencv_tools.robot.xml.document import Element
from opencv_tools.robot.xml.numbers import number_text
from opencv_tools.robot.xml.passthrough import URDF_NAMESPACE


def write_joint(model: Element, joint: Joint, context: WriteContext) -> None:
    """Write a joint into a model; in the namespace of URDF if SDF does not support its type."""
    kinematics, version = context.kinematics, context.version
    prefix = '' if joint.type in SDF_TYPES else f'{{{URDF_NAMESPACE}}}'
    element = etree.SubElement(model, f'{prefix}joint', name=joint.name)
    supported = _supported_joint(joint, version)
    element.set('type', supported.type)
    _preserve_type(element, joint, context)
    text_element(element, 'parent', joint.parent)
    text_element(element, 'child', joint.child)
    frame = FrameId('joint', joint.name)
    if joint.child != WORLD:
        pose_element(element, kinematics.between(FrameId('link', joint.child), frame))
    for tag, axis in zip(AXES, supported.axes):
        in_model = kinematics.pose(frame).rotate(axis.xyz) if version < JOINT_AXES else None
        element.append(axis_to_element(axis, tag, version, in_model))
        if axis.mimic and version < MIMIC:
            mimic = etree.SubElement(element, f'{{{URDF_NAMESPACE}}}mimic',
                                     joint=axis.mimic.joint)
            mimic.set('multiplier', number_text(axis.mimic.multiplier))
            mimic.set('offset', number_text(axis.mimic.offset))
            if tag != AXES[0]:
                mimic.set('axis', tag)
            context.report.preserve('mimic', joint.name, joint.line,
                                    f'not supported by SDF {version}; preserved as <urdf:mimic>')
    context.write_extension(element, joint)
    if joint.type == 'continuous' and version < CONTINUOUS:
        _remove_positions(element, joint, context)


def _supported_joint(joint: Joint, version: Version) -> Joint:
    """Return a revolute joint in place of a continuous or fixed joint of newer versions."""
    if joint.type == 'continuous' and version < CONTINUOUS:
        return replace(joint, type='revolute')
    if joint.type == 'fixed' and version < JOINT_AXES:
        return replace(joint, type='revolute', axes=(Axis((0.0, 0.0, 1.0), Limit(0.0, 0.0)),))
    return joint


def _preserve_type(element: Element, joint: Joint, context: WriteContext) -> None:
    """Preserve a type that SDF does not support, or that its reader would change."""
    is_unlimited = (joint.limit.lower, joint.limit.upper) == (-math.inf, math.inf)
    is_revolute = joint.type == 'fixed' and context.version < JOINT_AXES
    if is_revolute or (joint.type == 'revolute' and is_unlimited):
        element.set(f'{{{URDF_NAMESPACE}}}type', joint.type)
    if is_revolute:
        context.report.warn('joint', joint.name, joint.line,
                            f'fixed joints are not supported by SDF {context.version}; written as '
                            'a revolute joint with both limits 0')
    elif joint.type not in SDF_TYPES:
        context.report.warn('joint', joint.name, joint.line,
                            f'{joint.type} joints are not supported by SDF; preserved as '
                            f'<urdf:joint>, and link {joint.child!r} is not connected')


def _remove_positions(element: Element, joint: Joint, context: WriteContext) -> None:
    """Remove position limits of a continuous joint that would limit the revolute joint."""
    for limit in element.iterfind(f'{AXES[0]}/limit'):
        for number in list(limit.iterchildren('lower', 'upper')):
            limit.remove(number)
            context.report.warn(str(number.tag), joint.name, joint.line,
                                f'{number.text!r} is omitted: it would limit the revolute joint '
                                f'in place of a continuous joint in SDF {context.version}')
