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

"""SDF in the ``<gazebo>`` blocks of URDF, which Gazebo adds to the model, a link or a joint."""

from __future__ import annotations

from lxml import etree
from opencv_tools.robot.model import FrameId, MODEL
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.fragments import fragment_flaw
from opencv_tools.robot.sdf.values import GAZEBO, pose_of, POSED
from opencv_tools.robot.urdf.tree import LinkTree
from opencv_tools.robot.xml.document import Element, line_of, local_name
from opencv_tools.robot.xml.numbers import numbers_text
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.tracked import detached, TrackedElement

# Rounding error of a pose that was transformed there and back.
_ROUNDING = 1e-12


def extract_sdf(root: TrackedElement, tree: LinkTree, report: Report
                ) -> tuple[dict[FrameId, list[Element]], list[Element]]:
    """
    Extract the elements of SDF from the ``<gazebo>`` blocks.

    :returns: the elements by their owner, and the blocks with what remains in them.
    """
    extracted: dict[FrameId, list[Element]] = {}
    remaining = []
    for block in root.take_all('gazebo'):
        name = block.get('reference')
        owners = [MODEL] if name is None else [
            FrameId(kind, name) for kind, names in (('link', tree.links), ('joint', tree.joints))
            if name in names]
        if not owners:
            report.warn('gazebo', name or '', line_of(block), f'reference={name!r} is not a link '
                        'or joint of the robot; the element is preserved unchanged')
        copy = detached(block.element)
        copy.text = None
        for element in list(copy):
            owner = next((owner for owner in owners if element.tag in GAZEBO[owner.kind]), None)
            flaw = fragment_flaw(element) if owner else ''
            if flaw:
                report.warn(local_name(element), name or '', line_of(element),
                            f'{flaw}; the element is preserved unchanged')
            elif owner is not None:
                copy.remove(element)
                extracted.setdefault(owner, []).append(detached(element))
                report.preserve(str(element.tag), owner.name or root.get('name', ''),
                                line_of(element), f'moved from <gazebo> into the {owner.kind}')
        if len(copy) or set(copy.attrib) - {'reference'} or not owners:
            remaining.append(copy)
    return extracted, remaining


def in_link_frame(element: Element, offset: Pose | None) -> Element:
    """Return an element of SDF with its pose in its link instead of the parent joint."""
    pose = element.find('pose')
    if not offset or element.tag not in POSED or (pose is not None and pose.attrib):
        return element
    in_link = (offset.transform() @ pose_of(pose).transform()).pose()
    element = detached(element)
    if max(map(abs, in_link.xyz + in_link.rpy)) >= _ROUNDING:
        set_pose(element, in_link)
    elif (pose := element.find('pose')) is not None:
        element.remove(pose)
        element.text = element.text if len(element) else None
    return element


def set_pose(element: Element, pose: Pose) -> None:
    """Write the ``<pose>`` of an element of SDF in place of its former one."""
    child = element.find('pose')
    if child is None:
        child = etree.Element('pose')
        element.insert(0, child)
    child.attrib.clear()
    child.text = numbers_text(pose.xyz + pose.rpy)
