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
URDF, read as a robot.

Each joint is placed in its parent link. Each link with a parent joint is placed in that joint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math

from lxml import etree
from opencv_tools.robot.joint_kinds import JOINT_KINDS, URDF_TYPES, WITHOUT_AXIS
from opencv_tools.robot.kinematics import check_mimic_cycles
from opencv_tools.robot.model import (
    Axis, Dynamics, Extension, Frame, FrameId, Joint, Limit, Link, Mimic, MODEL, Placement, Robot)
from opencv_tools.robot.pose import Pose, ZERO
from opencv_tools.robot.sdf.fragments import (
    AXES, axis_from_element, frame_from_element, mimic_of_urdf)
from opencv_tools.robot.sdf.values import MODEL_FRAME, pose_of
from opencv_tools.robot.trees import select_root
from opencv_tools.robot.urdf.gazebo import extract_sdf, Extracted
from opencv_tools.robot.urdf.link_reader import inertial_from_element, origin_of, shapes_of
from opencv_tools.robot.urdf.materials import collect_materials, MaterialTable
from opencv_tools.robot.urdf.posed import in_link_frame
from opencv_tools.robot.urdf.settings import with_values
from opencv_tools.robot.urdf.tree import build_tree, LinkTree
from opencv_tools.robot.xml.document import (
    AnyElement, DescriptionError, Element, line_of, local_name, required_name, source_of,
    TrackedElement)
from opencv_tools.robot.xml.numbers import limit_number, number, vector
from opencv_tools.robot.xml.passthrough import extract_foreign, SDF_NAMESPACE
from opencv_tools.robot.xml.report import Report

_SDF = f'{{{SDF_NAMESPACE}}}'
_DEFAULT_NAME = 'robot'


@dataclass(frozen=True, kw_only=True)
class _ReadContext:
    """Facts of the whole file that its elements are read with."""

    report: Report
    tree: LinkTree
    materials: MaterialTable
    gazebo: Extracted
    offsets: Mapping[str, Pose]  # by link: its parent joint's pose in it, if not the identity

    def link_frame(self, link: str) -> FrameId:
        """Return the frame of a link in URDF, which is that of its parent joint."""
        parent_joint = self.tree.parent_joint.get(link)
        if parent_joint is not None and link in self.offsets:
            return FrameId('joint', required_name(parent_joint))
        return FrameId('link', link)


def read_urdf(element: Element, report: Report, *, root_link: str = '') -> Robot:
    """
    Read a robot.

    :param element: the element ``<robot>``.
    :param root_link: root of the tree to read, if the file has several trees.
    :raises DescriptionError: the element is not a valid robot.
    """
    root = TrackedElement(element)
    if root.tag != 'robot':
        raise DescriptionError(f'is not URDF; its root is <{local_name(root)}> instead of <robot>',
                               root)
    name = root.get('name', '').strip()
    if not name:
        name = _DEFAULT_NAME
        report.warn('robot', '', line_of(root), f'has no name; it is named {name!r}')
    tree = build_tree(root, report)
    canonical = root.get(f'{_SDF}canonical_link', '')
    if canonical and canonical not in tree.links:
        raise DescriptionError(f'canonical_link={canonical!r} is not a link of the robot', root)
    gazebo = extract_sdf(root, tree, report)
    context = _ReadContext(
        report=report, tree=tree, materials=collect_materials(root, report), gazebo=gazebo,
        offsets={link: pose for link, joint in tree.parent_joint.items()
                 if (pose := _sdf_pose(joint)) is not None and not pose.is_identity})
    robot = Robot(
        name=name, source=source_of(root),
        links=tuple(_link(link, context) for link in tree.links.values()),
        joints=tuple(_joint(joint, context) for joint in tree.joints.values()),
        frames=_frames(root, tree), canonical_link=canonical,
        extension=_extension(root, gazebo.moved.get(MODEL, []), gazebo.remaining))
    robot = select_root(robot, root_link, report)
    check_mimic_cycles(robot)
    return robot


def _link(element: TrackedElement, context: _ReadContext) -> Link:
    name = required_name(element)
    link_frame, offset = context.link_frame(name), context.offsets.get(name)
    inertial = element.find('inertial')
    visuals, collisions = (shapes_of(element, tag, link_frame, context.materials, context.report)
                           for tag in ('visual', 'collision'))
    gazebo, values = context.gazebo, context.gazebo.values
    moved = [in_link_frame(child, offset) for child in gazebo.moved.get(FrameId('link', name), [])]
    collisions = tuple(replace(shape, extension=with_values(
        shape.extension, values.get(('collision', name)))) for shape in collisions)
    return Link(
        name=name, placement=_link_placement(element, context),
        inertial=None if inertial is None else inertial_from_element(
            inertial, link_frame, context.report, name),
        visuals=visuals, collisions=collisions, line=line_of(element),
        extension=with_values(_extension(element, moved), values.get(('link', name))))


def _link_placement(element: TrackedElement, context: _ReadContext) -> Placement:
    """Return the placement of a link in its parent joint, or of a root link in the model."""
    name = required_name(element)
    parent_joint = context.tree.parent_joint.get(name)
    if parent_joint is None:
        return Placement(_sdf_pose(element) or Pose(), MODEL)
    offset = context.offsets.get(name)
    pose = offset.transform().inverse().pose() if offset else Pose()
    return Placement(pose, FrameId('joint', required_name(parent_joint)))


def _sdf_pose(element: TrackedElement) -> Pose | None:
    """Read the pose that the URDF writer preserved, if there is one."""
    pose = element.find(f'{_SDF}pose')
    return None if pose is None else pose_of(pose)


def _joint(element: TrackedElement, context: _ReadContext) -> Joint:
    name, joint_type = required_name(element), element.get('type')
    if joint_type not in URDF_TYPES:
        problem = 'has no type=' if joint_type is None else f'type={joint_type!r} is not supported'
        raise DescriptionError(f'{problem}; give one of {", ".join(URDF_TYPES)}', element)
    is_loop = element.tag != 'joint'
    parent, child = context.tree.ends(element)
    placement = Placement(origin_of(element), context.link_frame(parent))
    if is_loop and (pose := _sdf_pose(element)) is not None:
        placement = Placement(pose, FrameId('link', child))
    sdf_type = element.get(f'{_SDF}type', '')
    axes = () if sdf_type else _axes(element, joint_type, context)
    extension = with_values(
        _extension(element, context.gazebo.moved.get(FrameId('joint', name), [])),
        context.gazebo.values.get(('joint', name)))
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


def _axes(element: TrackedElement, joint_type: str, context: _ReadContext) -> tuple[Axis, ...]:
    if joint_type in WITHOUT_AXIS:
        return ()
    axis = element.find('axis')
    xyz = (1.0, 0.0, 0.0)
    if axis is not None and 'xyz' in axis:
        xyz = vector(axis.get('xyz'), axis, 'xyz')
        if xyz == ZERO:
            raise DescriptionError(
                f'xyz={axis.get("xyz")!r} has no direction; give {joint_type} joint '
                f'{required_name(element)!r} a non-zero axis', axis)
    limit, dynamics = _limit(element, joint_type, context), element.find('dynamics')
    values = None if dynamics is None else Dynamics(*(
        number(dynamics.get(name), dynamics, name) if name in dynamics else None
        for name in ('damping', 'friction')))
    return (Axis(xyz, limit, values, _mimic(element, context)),)


def _limit(element: TrackedElement, joint_type: str, context: _ReadContext) -> Limit | None:
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


def _mimic(element: TrackedElement, context: _ReadContext) -> Mimic | None:
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


def _frames(root: TrackedElement, tree: LinkTree) -> tuple[Frame, ...]:
    elements = root.take_all(f'{_SDF}frame')
    ids = {'': MODEL, MODEL_FRAME: MODEL}
    for kind, names in (('frame', map(required_name, elements)),
                        ('joint', tree.joints), ('link', tree.links)):
        ids.update((name, FrameId(kind, name)) for name in names)

    def lookup(name: str, element: AnyElement) -> FrameId:
        if name not in ids:
            raise DescriptionError(f'{name!r} is not a link, joint or frame of the robot', element)
        return ids[name]

    frames = []
    for element in elements:
        frame = frame_from_element(element, lookup)
        urdf = extract_foreign(element, 'urdf')
        frames.append(replace(frame, extension=Extension(urdf, element.unread())))
    return tuple(frames)


def _extension(element: TrackedElement, sdf: Sequence[Element], urdf: Sequence[Element] = ()
               ) -> Extension:
    """Return the XML of an element that the model does not represent, with additional children."""
    preserved, tag = extract_foreign(element, 'sdf'), local_name(element)
    return Extension(_extended(element.unread(), tag, urdf), _extended(preserved, tag, sdf))


def _extended(unread: Element | None, tag: str, children: Sequence[Element]) -> Element | None:
    if children:
        unread = etree.Element(tag) if unread is None else unread
        unread.extend(children)
    return unread
