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

"""Reader of SDF joints: types, and closed loops."""

from __future__ import annotations

from dataclasses import replace

from opencv_tools.robot.joint_kinds import JOINT_KINDS, SDF_TYPES
from opencv_tools.robot.model import Joint, Robot
from opencv_tools.robot.sdf.context import ReadContext
from opencv_tools.robot.sdf.names import JOINTS
from opencv_tools.robot.sdf.values import MODEL_FRAME
from opencv_tools.robot.xml.document import (
    DescriptionError, line_of, required_name, TrackedElement)
from opencv_tools.robot.xml.passthrough import URDF_JOINT_TYPE


def read_joint(element: TrackedElement, context: ReadContext) -> Joint:
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
