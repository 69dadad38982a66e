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

"""Facts of a whole URDF file that its elements are read with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lxml import etree
from opencv_tools.robot.model import Extension, FrameId, MODEL
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.urdf.gazebo import extract_sdf, Extracted
from opencv_tools.robot.urdf.materials import collect_materials, MaterialTable
from opencv_tools.robot.urdf.poses import in_link_frame, preserved_pose
from opencv_tools.robot.urdf.tree import build_tree, LinkTree
from opencv_tools.robot.xml.document import Element, local_name, required_name, TrackedElement
from opencv_tools.robot.xml.passthrough import extract_foreign
from opencv_tools.robot.xml.report import Report


@dataclass(frozen=True, kw_only=True)
class ReadContext:
    """
    Facts of the whole file.

    :param offsets: by link, the pose of its parent joint in it; without identities.
    """

    report: Report
    tree: LinkTree
    materials: MaterialTable
    gazebo: Extracted
    offsets: Mapping[str, Pose]

    def link_frame(self, link: str) -> FrameId:
        """Return the frame of a link in URDF, which is that of its parent joint."""
        parent_joint = self.tree.parent_joint.get(link)
        if parent_joint is not None and link in self.offsets:
            return FrameId('joint', required_name(parent_joint))
        return FrameId('link', link)

    def extension(self, element: TrackedElement, owner: FrameId) -> Extension:
        """Return the XML of a link or joint that the model does not represent."""
        offset = self.offsets.get(owner.name) if owner.kind == 'link' else None
        moved = [in_link_frame(child, offset) for child in self.gazebo.moved.get(owner, [])]
        return self.gazebo.with_settings(_extension(element, moved), owner.kind, owner.name)

    def robot_extension(self, root: TrackedElement) -> Extension:
        """Return the XML of the robot that the model does not represent."""
        return _extension(root, self.gazebo.moved.get(MODEL, []), self.gazebo.remaining)


def read_context(root: TrackedElement, report: Report) -> ReadContext:
    """
    Read the tree, the materials and the ``<gazebo>`` blocks of a file, before its elements.

    :raises DescriptionError: the links and joints are not a tree, or a material is not valid.
    """
    tree = build_tree(root, report)
    gazebo = extract_sdf(root, tree, report)
    return ReadContext(
        report=report, tree=tree, materials=collect_materials(root, report), gazebo=gazebo,
        offsets={link: pose for link, joint in tree.parent_joint.items()
                 if (pose := preserved_pose(joint)) is not None and not pose.is_identity})


def _extension(element: TrackedElement, sdf: Sequence[Element], urdf: Sequence[Element] = ()
               ) -> Extension:
    """Return the XML of an element that the model does not represent, with additional children."""
    preserved, tag = extract_foreign(element, 'sdf'), local_name(element)
    return Extension(_extended(element.unread(), tag, urdf), _extended(preserved, tag, sdf))


def _extended(unread: Element | None, tag: str, children: Sequence[Element]) -> Element | None:
    if children:
        unread = etree.Element(tag) if unread is None else unread
        unread.extend(children)
    return unread
