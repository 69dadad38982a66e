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

"""Unread parts of tracked elements, and how they are merged and embedded again."""

from __future__ import annotations

from lxml import etree
from opencv_tools.robot.xml.document import PARTLY_READ, TrackedElement
from opencv_tools.robot.xml.passthrough import (
    embed_foreign, extract_foreign, merge_unread, namespaces)
from opencv_tools.robot.xml.report import Report
import pytest

LINK = '<link name="a" x="1"><mass value="2" unit="g"/><pose>1</pose><odd/></link>'


def tracked(text: str = LINK) -> TrackedElement:
    """Return an element of which nothing is read."""
    return TrackedElement(etree.fromstring(text))


def unread_text(element: TrackedElement) -> str:
    """Return the text of what is unread, with a short mark of elements that were read in part."""
    unread = element.unread()
    text = '' if unread is None else etree.tostring(unread).decode()
    return text.replace(' xmlns:ns0="urn:opencv_tools:preserved"', '').replace('ns0:', '')


def test_nothing_read() -> None:
    assert unread_text(tracked()) == LINK


def test_everything_read() -> None:
    element = tracked()
    mass = element.find('mass')
    assert mass is not None
    assert [element.get('name'), element.get('x'), mass.get('value'), mass.get('unit')] == [
        'a', '1', '2', 'g']
    assert element.findtext('pose') == '1'
    assert element.take_first('odd') is not None
    assert element.unread() is None


def test_child_read_in_part() -> None:
    element = tracked()
    mass = element.find('mass')
    assert mass is not None and mass.get('value') == '2'
    assert element.get('missing') is None and 'unit' in mass
    assert unread_text(element) == (
        '<link name="a" x="1"><mass unit="g" part="true"/><pose>1</pose><odd/></link>')


def test_taken_children_have_their_own_unread_parts() -> None:
    element = tracked()
    mass, = element.take_all('mass')
    assert unread_text(element) == '<link name="a" x="1"><pose>1</pose><odd/></link>'
    assert unread_text(mass) == '<mass value="2" unit="g"/>'
    element.put_back(mass)
    assert unread_text(element) == LINK


@pytest.mark.parametrize('text', [LINK, '<link>text<a>1<b/></a><a x="1"/></link>'])
def test_merge_of_unread_parts(text: str) -> None:
    element = tracked(text)
    for child in ('mass', 'a'):
        if (found := element.find(child)) is not None:
            found.get('value')
    written = etree.Element('link')
    merge_unread(written, element.unread())
    assert PARTLY_READ not in etree.tostring(written).decode()
    assert {child.tag for child in written} == {child.tag for child in element.element}
    assert dict(written.attrib) == dict(element.element.attrib)


def test_foreign_parts_are_embedded_and_extracted() -> None:
    report = Report()
    written = etree.Element('link', nsmap=namespaces((), 'urdf'))
    embed_foreign(written, etree.fromstring(LINK), 'urdf', report, 'a', 3)
    assert [note.element for note in report.notes] == ['@x', 'mass', 'pose', 'odd']
    assert not report.warnings
    element = TrackedElement(written)
    extracted = extract_foreign(element, 'urdf')
    assert extracted is not None and element.unread() is None
    expected = etree.fromstring(LINK)
    assert [child.tag for child in extracted] == [child.tag for child in expected]
    assert dict(extracted.attrib) == dict(expected.attrib)
    assert extract_foreign(tracked(), 'urdf') is None
