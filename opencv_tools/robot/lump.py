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

"""Links that fixed joints hold together, made one link, as some simulators want them."""

from __future__ import annotations

from dataclasses import replace

from lxml import etree
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import Frame, FrameId, Inertial, Joint, Link, Placement, Robot, Shape
from opencv_tools.robot.pose import Pose, rotated_tensor, Vector
from opencv_tools.robot.xml.document import Element
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.schema import POSED
from opencv_tools.robot.xml.tracked import detached

# What a <gazebo reference> says of a joint that is to stay.
_KEEPERS = ('preserveFixedJoint', 'disableFixedJointLumping')


def lump_fixed(robot: Robot, report: Report) -> Robot:
    """
    Put what hangs on fixed joints into the link that it hangs on.

    Masses become one, in the frame of that link. The links and joints that go stay as frames, in
    which their visuals and collisions go on being placed. Joints that a ``<gazebo>`` block wants
    preserved, and those to the world, stay.
    """
    kinematics = Kinematics(robot)
    links = {link.name: link for link in robot.links}
    kept = _preserved(robot)
    hosts = {name: name for name in kinematics.roots}
    lumped: dict[str, Joint] = {}
    for name in kinematics.subtree(kinematics.roots):
        for joint in kinematics.child_joints[name]:
            stays = joint.type != 'fixed' or joint.name in kept or links[name].is_world
            hosts[joint.child] = joint.child if stays else hosts[name]
            if not stays:
                lumped[joint.child] = joint
    if not lumped:
        return robot
    guests: dict[str, list[Link]] = {}
    for link in robot.links:
        guests.setdefault(hosts[link.name], []).append(link)
    lumps = {name: _lump(links[name], [link for link in of if link.name != name], kinematics)
             for name, of in guests.items()}
    frames = []
    for child, joint in lumped.items():
        report.warn('joint', joint.name, joint.line,
                    f'lumped: link {child!r} is a frame of link {hosts[child]!r} now')
        frames.append(Frame(
            _frame_of_joint(joint), FrameId('link', hosts[child]),
            Placement(kinematics.between(FrameId('link', hosts[child]),
                                         FrameId('joint', joint.name)),
                      FrameId('link', hosts[child])), joint.extension, joint.line))
        frames.append(Frame(
            child, FrameId('link', hosts[child]), links[child].placement,
            replace(links[child].extension, sdf=None), links[child].line))
    whole = replace(
        robot, links=tuple(lumps[link.name] for link in robot.links if link.name in lumps),
        joints=tuple(replace(joint, parent=hosts[joint.parent]) for joint in robot.joints
                     if lumped.get(joint.child) is not joint),
        frames=(*robot.frames, *frames),
        canonical_link=hosts.get(robot.canonical_link, ''))
    now = {**{FrameId('link', child): FrameId('frame', child) for child in lumped},
           **{FrameId('joint', joint.name): FrameId('frame', _frame_of_joint(joint))
              for joint in lumped.values()}}
    whole = replace(whole, frames=tuple(
        replace(frame, attached_to=now.get(frame.attached_to, frame.attached_to))
        for frame in whole.frames))
    return whole.map_placements(lambda placement: replace(
        placement, relative_to=now.get(placement.relative_to, placement.relative_to)))


def _frame_of_joint(joint: Joint) -> str:
    return f'{joint.name}_joint' if joint.name == joint.child else joint.name


def _preserved(robot: Robot) -> set[str]:
    """Name the joints that are not to be lumped."""
    return {block.get('reference', '') for block in
            ([] if robot.extension.urdf is None else robot.extension.urdf.iterchildren('gazebo'))
            for tag in _KEEPERS if (block.findtext(tag) or '').strip().lower() in ('true', '1')}


def _lump(host: Link, guests: list[Link], kinematics: Kinematics) -> Link:
    """Put into a link what others have: shapes and sensors stay placed in the frames of those."""
    if not guests:
        return host
    rest = None if host.extension.sdf is None else detached(host.extension.sdf)
    for guest in guests:
        for part in guest.extension.sdf if guest.extension.sdf is not None else ():
            rest = etree.Element('link') if rest is None else rest
            rest.append(_placed_in(part, guest.name))
    inertials = [link.inertial for link in (host, *guests) if link.inertial]
    return replace(
        host,
        visuals=tuple(_named_by(link, host, shape) for link in (host, *guests)
                      for shape in link.visuals),
        collisions=tuple(_named_by(link, host, shape) for link in (host, *guests)
                         for shape in link.collisions),
        inertial=_sum(inertials, host, kinematics) if inertials else None,
        extension=replace(host.extension, sdf=rest))


def _named_by(link: Link, host: Link, shape: Shape) -> Shape:
    """Name a shape by the link that it was on, so that all of a lump have names of their own."""
    if link is host or not shape.name:
        return shape
    return replace(shape, name=f'{link.name}_{shape.name}')


def _placed_in(part: Element, frame: str) -> Element:
    """Copy an element of a link that is to be placed in a frame."""
    copy = detached(part)
    if copy.tag in POSED:
        pose = copy.find('pose')
        if pose is None:
            pose = etree.SubElement(copy, 'pose')
        if not pose.get('relative_to'):
            pose.set('relative_to', frame)
    return copy


def _sum(inertials: list[Inertial], host: Link, kinematics: Kinematics) -> Inertial:
    """Add masses up: one centre, and moments about it by the parallel axis theorem."""
    if len(inertials) == 1:
        return inertials[0]
    frame = FrameId('link', host.name)
    poses = [kinematics.within(frame, inertial.placement).transform() for inertial in inertials]
    mass = sum(inertial.mass for inertial in inertials)
    centre = _weighted([pose.translation for pose in poses],
                       [inertial.mass / mass if mass else 0.0 for inertial in inertials])
    total = [0.0] * 6
    for inertial, pose in zip(inertials, poses):
        x, y, z = (value - middle for value, middle in zip(pose.translation, centre))
        turned = rotated_tensor(inertial.inertia, pose.rotation)
        shifted = (y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y)
        total = [sum_ + own + inertial.mass * far
                 for sum_, own, far in zip(total, turned, shifted)]
    ixx, ixy, ixz, iyy, iyz, izz = total
    return Inertial(Placement(Pose(centre), frame), mass, (ixx, ixy, ixz, iyy, iyz, izz))


def _weighted(points: list[Vector], weights: list[float]) -> Vector:
    x, y, z = (sum(weight * value for weight, value in zip(weights, values))
               for values in zip(*points))
    return (x, y, z)
