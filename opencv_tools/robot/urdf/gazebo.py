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

"""What stands in the ``<gazebo>`` blocks of URDF, of which some is SDF as it is."""

from __future__ import annotations

from lxml import etree
from opencv_tools.robot.model import FrameId, MODEL
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.fragments import fragment_flaw
from opencv_tools.robot.sdf.values import pose_of
from opencv_tools.robot.urdf.tree import TreeOfLinks
from opencv_tools.robot.xml.document import Element, line_of, local_name
from opencv_tools.robot.xml.numbers import numbers_text
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.schema import GAZEBO, POSED
from opencv_tools.robot.xml.tracked import detached, TrackedElement

# What turning a pose there and back leaves of nothing.
_NOTHING_LEFT = 1e-12


def sorted_blocks(root: TrackedElement, tree: TreeOfLinks, report: Report
                  ) -> tuple[dict[FrameId, list[Element]], list[Element]]:
    """
    Sort what stands in ``<gazebo>`` blocks.

    :returns: what is SDF, by what it belongs to, and the blocks with what remains.
    """
    found: dict[FrameId, list[Element]] = {}
    rest = []
    for block in root.take_all('gazebo'):
        name = block.get('reference')
        owners = [MODEL] if name is None else [
            FrameId(kind, name) for kind, names in (('link', tree.links), ('joint', tree.joints))
            if name in names]
        if not owners:
            report.warn('gazebo', name or '', line_of(block),
                        'refers to no link or joint; it is kept as it is')
        remains = detached(block.element)
        remains.text = None
        for part in list(remains):
            owner = next((owner for owner in owners if part.tag in GAZEBO[owner.kind]), None)
            flaw = fragment_flaw(part) if owner else ''
            if flaw:
                report.warn(local_name(part), name or '', line_of(part), f'{flaw}; it is kept as '
                            'it is')
            elif owner is not None:
                remains.remove(part)
                found.setdefault(owner, []).append(detached(part))
                report.preserve(str(part.tag), owner.name or root.get('name', ''), line_of(part),
                             f'out of <gazebo>; SDF has it in the {owner.kind} itself')
        if len(remains) or set(remains.attrib) - {'reference'} or not owners:
            rest.append(remains)
    return found, rest


def in_link_frame(part: Element, offset: Pose | None) -> Element:
    """Give an element of SDF with its pose in its link, where it was in the joint above."""
    pose = part.find('pose')
    if not offset or part.tag not in POSED or (pose is not None and pose.attrib):
        return part
    here = (offset.transform() @ pose_of(pose).transform()).pose()
    part = detached(part)
    pose = part.find('pose')
    if max(map(abs, here.xyz + here.rpy)) < _NOTHING_LEFT:
        if pose is not None:
            part.remove(pose)
            part.text = part.text if len(part) else None
        return part
    if pose is None:
        pose = etree.Element('pose')
        part.insert(0, pose)
    pose.text = numbers_text(here.xyz + here.rpy)
    return part
