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

"""Reader of URDF links."""

from __future__ import annotations

from dataclasses import replace

from opencv_tools.robot.model import FrameId, INERTIA, Inertial, Link, MODEL, Placement
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.urdf.context import ReadContext
from opencv_tools.robot.urdf.poses import origin_of, preserved_pose
from opencv_tools.robot.urdf.shape_reader import shapes_of
from opencv_tools.robot.xml.document import (
    line_of, required_child, required_name, TrackedElement)
from opencv_tools.robot.xml.numbers import required_number
from opencv_tools.robot.xml.report import Report


def read_link(element: TrackedElement, context: ReadContext) -> Link:
    """Read a link, with what ``<gazebo>`` adds to it."""
    name = required_name(element)
    link_frame = context.link_frame(name)
    inertial = element.find('inertial')
    visuals, collisions = (shapes_of(element, tag, link_frame, context.materials, context.report)
                           for tag in ('visual', 'collision'))
    collisions = tuple(replace(shape, extension=context.gazebo.with_settings(
        shape.extension, 'collision', name)) for shape in collisions)
    return Link(
        name=name, placement=_link_placement(element, context),
        inertial=None if inertial is None else _inertial(
            inertial, link_frame, context.report, name),
        visuals=visuals, collisions=collisions, line=line_of(element),
        extension=context.extension(element, FrameId('link', name)))


def _link_placement(element: TrackedElement, context: ReadContext) -> Placement:
    """Return the placement of a link in its parent joint, or of a root link in the model."""
    name = required_name(element)
    parent_joint = context.tree.parent_joint.get(name)
    if parent_joint is None:
        return Placement(preserved_pose(element) or Pose(), MODEL)
    offset = context.offsets.get(name)
    pose = offset.transform().inverse().pose() if offset else Pose()
    return Placement(pose, FrameId('joint', required_name(parent_joint)))


def _inertial(element: TrackedElement, link_frame: FrameId, report: Report, link: str
              ) -> Inertial:
    mass, inertia = required_child(element, 'mass'), element.find('inertia')
    value = required_number(mass, 'value')
    if value < 0:
        report.warn('mass', link, line_of(mass), f'value={mass.get("value")!r} is negative')
    missing = [name for name in INERTIA if inertia is None or name not in inertia]
    if inertia is None:
        report.warn('inertial', link, line_of(element), 'has no <inertia>; its moments are 0')
    elif missing:
        report.warn('inertia', link, line_of(inertia),
                    f'has no {", ".join(f"{name}=" for name in missing)}; missing moments are 0')
    ixx, ixy, ixz, iyy, iyz, izz = (
        0.0 if inertia is None or name in missing else required_number(inertia, name)
        for name in INERTIA)
    return Inertial(Placement(origin_of(element), link_frame), value,
                    (ixx, ixy, ixz, iyy, iyz, izz))
