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

"""Documents of xacro: lines of elements."""

from __future__ import annotations

from pathlib import Path

import pytest
from xacro_files import expanded, HEAD

# The commands expand xacro in a separate process.
pytestmark = pytest.mark.process


def test_lines_of_expanded_elements(tmp_path: Path) -> None:
    (tmp_path / 'b.xacro').write_text(f'{HEAD}' + '\n' * 50 + '<link name="deep"/></robot>')
    root = expanded(tmp_path / 'a.xacro', """
        <!-- a
             comment -->
        <xacro:macro name="m" params="name"><link name="${name}"/></xacro:macro>
        <first a="&lt;&quot;&#10;&amp;">&lt;${1 + 1}<![CDATA[<]]></first>
        <xacro:m name="x"/>
        <xacro:include filename="b.xacro"/>

        <last b="1" a="2"/>""")
    assert [(one.tag, one.sourceline) for one in root] == [
        ('first', 5), ('link', 5), ('link', 5), ('last', 9)]
    assert (root[0].get('a'), root[0].text) == ('<"\n&', '<2<')
    assert root[3].keys() == ['b', 'a']
