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

"""Locations in xacro: those of elements, and those in its errors of one line."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import re
from types import TracebackType
from typing import Any, TypeVar
from xml.dom import expatbuilder, minidom

from opencv_tools.robot.xml.document import DescriptionError

_LOCATION = 'location'  # key of the location among the data of an element
# Like xml.sax.saxutils, which takes long to import.
_TEXT_ESCAPES = str.maketrans({'&': '&amp;', '<': '&lt;', '>': '&gt;'})
_ATTRIBUTE_ESCAPES = _TEXT_ESCAPES | str.maketrans(
    {'"': '&quot;', '\n': '&#10;', '\r': '&#13;', '\t': '&#9;'})

Location = tuple[str, int]
# An expanded $(find package) until it is known how the path is used. It is an absolute path with
# characters of Unicode's private use area, which no file has.
PACKAGE_MARKER = re.compile('/\ue000([^\ue000\ue001]*)\ue001')
TOO_LARGE = ('needs more memory than the limit for a robot description; look for a property or an '
             'expression that grows without end')
_LONGEST = 400  # characters of a message
_Error = TypeVar('_Error', bound=BaseException)


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


class XacroProblem(Exception):
    """An error in a file, without its location."""


def to_description_error(err: Exception, source: str) -> DescriptionError:
    """Return an error of xacro as one line, with the location of the element that it expanded."""
    causes = list(_causes(err))
    known = _first(causes, DescriptionError)
    if known and not _first(causes, OSError):
        return known
    argument = next((cause for cause in causes if type(cause).__name__ == 'ArgException'), None)
    if _first(causes, RecursionError):
        message = 'infinite recursion: a macro calls itself'
    elif _first(causes, MemoryError):
        message = TOO_LARGE
    elif argument is not None:
        message = f'argument {str(argument)!r} has no value; set it with --arg {argument}:=VALUE'
    else:
        message = (str(_first(causes, XacroProblem) or err).strip()
                   or f'cannot be expanded: {type(causes[-1]).__name__}')
    file, line, tag = _location(err.__traceback__) or (source, 0, '')
    return DescriptionError(one_line(message), source=file, line=line, tag=tag)


def one_line(message: str) -> str:
    """Return a message of xacro as one line of limited length, with packages as in the file."""
    message = PACKAGE_MARKER.sub(r'$(find \1)', ' '.join(message.split()))
    message = message.replace(' (<expression>, line 1)', '')
    return message if len(message) <= _LONGEST else f'{message[:_LONGEST]} ...'


def os_error(err: BaseException) -> OSError | None:
    """Return the error of the operating system that led to an error, if there is one."""
    return _first(_causes(err), OSError)


def _first(causes: Iterable[BaseException], kind: type[_Error]) -> _Error | None:
    return next((cause for cause in causes if isinstance(cause, kind)), None)


def _causes(err: BaseException | None) -> Iterator[BaseException]:
    """Return an error and the errors that led to it, some of which xacro keeps as attributes."""
    pending, seen = [err], set()
    while pending:
        cause = pending.pop(0)
        if isinstance(cause, BaseException) and id(cause) not in seen:
            seen.add(id(cause))
            yield cause
            pending += [getattr(cause, 'exc', None), cause.__cause__, cause.__context__]


def _location(traceback: TracebackType | None) -> tuple[str, int, str] | None:
    """Return file, line and tag of the element that xacro expanded, from its local variables."""
    found = None
    while traceback is not None:
        if traceback.tb_frame.f_code.co_name == 'eval_all':
            node = traceback.tb_frame.f_locals.get('node')
            while node is not None and node.nodeType != node.ELEMENT_NODE:
                node = node.parentNode
            if node is not None and location_of(node)[0]:
                found = (*location_of(node), node.tagName)
        traceback = traceback.tb_next
    return found
