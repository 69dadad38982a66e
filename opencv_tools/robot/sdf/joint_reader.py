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

"""Joints of SDF, read: their axes by the rules of each version, and the loops they close."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
import math

from opencv_tools.robot.joint_kinds import JOINT_KINDS, SDF_TYPES
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import Axis, FrameId, Joint, Mimic
from opencv_tools.robot.pose import ZERO
from opencv_tools.robot.sdf.fragments import AXES, axis_from_element, Turn
from opencv_tools.robot.sdf.link_reader import Place
from opencv_tools.robot.sdf.names import JOINTS
from opencv_tools.robot.sdf.values import flag, FRAMES, JOINT_AXES, MODEL_FRAME
from opencv_tools.robot.xml.document import DescriptionError, line_of, required_name
from opencv_tools.robot.xml.numbers import number
from opencv_tools.robot.xml.passthrough import URDF_NAMESPACE
from opencv_tools.robot.xml.tracked import TrackedElement

_TYPE = f'{{{URDF_NAMESPACE}}}type'
_MIMIC = f'{{{URDF_NAMESPACE}}}mimic'


def read_joint(element: TrackedElement, place: Place) -> Joint:
    """Read what a joint connects and where it is, without its axes."""
    name = place.scope.qualified(required_name(element))
    names, scope = place.names, place.scope
    child, parent = names.child_frame(element, scope), names.parent_frame(element, scope)
    ends = {'parent': names.link_of(parent), 'child': names.link_of(child)}
    for tag, frame in (('parent', parent), ('child', child)):
        if frame.kind != 'link':
            place.report.preserve('joint', name, line_of(element),
                               f'its {tag} is {frame.name or MODEL_FRAME!r}, '
                               f'which moves with link {ends[tag]!r}')
    if ends['parent'] == ends['child']:
        raise DescriptionError(f'connects link {ends["child"]!r} with itself', element)
    return Joint(name, _type(element), ends['parent'], ends['child'],
                 place.placement(element, child), line=line_of(element))


def with_axes(joint: Joint, element: TrackedElement, place: Place, kinematics: Kinematics
              ) -> Joint:
    """
    Read the axes of a joint, and keep what else there is of it.

    :param joint: as `read_joint` gives it.
    :param kinematics: of the robot, with all its frames.
    """
    axes = []
    for tag in AXES[:joint.kind.max_axes]:
        child = element.find(tag)
        if child is None:
            # The second axis may be left out, so may that of a joint that SDF does not have.
            if tag == AXES[0] and joint.type in SDF_TYPES:
                place.report.warn('joint', joint.name, joint.line, f'a {joint.type} joint without '
                                  '<axis>; it is taken for 0 0 1, as SDF has it')
                axes.append(Axis((0.0, 0.0, 1.0)))
            continue
        axis = axis_from_element(child, _turn(child, joint, place, kinematics),
                                 kind=joint.type)
        axes.append(replace(axis, mimic=_mimic(element, child, tag, axis, place)))
    own = element.get(_TYPE)
    if own == 'fixed':
        element.take_first(AXES[0])  # an old version wants one of a fixed joint
    joint = replace(joint, axes=tuple(axes))
    limits = joint.limit.lower, joint.limit.upper
    if limits[0] > limits[1]:
        place.report.warn('limit', joint.name, joint.line,
                          f'lower {limits[0]} is above upper {limits[1]}; kept as it is')
    if joint.type == 'revolute' and limits == (-math.inf, math.inf) and not own:
        joint = replace(joint, type='continuous')
    return replace(joint, extension=place.carried(element))


def marked_loops(joints: Sequence[Joint], links: Iterable[str], canonical: str
                 ) -> tuple[Joint, ...]:
    """
    Mark the joints that close a loop, so that the others make trees.

    A link's first joint in the order of the file places it. Where every link is the child of a
    joint, the canonical link or else the first one is what the others hang on.

    :param links: in the order of the file.
    :param canonical: the canonical link.
    """
    children = {joint.child for joint in joints}
    whole = _DisjointSets()
    for joint in joints:
        whole.join(joint.parent, joint.child)
    links = [canonical, *links] if canonical else list(links)
    rooted = {whole.top(link) for link in links if link not in children}
    roots = set()
    for link in links:
        if whole.top(link) not in rooted:
            rooted.add(whole.top(link))
            roots.add(link)
    trees, placed, result = _DisjointSets(), roots, []
    for joint in joints:
        is_loop = joint.child in placed or not trees.join(joint.parent, joint.child)
        if not is_loop:
            placed.add(joint.child)
        result.append(replace(joint, is_loop=True) if is_loop else joint)
    return tuple(result)


class _DisjointSets:
    """Links that hang together."""

    def __init__(self) -> None:
        self._above: dict[str, str] = {}

    def top(self, link: str) -> str:
        """Name the one link that stands for all that hang together with one."""
        while (above := self._above.get(link, link)) != link:
            self._above[link] = self._above.get(above, above)
            link = above
        return link

    def join(self, one: str, other: str) -> bool:
        """Note that two links hang together; tell whether that is new."""
        one, other = self.top(one), self.top(other)
        self._above[other] = one
        return one != other


def _type(element: TrackedElement) -> str:
    written = element.get('type', '')
    text = element.get(_TYPE, written).strip().lower()
    # In the namespace of URDF stand those that SDF does not have.
    types = tuple(JOINT_KINDS) if element.tag != JOINTS[0] else SDF_TYPES
    if text not in types:
        raise DescriptionError(f'type={text!r} is not a type of joint; write one of '
                               f'{", ".join(types)}', element)
    return text


def _turn(axis: TrackedElement, joint: Joint, place: Place, kinematics: Kinematics) -> Turn:
    """Give what turns an axis into the joint's frame, by the rules of its version."""
    version, xyz = place.scope.version, axis.find('xyz')
    name = '' if xyz is None else xyz.get('expressed_in', '')
    old = axis.find('use_parent_model_frame')
    if old is not None and flag(old.text, old) and version >= FRAMES:
        place.report.warn('axis', joint.name, line_of(old), 'use_parent_model_frame means nothing '
                          'from SDF 1.7 on, where it is expressed_in=')
    elif version < FRAMES:
        in_model = version < JOINT_AXES and not place.scope.is_inside
        if in_model if old is None else flag(old.text, old):
            name = MODEL_FRAME
    if not name:
        return None
    frame = place.names.lookup(place.scope, name, axis, 'expressed_in')
    pose = kinematics.between(FrameId('joint', joint.name), frame)
    return None if pose.rpy == ZERO else pose.transform().rotate


def _mimic(joint: TrackedElement, element: TrackedElement, tag: str, axis: Axis, place: Place
           ) -> Mimic | None:
    mimic, own = axis.mimic, element.find('mimic')
    for kept in joint.take_all(_MIMIC):
        if kept.get('axis', AXES[0]) == tag:
            mimic = Mimic(kept.get('joint', ''),
                          number(kept.get('multiplier', '1'), kept, 'multiplier'),
                          number(kept.get('offset', '0'), kept, 'offset'))
    if mimic is None:
        return None
    leader = FrameId('joint', place.scope.qualified(mimic.joint))
    if leader not in place.names.elements:
        if own is None:
            raise DescriptionError(f'mimics {mimic.joint!r}, which is no joint', element)
        place.report.warn('mimic', place.scope.qualified(required_name(joint)), line_of(own),
                          f'joint={mimic.joint!r} is no joint of the model; it follows none')
        element.put_back(own)
        return None
    return replace(mimic, joint=leader.name)
