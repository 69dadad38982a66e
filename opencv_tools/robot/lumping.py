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
Links on fixed joints that become frames of other links, and links again.

A simulator gives a link of SDF without ``<inertial>`` a mass of 1 kg. Therefore a link without
mass becomes a frame of the link with mass to which fixed joints connect it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from lxml import etree
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import (
    FrameId, Joint, Link, Placement, Robot, RobotFrame, Shape)
from opencv_tools.robot.names import Names
from opencv_tools.robot.pose import IDENTITY
from opencv_tools.robot.sdf.inertia import total_inertial, without_auto
from opencv_tools.robot.sdf.values import POSED, PRESERVING_TAGS
from opencv_tools.robot.trees import without_orphan_mimics
from opencv_tools.robot.xml.document import detached, Element, line_of
from opencv_tools.robot.xml.passthrough import URDF_TAG
from opencv_tools.robot.xml.report import Report

_Owner = TypeVar('_Owner', Shape, Link, Joint, RobotFrame)
_SHAPES = ('visuals', 'collisions')
# Elements that a link has once. If links become one, that of the first link counts.
_SINGLE = ('enable_wind', 'gravity', 'inertial', 'kinematic', 'must_be_base_link', 'self_collide',
           'velocity_decay')
# Marks for the conversion back: the link or joint that a frame was, by its number among all links
# or joints, the former link of a shape or of another element, the former links and name of a
# joint, and a link that has no mass in URDF.
_MARKS = _LINK, _JOINT, _PARENT, _CHILD, _FORMER, _MASSLESS = tuple(
    f'{URDF_TAG}{name}' for name in ('link', 'joint', 'parent', 'child', 'former', 'massless'))
_NO_MARKS = dict.fromkeys(_MARKS)


def lump_fixed(robot: Robot, report: Report) -> Robot:
    """
    Return a robot with each link below a fixed joint merged into its parent link.

    The parent link gets the total mass, the visuals and the collisions. Merged links and joints
    remain as frames, and shapes remain placed in them. Joints to the world stay, and so do joints
    with a sensor and those that a ``<gazebo>`` block preserves.
    """
    kinematics = Kinematics(robot)
    hosts = {name: name for name in kinematics.roots}
    inner = _joints_inside(robot)
    for name in kinematics.subtree(kinematics.roots):
        for joint in kinematics.child_joints[name]:
            hosts[joint.child] = hosts[name] if joint.name in inner else joint.child
    for joint in robot.joints:
        # Joints that close a loop may connect two links that are one now.
        host = hosts[joint.child]
        if hosts[joint.parent] == host:
            report.warn('joint', joint.name, joint.line, (
                f'lumped: both its links are link {host!r} now, so it is a frame'
                if joint.is_loop else
                f'lumped: link {joint.child!r} is now a frame of link {host!r}'))
    return _merged(robot, hosts, report, is_marked=False)


def without_massless(robot: Robot, report: Report) -> Robot:
    """
    Return a robot in which links without an inertial are frames of links with mass.

    A link becomes a frame if fixed joints connect it to a link with mass. The nearest link above
    counts, or else the first one below. `with_massless` makes links of these frames again.

    :param robot: a robot with valid SDF names.
    """
    kinematics, links = Kinematics(robot), {link.name: link for link in robot.links}
    inner, groups, hosts = _joints_inside(robot), dict[str, str](), dict[str, str]()
    heavy: dict[str, str] = {}  # the first link with mass of each group, by its topmost link
    names = kinematics.subtree(kinematics.roots)
    above = {name: joint.parent for name, joint in kinematics.parent_joint.items()
             if joint.name in inner}
    for name in names:
        groups[name] = groups[above[name]] if name in above else name
        inertial = links[name].inertial
        if inertial and inertial.mass > 0:
            heavy.setdefault(groups[name], name)
    for name in names:
        host = heavy.get(groups[name])
        hosts[name] = name if host is None or links[name].inertial else hosts.get(
            above.get(name, ''), host)
    for name in names:
        if hosts[name] != name:
            report.preserve('link', name, links[name].line, 'has no <inertial>, which is 1 kg in '
                            f'SDF; it is a <frame> of link {hosts[name]!r}')
    return _merged(robot, hosts, report, is_marked=True)


def marked_massless(robot: Robot) -> Robot:
    """Return a robot with marks of the links without an inertial beside links with one."""
    if not any(link.inertial for link in robot.links):
        return robot
    return replace(robot, links=tuple(
        link if link.inertial or link.is_world else _marked(link, {_MASSLESS: 'true'})
        for link in robot.links))


def is_massless(link: Link) -> bool:
    """Return whether a link of SDF without an inertial has no mass in URDF."""
    return _MASSLESS in link.extension.marks


def _joints_inside(robot: Robot) -> set[str]:
    """Return the names of the fixed joints that need not remain joints."""
    worlds = {link.name for link in robot.links if link.is_world}
    root = robot.extension.urdf
    preserved = {block.get('reference', '')
                 for block in ([] if root is None else root.iterchildren('gazebo'))
                 for tag in PRESERVING_TAGS
                 if (block.findtext(tag) or '').strip().lower() in ('true', '1')}
    return {joint.name for joint in robot.joints
            if joint.type == 'fixed' and not joint.is_loop and joint.name not in preserved
            and not {joint.parent, joint.child} & worlds
            and joint.extension.find_sdf('sensor') is None}


def _merged(robot: Robot, hosts: Mapping[str, str], report: Report, *, is_marked: bool) -> Robot:
    if all(name == host for name, host in hosts.items()):
        return robot
    robot = _with_children_first(robot, hosts)
    merged = _Merging(robot, Kinematics(robot), hosts, is_marked).merged(report)
    _report_names(merged, {frame.name for frame in merged.frames}, report)
    return merged


def _report_names(robot: Robot, frames: set[str], report: Report) -> None:
    """Warn of plugins and sensors that name a frame where they may need a link or joint."""
    owners = {owner.name for owner in robot.links + robot.joints}
    roots = (part.extension.sdf for part in robot.parts() if part.extension.sdf is not None)
    for element in (one for root in roots for one in root.iter('{*}*')):
        holder, name = next(element.iterancestors('plugin', 'sensor'), None), (
            element.text or '').strip()
        if holder is not None and name in frames - owners and 'frame' not in str(
                element.tag).lower():
            report.warn(str(holder.tag), holder.get('name', ''), line_of(element),
                        f'<{element.tag!s}> names {name!r}, which is a frame in SDF; a plugin '
                        'that needs a link or joint does not find it')


def _with_children_first(robot: Robot, hosts: Mapping[str, str]) -> Robot:
    """
    Return a robot in which the joints at links that become frames are placed in their child links.

    A link is then placed in its parent link, with the numbers of the joint. Otherwise a link
    would be placed in a joint that becomes a frame of it.
    """
    links, joints = {link.name: link for link in robot.links}, []
    for joint in robot.joints:
        child, frame = links[joint.child], FrameId('joint', joint.name)
        is_inside = hosts[joint.parent] == hosts[joint.child] or hosts[child.name] != child.name
        if is_inside and not joint.is_loop and child.placement.relative_to == frame:
            offset, pose = child.placement.pose.transform(), joint.placement.pose
            if offset != IDENTITY:
                pose = (pose.transform() @ offset).pose()
            links[child.name] = replace(child, placement=replace(joint.placement, pose=pose))
            joint = replace(joint, placement=Placement(
                offset.inverse().pose(), FrameId('link', child.name)))
        joints.append(joint)
    return replace(robot, links=tuple(links.values()), joints=tuple(joints))


@dataclass(frozen=True)
class _Merging:
    """
    Links that become frames.

    :param hosts: the link that each link becomes a frame of; itself if it stays.
    :param is_marked: whether marks say what the frames were.
    """

    robot: Robot
    kinematics: Kinematics
    hosts: Mapping[str, str]
    is_marked: bool

    def merged(self, report: Report) -> Robot:
        """Return the robot with the frames, and with all elements in the links that stay."""
        robot, hosts = self.robot, self.hosts
        frames = self._frames()
        others: dict[str, list[Link]] = {}
        for link in robot.links:
            if hosts[link.name] != link.name:
                others.setdefault(hosts[link.name], []).append(link)
        links = tuple(self._with_members(link, others.get(link.name, ()), report)
                      for link in robot.links if hosts[link.name] == link.name)
        joints = [self._between_hosts(joint) for joint in robot.joints
                  if hosts[joint.parent] != hosts[joint.child]]
        canonical = hosts[robot.canonical_link or _first_body(robot.links)]
        if not robot.canonical_link and canonical == _first_body(links):
            canonical = ''

        def new_id(frame: FrameId) -> FrameId:
            return FrameId('frame', frames[frame].name) if frame in frames else frame

        # A frame that is marked is still a fixed joint to follow.
        return replace(robot, links=links, joints=tuple(joints) if self.is_marked else (
                           without_orphan_mimics(joints, report)),
                       frames=(*robot.frames, *frames.values()),
                       canonical_link=canonical).map_frame_ids(new_id)

    def _frames(self) -> dict[FrameId, RobotFrame]:
        """Return frames in place of the joints and links that vanish, by the frames of those."""
        found: dict[FrameId, RobotFrame] = {}
        for number, joint in enumerate(self.robot.joints):
            if self.hosts[joint.child] == self.hosts[joint.parent]:
                former = joint.extension.marks.get('name')
                frame = self._frame(joint, self.hosts[joint.child], {
                    _JOINT: str(number), _PARENT: joint.parent, _CHILD: joint.child,
                    **({_FORMER: former} if former else {})})
                if joint.name == joint.child:
                    frame = replace(frame, name=f'{joint.name}_joint')
                found[FrameId('joint', joint.name)] = frame
        for number, link in enumerate(self.robot.links):
            if self.hosts[link.name] != link.name:
                found[FrameId('link', link.name)] = self._frame(
                    link, self.hosts[link.name], {_LINK: str(number)})
        return found

    def _frame(self, owner: Link | Joint, host: str, marks: Mapping[str, str]) -> RobotFrame:
        extension, sdf = owner.extension.with_sdf(None), owner.extension.sdf
        if self.is_marked:
            if isinstance(owner, Joint) and sdf is not None:
                extension = extension.with_sdf(_prefixed(sdf))
            # A link may have the same name in URDF, and names of frames are unique.
            extension = extension.marked({**marks, **({'name': None} if _FORMER in marks else {})})
        return RobotFrame(name=owner.name, attached_to=FrameId('link', host),
                          placement=owner.placement, extension=extension, line=owner.line)

    def _between_hosts(self, joint: Joint) -> Joint:
        """Return a joint between the links that stay."""
        ends = {_PARENT: joint.parent, _CHILD: joint.child}
        marks = {mark: name for mark, name in ends.items() if self.hosts[name] != name}
        joint = replace(joint, parent=self.hosts[joint.parent], child=self.hosts[joint.child])
        return _marked(joint, marks) if marks and self.is_marked else joint

    def _with_members(self, host: Link, others: Sequence[Link], report: Report) -> Link:
        """Return a link with the inertials, shapes and sensors of other links merged into it."""
        if not others:
            return host
        host = without_auto(host)  # the numbers of the sum count
        sdf = etree.Element('link') if host.extension.sdf is None else detached(host.extension.sdf)
        shapes = {kind: [*getattr(host, kind)] for kind in _SHAPES}
        taken = {kind: Names(shape.name for shape in shapes[kind]) for kind in _SHAPES}
        for link in others:
            for kind in _SHAPES:
                shapes[kind] += [self._shape(shape, link, taken[kind])
                                 for shape in getattr(link, kind)]
            names = dict(zip((shape.name for shape in link.collisions), (
                shape.name for shape in shapes['collisions'][-len(link.collisions):])))
            for element in link.extension.sdf if link.extension.sdf is not None else ():
                copy = _posed_in(element, link.name)
                for collision in copy.iterfind('contact/collision'):
                    collision.text = names.get((collision.text or '').strip(), collision.text)
                held = sdf.find(element.tag) if element.tag in _SINGLE else None
                if held is not None and ''.join(held.itertext()) != ''.join(copy.itertext()):
                    report.warn(str(element.tag), link.name, link.line, 'has no effect: link '
                                f'{host.name!r}, which holds this frame, has another value')
                if self.is_marked:
                    copy.set(_LINK, link.name)
                    if held is not None or element.tag == 'inertial':
                        copy.tag = URDF_TAG + str(element.tag)
                if self.is_marked or held is None:
                    sdf.append(copy)
        inertials = [link.inertial for link in (host, *others) if link.inertial]
        return replace(
            host, visuals=tuple(shapes['visuals']), collisions=tuple(shapes['collisions']),
            inertial=total_inertial(inertials, FrameId('link', host.name), self.kinematics)
            if inertials else None,
            extension=host.extension.with_sdf(sdf))

    def _shape(self, shape: Shape, link: Link, taken: Names) -> Shape:
        """Return a shape with the name of its former link in its name."""
        if self.is_marked:
            shape = _marked(shape, {
                'name': shape.name, **shape.extension.marks, _LINK: link.name})
        return replace(shape, name=shape.name and taken.new(f'{link.name}_{shape.name}'))


def _first_body(links: Sequence[Link]) -> str:
    return next((link.name for link in links if not link.is_world), '')


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


def with_massless(robot: Robot) -> Robot:
    """
    Return a robot with the links and joints that `without_massless` made frames of.

    The robot is returned unchanged if its frames and links were edited so that they do not fit.
    """
    if not any(_NO_MARKS.keys() & owner.extension.marks for _, owner in robot.frame_owners()):
        return robot
    robot = replace(robot, links=tuple(
        replace(_marked(link, _NO_MARKS), default_mass=0.0) if is_massless(link) else link
        for link in robot.links))
    frames = {mark: sorted(((int(text[:9]), frame) for frame in robot.frames
                            if (text := frame.extension.marks.get(mark, '')).isdecimal()),
                           key=lambda one: one[0]) for mark in (_LINK, _JOINT)}
    parts = {frame.name: {kind: list[Any]() for kind in (*_SHAPES, 'sdf')}
             for _, frame in frames[_LINK]}
    links = [_split(link, parts) for link in robot.links] if parts else []
    names = {*parts, *(link.name for link in links)}
    joints = [_reconnected(joint) for joint in robot.joints]
    for number, frame in frames[_JOINT] if parts else ():
        joints.insert(number, _reconnected(Joint(
            name=frame.name, type='fixed', parent='', child='', placement=frame.placement,
            extension=frame.extension, line=frame.line)))
    if not {end for joint in joints for end in (joint.parent, joint.child)} <= names:
        return robot
    for number, frame in frames[_LINK]:
        own, sdf = parts[frame.name], etree.Element('link')
        sdf.extend(own['sdf'])
        links.insert(number, Link(
            name=frame.name, placement=frame.placement, visuals=tuple(own['visuals']),
            collisions=tuple(own['collisions']), line=frame.line,
            extension=frame.extension.with_sdf(sdf).marked(_NO_MARKS)))
    new_ids = {FrameId('frame', frame.name): FrameId(mark.removeprefix(URDF_TAG), frame.name)
               for mark, found in frames.items() for _, frame in found}
    result = replace(
        robot, links=tuple(links), joints=tuple(joints), frames=tuple(
            frame for frame in robot.frames if FrameId('frame', frame.name) not in new_ids)
    ).map_frame_ids(lambda frame: new_ids.get(frame, frame))
    kinematics = Kinematics(result)
    is_tree = (len(kinematics.roots) == len(Kinematics(robot).roots)
               and len(kinematics.subtree(kinematics.roots)) == len(links))
    return result if is_tree else robot


def _split(link: Link, parts: Mapping[str, Mapping[str, list[Any]]]) -> Link:
    """Return a link without what belongs to former links, and add that to the parts of those."""
    shapes: dict[str, list[Shape]] = {kind: [] for kind in _SHAPES}
    for kind, own in shapes.items():
        for shape in getattr(link, kind):
            name = shape.extension.marks.get(_LINK, '')
            if name in parts:
                parts[name][kind].append(_marked(shape, _NO_MARKS))
            else:
                own.append(shape)
    sdf = None if link.extension.sdf is None else detached(link.extension.sdf)
    for element in [] if sdf is None else sdf.findall('*'):
        name = element.get(_LINK, '')
        if name in parts and sdf is not None:
            sdf.remove(element)
            parts[name]['sdf'].append(element)
            del element.attrib[_LINK]
            element.tag = str(element.tag).removeprefix(URDF_TAG)
            pose = element.find('pose')
            if pose is not None and pose.get('relative_to') == name:
                del pose.attrib['relative_to']
                if not pose.text:
                    element.remove(pose)
    return replace(link, visuals=tuple(shapes['visuals']), collisions=tuple(shapes['collisions']),
                   extension=link.extension.with_sdf(sdf))


def _reconnected(joint: Joint) -> Joint:
    """Return a joint between its former links."""
    marks, sdf = joint.extension.marks, joint.extension.sdf
    if sdf is not None and _JOINT in marks:
        sdf = detached(sdf)
        for element in sdf.iterchildren(f'{URDF_TAG}*'):
            element.tag = str(element.tag).removeprefix(URDF_TAG)
    return replace(
        joint, parent=marks.get(_PARENT, joint.parent), child=marks.get(_CHILD, joint.child),
        extension=joint.extension.with_sdf(sdf).marked(
            {**({'name': marks[_FORMER]} if _FORMER in marks else {}), **_NO_MARKS}))


def _prefixed(sdf: Element) -> Element:
    """Return a copy of an element whose children SDF ignores."""
    copy = detached(sdf)
    for element in copy.iterchildren('{}*'):
        element.tag = URDF_TAG + str(element.tag)
    return copy


def _marked(owner: _Owner, marks: Mapping[str, str | None]) -> _Owner:
    return replace(owner, extension=owner.extension.marked(marks))
