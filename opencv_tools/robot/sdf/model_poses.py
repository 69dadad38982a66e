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

"""Poses of the models in an SDF file, by their own poses and by ``placement_frame``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from graphlib import CycleError

from opencv_tools.robot.kinematics import cycle_text, Kinematics, resolve_chain
from opencv_tools.robot.model import MODEL, Placement, Robot, WORLD
from opencv_tools.robot.pose import IDENTITY, Pose, Transform
from opencv_tools.robot.sdf.names import FrameRegistry
from opencv_tools.robot.sdf.scopes import Scope
from opencv_tools.robot.sdf.values import pose_of
from opencv_tools.robot.xml.document import DescriptionError


def check_placements(robot: Robot, registry: FrameRegistry) -> None:
    """Check that the placement of every frame leads to the model frame."""
    bases = {frame: owner.placement.relative_to for frame, owner in robot.frame_owners()}
    placed = {MODEL}
    try:
        for start in bases:
            placed.update(resolve_chain(
                start, lambda frame: None if frame in placed else bases[frame]))
    except CycleError as err:
        raise DescriptionError(f'placement cycle: {cycle_text(err)}',
                               registry.elements.get(err.args[1][0])) from err


def with_placement_frames(robot: Robot, scopes: Sequence[Scope], registry: FrameRegistry
                          ) -> Robot:
    """Place the nested models whose pose is that of a frame in them, innermost first."""
    for scope in reversed(scopes[1:]):
        if not scope.file.placement_frame:
            continue
        inverse = _placement_frame(robot, scope, registry).inverse()
        robot = replace(robot, frames=tuple(
            replace(frame, placement=Placement(
                (frame.placement.pose.transform() @ inverse).pose(), frame.placement.relative_to))
            if frame.name == scope.frame.name else frame for frame in robot.frames))
    return robot


def _placement_frame(robot: Robot, scope: Scope, registry: FrameRegistry) -> Transform:
    """Return the pose of the ``placement_frame`` in the model frame."""
    name = scope.file.placement_frame
    if not name:
        return IDENTITY
    frame = registry.lookup(scope, name, scope.element, 'placement_frame')
    return Kinematics(robot).between(scope.frame, frame).transform()


def pose_in_world(robot: Robot, top: Scope, registry: FrameRegistry) -> Pose:
    """Return the pose of the robot in the world; zero if relative to an object outside of it."""
    pose = top.file.pose_holder.element.find('pose')
    placed = _placement_frame(robot, top, registry)
    if pose is not None and pose.get('relative_to'):
        return Pose()
    written = pose_of(pose)
    return written if placed == IDENTITY else (written.transform() @ placed.inverse()).pose()


def with_world(robot: Robot, pose_in_world: Pose) -> Robot:
    """Place the world relative to the robot, if a joint needs it."""
    *links, last = robot.links
    if last.name != WORLD or pose_in_world.is_identity:
        return robot
    placement = Placement(pose_in_world.transform().inverse().pose(), MODEL)
    return replace(robot, links=(*links, replace(last, placement=placement)))
