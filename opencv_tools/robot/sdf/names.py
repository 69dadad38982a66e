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

"""Names in an SDF: what each means where it stands, and the link that it moves with."""

from __future__ import annotations

from collections.abc import Sequence

from opencv_tools.robot.model import FrameId, WORLD
from opencv_tools.robot.sdf.scopes import Scope
from opencv_tools.robot.sdf.values import CAPSULE, flag, FRAMES, MODEL_FRAME, SEPARATOR, text_of
from opencv_tools.robot.xml.document import AnyElement, DescriptionError, local_name, required_name
from opencv_tools.robot.xml.passthrough import URDF_NAMESPACE
from opencv_tools.robot.xml.tracked import TrackedElement

# Joints and frames that SDF has no word for are written in the namespace of URDF.
JOINTS = ('joint', f'{{{URDF_NAMESPACE}}}joint')
FRAME_TAGS = ('frame', f'{{{URDF_NAMESPACE}}}frame')
# Of things with one name, which SDF before 1.7 allows, poses mean the first of these.
_KINDS = ('link', 'joint', 'frame')
_NESTED_NAMES = CAPSULE  # from this version on '::' is what reaches into a model


class FrameRegistry:
    """All frames of a robot by their names, with the elements that declare them."""

    def __init__(self, scopes: Sequence[Scope]) -> None:
        """
        Collect the names.

        :raises DescriptionError: a name is there twice, or is none that may be given.
        """
        self.elements: dict[FrameId, TrackedElement] = {}
        self._scopes: dict[FrameId, Scope] = {}  # by the frame of each model
        self._homes: dict[FrameId, Scope] = {}  # the model that each frame is declared in
        self._frames: dict[str, FrameId] = {}
        self._links: dict[FrameId, str] = {}
        for scope in scopes:
            for tags, kind in ((('link',), 'link'), (JOINTS, 'joint'), (FRAME_TAGS, 'frame')):
                for element in scope.element.take_all(*tags):
                    name = scope.qualified(_allowed(element, scope))
                    self._declare(name, FrameId(kind, name), element, scope)
        for scope in scopes:
            self._scopes[scope.frame] = scope
            if scope.parent is not None:
                name = scope.frame.name if scope.is_merged else scope.prefix[:-len(SEPARATOR)]
                self._declare(name, scope.frame, scope.element, scope.parent)
                self._frames[scope.frame.name] = scope.frame

    def lookup(self, scope: Scope, name: str, element: AnyElement, what: str) -> FrameId:
        """
        Give the frame that a name means in a model.

        :param what: the attribute or tag that has the name, for messages.
        :raises DescriptionError: there is no such frame.
        """
        if name == MODEL_FRAME:
            return scope.frame
        try:
            return self._frames[scope.qualified(name)]
        except KeyError:
            raise DescriptionError(f'{what} {name!r} is no link, joint, frame or model in model '
                                   f'{scope.part.name!r}', element) from None

    def link_of(self, frame: FrameId) -> str:
        """
        Name the link that a frame moves with.

        :raises DescriptionError: it is attached to itself, by way of others.
        """
        chain: list[FrameId] = []
        while frame.kind != 'link' and frame not in self._links:
            if frame in chain[:1] or len(chain) > len(self.elements):
                raise DescriptionError(f'{frame.name!r} is attached to itself, by way of others',
                                       self.elements.get(frame))
            chain.append(frame)
            frame = self._attached(frame)
        link = frame.name if frame.kind == 'link' else self._links[frame]
        self._links.update(dict.fromkeys(chain, link))
        return link

    def child_frame(self, element: TrackedElement, scope: Scope) -> FrameId:
        """
        Give the frame that is the child of a joint.

        :param element: the joint.
        """
        name = _end(element, 'child')
        if name == WORLD:
            raise DescriptionError('has the world as its child; make the world its parent',
                                   element)
        return self.lookup(scope, name, element, '<child>')

    def parent_frame(self, element: TrackedElement, scope: Scope) -> FrameId:
        """
        Give the frame that is the parent of a joint; the link `WORLD` for the world.

        :param element: the joint.
        """
        name = _end(element, 'parent')
        if name == WORLD:
            return FrameId('link', WORLD)
        return self.lookup(scope, name, element, '<parent>')

    def canonical_link(self, scope: Scope) -> FrameId:
        """Give the frame of the link, or of the model inside, that a model moves with."""
        name = scope.element.get('canonical_link', '')
        if name:
            frame = self.lookup(scope, name, scope.element, 'canonical_link')
            if frame.kind != 'link':
                raise DescriptionError(f'canonical_link={name!r} is no link', scope.element)
            return frame
        first = self._first(scope)
        static = scope.element.element.find('static')
        if first is None and scope.parent and static is not None and flag(static.text, static):
            return scope.parent.frame  # it does not move, so it needs no links
        if first is None:
            raise DescriptionError(f'model {scope.part.name!r} has no links', scope.element)
        return first

    def _first(self, scope: Scope) -> FrameId | None:
        """Give the first link of a model, or else the first model inside it."""
        inner = iter(scope.inner)
        nested = None
        for child in scope.element.take_all('link', 'model', 'include'):
            if local_name(child) == 'link':
                return FrameId('link', scope.qualified(required_name(child)))
            other = next(inner)
            first = self._first(other) if other.is_merged else other.frame
            if first is not None and first.kind == 'link':
                return first
            nested = nested or first
        return nested

    def _attached(self, frame: FrameId) -> FrameId:
        if frame in self._scopes:
            return self.canonical_link(self._scopes[frame])
        element, scope = self.elements[frame], self._homes[frame]
        if frame.kind == 'joint':
            return self.child_frame(element, scope)
        name = element.get('attached_to') or MODEL_FRAME
        return self.lookup(scope, name, element, 'attached_to')

    def _declare(self, name: str, frame: FrameId, element: TrackedElement, scope: Scope) -> None:
        other = self._frames.get(name)
        if frame in self.elements or (other and scope.version >= FRAMES):
            before = self.elements[frame if frame in self.elements else other or frame]
            raise DescriptionError(
                f'{name!r} is the name of <{local_name(before)}> in line {before.sourceline} '
                'already; give each its own', element)
        self.elements[frame] = element
        self._homes[frame] = scope
        if other is None or _KINDS.index(frame.kind) < _KINDS.index(other.kind):
            self._frames[name] = frame


def _allowed(element: TrackedElement, scope: Scope) -> str:
    name = required_name(element)
    is_reserved = len(name) > 3 and name.startswith('__') and name.endswith('__')
    if name == WORLD or (is_reserved and scope.version >= FRAMES):
        raise DescriptionError(f'{name!r} is reserved; give it another name', element)
    if scope.version >= _NESTED_NAMES and SEPARATOR in name:
        raise DescriptionError(f'{name!r} has {SEPARATOR!r} in it, which reaches into a model; '
                               'give it another name', element)
    return name


def _end(joint: TrackedElement, tag: str) -> str:
    name = text_of(joint, tag)
    if not name:
        raise DescriptionError(f'has no <{tag}>', joint)
    return name
