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

"""Trees of a robot: selection of one tree, and links of fixed joints as frames, or the reverse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from lxml import etree
from opencv_tools.robot.inertia import total_inertial, without_auto
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import (
    Frame, FrameId, Joint, Link, MODEL, Placement, Robot, Shape)
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.renaming import Names
from opencv_tools.robot.sdf.values import POSED
from opencv_tools.robot.xml.document import DescriptionError, Element
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.tracked import detached

# Tags in <gazebo reference="joint"> that preserve a fixed joint.
PRESERVING_TAGS = ('preserveFixedJoint', 'disableFixedJointLumping')
# Elements that a link has once. If links become one, that of the first link counts.
_SINGLE = ('enable_wind', 'gravity', 'inertial', 'kinematic', 'must_be_base_link', 'self_collide',
           'velocity_decay')


def select_root(robot: Robot, root: str, report: Report) -> Robot:
    """
    Return the tree of a robot below one root link, because URDF allows only one.

    :param root: name of the root link; may be empty if the robot has only one.
    :raises DescriptionError: the robot has several root links, or ``root`` is not one of them.
    """
    kinematics = Kinematics(robot)
    roots = kinematics.roots
    if root and root not in roots:
        raise DescriptionError(f'--root {root!r} is not a root link; give one of '
                               f'{shortened(roots)}', source=robot.source)
    if not root and len(roots) > 1:
        raise DescriptionError(f'has {len(roots)} root links, URDF allows one; select it with '
                               f'--root: {shortened(roots)}', source=robot.source)
    if len(roots) == 1:
        return robot
    lines = {link.name: link.line for link in robot.links}
    for other in roots:
        if other != root:
            names = kinematics.subtree([other])
            report.warn('link', other, lines[other],
                        f'not below --root {root!r}; dropped: {shortened(names)}')
    robot = _with_links(robot, set(kinematics.subtree([root])), kinematics)
    return replace(robot, joints=_drop_orphan_mimics(robot.joints, report))


def _with_links(robot: Robot, names: set[str], kinematics: Kinematics) -> Robot:
    """Return a robot with only some of its links, and with the joints and frames on them."""
    attached = kinematics.attached_links()
    robot = replace(
        robot, links=tuple(link for link in robot.links if link.name in names),
        joints=tuple(joint for joint in robot.joints
                     if joint.child in names and joint.parent in names),
        frames=tuple(frame for frame in robot.frames if frame.attached_to == MODEL
                     or attached[FrameId('frame', frame.name)].name in names),
        canonical_link=robot.canonical_link if robot.canonical_link in names else '')
    kept = {MODEL, *(frame for frame, _ in robot.frame_owners())}

    def place(placement: Placement) -> Placement:
        if placement.relative_to in kept:
            return placement
        return Placement(kinematics.placement_pose(placement).pose(), MODEL)

    return robot.map_placements(place)


def _drop_orphan_mimics(joints: Sequence[Joint], report: Report) -> tuple[Joint, ...]:
    """Return joints without mimics of joints that are not among them."""
    names = {joint.name for joint in joints}
    result = []
    for joint in joints:
        axes = tuple(replace(axis, mimic=None) if axis.mimic and axis.mimic.joint not in names
                     else axis for axis in joint.axes)
        if axes != joint.axes:
            report.warn('joint', joint.name, joint.line,
                        'mimics a dropped joint; dropped its <mimic>')
        result.append(replace(joint, axes=axes))
    return tuple(result)


def shortened(names: Sequence[str]) -> str:
    """Return the first five names in quotes, and the number of the others."""
    few = ', '.join(map(repr, names[:5]))
    return f'{few} and {len(names) - 5} more' if len(names) > 5 else few


def lump_fixed(robot: Robot, report: Report) -> Robot:
    """
    Return a robot with each link below a fixed joint merged into its parent link.

    The parent link gets the total mass, the visuals and the collisions. Merged links and joints
    remain as frames, and shapes remain placed in them. Joints to the world stay, and so do joints
    with a sensor and those that a ``<gazebo>`` block preserves.
    """
    kinematics = Kinematics(robot)
    links = {link.name: link for link in robot.links}
    preserved = _preserved_joints(robot) | {
        joint.name for joint in robot.joints
        if joint.extension.sdf is not None and joint.extension.sdf.find('sensor') is not None}
    hosts = {name: name for name in kinematics.roots}  # by link: the link that it is merged into
    lumped: dict[str, Joint] = {}  # by child link
    for name in kinematics.subtree(kinematics.roots):
        for joint in kinematics.child_joints[name]:
            stays = joint.type != 'fixed' or joint.name in preserved or links[name].is_world
            hosts[joint.child] = joint.child if stays else hosts[name]
            if not stays:
                lumped[joint.child] = joint
    if not lumped:
        return robot
    members: dict[str, list[Link]] = {}
    for link in robot.links:
        members.setdefault(hosts[link.name], []).append(link)
    merged = {name: _merged(links[name], [link for link in group if link.name != name], kinematics)
              for name, group in members.items()}
    new_ids: dict[FrameId, FrameId] = {}
    frames = []
    # Joints that close a loop may connect two links that are one now.
    for joint in robot.joints:
        if hosts[joint.parent] != hosts[joint.child]:
            continue
        child = joint.child if lumped.get(joint.child) is joint else ''
        host = FrameId('link', hosts[joint.child])
        report.warn('joint', joint.name, joint.line, f'lumped: link {child!r} is now a frame of '
                    f'link {host.name!r}' if child else
                    f'lumped: both its links are link {host.name!r} now, so it is a frame')
        joint_frame = f'{joint.name}_joint' if joint.name == joint.child else joint.name
        new_ids[FrameId('joint', joint.name)] = FrameId('frame', joint_frame)
        pose = kinematics.between(host, FrameId('joint', joint.name))
        frames.append(Frame(name=joint_frame, attached_to=host, placement=Placement(pose, host),
                            extension=replace(joint.extension, sdf=None), line=joint.line))
        if child:
            link = links[child]
            new_ids[FrameId('link', child)] = FrameId('frame', child)
            frames.append(Frame(name=child, attached_to=host, placement=link.placement,
                                extension=replace(link.extension, sdf=None), line=link.line))

    return replace(
        robot, links=tuple(merged[link.name] for link in robot.links if link.name in merged),
        # The child of a joint that closes a loop may be lumped by another joint.
        joints=_drop_orphan_mimics([
            replace(joint, parent=hosts[joint.parent], child=hosts[joint.child])
            for joint in robot.joints if hosts[joint.parent] != hosts[joint.child]], report),
        frames=(*robot.frames, *frames), canonical_link=hosts.get(robot.canonical_link, '')
    ).map_frame_ids(lambda frame: new_ids.get(frame, frame))


def with_frame_links(robot: Robot, report: Report) -> Robot:
    """
    Return a robot with an empty link on a fixed joint in place of each frame, so that tf has it.

    The joint is named after the link, with ``_joint``. `lump_fixed` makes frames of them again.

    :raises DescriptionError: the frames have a cycle.
    """
    attached = Kinematics(robot).attached_links()
    taken = Names([*(link.name for link in robot.links), *(joint.name for joint in robot.joints)])
    links, joints = [], []
    # The names of all links before those of joints, because users know the frames.
    for frame, name in [(frame, taken.new(frame.name)) for frame in robot.frames]:
        joint = taken.new(f'{name}_joint')
        if frame.extension.sdf is not None:
            report.warn('frame', frame.name, frame.line, 'has other elements than a pose, which '
                        'the link does not get')
        links.append(Link(name=name, placement=Placement(Pose(), FrameId('joint', joint)),
                          line=frame.line))
        joints.append(Joint(
            name=joint, type='fixed', parent=attached[FrameId('frame', frame.name)].name,
            child=name, placement=frame.placement, line=frame.line))
    new_ids = {FrameId('frame', frame.name): FrameId('link', link.name)
               for frame, link in zip(robot.frames, links)}
    return replace(robot, links=(*robot.links, *links), joints=(*robot.joints, *joints), frames=()
                   ).map_frame_ids(lambda frame: new_ids.get(frame, frame))


def _preserved_joints(robot: Robot) -> set[str]:
    """Return the names of the fixed joints that ``<gazebo>`` blocks preserve."""
    root = robot.extension.urdf
    return {block.get('reference', '')
            for block in ([] if root is None else root.iterchildren('gazebo'))
            for tag in PRESERVING_TAGS
            if (block.findtext(tag) or '').strip().lower() in ('true', '1')}


def _merged(host: Link, guests: list[Link], kinematics: Kinematics) -> Link:
    """Return a link with the inertials, shapes and sensors of other links merged into it."""
    if not guests:
        return host
    host = without_auto(host)  # the numbers of the sum count
    sdf = None if host.extension.sdf is None else detached(host.extension.sdf)
    for guest in guests:
        for element in guest.extension.sdf if guest.extension.sdf is not None else ():
            sdf = etree.Element('link') if sdf is None else sdf
            if element.tag not in _SINGLE or sdf.find(element.tag) is None:
                sdf.append(_posed_in(element, guest.name))
    members = (host, *guests)
    inertials = [link.inertial for link in members if link.inertial]
    return replace(
        host,
        visuals=tuple(_qualified(shape, link, host) for link in members for shape in link.visuals),
        collisions=tuple(_qualified(shape, link, host) for link in members
                         for shape in link.collisions),
        inertial=total_inertial(
            inertials, FrameId('link', host.name), kinematics) if inertials else None,
        extension=replace(host.extension, sdf=sdf))


def _qualified(shape: Shape, link: Link, host: Link) -> Shape:
    """Return a shape with the name of its former link in its name, so that names stay unique."""
    if link is host or not shape.name:
        return shape
    return replace(shape, name=f'{link.name}_{shape.name}')


def _posed_in(element: Element, frame: str) -> Element:
    """Return a copy of an element of a link whose pose is relative to a frame."""
    copy = detached(element)
    if copy.tag in POSED:
        pose = copy.find('pose')
        if pose is None:
            pose = etree.SubElement(copy, 'pose')
        if not pose.get('relative_to'):
            pose.set('relative_to', frame)
    return copy
