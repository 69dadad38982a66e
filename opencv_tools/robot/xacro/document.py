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

"""Documents that xacro expands, with the file and line of each element."""

from __future__ import annotations

from typing import Any
from xml.dom import expatbuilder, minidom

_LOCATION = 'location'  # key of the location among the data of an element
# Like xml.sax.saxutils, which takes long to import.
_TEXT_ESCAPES = str.maketrans({'&': '&amp;', '<': '&lt;', '>': '&gt;'})
_ATTRIBUTE_ESCAPES = _TEXT_ESCAPES | str.maketrans(
    {'"': '&quot;', '\n': '&#10;', '\r': '&#13;', '\t': '&#9;'})

Location = tuple[str, int]


def location_of(element: minidom.Element) -> Location:
    """Return the file and line of an element."""
    location: Location = element.getUserData(_LOCATION) or ('', 0)
    return location


class LocatedBuilder(expatbuilder.ExpatBuilderNS):
    """Parser that creates the elements that xacro needs, with their locations."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self._source = source

    def start_element_handler(self, name: str, attributes: list[str]) -> None:
        super().start_element_handler(name, attributes)
        line = self.getParser().CurrentLineNumber
        self.curNode.setUserData(_LOCATION, (self._source, line), _CopyLocation())


class _CopyLocation:
    """Handler that copies the location when a macro copies an element."""

    def handle(self, _: int, key: str, location: Location, source: object, copy: Any) -> None:
        copy.setUserData(key, location, self)


def to_text(document: minidom.Document, source: str) -> str:
    """
    Return the text of a document without comments. Elements of a file keep their lines.

    Elements of macros and of other files are on the line of the element before them, so that
    messages about them lead to the macro call or the include.

    :param source: the file whose elements keep their lines.
    """
    parts: list[str] = []
    line = 1
    pending: list[minidom.Node | str | None] = [document.documentElement]
    while pending:
        node = pending.pop()
        if isinstance(node, str):
            parts.append(node)
        elif isinstance(node, minidom.Text):
            if node.data.strip():
                parts.append(node.data.translate(_TEXT_ESCAPES))
                line += node.data.count('\n')
        elif isinstance(node, minidom.Element):
            node_source, node_line = location_of(node)
            if node_source == source and node_line > line:
                parts.append('\n' * (node_line - line))
                line = node_line
            attributes = ''.join(f' {name}="{value.translate(_ATTRIBUTE_ESCAPES)}"'
                                 for name, value in node.attributes.items())
            parts.append(f'<{node.tagName}{attributes}>')
            pending.append(f'</{node.tagName}>')
            pending.extend(reversed(node.childNodes))
    return ''.join(parts)
