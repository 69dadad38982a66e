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

"""Reader of SDF joints and their axes: types, rules of each version, and closed loops."""

from __future__ import annotations

from dataclasses import replace
import math

from opencv_tools.robot.joint_kinds import JOINT_KINDS, SDF_TYPES
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import Axis, FrameId, Joint, Mimic, Robot
from opencv_tools.robot.sdf.context import SdfContext
from opencv_tools.robot.sdf.fragments import AXES, axis_from_element, mimic_of_urdf, Rotation
from opencv_tools.robot.sdf.names import JOINTS
from opencv_tools.robot.sdf.values import flag, FRAMES, JOINT_AXES, MODEL_FRAME
from opencv_tools.robot.xml.document import (
    DescriptionError, line_of, required_name, TrackedElement)
from opencv_tools.robot.xml.passthrough import URDF_JOINT_TYPE, URDF_TAG

_MIMIC = f'{URDF_TAG}mimic'


def with_axes(joint: Joint, element: TrackedElement, context: SdfContext, kinematics: Kinematics
              ) -> Joint:
    """
    Add the axes of a joint and its unread parts.

    :param joint: result of `joint_reader.read_joint`.
    :param kinematics: kinematics of the robot with all its frames.
    """
    axes = []
    for tag in AXES[:joint.kind.max_axes]:
        child = element.find(tag)
        if child is not None:
            axis = axis_from_element(child, _rotation(child, joint, context, kinematics),
                                     joint_type=joint.type)
            axes.append(replace(axis, mimic=_mimic(element, child, axis, context)))
        elif tag == AXES[0] and joint.type in SDF_TYPES:
            context.report.warn('joint', joint.name, joint.line, f'{joint.type} joint without '
                                '<axis>; the default of SDF is 0 0 1')
            axes.append(Axis((0.0, 0.0, 1.0)))
    urdf_type = element.get(URDF_JOINT_TYPE)
    if urdf_type == 'fixed':
        element.take_first(AXES[0])  # before SDF 1.5 it is a revolute joint with an axis
    joint = replace(joint, axes=tuple(axes), extension=context.extension(element))
    limits = joint.limit.lower, joint.limit.upper
    if limits[0] > limits[1]:
        context.report.warn('limit', joint.name, joint.line,
                            f'lower={limits[0]} is greater than upper={limits[1]}')
    is_continuous = joint.type == 'revolute' and limits == (-math.inf, math.inf) and not urdf_type
    return replace(joint, type='continuous') if is_continuous else joint


def _rotation(axis: TrackedElement, joint: Joint, context: SdfContext, kinematics: Kinematics
              ) -> Rotation | None:
    """Return the rotation of an axis into the joint frame, by the rules of the SDF version."""
    version, xyz = context.scope.file.version, axis.find('xyz')
    name = '' if xyz is None else xyz.get('expressed_in', '')
    old = axis.find('use_parent_model_frame')
    if old is not None and flag(old.text, old) and version >= FRAMES:
        context.report.warn('axis', joint.name, line_of(old), 'use_parent_model_frame is ignored '
                            'since SDF 1.7; use expressed_in=')
    elif version < FRAMES:
        # An axis of a model inside another model, not in its own file, is in the joint frame.
        is_inline = context.scope.parent is not None and not context.scope.file.includes
        in_model = version < JOINT_AXES and not is_inline
        if in_model if old is None else flag(old.text, old):
            name = MODEL_FRAME
    if not name:
        return None
    frame = context.registry.lookup(context.scope, name, axis, 'expressed_in')
    pose = kinematics.between(FrameId('joint', joint.name), frame)
    return pose.transform().rotate if any(pose.rpy) else None


def _mimic(joint: TrackedElement, element: TrackedElement, axis: Axis, context: SdfContext
           ) -> Mimic | None:
    """Return the mimic of an axis, which older versions keep as ``<urdf:mimic>`` of the joint."""
    mimic, child = axis.mimic, element.find('mimic')
    for old in joint.take_all(_MIMIC):
        if old.get('axis', AXES[0]) == element.tag:
            mimic = mimic_of_urdf(old, old.get('joint', ''))
    if mimic is None:
        return None
    leader = FrameId('joint', context.scope.qualified(mimic.joint))
    if leader in context.registry.elements:
        return replace(mimic, joint=leader.name)
    if child is None:
        raise DescriptionError(f'mimics {mimic.joint!r}, which is not a joint; name a joint of '
                               'the model', element)
    context.report.warn('mimic', context.scope.qualified(required_name(joint)), line_of(child),
                        f'joint={mimic.joint!r} is not a joint of the model; the <mimic> is '
                        'preserved without effect')
    element.put_back(child)
    return None


def read_joint(element: TrackedElement, context: SdfContext) -> Joint:
    """Read a joint without its axes."""
    scope, registry = context.scope, context.registry
    name = scope.qualified(required_name(element))
    ends = {tag: registry.joint_end(element, scope, tag) for tag in ('parent', 'child')}
    links = {tag: registry.link_of(frame) for tag, frame in ends.items()}
    for tag, frame in ends.items():
        if frame.kind != 'link':
            context.report.preserve('joint', name, line_of(element),
                                    f'<{tag}> is frame {frame.name or MODEL_FRAME!r}; '
                                    f'converted to its link {links[tag]!r}')
    if links['parent'] == links['child']:
        raise DescriptionError(f'connects link {links["child"]!r} with itself; name two links',
                               element)
    return Joint(name=name, type=_joint_type(element), parent=links['parent'],
                 child=links['child'], placement=context.placement(element, ends['child']),
                 line=line_of(element))


def mark_loops(robot: Robot, canonical: str) -> Robot:
    """
    Mark the joints that close a loop, so that the other joints form trees.

    The first joint of a link, in the order of the file, places the link. If every link is the
    child of a joint, the root is the canonical link, or else the first link.
    """
    components = _DisjointSets()
    for joint in robot.joints:
        components.union(joint.parent, joint.child)
    children = {joint.child for joint in robot.joints}
    links = [canonical, *(link.name for link in robot.links)]
    rooted = {components.find(link) for link in links if link not in children}
    placed = set()
    for link in links:
        if components.find(link) not in rooted:
            rooted.add(components.find(link))
            placed.add(link)
    trees, joints = _DisjointSets(), []
    for joint in robot.joints:
        is_loop = joint.child in placed or not trees.union(joint.parent, joint.child)
        if not is_loop:
            placed.add(joint.child)
        joints.append(replace(joint, is_loop=is_loop))
    return replace(robot, joints=tuple(joints))


class _DisjointSets:
    """Sets of connected links (union-find)."""

    def __init__(self) -> None:
        self._parents: dict[str, str] = {}

    def find(self, link: str) -> str:
        """Return the representative of the set of a link."""
        while (parent := self._parents.get(link, link)) != link:
            self._parents[link] = self._parents.get(parent, parent)
            link = parent
        return link

    def union(self, first: str, second: str) -> bool:
        """Join the sets of two links; return whether they were separate."""
        first, second = self.find(first), self.find(second)
        self._parents[second] = first
        return first != second


def _joint_type(element: TrackedElement) -> str:
    text = element.get(URDF_JOINT_TYPE, element.get('type', '')).strip().lower()
    # A joint in the namespace of URDF may have a type that is not supported by SDF.
    types = SDF_TYPES if element.tag == JOINTS[0] else tuple(JOINT_KINDS)
    if text not in types:
        raise DescriptionError(f'type={text!r} is not supported; use one of {", ".join(types)}',
                               element)
    return text
