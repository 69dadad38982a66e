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

"""The model that elements of SDF are read from, and the meaning of names in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import os
from pathlib import Path

from opencv_tools.robot.model import Extension, FrameId, MODEL, Placement
from opencv_tools.robot.sdf.includes import first_file, ModelLoader
from opencv_tools.robot.sdf.names import FrameRegistry, JOINTS
from opencv_tools.robot.sdf.scopes import collect_scopes, Scope
from opencv_tools.robot.sdf.values import flag, FRAMES, MODEL_FRAME, pose_of, poses_in, SEPARATOR
from opencv_tools.robot.xml.document import (
    DescriptionError, Element, line_of, source_of, TrackedElement)
from opencv_tools.robot.xml.passthrough import extract_foreign
from opencv_tools.robot.xml.report import Report


@dataclass(frozen=True)
class SdfContext:
    """
    A model, and the names that it may refer to.

    :param folder: folder of the first file, to which relative mesh paths are converted.
    """

    scope: Scope
    registry: FrameRegistry
    report: Report
    folder: str

    def joint_elements(self) -> list[TrackedElement]:
        """Return the joints of the model, also those that the SDF writer preserved."""
        return self.scope.element.take_all(*JOINTS)

    def placement(self, holder: TrackedElement, default: FrameId) -> Placement:
        """
        Read the ``<pose>`` of an element.

        :param default: the frame of a pose without ``relative_to``.
        """
        pose = holder.find('pose')
        if pose is None:
            return Placement(pose_of(None), default)
        name, old_name = pose.get('relative_to', ''), pose.get('frame')
        if old_name is not None and self.scope.file.version >= FRAMES:
            self.report.warn('pose', holder.element.get('name', ''), line_of(pose),
                             'frame= is ignored since SDF 1.7; use relative_to=')
        elif old_name is not None:
            name = old_name
        frame = self.registry.lookup(self.scope, name, pose, 'relative_to') if name else default
        return Placement(pose_of(pose), frame)

    def extension(self, element: TrackedElement) -> Extension:
        """Return the unread parts of an element."""
        return Extension(urdf=extract_foreign(element, 'urdf'), sdf=self.unread(element))

    def unread(self, element: TrackedElement) -> Element | None:
        """Return the unread SDF of an element, in terms of SDF 1.7 and later."""
        unread = element.unread()
        if unread is None:
            return None
        is_old = self.scope.file.version < FRAMES
        for axis in unread.iterchildren('axis', 'axis2') if element.tag in JOINTS else ():
            if is_old:
                _to_expressed_in(axis)
            xyz = axis.find('xyz')
            if xyz is not None and (name := xyz.get('expressed_in')):
                # Renaming does not change it, so it gets the name in the flat robot here.
                xyz.set('expressed_in', self._name_in_robot(name).replace(SEPARATOR, '__'))
        for pose in poses_in(unread):
            if is_old and 'frame' in pose.attrib:
                pose.set('relative_to', pose.attrib.pop('frame'))
            if name := pose.get('relative_to'):
                pose.set('relative_to', self._name_in_robot(name))
        return unread

    def resolved_uri(self, uri: str) -> str:
        """Return a relative path of an included file relative to the first file."""
        files = self.scope.file.files
        if not uri or '://' in uri or len(files) == 1 or Path(uri).is_absolute():
            return uri
        return os.path.relpath(files[-1].parent / uri, self.folder)

    def _name_in_robot(self, name: str) -> str:
        if self.scope.frame == MODEL:
            return name
        return self.scope.frame.name if name == MODEL_FRAME else self.scope.qualified(name)


def model_contexts(root: Element, report: Report, model: str, search: Sequence[str]
                   ) -> list[SdfContext]:
    """
    Return the contexts of the model to read and of all models nested in it, outermost first.

    :param model: name of the model; empty if the file has only one.
    :param search: folders with included models.
    :raises DescriptionError: the model cannot be chosen, a name in it is not valid, or it has no
        links.
    """
    # Nested models and includes are collected first: each is a scope of names.
    scopes = collect_scopes(root, ModelLoader(search, report), model, report)
    top = scopes[0]
    if not any(scope.element.take_all('link') for scope in scopes):
        raise DescriptionError(f'model {top.file.name!r} has no links', top.element)
    # All names are registered before elements are read, because they may refer to later elements.
    registry = FrameRegistry(scopes)
    folder = str(first_file(source_of(root)).parent)
    return [SdfContext(scope, registry, report, folder) for scope in scopes]


def _to_expressed_in(axis: Element) -> None:
    """Replace ``use_parent_model_frame`` of older versions by ``expressed_in``."""
    xyz, old = axis.find('xyz'), axis.find('use_parent_model_frame')
    if old is not None:
        if xyz is not None and flag(old.text, old):
            xyz.set('expressed_in', MODEL_FRAME)
        axis.remove(old)
