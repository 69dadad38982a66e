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

"""Elements and attributes that a format does not define at their place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from opencv_tools.robot.xml.document import Element, line_of
from opencv_tools.robot.xml.report import Report

Table = Mapping[str, frozenset[str]]  # by the tag of the element around them
_UNCHECKED = ('plugin', 'model')  # the model in a model is checked by itself


def read_lines(path: Path) -> dict[str, list[str]]:
    """Read a table of facts: the words of each line by what is before its colon."""
    lines = (line.partition(':') for line in path.read_text(encoding='utf-8').splitlines()
             if not line.startswith('#'))
    return {key: words.split() for key, _, words in lines}


def read_table(path: Path) -> Table:
    """Read ``elements.txt`` of a format."""
    return {tag: frozenset(names) for tag, names in read_lines(path).items() if '*' not in names}


def report_undefined(unread: Iterable[tuple[Element, str]], table: Table, language: str,
                     report: Report) -> None:
    """
    Warn of what a format does not define in some elements. Names with prefixes are others'.

    :param unread: unread elements, because readers read what is defined only, and their names.
    """
    pending = [*unread]
    while pending:
        element, name = pending.pop()
        names = table.get(str(element.tag))
        if names is None:
            continue
        unknown = [(f'@{key}', element) for key in element.attrib if f'@{key}' not in names]
        for child in element:
            tag = str(child.tag)
            if tag not in names:
                unknown.append((tag, child))
            elif tag not in _UNCHECKED:
                pending.append((child, child.get('name') or name))
        for key, place in unknown:
            if key not in _UNCHECKED and '{' not in key:
                report.warn(key, name, line_of(place), f'is not defined in <{element.tag!s}> by '
                            f'{language} and has no effect')
