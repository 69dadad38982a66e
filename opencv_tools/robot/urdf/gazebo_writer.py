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

"""``<gazebo>`` blocks of a URDF that is written, from which Gazebo reads SDF and settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lxml import etree
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import FrameId, MODEL, Robot
from opencv_tools.robot.sdf.values import GAZEBO, MODEL_FRAME
from opencv_tools.robot.urdf.poses import in_joint_frame
from opencv_tools.robot.urdf.settings import take_settings
from opencv_tools.robot.xml.document import detached, Element, line_of
from opencv_tools.robot.xml.report import Report


@dataclass(frozen=True)
class GazeboBlocks:
    """
    The blocks of a robot.

    :param settings: settings by their owners, as they are in the blocks.
    :param frames: frames by the names that poses of SDF use.
    """

    kinematics: Kinematics
    settings: Mapping[FrameId, Sequence[Element]]
    frames: Mapping[str, FrameId]
    report: Report

    def outside(self, unread: Element | None, owner: FrameId) -> Element | None:
        """Return the SDF of an object without what is written into its block."""
        tags = self._tags(owner)
        if unread is None or not any(child.tag in tags for child in unread):
            return unread
        copy = detached(unread)
        for child in list(copy):
            if child.tag in tags:
                copy.remove(child)
        return copy if len(copy) or copy.attrib else None

    def write(self, root: Element, robot: Robot) -> None:
        """Write the blocks, and report the elements in them."""
        self._write_block(root, MODEL, robot.name, robot.extension.sdf)
        for owner, part in robot.frame_owners():
            if owner.kind != 'frame':
                self._write_block(root, owner, part.name, part.extension.sdf)

    def _write_block(self, root: Element, owner: FrameId, name: str, unread: Element | None
                     ) -> None:
        tags, values = self._tags(owner), self.settings.get(owner, ())
        children = [] if unread is None else [child for child in unread if child.tag in tags]
        if children or values:
            block = etree.SubElement(root, 'gazebo', {} if owner == MODEL else {
                'reference': name})
            block.extend(self._in_urdf(child, owner) for child in children)
            block.extend(values)
        for child in (*children, *values):
            self.report.preserve(str(child.tag), name, line_of(child),
                                 'not supported by URDF; preserved in <gazebo>')

    def _tags(self, owner: FrameId) -> frozenset[str]:
        # If a link and a joint have the same name, the block belongs to the link.
        is_shadowed = owner.kind == 'joint' and owner.name in self.kinematics.child_joints
        return frozenset() if is_shadowed else GAZEBO[owner.kind]

    def _in_urdf(self, element: Element, owner: FrameId) -> Element:
        if owner.kind != 'link':
            return detached(element)
        return in_joint_frame(element, owner.name, self.kinematics, self.frames, self.report)


def take_blocks(robot: Robot, report: Report) -> tuple[Robot, GazeboBlocks]:
    """Return a robot without the settings that are written into blocks, and the blocks."""
    robot, settings = take_settings(robot, report)
    frames = {MODEL_FRAME: MODEL}
    for frame_id, owner in robot.frame_owners():
        frames.setdefault(owner.name, frame_id)
    return robot, GazeboBlocks(Kinematics(robot), settings, frames, report)
