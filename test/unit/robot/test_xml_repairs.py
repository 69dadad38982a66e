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
from opencv_tools.robot.xml.document import DescriptionError, parse
from opencv_tools.robot.xml.report import Report
import pytest
from rows import each_row


@each_row(('text', 'line'), [
    ('\n\n<?xml version="1.0"?>\n<robot>\n<link/></robot>', 5),
    ('text\n<robot>\n<link/></robot>', 3),
    ('<?xml version="0.0"?>\n<robot>\n<link/></robot>', 3),
    ('<?xml encoding="utf-8"?>\n<sdf>\n<link/></sdf>', 3),
    ('<robot><!-- a -- b\n -->\n<link/></robot>', 3),
    ('<robot><!---->\n<!-- -- --><link/></robot>', 2),
    (f'<robot>{"<!-- -- --->" * 300}\n<link/></robot>', 2),
    ('<robot>\n<x:y/><link/></robot>', 2),
    ('<robot>\n<link x:y="1"/></robot>', 2),
    ('\n<?xml version="2"?>\n<robot>\n<!-- -- -->\n<link><x:y z:a="1"/></link></robot>', 5),
])
def test_repaired_documents(text: str, line: int) -> None:
    report = Report()
    root = parse(text.encode(), 'a.urdf', report)
    link = root.find('link')
    assert link is not None and link.sourceline == line
    assert [note.message.endswith('read with this error repaired') for note in report.notes] == [
        True]
    again = parse(etree.tostring(root), 'a.urdf', report)
    assert len(report.notes) == 1 and again.nsmap == root.nsmap


@each_row('text', [
    '', 'text', '<a><x:y/></a>', '<robot><link></robot>', '<robot><!-- a', '<robot a="1"b="2"/>',
    '<robot><xacro:macro/></robot>', '<robot><!-- -- --><link></robot>', '<robot/>text',
    '<robot a="1" a="2"><x:y/></robot>', f'<robot>{"<x:y/>" * 3000}<link></robot>',
])
def test_documents_without_a_repair(text: str) -> None:
    with pytest.raises(DescriptionError, match='not well-formed XML'):
        parse(text.encode(), 'a.urdf', Report())


@each_row('text', [
    '<robot/>', '<robotics/>',
    '<robot xmlns:x="urn:x"><x:y x:z="1" xml:space="default"/></robot>'])
def test_documents_without_an_error(text: str) -> None:
    report = Report()
    parse(text.encode(), 'a.urdf', report)
    assert report.notes == []
