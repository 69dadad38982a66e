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

"""Where in a file of xacro something is wrong, and what, as one sentence."""

from __future__ import annotations

from collections.abc import Iterator
import re
from types import TracebackType

from opencv_tools.robot.xacro.document import place_of
from opencv_tools.robot.xml.document import DescriptionError

# What $(find package) stands for until it is known what the path is used for: an absolute path
# with characters of Unicode's private area, which no file has.
PACKAGE_MARKER = re.compile('/\ue000([^\ue000\ue001]*)\ue001')
TOO_LARGE = ('takes more memory to expand than any robot; look for a property or an expression '
             'that grows without end')
_LONGEST = 400  # characters of a message


class XacroProblem(Exception):
    """What is wrong with a file, yet without its place."""


def sentence(err: Exception, source: str) -> DescriptionError:
    """Say in a sentence what went wrong, and where."""
    causes = list(_causes(err))
    known = next((cause for cause in causes if isinstance(cause, DescriptionError)), None)
    place, line, tag = _place(err.__traceback__) or (source, 0, '')
    if known is not None and not any(isinstance(cause, OSError) for cause in causes):
        return known
    trouble = next((cause for cause in causes if isinstance(cause, XacroProblem)), None)
    argument = next((cause for cause in causes if type(cause).__name__ == 'ArgException'), None)
    if any(isinstance(cause, RecursionError) for cause in causes):
        message = 'a macro calls itself without end'
    elif any(isinstance(cause, MemoryError) for cause in causes):
        message = TOO_LARGE
    elif argument is not None:
        message = (f'argument {str(argument)!r} has no value; give it one by '
                   f'--arg {argument}:=VALUE')
    elif trouble is not None:
        message = str(trouble)
    else:
        message = str(err).strip() or f'cannot be expanded: {type(causes[-1]).__name__}'
    return DescriptionError(one_line(message), source=place, line=line, tag=tag)


def one_line(message: str) -> str:
    """Give a message of xacro as one line, with packages as the file names them."""
    message = PACKAGE_MARKER.sub(r'$(find \1)', ' '.join(message.split()))
    message = message.replace(' (<expression>, line 1)', '')
    return message if len(message) <= _LONGEST else f'{message[:_LONGEST]} ...'


def _causes(err: BaseException | None) -> Iterator[BaseException]:
    """Give an error and those that led to it; xacro keeps some as attributes."""
    pending, seen = [err], set()
    while pending:
        one = pending.pop(0)
        if isinstance(one, BaseException) and id(one) not in seen:
            seen.add(id(one))
            yield one
            pending += [getattr(one, 'exc', None), one.__cause__, one.__context__]


def os_error(err: BaseException) -> BaseException | None:
    return next((cause for cause in _causes(err) if isinstance(cause, OSError)), None)


def _place(traceback: TracebackType | None) -> tuple[str, int, str] | None:
    """Give file, line and tag of the element that xacro was at, which it keeps to itself."""
    found = None
    while traceback is not None:
        if traceback.tb_frame.f_code.co_name == 'eval_all':
            node = traceback.tb_frame.f_locals.get('node')
            while node is not None and node.nodeType != node.ELEMENT_NODE:
                node = node.parentNode
            if node is not None and place_of(node)[0]:
                found = (*place_of(node), node.tagName)
        traceback = traceback.tb_next
    return found
