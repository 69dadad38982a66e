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

"""Documents as xacro works on them, with the place in a file that each element comes from."""

from __future__ import annotations

from typing import Any
from xml.dom import expatbuilder, minidom

_PLACE = 'place'  # under which an element keeps file and line
# As xml.sax.saxutils has them, which takes longer to import than all else here.
_IN_TEXT = str.maketrans({'&': '&amp;', '<': '&lt;', '>': '&gt;'})
_IN_ATTRIBUTE = _IN_TEXT | str.maketrans(
    {'"': '&quot;', '\n': '&#10;', '\r': '&#13;', '\t': '&#9;'})

Place = tuple[str, int]


def place_of(element: minidom.Element) -> Place:
    """Give file and line of an element."""
    place: Place = element.getUserData(_PLACE) or ('', 0)
    return place


class PlacedBuilder(expatbuilder.ExpatBuilderNS):
    """Parses into the elements that xacro works on, with the place of each."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self._source = source

    def start_element_handler(self, name: str, attributes: list[str]) -> None:
        super().start_element_handler(name, attributes)
        line = self.getParser().CurrentLineNumber
        self.curNode.setUserData(_PLACE, (self._source, line), _KeepPlace())


class _KeepPlace:
    """Gives copies of an element, as macros make them, the place of the original."""

    def handle(self, _: int, key: str, place: Place, source: object, copy: Any) -> None:
        copy.setUserData(key, place, self)


def text_of(document: minidom.Document, source: str) -> str:
    """
    Write a document, each element of a file in the line that it has there.

    What macros and other files put in between is in the line of what is before it, so that
    messages about it lead to where it is asked for. Comments are left out.
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
                parts.append(node.data.translate(_IN_TEXT))
                line += node.data.count('\n')
        elif isinstance(node, minidom.Element):
            file, wanted = place_of(node)
            if file == source and wanted > line:
                parts.append('\n' * (wanted - line))
                line = wanted
            attributes = ''.join(f' {name}="{value.translate(_IN_ATTRIBUTE)}"'
                                 for name, value in node.attributes.items())
            parts.append(f'<{node.tagName}{attributes}>')
            pending.append(f'</{node.tagName}>')
            pending.extend(reversed(node.childNodes))
    return ''.join(parts)
