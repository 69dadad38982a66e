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

"""Elements of XML that record which of their parts a reader has consumed."""

from __future__ import annotations

from copy import deepcopy
from typing import overload

from lxml import etree

_Element = etree._Element

# Marks an unread element that the reader found. Its value is TEXT_READ if the text was read.
PARTLY_READ = '{urn:opencv_tools:preserved}part'
TEXT_READ = 'text'


class TrackedElement:
    """
    An element that records which attributes, texts and children a reader consumed.

    Reading an attribute or a text consumes it. A child from `find` keeps its unread parts in this
    element; a child from `take_first` or `take_all` has its own. The XML is never changed.
    """

    __slots__ = ('_children', '_is_taken', '_names', 'element')

    def __init__(self, element: _Element) -> None:
        self.element = element  # reading from it consumes nothing
        self._names: set[str] = set()  # consumed attributes; '' is the text
        self._children: dict[_Element, TrackedElement] = {}
        self._is_taken = True  # whether its unread parts are its own, not its parent's

    @property
    def tag(self) -> str:
        """Tag of the element."""
        return str(self.element.tag)

    @property
    def sourceline(self) -> int | None:
        """Line where the element begins; None if it does not come from a file."""
        return self.element.sourceline

    def getroottree(self) -> etree._ElementTree:
        """Return the document of the element."""
        return self.element.getroottree()

    @property
    def text(self) -> str | None:
        """Text of the element; reading consumes it."""
        self._names.add('')
        return self.element.text

    def __contains__(self, name: str) -> bool:
        # This does not consume the attribute.
        return name in self.element.attrib

    @overload
    def get(self, name: str) -> str | None: ...
    @overload
    def get(self, name: str, default: str) -> str: ...

    def get(self, name: str, default: str | None = None) -> str | None:
        """Return an attribute and consume it."""
        value = self.element.get(name)
        if value is None:
            return default
        self._names.add(name)
        return value

    def find(self, tag: str) -> TrackedElement | None:
        """Return the first child with a tag; its unread parts stay those of this element."""
        child = next(self.element.iterchildren(tag), None)
        return None if child is None else self._child(child)

    def findtext(self, tag: str) -> str | None:
        """Return the text of the first child with a tag, and consume it."""
        child = self.find(tag)
        return None if child is None else child.text or ''

    def take_first(self, tag: str) -> TrackedElement | None:
        """Return the first child with a tag and consume it; its unread parts are its own."""
        child = next(self.element.iterchildren(tag), None)
        return None if child is None else self._child(child, take=True)

    def take_all(self, *tags: str) -> list[TrackedElement]:
        """Return the children with certain tags and consume them; unread parts are their own."""
        return [self._child(child, take=True) for child in self.element.iterchildren(*tags)]

    def put_back(self, child: TrackedElement) -> None:
        """Mark a child as not consumed."""
        self._children.pop(child.element, None)

    def unread(self) -> _Element | None:
        """
        Return a copy of the element with its unread parts only; None if everything was read.

        Children from `find` have the attribute ``PARTLY_READ``, even if nothing of them was read:
        the reader has an object for them, so the writer writes them again.
        """
        element, names = self.element, self._names
        children = []
        for child in element:
            tracked = self._children.get(child)
            if tracked is None:
                children.append(detached(child))
            elif not tracked._is_taken and (unread := tracked.unread()) is not None:
                children.append(unread)
        attributes = {str(name): str(value) for name, value in element.attrib.items()
                      if name not in names and name != PARTLY_READ}
        text = '' if '' in names else (element.text or '').strip()
        if self._is_taken:  # only taken children are read again; a robot has many children
            self._children = {child: tracked for child, tracked in self._children.items()
                              if tracked._is_taken}
        if not (children or attributes or text):
            return None
        if not self._is_taken:
            attributes[PARTLY_READ] = (
                TEXT_READ if '' in names else element.get(PARTLY_READ, 'true'))
        copy = etree.Element(element.tag, attributes, nsmap=element.nsmap)
        copy.getroottree().docinfo.URL = element.getroottree().docinfo.URL  # for messages
        copy.text = text or None
        copy.extend(children)
        return copy

    def _child(self, child: _Element, *, take: bool = False) -> TrackedElement:
        tracked = self._children.get(child)
        if tracked is None:
            tracked = self._children[child] = TrackedElement(child)
            tracked._is_taken = False
        tracked._is_taken |= take
        return tracked


def detached(element: _Element) -> _Element:
    """Return a copy of an element without the text that follows it."""
    copy = deepcopy(element)
    copy.tail = None
    return copy
