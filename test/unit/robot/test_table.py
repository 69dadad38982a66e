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

"""Differences as a table."""

from __future__ import annotations

from compared_robots import absent
from opencv_tools.robot.compare.compare import Difference
from opencv_tools.robot.compare.table import table
import pytest


def test_aligned_columns_of_the_table() -> None:
    assert table([]) == ''
    heading, first, second, count = table([
        Difference(element='joint', name='j', property='upper', a='1', b='22', size=21.0),
        absent('collision', 'a/0')]).splitlines()
    assert heading.split() == ['element', 'name', 'property', 'a', 'b', 'difference']
    assert first.index('upper') == second.index('presence') == heading.index('property')
    assert first.endswith('22  21')
    assert second == second.rstrip()
    assert count == '2 differences'


@pytest.mark.parametrize(('count', 'most', 'rows', 'last'), [
    (1, 50, 1, ['1 difference']), (50, 50, 50, ['50 differences']),
    (51, 50, 50, ['... and 1 more; --all shows them', '51 differences']),
    (173, 50, 50, ['... and 123 more; --all shows them', '173 differences']),
    (173, None, 173, ['173 differences'])])
def test_maximum_number_of_rows_of_the_table(count: int, most: int | None, rows: int,
                                             last: list[str]) -> None:
    found = [absent('link', f'{number}') for number in range(count)]
    lines = table(found, most).splitlines()
    assert [line.split()[1] for line in lines[1:rows + 1]] == [f'{n}' for n in range(rows)]
    assert lines[rows + 1:] == last
