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

"""Reader of SDF: converts any version, nested models and includes into one flat robot."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from graphlib import CycleError
from heapq import heappop, heappush
import math
from pathlib import Path

from lxml import etree
from opencv_tools.robot.joint_kinds import JOINT_KINDS, SDF_TYPES
from opencv_tools.robot.kinematics import check_mimic_cycles, cycle_text, Kinematics, resolve_chain
from opencv_tools.robot.model import (
    Axis, Extension, FrameId, Joint, Link, Mimic, MODEL, Placement, Robot, RobotFrame, WORLD)
from opencv_tools.robot.pose import IDENTITY, Pose, Transform
from opencv_tools.robot.sdf.context import model_contexts, SdfContext
from opencv_tools.robot.sdf.fragments import AXES, axis_from_element, mimic_of_urdf, Rotation
from opencv_tools.robot.sdf.includes import search_folders
from opencv_tools.robot.sdf.inertia import auto_inertial
from opencv_tools.robot.sdf.link_reader import read_link
from opencv_tools.robot.sdf.names import FrameRegistry, JOINTS
from opencv_tools.robot.sdf.scopes import Scope
from opencv_tools.robot.sdf.values import (
    flag, FRAMES, JOINT_AXES, MODEL_FRAME, pose_element, pose_of)
from opencv_tools.robot.trees import select_root
from opencv_tools.robot.xml.defined import read_table, report_undefined
from opencv_tools.robot.xml.document import (
    DescriptionError, detached, Element, line_of, local_name, required_name, source_of,
    TrackedElement)
from opencv_tools.robot.xml.passthrough import extract_foreign, URDF_JOINT_TYPE, URDF_TAG
from opencv_tools.robot.xml.report import Report

_MIMIC = f'{URDF_TAG}mimic'
_DEFINED = read_table(Path(__file__).with_name('elements.txt'))


def with_axes(joint: Joint, element: TrackedElement, context: SdfContext, kinematics: Kinematics
              ) -> Joint:
    """
    Add the axes of a joint and its unread parts.

    :param joint: result of `read_joint`.
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
    leader = context.scope.qualified(mimic.joint)
    # A frame is a fixed joint of URDF.
    if any(FrameId(kind, leader) in context.registry.elements
           for kind in (('joint', 'frame') if child is None else ('joint',))):
        return replace(mimic, joint=leader)
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

    The first joint that leads from a root to a link, in the order of the file, places the link. If
    every link is the child of a joint, the root is the canonical link, or else the first one that
    leads to all others.
    """
    leading = defaultdict[str, list[tuple[int, str]]](list)
    for number, joint in enumerate(robot.joints):
        leading[joint.parent].append((number, joint.child))

    def placed_by(roots: Iterable[str], seen: set[str]) -> set[int]:
        pending, joints = sorted((-1, root) for root in roots), set[int]()
        while pending:
            number, link = heappop(pending)
            if link not in seen:
                seen.add(link)
                joints.add(number)
                for one in leading[link]:
                    heappush(pending, one)
        return joints

    def starts(links: Iterable[str]) -> list[str]:
        """Return the links that no link before them leads to."""
        seen = set[str]()
        return [link for link in links if placed_by([link], seen)]

    # A later start may lead to an earlier one, but not the reverse.
    roots = starts(reversed(starts([canonical, *(link.name for link in robot.links)])))
    tree = placed_by(roots, set())
    return replace(robot, joints=tuple(
        replace(joint, is_loop=number not in tree) for number, joint in enumerate(robot.joints)))


def _joint_type(element: TrackedElement) -> str:
    text = element.get(URDF_JOINT_TYPE, element.get('type', '')).strip().lower()
    # A joint in the namespace of URDF may have a type that is not supported by SDF.
    types = SDF_TYPES if element.tag == JOINTS[0] else tuple(JOINT_KINDS)
    if text not in types:
        raise DescriptionError(f'type={text!r} is not supported; use one of {", ".join(types)}',
                               element)
    return text


def check_placements(robot: Robot, registry: FrameRegistry) -> None:
    """Check that the placement of every frame leads to the model frame."""
    bases = {frame: owner.placement.relative_to for frame, owner in robot.frame_owners()}
    placed = {MODEL}
    try:
        for start in bases:
            placed.update(resolve_chain(
                start, lambda frame: None if frame in placed else bases[frame]))
    except CycleError as err:
        raise DescriptionError(f'placement cycle: {cycle_text(err)}',
                               registry.elements.get(err.args[1][0])) from err


def with_placement_frames(robot: Robot, scopes: Sequence[Scope], registry: FrameRegistry
                          ) -> Robot:
    """Place the nested models whose pose is that of a frame in them, innermost first."""
    for scope in reversed(scopes[1:]):
        if not scope.file.placement_frame:
            continue
        inverse = _placement_frame(robot, scope, registry).inverse()
        robot = replace(robot, frames=tuple(
            replace(frame, placement=Placement(
                (frame.placement.pose.transform() @ inverse).pose(), frame.placement.relative_to))
            if frame.name == scope.frame.name else frame for frame in robot.frames))
    return robot


def _placement_frame(robot: Robot, scope: Scope, registry: FrameRegistry) -> Transform:
    """Return the pose of the ``placement_frame`` in the model frame."""
    name = scope.file.placement_frame
    if not name:
        return IDENTITY
    frame = registry.lookup(scope, name, scope.element, 'placement_frame')
    return Kinematics(robot).between(scope.frame, frame).transform()


def pose_in_world(robot: Robot, top: Scope, registry: FrameRegistry) -> Pose:
    """Return the pose of the robot in the world; zero if relative to an object outside of it."""
    pose = top.file.pose_holder.element.find('pose')
    placed = _placement_frame(robot, top, registry)
    if pose is not None and pose.get('relative_to'):
        return Pose()
    written = pose_of(pose)
    return written if placed == IDENTITY else (written.transform() @ placed.inverse()).pose()


def with_world(robot: Robot, pose_in_world: Pose) -> Robot:
    """Place the world relative to the robot, if a joint needs it."""
    *links, last = robot.links
    if last.name != WORLD or pose_in_world.is_identity:
        return robot
    placement = Placement(pose_in_world.transform().inverse().pose(), MODEL)
    return replace(robot, links=(*links, replace(last, placement=placement)))


# Children of an <include> that are converted.
_INCLUDE = ('uri', 'name', 'pose', 'placement_frame')
# Children of an <include> that replace those of the model.
_OVERRIDES = ('pose', 'static')


def report_nested(context: SdfContext) -> None:
    """Report the elements that a nested model loses by becoming a part of the robot."""
    file = context.scope.file
    preserved = extract_foreign(file.element, 'urdf')
    for holder in (file.element, *file.includes):
        holder.take_all(*_INCLUDE)
    for lost in (context.unread(file.element), preserved, *map(context.unread, file.includes)):
        for child in () if lost is None else lost:
            # <static>false</static> is the default.
            if child.tag != 'static' or flag(child.text, child):
                context.report.warn(local_name(child), file.name, line_of(child),
                                    'omitted: it belongs to a nested model')


def model_extension(context: SdfContext, pose_in_world: Pose) -> Extension:
    """Return the unread parts of the model, with the overrides of its includes."""
    file = context.scope.file
    urdf, unread = extract_foreign(file.element, 'urdf'), context.unread(file.element)
    if unread is None:
        unread = etree.Element('model')
    for include in reversed(file.includes):
        for child in include.element.iterchildren('*'):
            tag = local_name(child)
            if tag in _OVERRIDES:
                _remove(unread, tag)
            if tag in (*_OVERRIDES, 'plugin'):
                unread.append(detached(child))
            elif tag not in _INCLUDE:
                context.report.warn(tag, file.name, line_of(child), 'omitted from the <include>')
    _resolve_model_pose(unread, context, pose_in_world)
    return Extension(urdf=urdf, sdf=unread if len(unread) or unread.attrib else None)


def _resolve_model_pose(unread: Element, context: SdfContext, pose_in_world: Pose) -> None:
    """Write the pose of the model without names, which may be different in the output."""
    file = context.scope.file
    for pose in unread.findall('pose'):
        if name := pose.get('relative_to'):
            context.report.warn('pose', file.name, line_of(file.pose_holder),
                                f'omitted: it is relative to {name!r}, outside the model')
            unread.remove(pose)
    if frame := file.placement_frame:
        _remove(unread, 'pose')
        pose_element(unread, pose_in_world)
        context.report.preserve('pose', file.name, line_of(file.element),
                                f'placed {frame!r}; converted to the pose of the model frame')


def _remove(element: Element, tag: str) -> None:
    for child in element.findall(tag):
        element.remove(child)


def read_sdf(root: Element, report: Report, *, model: str = '', root_link: str = '',
             search: Sequence[str] = ()) -> Robot:
    """
    Read a robot from SDF.

    :param root: the ``<sdf>``.
    :param model: name of the model; empty if the file has only one.
    :param root_link: root of the tree to read; empty for all trees.
    :param search: folders with included models.
    :raises DescriptionError: the file is not a valid robot.
    """
    if local_name(root) != 'sdf':
        raise DescriptionError('is not SDF; the root must be <sdf>', root)
    contexts = model_contexts(root, report, model, search)
    top, registry = contexts[0].scope, contexts[0].registry
    # Placements are read as written. Joints have no axes yet, because axes depend on poses.
    links, joints, frames = _read_elements(contexts)
    robot = Robot(name=top.file.name, links=links, joints=joints, frames=frames,
                  source=source_of(root))
    canonical = registry.link_of(MODEL)
    if canonical != robot.links[0].name or top.element.get('canonical_link'):
        robot = replace(robot, canonical_link=canonical)
    # All following steps compute poses, which needs placements without cycles.
    check_placements(robot, registry)
    # Nested models get their final poses before other poses are computed from them.
    robot = with_placement_frames(robot, [context.scope for context in contexts], registry)
    # The pose in the world depends on the pose of the robot's own placement_frame.
    pose = pose_in_world(robot, top, registry)
    robot = with_world(robot, pose)
    # Axes may be expressed in any frame, so all poses are final here.
    elements = ((element, context) for context in contexts
                for element in context.joint_elements())
    kinematics = Kinematics(robot)
    robot = replace(robot, joints=tuple(
        with_axes(joint, element, context, kinematics)
        for joint, (element, context) in zip(robot.joints, elements)))
    # Mimics are parts of axes.
    check_mimic_cycles(robot)
    # The centres of collisions depend on the final poses, too.
    folders = search_folders(Path(contexts[0].folder), search)
    robot = _with_auto_inertials(robot, kinematics, folders, report)
    # Loops do not change poses or axes; only trees of the robot depend on them.
    robot = mark_loops(robot, canonical)
    # The extension is what no step has read, so it is last.
    robot = replace(robot, extension=model_extension(contexts[0], pose))
    report_undefined(((part.extension.sdf, part.name) for part in robot.parts()
                      if part.extension.sdf is not None), _DEFINED, 'SDF', report)
    return select_root(robot, root_link, report) if root_link else robot


def _read_elements(contexts: Sequence[SdfContext]
                   ) -> tuple[tuple[Link, ...], tuple[Joint, ...], tuple[RobotFrame, ...]]:
    """Read links, joints without axes, and frames; the world is a link if a joint needs it."""
    links: list[Link] = []
    joints: list[Joint] = []
    frames: list[RobotFrame] = []
    by_model = {context.scope.frame: context for context in contexts}
    for context in contexts:
        element, scope = context.scope.element, context.scope
        links.extend(read_link(child, context) for child in element.take_all('link'))
        joints.extend(read_joint(child, context) for child in context.joint_elements())
        if scope.parent is not None:
            frames.append(_model_frame(context, by_model[scope.parent.frame]))
            report_nested(context)
        frames.extend(_read_frame(child, context) for child in element.take_all('frame'))
    if any(joint.parent == WORLD for joint in joints):
        links.append(Link(name=WORLD, placement=Placement(Pose(), MODEL)))
    return tuple(links), tuple(joints), tuple(frames)


def _read_frame(element: TrackedElement, context: SdfContext) -> RobotFrame:
    name = context.scope.qualified(required_name(element))
    attached_to = context.registry.attached_to(FrameId('frame', name))
    return RobotFrame(name=name, attached_to=attached_to,
                      placement=context.placement(element, attached_to),
                      extension=context.extension(element), line=line_of(element))


def _model_frame(context: SdfContext, parent: SdfContext) -> RobotFrame:
    scope = context.scope
    return RobotFrame(name=scope.frame.name,
                      attached_to=FrameId('link', context.registry.link_of(scope.frame)),
                      placement=parent.placement(scope.file.pose_holder, parent.scope.frame),
                      line=line_of(scope.element))


def _with_auto_inertials(robot: Robot, kinematics: Kinematics, folders: Sequence[Path],
                         report: Report) -> Robot:
    """Compute the inertials that the file leaves to the density of the collisions."""
    return replace(robot, links=tuple(
        replace(link, inertial=auto_inertial(link, kinematics, report, folders) or link.inertial)
        for link in robot.links))
