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

"""URDF as a robot: every joint placed in its parent link, every other link in its joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math

from lxml import etree
from opencv_tools.robot.joint_kinds import JOINT_KINDS, URDF_TYPES, WITHOUT_AXIS
from opencv_tools.robot.kinematics import check_mimic_cycles
from opencv_tools.robot.model import (
    Axis, Dynamics, Extension, Frame, FrameId, Joint, Limit, Link, Mimic, MODEL, Placement, Robot)
from opencv_tools.robot.pose import Pose, ZERO
from opencv_tools.robot.sdf.fragments import AXES, axis_from_element, frame_from_element
from opencv_tools.robot.sdf.values import MODEL_FRAME, pose_of
from opencv_tools.robot.trees import select_root
from opencv_tools.robot.urdf.gazebo import in_link_frame, sorted_blocks
from opencv_tools.robot.urdf.link_reader import (
    collect_materials, inertial_from_element, MaterialTable, origin_of, restore_colors, shapes_of)
from opencv_tools.robot.urdf.tree import tree_of, TreeOfLinks
from opencv_tools.robot.xml.document import (
    AnyElement, DescriptionError, Element, line_of, local_name, required_name, source_of)
from opencv_tools.robot.xml.numbers import limit_number, number, vector
from opencv_tools.robot.xml.passthrough import extract_foreign, SDF_NAMESPACE
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.tracked import TrackedElement

_SDF = f'{{{SDF_NAMESPACE}}}'
_UNNAMED = 'robot'


@dataclass(frozen=True)
class _ReadContext:
    """What the parts of a robot are read with."""

    report: Report
    tree: TreeOfLinks
    looks: MaterialTable
    gazebo: Mapping[FrameId, list[Element]]
    offsets: Mapping[str, Pose]  # of joints in their child links, where they are apart

    def home(self, link: str) -> FrameId:
        """Give the frame that URDF means by a link: that of the joint above it."""
        above = self.tree.above.get(link)
        if above is not None and link in self.offsets:
            return FrameId('joint', required_name(above))
        return FrameId('link', link)


def read_urdf(element: Element, report: Report, *, root_link: str = '') -> Robot:
    """
    Read a robot.

    :param element: the element ``<robot>``.
    :param root_link: which link to take with all below it, where several hang on nothing.
    :raises DescriptionError: it is no robot, or not a right one.
    """
    root = TrackedElement(element)
    if root.tag != 'robot':
        raise DescriptionError(f'is no URDF, which begins with <robot>, not <{local_name(root)}>',
                               root)
    name = root.get('name', '').strip()
    if not name:
        name = _UNNAMED
        report.warn('robot', '', line_of(root), f'has no name; it is called {name!r}')
    restore_colors(element)
    tree = tree_of(root, report)
    gazebo, rest = sorted_blocks(root, tree, report)
    source = _ReadContext(report, tree, collect_materials(root, report), gazebo,
                     {link: pose for link, joint in tree.above.items()
                      if (pose := _sdf_pose(joint)) is not None and not pose.is_identity})
    links = tuple(_link(link, source) for link in tree.links.values())
    joints = tuple(_joint(joint, source) for joint in tree.joints.values())
    frames, canonical = _frames(root, tree), _canonical_link(root, source)
    extras = _carried(root, gazebo.get(MODEL, []))
    if rest:
        kept = etree.Element('robot') if extras.urdf is None else extras.urdf
        kept.extend(rest)
        extras = Extension(kept, extras.sdf)
    robot = select_root(Robot(name, links, joints, frames, canonical, extras, source_of(root)),
                     root_link, report)
    check_mimic_cycles(robot)
    return robot


def _canonical_link(root: TrackedElement, source: _ReadContext) -> str:
    name = root.get(f'{_SDF}canonical_link', '')
    if name and name not in source.tree.links:
        raise DescriptionError(f'canonical_link={name!r} is no link', root)
    return name


def _link(element: TrackedElement, source: _ReadContext) -> Link:
    name = required_name(element)
    home = source.home(name)
    inertial = element.find('inertial')
    visuals, collisions = (shapes_of(element, tag, home, source.looks, source.report)
                           for tag in ('visual', 'collision'))
    offset = source.offsets.get(name)
    extra = [in_link_frame(part, offset) for part in source.gazebo.get(FrameId('link', name), [])]
    return Link(
        name, _link_placement(element, source),
        None if inertial is None else inertial_from_element(inertial, home, source.report, name),
        visuals, collisions, _carried(element, extra), line_of(element))


def _link_placement(element: TrackedElement, source: _ReadContext) -> Placement:
    """Place a link in the joint above it, the root in the model."""
    name = required_name(element)
    above = source.tree.above.get(name)
    if above is None:
        return Placement(_sdf_pose(element) or Pose(), MODEL)
    offset = source.offsets.get(name)
    pose = offset.transform().inverse().pose() if offset else Pose()
    return Placement(pose, FrameId('joint', required_name(above)))


def _sdf_pose(element: TrackedElement) -> Pose | None:
    """Read what the writer of URDF noted of a pose that URDF has no word for."""
    pose = element.find(f'{_SDF}pose')
    return None if pose is None else pose_of(pose)


def _joint(element: TrackedElement, source: _ReadContext) -> Joint:
    name = required_name(element)
    kind = _type(element)
    is_loop = element.tag != 'joint'
    parent, child = source.tree.ends(element)
    placement = Placement(origin_of(element), source.home(parent))
    if is_loop and (pose := _sdf_pose(element)) is not None:
        placement = Placement(pose, FrameId('link', child))
    extra = source.gazebo.get(FrameId('joint', name), [])
    own = element.get(f'{_SDF}type', '')
    if not own:
        axes = _axes(element, kind, source)
        return Joint(name, kind, parent, child, placement, axes, is_loop,
                     _carried(element, extra), line_of(element))
    if own not in JOINT_KINDS:
        raise DescriptionError(f'type={own!r} is no type of joint of SDF', element)
    kept = _carried(element, extra)
    more = TrackedElement(etree.Element('joint') if kept.sdf is None else kept.sdf)
    axes = tuple(axis_from_element(axis) for axis in map(more.find, AXES) if axis is not None)
    return Joint(name, own, parent, child, placement, axes, is_loop,
                 Extension(kept.urdf, more.unread()), line_of(element))


def _type(element: TrackedElement) -> str:
    kind = element.get('type')
    if kind not in URDF_TYPES:
        problem = 'has no type' if kind is None else f'type={kind!r} is no type of joint'
        raise DescriptionError(f'{problem}; URDF has {", ".join(URDF_TYPES)}', element)
    return kind


def _axes(element: TrackedElement, kind: str, source: _ReadContext) -> tuple[Axis, ...]:
    """Read the axis of a joint that has one."""
    if kind in WITHOUT_AXIS:
        return ()
    axis = element.find('axis')
    xyz = (1.0, 0.0, 0.0)
    if axis is not None and 'xyz' in axis:
        xyz = vector(axis.get('xyz'), axis, 'xyz')
        if xyz == ZERO:
            raise DescriptionError(f'xyz={axis.get("xyz")!r} has no direction; give the axis of '
                                   f'{kind} joint {required_name(element)!r}', axis)
    return (Axis(xyz, _limit(element, kind, source), _dynamics(element),
                 _mimic(element, source)),)


def _limit(element: TrackedElement, kind: str, source: _ReadContext) -> Limit | None:
    limit = element.find('limit')
    if limit is None:
        if kind in ('revolute', 'prismatic'):
            raise DescriptionError(f'a {kind} joint needs <limit effort= velocity=>', element)
        return None
    strength = []
    for attribute in ('effort', 'velocity'):
        if attribute not in limit and kind != 'planar':
            raise DescriptionError(f'has no {attribute}=, which URDF demands', limit)
        value = limit_number(limit.get(attribute, 'inf'), limit, attribute)
        strength.append(abs(value) if math.isinf(value) else value)
    if kind not in ('revolute', 'prismatic'):
        return Limit(effort=strength[0], velocity=strength[1])
    lower, upper = (limit_number(limit.get(attribute, '0'), limit, attribute)
                    for attribute in ('lower', 'upper'))
    if lower > upper:
        source.report.warn('limit', required_name(element), line_of(limit),
                           f'lower={lower!r} is above upper={upper!r}')
    return Limit(lower, upper, strength[0], strength[1])


def _dynamics(element: TrackedElement) -> Dynamics | None:
    dynamics = element.find('dynamics')
    if dynamics is None:
        return None
    damping, friction = (
        number(dynamics.get(attribute), dynamics, attribute) if attribute in dynamics
        else None for attribute in ('damping', 'friction'))
    return Dynamics(damping, friction)


def _mimic(element: TrackedElement, source: _ReadContext) -> Mimic | None:
    mimic = element.find('mimic')
    if mimic is None:
        return None
    joint = mimic.element.get('joint', '').strip()
    if not joint:
        raise DescriptionError('has no joint= to say which joint it follows', mimic)
    if joint not in source.tree.joints:
        source.report.warn('mimic', required_name(element), line_of(mimic),
                           f'joint={joint!r} is no joint of the robot; it follows none')
        return None
    mimic.get('joint')
    return Mimic(joint, number(mimic.get('multiplier', '1'), mimic, 'multiplier'),
                 number(mimic.get('offset', '0'), mimic, 'offset'))


def _frames(root: TrackedElement, tree: TreeOfLinks) -> tuple[Frame, ...]:
    elements = root.take_all(f'{_SDF}frame')
    ids = {'': MODEL, MODEL_FRAME: MODEL}
    for kind, names in (('frame', [required_name(element) for element in elements]),
                        ('joint', tree.joints), ('link', tree.links)):
        ids.update((name, FrameId(kind, name)) for name in names)

    def lookup(name: str, element: AnyElement) -> FrameId:
        if name not in ids:
            raise DescriptionError(f'there is no link, joint or frame {name!r}', element)
        return ids[name]

    frames = []
    for element in elements:
        frame = frame_from_element(element, lookup)
        urdf = extract_foreign(element, 'urdf')
        frames.append(replace(frame, extension=Extension(urdf, element.unread())))
    return tuple(frames)


def _carried(element: TrackedElement, extra: list[Element]) -> Extension:
    """Return what URDF says beyond a robot, and what is there of SDF."""
    sdf = extract_foreign(element, 'sdf')
    if extra:
        sdf = etree.Element(local_name(element)) if sdf is None else sdf
        sdf.extend(extra)
    return Extension(element.unread(), sdf)
