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

"""What the model of a robot does not represent of SDF models and of their includes."""

from __future__ import annotations

from lxml import etree
from opencv_tools.robot.model import Extension
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.context import ReadContext
from opencv_tools.robot.sdf.values import flag, pose_element
from opencv_tools.robot.xml.document import detached, Element, line_of, local_name
from opencv_tools.robot.xml.passthrough import extract_foreign

# Children of an <include> that are converted.
_INCLUDE = ('uri', 'name', 'pose', 'placement_frame')
# Children of an <include> that replace those of the model.
_OVERRIDES = ('pose', 'static')


def report_nested(context: ReadContext) -> None:
    """Report the elements that a nested model loses by becoming a part of the robot."""
    file = context.scope.file
    preserved = extract_foreign(file.element, 'urdf')
    for holder in (file.element, *file.includes):
        holder.take_all(*_INCLUDE)
    for lost in (context.unread(file.element), preserved, *map(context.unread, file.includes)):
        for child in () if lost is None else lost:
            # <static>false</static> is the default.
            if child.tag != 'static' or flag(child.text, child):
                context.report.warn(local_name(child), file.name, line_of(child),
                                    'omitted: it belongs to a nested model')


def model_extension(context: ReadContext, pose_in_world: Pose) -> Extension:
    """Return the unread parts of the model, with the overrides of its includes."""
    file = context.scope.file
    urdf, unread = extract_foreign(file.element, 'urdf'), context.unread(file.element)
    if unread is None:
        unread = etree.Element('model')
    for include in reversed(file.includes):
        for child in include.element.iterchildren('*'):
            tag = local_name(child)
            if tag in _OVERRIDES:
                _remove(unread, tag)
            if tag in (*_OVERRIDES, 'plugin'):
                unread.append(detached(child))
            elif tag not in _INCLUDE:
                context.report.warn(tag, file.name, line_of(child), 'omitted from the <include>')
    _resolve_model_pose(unread, context, pose_in_world)
    return Extension(urdf=urdf, sdf=unread if len(unread) or unread.attrib else None)


def _resolve_model_pose(unread: Element, context: ReadContext, pose_in_world: Pose) -> None:
    """Write the pose of the model without names, which may be different in the output."""
    file = context.scope.file
    for pose in unread.findall('pose'):
        if name := pose.get('relative_to'):
            context.report.warn('pose', file.name, line_of(file.pose_holder),
                                f'omitted: it is relative to {name!r}, outside the model')
            unread.remove(pose)
    if frame := file.placement_frame:
        _remove(unread, 'pose')
        pose_element(unread, pose_in_world)
        context.report.preserve('pose', file.name, line_of(file.element),
                                f'placed {frame!r}; converted to the pose of the model frame')


def _remove(element: Element, tag: str) -> None:
    for child in element.findall(tag):
        element.remove(child)
