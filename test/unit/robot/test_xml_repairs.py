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

"""Repair of XML: each repaired error, lines of elements, and documents without a repair."""

from __future__ import annotations

from lxml import etree
from opencv_tools.robot.xml.document import repaired
import pytest
from rows import each_row


@each_row(('text', 'line'), [
    ('\n\n<?xml version="1.0"?>\n<robot>\n<link/></robot>', 5),
    ('text\n<robot>\n<link/></robot>', 3),
    ('<?xml version="0.0"?>\n<robot>\n<link/></robot>', 3),
    ('<?xml encoding="utf-8"?>\n<sdf>\n<link/></sdf>', 3),
    ('<robot><!-- a -- b\n -->\n<link/></robot>', 3),
    ('<robot><!---->\n<!-- -- --><link/></robot>', 2),
    ('<robot>\n<x:y/><link/></robot>', 2),
    ('<robot>\n<link x:y="1"/></robot>', 2),
    ('\n<?xml version="2"?>\n<robot>\n<!-- -- -->\n<link><x:y z:a="1"/></link></robot>', 5),
])
def test_repaired_documents(text: str, line: int) -> None:
    with pytest.raises(etree.XMLSyntaxError):
        etree.fromstring(text.encode())
    document = repaired(text.encode())
    assert document is not None
    link = etree.fromstring(document).find('link')
    assert link is not None and link.sourceline == line
    assert repaired(document) is None


@each_row('text', [
    '', 'text', '<a><x:y/></a>', '<robot/>', '<robot><link></robot>', '<robot><!-- a',
    '<robotics/>', '<robot><xacro:macro/></robot>',
    '<robot xmlns:x="urn:x"><x:y x:z="1" xml:space="default"/>',
])
def test_documents_without_a_repair(text: str) -> None:
    assert repaired(text.encode()) is None
