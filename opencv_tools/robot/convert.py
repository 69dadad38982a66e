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

"""Conversion of a robot to the XML of the other format, with links that fixed joints connect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from lxml import etree
from opencv_tools.robot.geometry import Mesh
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import FrameId, Inertial, Link, Placement, Robot, RobotFrame, Shape
from opencv_tools.robot.physical import report_inertials, with_physical_inertials
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.renaming import (
    with_original_names, with_valid_sdf_names, with_valid_urdf_names)
from opencv_tools.robot.sdf.inertia import total_inertial, without_auto
from opencv_tools.robot.sdf.rules import keep_sdf_rules
from opencv_tools.robot.sdf.values import DEFAULT_INERTIAL, POSED, PRESERVING_TAGS
from opencv_tools.robot.sdf.writer import write_sdf
from opencv_tools.robot.trees import (
    select_root, shortened, with_frame_links, without_orphan_mimics)
from opencv_tools.robot.urdf.rules import keep_urdf_rules
from opencv_tools.robot.urdf.writer import write_urdf
from opencv_tools.robot.xml.document import detached, Element
from opencv_tools.robot.xml.report import Report

# Elements that a link has once. If links become one, that of the first link counts.
_SINGLE = ('enable_wind', 'gravity', 'inertial', 'kinematic', 'must_be_base_link', 'self_collide',
           'velocity_decay')


def lump_fixed(robot: Robot, report: Report) -> Robot:
    """
    Return a robot with each link below a fixed joint merged into its parent link.

    The parent link gets the total mass, the visuals and the collisions. Merged links and joints
    remain as frames, and shapes remain placed in them. Joints to the world stay, and so do joints
    with a sensor and those that a ``<gazebo>`` block preserves.
    """
    kinematics = Kinematics(robot)
    hosts = _hosts(robot, kinematics)
    if all(name == host for name, host in hosts.items()):
        return robot
    links = {link.name: link for link in robot.links}
    members: dict[str, list[Link]] = {}
    for link in robot.links:
        members.setdefault(hosts[link.name], []).append(link)
    merged = {name: _merged(links[name], [link for link in group if link.name != name], kinematics)
              for name, group in members.items()}
    frames = _frames_of_lumped(robot, hosts, kinematics, report)

    def new_id(frame: FrameId) -> FrameId:
        return FrameId('frame', frames[frame].name) if frame in frames else frame

    return replace(
        robot, links=tuple(merged[link.name] for link in robot.links if link.name in merged),
        # The child of a joint that closes a loop may be lumped by another joint.
        joints=without_orphan_mimics([
            replace(joint, parent=hosts[joint.parent], child=hosts[joint.child])
            for joint in robot.joints if hosts[joint.parent] != hosts[joint.child]], report),
        frames=(*robot.frames, *frames.values()),
        canonical_link=hosts.get(robot.canonical_link, '')).map_frame_ids(new_id)


def _hosts(robot: Robot, kinematics: Kinematics) -> dict[str, str]:
    """Return the link that each link is merged into, which is itself if it stays."""
    links = {link.name: link for link in robot.links}
    preserved = _preserved_joints(robot) | {
        joint.name for joint in robot.joints
        if joint.extension.find_sdf('sensor') is not None}
    hosts = {name: name for name in kinematics.roots}
    for name in kinematics.subtree(kinematics.roots):
        for joint in kinematics.child_joints[name]:
            stays = joint.type != 'fixed' or joint.name in preserved or links[name].is_world
            hosts[joint.child] = joint.child if stays else hosts[name]
    return hosts


def _frames_of_lumped(robot: Robot, hosts: Mapping[str, str], kinematics: Kinematics,
                      report: Report) -> dict[FrameId, RobotFrame]:
    """Return frames in place of the joints and links that vanish, by the frames of those."""
    links = {link.name: link for link in robot.links}
    found: dict[FrameId, RobotFrame] = {}
    # Joints that close a loop may connect two links that are one now.
    for joint in robot.joints:
        if hosts[joint.parent] != hosts[joint.child]:
            continue
        host, frame = FrameId('link', hosts[joint.child]), FrameId('joint', joint.name)
        report.warn('joint', joint.name, joint.line, (
            f'lumped: both its links are link {host.name!r} now, so it is a frame'
            if joint.is_loop else
            f'lumped: link {joint.child!r} is now a frame of link {host.name!r}'))
        found[frame] = RobotFrame(
            name=f'{joint.name}_joint' if joint.name == joint.child else joint.name,
            attached_to=host, placement=Placement(kinematics.between(host, frame), host),
            extension=replace(joint.extension, sdf=None), line=joint.line)
        if not joint.is_loop:
            link = links[joint.child]
            found[FrameId('link', link.name)] = RobotFrame(
                name=link.name, attached_to=host, placement=link.placement,
                extension=replace(link.extension, sdf=None), line=link.line)
    return found


def _preserved_joints(robot: Robot) -> set[str]:
    """Return the names of the fixed joints that ``<gazebo>`` blocks preserve."""
    root = robot.extension.urdf
    return {block.get('reference', '')
            for block in ([] if root is None else root.iterchildren('gazebo'))
            for tag in PRESERVING_TAGS
            if (block.findtext(tag) or '').strip().lower() in ('true', '1')}


def _merged(host: Link, others: list[Link], kinematics: Kinematics) -> Link:
    """Return a link with the inertials, shapes and sensors of other links merged into it."""
    if not others:
        return host
    host = without_auto(host)  # the numbers of the sum count
    sdf = None if host.extension.sdf is None else detached(host.extension.sdf)
    for other in others:
        for element in other.extension.sdf if other.extension.sdf is not None else ():
            sdf = etree.Element('link') if sdf is None else sdf
            if element.tag not in _SINGLE or sdf.find(element.tag) is None:
                sdf.append(_posed_in(element, other.name))
    members = (host, *others)
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


# Mass and moments of inertia of links without <inertial>.
INERTIALS = {
    'keep': None,
    'physical': None,
    'zero': (0.0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    'default': DEFAULT_INERTIAL,
}
_SCHEMES = {'model': 'model://', 'package': 'package://'}


@dataclass(frozen=True, kw_only=True)
class SdfOptions:
    """
    Options for writing a robot as SDF.

    :param version: SDF version, ``1.7`` to ``1.12``.
    :param relative: whether the pose of each link is relative to its parent link, with the
        numbers of the file; otherwise poses are relative to the model, as in the tutorial.
    :param inertial: a key of ``INERTIALS``.
    :param lump: whether links that fixed joints connect are merged.
    :param mesh_uri: ``model``, ``package`` or ``keep``, see `with_mesh_uris`.
    """

    version: str = '1.11'
    relative: bool = False
    inertial: str = 'keep'
    lump: bool = False
    mesh_uri: str = 'model'


@dataclass(frozen=True, kw_only=True)
class UrdfOptions:
    """
    Options for writing a robot as URDF.

    :param inertial: a key of ``INERTIALS``.
    :param frame_links: whether the frames become links, see `trees.with_frame_links`.
    :param mesh_uri: ``model``, ``package`` or ``keep``, see `with_mesh_uris`.
    """

    inertial: str = 'keep'
    frame_links: bool = False
    mesh_uri: str = 'package'


def convert_to_sdf(robot: Robot, report: Report, options: SdfOptions = SdfOptions()) -> Element:
    """
    Return a robot as SDF.

    :returns: the element ``<sdf>``.
    :raises DescriptionError: SDF of this version does not support the robot.
    """
    if options.lump:
        robot = lump_fixed(robot, report)
    robot = with_mesh_uris(with_inertials(robot, options.inertial, report), options.mesh_uri)
    report_inertials(robot, report)
    robot = with_valid_sdf_names(robot, report)
    root = write_sdf(robot, report, version=options.version, relative=options.relative)
    keep_sdf_rules(root, robot.source, report)
    return root


def convert_to_urdf(robot: Robot, report: Report, options: UrdfOptions = UrdfOptions()
                    ) -> Element:
    """
    Return a robot as URDF.

    :returns: the element ``<robot>``.
    :raises DescriptionError: URDF does not support the robot.
    """
    robot = with_inertials(select_root(robot, '', report), options.inertial, report)
    report_inertials(robot, report)
    robot = with_mesh_uris(robot, options.mesh_uri)
    if options.frame_links:
        robot = with_frame_links(robot, report)
    root = write_urdf(with_original_names(with_valid_urdf_names(robot, report)), report)
    keep_urdf_rules(root, robot.source, report)
    return root


def with_inertials(robot: Robot, choice: str, report: Report) -> Robot:
    """
    Return a robot with an inertial for each link that has none, except the world.

    :param choice: a key of ``INERTIALS``; ``keep`` adds nothing and warns instead. ``physical``
        does so too, and corrects physically impossible inertials.
    :raises DescriptionError: see `with_physical_inertials`.
    """
    if choice == 'physical':
        robot = with_physical_inertials(robot, report)
    without = [link for link in robot.links if link.inertial is None and not link.is_world]
    values = INERTIALS[choice]
    if values is None:
        if without:
            others = [link.name for link in without[1:]]
            like = f', like {shortened(others)}' if others else ''
            report.warn('link', without[0].name, without[0].line, (
                f'has no <inertial>{like}: massless in URDF, 1 kg in SDF; '
                'choose with --inertial zero or --inertial default'))
        return robot
    return replace(robot, links=tuple(
        replace(link, inertial=Inertial(Placement(Pose(), FrameId('link', link.name)), *values))
        if link.inertial is None and not link.is_world else link for link in robot.links))


def with_mesh_uris(robot: Robot, choice: str) -> Robot:
    """
    Return a robot with the URIs of meshes and textures in the scheme of a format.

    :param choice: ``package`` or ``model`` to replace the other of both schemes; ``keep`` to
        keep all URIs.
    """
    if choice == 'keep':
        return robot
    new = _SCHEMES[choice]
    old, = {*_SCHEMES.values()} - {new}

    def uri(value: str) -> str:
        return new + value.removeprefix(old) if value.startswith(old) else value

    def converted(shape: Shape) -> Shape:
        geometry, material = shape.geometry, shape.material
        if isinstance(geometry, Mesh):
            shape = replace(shape, geometry=replace(geometry, uri=uri(geometry.uri)))
        if material and material.texture:
            shape = replace(shape, material=replace(material, texture=uri(material.texture)))
        return shape

    return replace(robot, links=tuple(
        replace(link, visuals=tuple(map(converted, link.visuals)),
                collisions=tuple(map(converted, link.collisions))) for link in robot.links))
