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
URDF, read as a robot.

Each joint is placed in its parent link. Each link with a parent joint is placed in that joint.
"""

from __future__ import annotations

from dataclasses import replace

from opencv_tools.robot.kinematics import check_mimic_cycles
from opencv_tools.robot.model import Extension, FrameId, MODEL, Robot, RobotFrame
from opencv_tools.robot.sdf.fragments import frame_from_element
from opencv_tools.robot.sdf.values import MODEL_FRAME
from opencv_tools.robot.trees import select_root
from opencv_tools.robot.urdf.context import read_context
from opencv_tools.robot.urdf.joint_reader import read_joint
from opencv_tools.robot.urdf.link_reader import read_link
from opencv_tools.robot.urdf.tree import LinkTree
from opencv_tools.robot.xml.document import (
    AnyElement, DescriptionError, Element, line_of, local_name, required_name, source_of,
    TrackedElement)
from opencv_tools.robot.xml.passthrough import extract_foreign, SDF_TAG
from opencv_tools.robot.xml.report import Report

_DEFAULT_NAME = 'robot'


def read_urdf(element: Element, report: Report, *, root_link: str = '') -> Robot:
    """
    Read a robot.

    :param element: the element ``<robot>``.
    :param root_link: root of the tree to read, if the file has several trees.
    :raises DescriptionError: the element is not a valid robot.
    """
    root = TrackedElement(element)
    if root.tag != 'robot':
        raise DescriptionError(f'is not URDF; its root is <{local_name(root)}> instead of <robot>',
                               root)
    name = root.get('name', '').strip()
    if not name:
        name = _DEFAULT_NAME
        report.warn('robot', '', line_of(root), f'has no name; it is named {name!r}')
    context = read_context(root, report)
    tree = context.tree
    canonical = root.get(f'{SDF_TAG}canonical_link', '')
    if canonical and canonical not in tree.links:
        raise DescriptionError(f'canonical_link={canonical!r} is not a link of the robot', root)
    robot = Robot(
        name=name, source=source_of(root),
        links=tuple(read_link(link, context) for link in tree.links.values()),
        joints=tuple(read_joint(joint, context) for joint in tree.joints.values()),
        frames=_frames(root, tree), canonical_link=canonical,
        extension=context.robot_extension(root))
    robot = select_root(robot, root_link, report)
    check_mimic_cycles(robot)
    return robot


def _frames(root: TrackedElement, tree: LinkTree) -> tuple[RobotFrame, ...]:
    elements = root.take_all(f'{SDF_TAG}frame')
    ids = {'': MODEL, MODEL_FRAME: MODEL}
    for kind, names in (('frame', map(required_name, elements)),
                        ('joint', tree.joints), ('link', tree.links)):
        ids.update((name, FrameId(kind, name)) for name in names)

    def lookup(name: str, element: AnyElement) -> FrameId:
        if name not in ids:
            raise DescriptionError(f'{name!r} is not a link, joint or frame of the robot', element)
        return ids[name]

    frames = []
    for element in elements:
        frame = frame_from_element(element, lookup)
        urdf = extract_foreign(element, 'urdf')
        frames.append(replace(frame, extension=Extension(urdf, element.unread())))
    return tuple(frames)
