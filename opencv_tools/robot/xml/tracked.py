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

"""Elements of XML that remember what a reader took of them, so that the rest can be carried."""

from __future__ import annotations

from copy import deepcopy
from typing import overload

from lxml import etree

_Element = etree._Element

# Marks what is left of an element that was read, apart from elements that were not read at all.
PARTLY_READ = '{urn:opencv_tools:preserved}part'
TEXT_READ = 'text'  # its value where the text was read


class TrackedElement:
    """
    An element as a reader sees it, who takes what it understands by asking for it.

    The element itself is never changed. Of several children with one tag the first is read, unless
    all are asked for.
    """

    __slots__ = ('_is_whole', '_names', '_parts', 'element')

    def __init__(self, element: _Element) -> None:
        """
        Begin with nothing taken.

        :param element: the element, to name in messages.
        """
        self.element = element
        self._names: set[str] = set()  # of attributes that were taken; '' for the text
        self._parts: dict[_Element, TrackedElement] = {}
        self._is_whole = True  # whether its rest is its own, not its parent's

    @property
    def tag(self) -> str:
        """Tag of the element."""
        return str(self.element.tag)

    @property
    def sourceline(self) -> int | None:
        """Line that the element begins at; None when it comes from no file."""
        return self.element.sourceline

    def getroottree(self) -> etree._ElementTree:
        """Return the document that the element is in."""
        return self.element.getroottree()

    @property
    def text(self) -> str | None:
        """Text of the element, which is taken."""
        self._names.add('')
        return self.element.text

    def __contains__(self, name: str) -> bool:
        """Return whether there is an attribute."""
        return name in self.element.attrib

    @overload
    def get(self, name: str) -> str | None: ...
    @overload
    def get(self, name: str, default: str) -> str: ...

    def get(self, name: str, default: str | None = None) -> str | None:
        """Take an attribute."""
        value = self.element.get(name)
        if value is None:
            return default
        self._names.add(name)
        return value

    def find(self, tag: str) -> TrackedElement | None:
        """Return the first child with a tag, to take parts of it; its rest stays in this one's."""
        child = next(self.element.iterchildren(tag), None)
        return None if child is None else self._part(child)

    def findtext(self, tag: str) -> str | None:
        """Take the text of the first child with a tag."""
        child = self.find(tag)
        return None if child is None else child.text or ''

    def take_first(self, tag: str) -> TrackedElement | None:
        """Take the first child with a tag whole; it has a rest of its own."""
        child = next(self.element.iterchildren(tag), None)
        return None if child is None else self._part(child, whole=True)

    def take_all(self, *tags: str) -> list[TrackedElement]:
        """Take all children with one of some tags; each has a rest of its own."""
        return [self._part(child, whole=True) for child in self.element.iterchildren(*tags)]

    def put_back(self, child: TrackedElement) -> None:
        """Return a child to the rest, with all that was taken of it."""
        self._parts.pop(child.element, None)

    def unread(self) -> _Element | None:
        """
        Return a copy of the element with what was not taken; None where nothing is left.

        Children that were read in part have the attribute ``PARTLY_READ``.
        """
        parts, element, names = [], self.element, self._names
        for child in element:
            part = self._parts.get(child)
            if part is None:
                parts.append(detached(child))
            elif not part._is_whole and (left := part.unread()) is not None:
                parts.append(left)
        untaken = [str(name) for name in element.attrib
                   if name not in names and name != PARTLY_READ]
        text = '' if '' in names else (element.text or '').strip()
        rest = None
        if parts or untaken or text:
            attributes = {name: element.get(name, '') for name in untaken}
            if not self._is_whole and (PARTLY_READ in element.attrib or self._is_taken()):
                attributes[PARTLY_READ] = (
                    TEXT_READ if '' in names else element.get(PARTLY_READ, 'true'))
            rest = etree.Element(element.tag, attributes, nsmap=element.nsmap)
            # Messages about it name the file.
            rest.getroottree().docinfo.URL = element.getroottree().docinfo.URL
            rest.text = text or None
            rest.extend(parts)
        if self._is_whole:  # nothing more is read of its other parts, and a robot has many
            self._parts = {child: part for child, part in self._parts.items() if part._is_whole}
        return rest

    def _part(self, child: _Element, *, whole: bool = False) -> TrackedElement:
        part = self._parts.get(child)
        if part is None:
            part = self._parts[child] = TrackedElement(child)
            part._is_whole = False
        if whole:
            part._is_whole = True
        return part

    def _is_taken(self) -> bool:
        """Return whether anything of the element was taken."""
        return bool(self._names) or any(
            part._is_whole or part._is_taken() for part in self._parts.values())


def detached(element: _Element) -> _Element:
    """Copy an element without the text that follows it."""
    copy = deepcopy(element)
    copy.tail = None
    return copy
