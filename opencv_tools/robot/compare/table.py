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

"""Differences between two robots as a table for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from opencv_tools.robot.compare.compare import Difference

_HEADING = ('element', 'name', 'property', 'a', 'b', 'difference')


def table(found: Sequence[Difference], most: int | None = None) -> str:
    """
    Return a heading, one line for each difference, and the number of differences.

    :param most: greatest number of lines for differences; None for all.
    :returns: the lines, or an empty string if there are no differences.
    """
    if not found:
        return ''
    rows = [_HEADING, *(
        (row.element, row.name, row.property, row.a, row.b, f'{row.size:.3g}' if row.size else '')
        for row in found[:most])]
    widths = [max(map(len, column)) for column in zip(*rows)]
    lines = ['  '.join(map(str.ljust, row, widths)).rstrip() for row in rows]
    if len(found) >= len(rows):
        lines.append(f'... and {len(found) - len(rows) + 1} more; --all shows them')
    return '\n'.join([*lines, '1 difference' if len(found) == 1 else f'{len(found)} differences'])
