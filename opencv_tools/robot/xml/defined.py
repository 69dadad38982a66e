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


def read_table(path: Path) -> Table:
    """Read ``elements.txt`` of a format."""
    lines = (line.partition(':') for line in path.read_text(encoding='utf-8').splitlines()
             if not line.startswith('#'))
    return {tag: frozenset(names.split()) for tag, _, names in lines}


def report_undefined(roots: Iterable[Element], table: Table, language: str, report: Report
                     ) -> None:
    """Warn of what a format does not define in some elements. Names with prefixes are others'."""
    pending = [(root, root.get('name', '')) for root in roots]
    while pending:
        element, name = pending.pop()
        names = table.get(str(element.tag), {'*'})
        if '*' in names:
            continue
        found = [*((f'@{key}', element) for key in map(str, element.attrib)),
                 *((str(child.tag), child) for child in element)]
        for key, place in found:
            if key not in (*names, *_UNCHECKED) and '{' not in key:
                report.warn(key, name, line_of(place), f'is not defined in <{element.tag!s}> by '
                            f'{language} and has no effect; kept for the conversion back')
        pending.extend((child, child.get('name') or name) for child in element
                       if child.tag in names and child.tag not in _UNCHECKED)
