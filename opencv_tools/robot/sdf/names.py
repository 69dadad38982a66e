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

"""Names in SDF: the frame that a name refers to, and the link that a frame moves with."""

from __future__ import annotations

from collections.abc import Sequence
from graphlib import CycleError

from opencv_tools.robot.kinematics import cycle_text, resolve_chain
from opencv_tools.robot.model import FrameId, WORLD
from opencv_tools.robot.sdf.scopes import Scope
from opencv_tools.robot.sdf.values import CAPSULE, flag, FRAMES, MODEL_FRAME, SEPARATOR, text_of
from opencv_tools.robot.xml.document import (
    AnyElement, DescriptionError, line_of, local_name, required_name, TrackedElement)
from opencv_tools.robot.xml.passthrough import URDF_TAG

# Joints and frames that are not supported by SDF are written in the namespace of URDF.
JOINTS = ('joint', f'{URDF_TAG}joint')
# Before SDF 1.7 a link, a joint and a frame may share a name; a pose refers to the first of them.
_KINDS = ('link', 'joint', 'frame')
_NESTED_NAMES = CAPSULE  # from this version on, '::' separates model names


class FrameRegistry:
    """All frames of a robot by name, with the elements that declare them."""

    def __init__(self, scopes: Sequence[Scope]) -> None:
        """
        Register the links, joints, frames and models of all scopes.

        :raises DescriptionError: a name is missing, reserved or not unique.
        """
        self.elements: dict[FrameId, TrackedElement] = {}
        self._models: dict[FrameId, Scope] = {}  # by model frame
        self._declared_in: dict[FrameId, Scope] = {}
        self._frames: dict[str, FrameId] = {}
        self._links: dict[FrameId, str] = {}  # results of link_of
        for scope in scopes:
            for tags, kind in ((('link',), 'link'), (JOINTS, 'joint'), (('frame',), 'frame')):
                for element in scope.element.take_all(*tags):
                    name = scope.qualified(_checked_name(element, scope))
                    self._declare(name, FrameId(kind, name), element, scope)
        for scope in scopes:
            self._models[scope.frame] = scope
            if scope.parent is not None:
                name = scope.frame.name if scope.is_merged else scope.prefix[:-len(SEPARATOR)]
                self._declare(name, scope.frame, scope.element, scope.parent)
                self._frames[scope.frame.name] = scope.frame

    def lookup(self, scope: Scope, name: str, element: AnyElement, label: str) -> FrameId:
        """
        Return the frame that a name refers to in a model.

        :param element: the element with the name.
        :param label: attribute or tag with the name, for messages.
        :raises DescriptionError: the model has no such frame.
        """
        if name == MODEL_FRAME:
            return scope.frame
        try:
            return self._frames[scope.qualified(name)]
        except KeyError:
            raise DescriptionError(f'{label} {name!r} is not a link, joint, frame or nested model '
                                   f'of model {scope.file.name!r}', element) from None

    def link_of(self, frame: FrameId) -> str:
        """
        Return the name of the link that a frame moves with.

        :raises DescriptionError: the frame is attached to itself.
        """
        def next_frame(name: FrameId) -> FrameId | None:
            return None if name.kind == 'link' or name in self._links else self.attached_to(name)

        try:
            chain = resolve_chain(frame, next_frame)
        except CycleError as err:
            raise DescriptionError(f'attachment cycle: {cycle_text(err)}',
                                   self.elements.get(err.args[1][0])) from err
        link = self._links.get(chain[-1], chain[-1].name)
        self._links.update(dict.fromkeys(chain, link))
        return link

    def joint_end(self, joint: TrackedElement, scope: Scope, tag: str) -> FrameId:
        """Return the frame of ``<parent>`` or ``<child>``; the link `WORLD` for the world."""
        name = text_of(joint, tag)
        if not name:
            raise DescriptionError(f'has no <{tag}>', joint)
        if name != WORLD:
            return self.lookup(scope, name, joint, f'<{tag}>')
        if tag == 'child':
            raise DescriptionError("<child> is 'world', which cannot move; make it the <parent>",
                                   joint)
        return FrameId('link', WORLD)

    def attached_to(self, frame: FrameId) -> FrameId:
        """Return the frame that a joint, a frame or a model moves with."""
        if frame in self._models:
            return self._canonical_frame(self._models[frame])
        element, scope = self.elements[frame], self._declared_in[frame]
        if frame.kind == 'joint':
            return self.joint_end(element, scope, 'child')
        name = element.get('attached_to') or MODEL_FRAME
        return self.lookup(scope, name, element, 'attached_to')

    def _canonical_frame(self, scope: Scope) -> FrameId:
        """Return the link, or the frame of a nested model, that a model moves with."""
        name = scope.element.get('canonical_link', '')
        if name:
            frame = self.lookup(scope, name, scope.element, 'canonical_link')
            if frame.kind != 'link':
                raise DescriptionError(f'canonical_link={name!r} is a {frame.kind}; name a link',
                                       scope.element)
            return frame
        first = self._first_frame(scope)
        if first is not None:
            return first
        static = scope.element.element.find('static')
        if scope.parent and static is not None and flag(static.text, static):
            return scope.parent.frame  # a static model does not need links
        raise DescriptionError(f'model {scope.file.name!r} has no links', scope.element)

    def _first_frame(self, scope: Scope) -> FrameId | None:
        """Return the first link of a model, or the frame of its first nested model."""
        nested_scopes = iter(scope.nested)
        nested = None
        for child in scope.element.take_all('link', 'model', 'include'):
            if local_name(child) == 'link':
                return FrameId('link', scope.qualified(required_name(child)))
            inner = next(nested_scopes)
            first = self._first_frame(inner) if inner.is_merged else inner.frame
            if first is not None and first.kind == 'link':
                return first
            nested = nested or first
        return nested

    def _declare(self, name: str, frame: FrameId, element: TrackedElement, scope: Scope) -> None:
        namesake = self._frames.get(name)
        if frame in self.elements or (namesake and scope.file.version >= FRAMES):
            first = self.elements[frame if frame in self.elements else namesake or frame]
            raise DescriptionError(
                f'{name!r} is already the name of <{local_name(first)}>'
                f'{f" in line {line_of(first)}" if line_of(first) else ""}; use unique names',
                element)
        self.elements[frame] = element
        self._declared_in[frame] = scope
        if namesake is None or _KINDS.index(frame.kind) < _KINDS.index(namesake.kind):
            self._frames[name] = frame


def _checked_name(element: TrackedElement, scope: Scope) -> str:
    name = required_name(element)
    is_reserved = len(name) > 3 and name.startswith('__') and name.endswith('__')
    if name == WORLD or (is_reserved and scope.file.version >= FRAMES):
        raise DescriptionError(f'{name!r} is reserved; use another name', element)
    if scope.file.version >= _NESTED_NAMES and SEPARATOR in name:
        raise DescriptionError(f'{name!r} contains {SEPARATOR!r}; use another name', element)
    return name
