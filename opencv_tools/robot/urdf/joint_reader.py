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

"""Reader of URDF joints, also of those that only SDF has and that the URDF writer preserved."""

from __future__ import annotations

import math

from lxml import etree
from opencv_tools.robot.joint_kinds import JOINT_KINDS, URDF_TYPES, WITHOUT_AXIS
from opencv_tools.robot.model import (
    Axis, Dynamics, Extension, FrameId, Joint, Limit, Mimic, Placement)
from opencv_tools.robot.sdf.fragments import AXES, axis_from_element, mimic_of_urdf
from opencv_tools.robot.urdf.context import UrdfContext
from opencv_tools.robot.urdf.poses import origin_of, preserved_pose
from opencv_tools.robot.xml.document import (
    DescriptionError, line_of, required_name, TrackedElement)
from opencv_tools.robot.xml.numbers import limit_number, number, vector
from opencv_tools.robot.xml.passthrough import SDF_TAG


def read_joint(element: TrackedElement, context: UrdfContext) -> Joint:
    """Read a joint with its axes, and with what ``<gazebo>`` adds to it."""
    name, joint_type = required_name(element), element.get('type')
    if joint_type not in URDF_TYPES:
        problem = 'has no type=' if joint_type is None else f'type={joint_type!r} is not supported'
        raise DescriptionError(f'{problem}; give one of {", ".join(URDF_TYPES)}', element)
    is_loop = element.tag != 'joint'
    parent, child = context.tree.ends(element)
    placement = Placement(origin_of(element), context.link_frame(parent))
    if is_loop and (pose := preserved_pose(element)) is not None:
        placement = Placement(pose, FrameId('link', child))
    sdf_type = element.get(f'{SDF_TAG}type', '')
    axes = () if sdf_type else _axes(element, joint_type, context)
    extension = context.extension(element, FrameId('joint', name))
    if sdf_type:
        joint_type = sdf_type
        axes, extension = _sdf_axes(element, sdf_type, extension)
    return Joint(name=name, type=joint_type, parent=parent, child=child, placement=placement,
                 axes=axes, is_loop=is_loop, extension=extension, line=line_of(element))


def _sdf_axes(element: TrackedElement, sdf_type: str, extension: Extension
              ) -> tuple[tuple[Axis, ...], Extension]:
    """Return the axes of a joint that URDF does not have, and its extension without them."""
    if sdf_type not in JOINT_KINDS:
        raise DescriptionError(f'type={sdf_type!r} is not a joint type of SDF', element)
    sdf = TrackedElement(etree.Element('joint') if extension.sdf is None else extension.sdf)
    axes = tuple(axis_from_element(axis) for axis in map(sdf.find, AXES) if axis is not None)
    return axes, Extension(extension.urdf, sdf.unread())


def _axes(element: TrackedElement, joint_type: str, context: UrdfContext) -> tuple[Axis, ...]:
    if joint_type in WITHOUT_AXIS:
        return ()
    axis = element.find('axis')
    xyz = (1.0, 0.0, 0.0)
    if axis is not None and 'xyz' in axis:
        xyz = vector(axis.get('xyz'), axis, 'xyz')
        if not any(xyz):
            raise DescriptionError(
                f'xyz={axis.get("xyz")!r} has no direction; give {joint_type} joint '
                f'{required_name(element)!r} a non-zero axis', axis)
    limit, dynamics = _limit(element, joint_type, context), element.find('dynamics')
    values = None if dynamics is None else Dynamics(*(
        number(dynamics.get(name), dynamics, name) if name in dynamics else None
        for name in ('damping', 'friction')))
    return (Axis(xyz, limit, values, _mimic(element, context)),)


def _limit(element: TrackedElement, joint_type: str, context: UrdfContext) -> Limit | None:
    limit = element.find('limit')
    has_position_limits = joint_type in ('revolute', 'prismatic')
    if limit is None:
        if has_position_limits:
            raise DescriptionError(
                f'a {joint_type} joint requires <limit effort= velocity=>', element)
        return None
    effort, velocity = (_effort_or_velocity(limit, name, is_required=joint_type != 'planar')
                        for name in ('effort', 'velocity'))
    if not has_position_limits:
        return Limit(effort=effort, velocity=velocity)
    lower, upper = (limit_number(limit.get(name, '0'), limit, name) for name in ('lower', 'upper'))
    if lower > upper:
        context.report.warn('limit', required_name(element), line_of(limit),
                            f'lower={lower!r} is greater than upper={upper!r}')
    return Limit(lower, upper, effort, velocity)


def _effort_or_velocity(limit: TrackedElement, name: str, *, is_required: bool) -> float:
    if name not in limit and is_required:
        raise DescriptionError(f'has no {name}=, which URDF requires', limit)
    value = limit_number(limit.get(name, 'inf'), limit, name)
    return abs(value) if math.isinf(value) else value


def _mimic(element: TrackedElement, context: UrdfContext) -> Mimic | None:
    mimic = element.find('mimic')
    if mimic is None:
        return None
    joint = mimic.element.get('joint', '').strip()
    if not joint:
        raise DescriptionError('has no joint=; name the joint to follow', mimic)
    if joint not in context.tree.joints:
        context.report.warn('mimic', required_name(element), line_of(mimic),
                            f'joint={joint!r} does not exist; the <mimic> is preserved without '
                            'effect')
        return None
    mimic.get('joint')
    return mimic_of_urdf(mimic, joint)
