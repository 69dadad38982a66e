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

"""Changes of a robot's tree: one of several trees, and links in place of frames."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace

from lxml import etree
from opencv_tools.robot.kinematics import attached_links, Kinematics
from opencv_tools.robot.model import FrameId, Joint, Link, MODEL, Placement, Robot, WORLD
from opencv_tools.robot.names import Names
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report


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
                               f'urdf_to_sdf or sdf_to_urdf --root: {shortened(roots)}, or fix '
                               'all to one with sdf_to_urdf --world-link', source=robot.source)
    if len(roots) == 1:
        return robot
    lines = {link.name: link.line for link in robot.links}
    for other in roots:
        if other != root:
            names = kinematics.subtree([other])
            report.warn('link', other, lines[other],
                        f'not below --root {root!r}; dropped: {shortened(names)}')
    robot = _with_links(robot, set(kinematics.subtree([root])), kinematics)
    return replace(robot, joints=without_orphan_mimics(robot.joints, report))


def _with_links(robot: Robot, names: set[str], kinematics: Kinematics) -> Robot:
    """Return a robot with only some of its links, and with the joints and frames on them."""
    attached = attached_links(robot)
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


def with_world_link(robot: Robot, name: str) -> Robot:
    """
    Return a robot with one root link, to which the other root links are fixed where they are.

    The joints are named after the links, with ``_joint``.

    :param name: name of the root link; a new link in the origin of the model, unless it is that
        of a root link.
    :raises DescriptionError: another link has the name.
    """
    roots, links = Kinematics(robot).roots, {link.name for link in robot.links}
    if name in links and name not in roots:
        raise DescriptionError(f'--world-link {name!r} is a link below another one; give the '
                               f'name of a new link, or one of {shortened(roots)}',
                               source=robot.source)
    new = () if name in links else (Link(name=name, placement=Placement(Pose(), MODEL)),)
    taken = Names([*links, *(joint.name for joint in robot.joints)])
    joints = [Joint(name=taken.new(f'{root}_joint'), type='fixed', parent=name, child=root,
                    placement=Placement(Pose(), FrameId('link', root)))
              for root in roots if root != name]
    return replace(robot, links=(*new, *robot.links), joints=(*joints, *robot.joints))


def without_orphan_mimics(joints: Sequence[Joint], report: Report) -> tuple[Joint, ...]:
    """Return joints without mimics of joints that are not among them."""
    names = {joint.name for joint in joints}
    result = []
    for joint in joints:
        axes = tuple(replace(axis, mimic=None) if axis.mimic and axis.mimic.joint not in names
                     else axis for axis in joint.axes)
        if axes != joint.axes:
            report.warn('joint', joint.name, joint.line,
                        'mimics a dropped joint; dropped its <mimic>')
            extension = deepcopy(joint.extension)
            for unread in (extension.urdf, extension.sdf):
                if unread is not None:  # the next one would take the place of the first
                    etree.strip_elements(unread, 'mimic', with_tail=False)
            joint = replace(joint, extension=extension)
        result.append(replace(joint, axes=axes))
    return tuple(result)


def shortened(names: Sequence[str]) -> str:
    """Return the first five names in quotes, and the number of the others."""
    few = ', '.join(map(repr, names[:5]))
    return f'{few} and {len(names) - 5} more' if len(names) > 5 else few


def with_frame_links(robot: Robot, report: Report) -> Robot:
    """
    Return a robot with an empty link on a fixed joint in place of each frame, so that tf has it.

    The joint is named after the link, with ``_joint``. `lumping.lump_fixed` makes frames of them
    again.

    :raises DescriptionError: the frames have a cycle.
    """
    attached = attached_links(robot)
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


def with_bare_world(robot: Robot, report: Report) -> Robot:
    """Return a robot whose root ``world`` is that of SDF: without shapes and settings."""
    parents, children = ({getattr(joint, end) for joint in robot.joints if not joint.is_loop}
                         for end in ('parent', 'child'))

    def bare(link: Link) -> Link:
        if link.name != WORLD or link.is_world or link.inertial or (
                WORLD not in parents - children):
            return link
        report.warn('link', WORLD, link.line, 'is the world in SDF, which has no shapes and no '
                    'settings; they are left out')
        return Link(name=WORLD, placement=link.placement, line=link.line)

    return replace(robot, links=tuple(map(bare, robot.links)))
