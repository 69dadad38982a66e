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

"""Errors of xacro as one line with the location of the element."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import re
from types import TracebackType
from typing import TypeVar

from opencv_tools.robot.xacro.document import location_of
from opencv_tools.robot.xml.document import DescriptionError

# An expanded $(find package) until it is known how the path is used. It is an absolute path with
# characters of Unicode's private use area, which no file has.
PACKAGE_MARKER = re.compile('/\ue000([^\ue000\ue001]*)\ue001')
TOO_LARGE = ('needs more memory than the limit for a robot description; look for a property or an '
             'expression that grows without end')
_LONGEST = 400  # characters of a message
_Error = TypeVar('_Error', bound=BaseException)


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
