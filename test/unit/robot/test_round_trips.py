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

"""Round trips of random robots: the same robot, with all its elements."""

from __future__ import annotations

from collections import Counter
from random import Random
import xml.etree.ElementTree as ElementTree

from hypothesis import given, HealthCheck, settings, strategies as st
from lxml import etree
from opencv_tools.robot.compare.compare import differences
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf, SdfOptions
from opencv_tools.robot.model import Robot
from opencv_tools.robot.renaming import with_original_names
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.xml.document import parse, to_bytes
from opencv_tools.robot.xml.report import Report
import pytest
import robots

TOLERANCE = 1e-12
PROPERTY = settings(max_examples=30, deadline=None, derandomize=True,
                    suppress_health_check=list(HealthCheck))
SEEDS = st.integers(0, 2**32)
# Most faults need few links.
SIZES = pytest.mark.parametrize('most', [6, 30])
LINKS = st.integers(1, 30)


def urdf_of(data: bytes) -> Robot:
    """Read URDF."""
    return read_urdf(parse(data, 'made_up.urdf', Report()), Report())


def sdf_of(data: bytes) -> Robot:
    """Read SDF."""
    return with_original_names(read_sdf(parse(data, 'made_up.sdf', Report()), Report()))


def check_there_and_back(
        written: ElementTree.Element, relative: bool) -> ElementTree.Element:
    """
    Convert URDF to SDF and back, and return the result.

    Assert that each step has the same robot and that the result has all elements of the original.
    """
    robot = urdf_of(ElementTree.tostring(written))
    there = to_bytes(convert_to_sdf(robot, Report(), SdfOptions(relative=relative)))
    again = sdf_of(there)
    assert not differences(robot, again, samples=2, tolerance=TOLERANCE)
    back = to_bytes(convert_to_urdf(again, Report()))
    assert not differences(robot, urdf_of(back), samples=2, tolerance=TOLERANCE)
    result = ElementTree.fromstring(back)
    assert not robots.elements(written) - robots.elements(result)
    return result


@pytest.mark.quick_cases(1)
@SIZES
@given(seed=SEEDS, links=LINKS)
@PROPERTY
def test_urdf_to_sdf_and_back(most: int, seed: int, links: int) -> None:
    check_there_and_back(robots.urdf(Random(seed), min(links, most)), relative=False)


@pytest.mark.quick_cases(1)
@SIZES
@given(seed=SEEDS, links=LINKS)
@PROPERTY
def test_numbers_of_relative_poses_after_a_round_trip(most: int, seed: int, links: int) -> None:
    written = robots.urdf(Random(seed), min(links, most))
    result = check_there_and_back(written, relative=True)
    assert not robots.numbers(written) - robots.numbers(result)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize('relative', [False, True], ids=['model', 'relative'])
@SIZES
@given(seed=SEEDS, links=LINKS)
@PROPERTY
def test_sdf_to_urdf_and_back(relative: bool, most: int, seed: int, links: int) -> None:
    written = robots.sdf(Random(seed), min(links, most))
    robot = sdf_of(ElementTree.tostring(written))
    there = to_bytes(convert_to_urdf(robot, Report()))
    again = urdf_of(there)
    assert not differences(robot, again, samples=2, tolerance=TOLERANCE)
    back = to_bytes(convert_to_sdf(again, Report(), SdfOptions(relative=relative)))
    assert not differences(robot, sdf_of(back), samples=2, tolerance=TOLERANCE)
    missing = robots.elements(written) - robots.elements(ElementTree.fromstring(back))
    # A pose that is the default is omitted.
    assert {path for path in missing if not path.endswith('/pose')} == set()


@pytest.mark.quick_cases(1)
@SIZES
@given(seed=SEEDS, links=LINKS)
@PROPERTY
def test_identical_bytes_after_two_conversions_to_sdf(most: int, seed: int, links: int) -> None:
    robot = urdf_of(ElementTree.tostring(robots.urdf(Random(seed), min(links, most))))
    first = to_bytes(convert_to_sdf(robot, Report(), SdfOptions(relative=True)))
    # The command restores original names when it writes, not when it reads.
    there = read_sdf(parse(first, 'made_up.sdf', Report()), Report())
    back = to_bytes(convert_to_urdf(there, Report()))
    assert to_bytes(convert_to_sdf(urdf_of(back), Report(), SdfOptions(relative=True))) == first


# Unknown elements, some with the names of elements that the writers use.
URDF_WITH_MORE = b"""<robot name="r" xmlns:drake="http://drake.mit.edu" xmlns:gz="urn:gz">
<link name="a" gz:foo="1">words<gz:bar gz:foo="2"/><element foo="1"/><name>n</name></link>
<link name="b"/><link name="c"/><link name="d"/>
<joint name="j" type="fixed"><parent link="a"/><child link="b"/><mimic joint="k"/></joint>
<joint name="k" type="prismatic"><parent link="a"/><child link="c"/>
<limit lower="0" upper="1" effort="1" velocity="1" drake:acceleration="2.5">words</limit></joint>
<joint name="l" type="prismatic"><parent link="a"/><child link="d"/><mimic joint="k"/>
<limit lower="0" upper="1" effort="1" velocity="1"/><limit lower="5"/>
<mimic joint="k" multiplier="3"/><type>t</type><pose/><axis2/></joint>
<frame name="hand" link="b" xyz="0 0 -2.1"/><frame name="hand" link="b" rpy="0 0 1"/>
<canonical_link>b</canonical_link>
</robot>"""
SDF_WITH_MORE = b"""<sdf version="1.9" xmlns:gz="urn:gz"><model name="m" gz:foo="1">
<link name="a" gz:foo="1"><gz:bar gz:foo="2"/><element foo="1"/><type>t</type></link>
<link name="b"><pose>0 0 1 0 0 0</pose><pose>0 0 2 0 0 0</pose></link>
<joint name="j" type="revolute"><parent>a</parent><child>b</child><name>n</name>
<axis><xyz gz:foo="3">0 0 1</xyz><initial_position>1</initial_position>
<limit gz:foo="4"><lower>-1</lower><upper>1</upper></limit></axis><axis xyz="1 0 0"/>
<mimic joint="x"/></joint>
<frame name="f" gz:foo="5"/><gz:frame name="g"/><canonical_link>b</canonical_link>
</model></sdf>"""


def _elements(data: bytes) -> Counter[str]:
    """Count the elements of a document, each with its prefixes and without its contents."""
    found: Counter[str] = Counter()
    for element in parse(data, 'robot', Report()).iter():
        prefix = f'{element.prefix}:' if element.prefix else ''
        names = {uri: f'{short}:' for short, uri in element.nsmap.items()}
        attributes = {names.get(etree.QName(name).namespace, '') + etree.QName(name).localname:
                      value for name, value in element.attrib.items()}
        found[f'{prefix}{etree.QName(element).localname} {sorted(attributes.items())} '
              f'{(element.text or "").strip()}'] += 1
    return found


@pytest.mark.parametrize('version', ['1.7', '1.10', '1.12'])
def test_unknown_elements_of_urdf_after_sdf(version: str) -> None:
    there = to_bytes(convert_to_sdf(
        urdf_of(URDF_WITH_MORE), Report(), SdfOptions(version=version)))
    back = to_bytes(convert_to_urdf(sdf_of(there), Report()))
    assert _elements(URDF_WITH_MORE) - _elements(back) == Counter()
    assert to_bytes(convert_to_sdf(urdf_of(back), Report(), SdfOptions(version=version))) == there


def test_urdf_elements_of_a_lumped_frame() -> None:
    robot = convert_to_sdf(urdf_of(URDF_WITH_MORE), Report(), SdfOptions(fixed='lump'))
    assert len(robot.xpath('model/frame/*/mimic')) == 1
    back = to_bytes(convert_to_urdf(sdf_of(to_bytes(robot)), Report()))
    again = convert_to_sdf(urdf_of(back), Report())
    assert len(again.xpath('model/frame/*/mimic')) == 1


def test_unknown_elements_of_sdf_after_urdf() -> None:
    there = to_bytes(convert_to_urdf(sdf_of(SDF_WITH_MORE), Report()))
    back = to_bytes(convert_to_sdf(urdf_of(there), Report(), SdfOptions(version='1.9')))
    assert _elements(SDF_WITH_MORE) - _elements(back) == Counter()
    assert _elements(to_bytes(convert_to_urdf(sdf_of(back), Report()))) == _elements(there)


@pytest.mark.parametrize('version', ['1.6', '1.9'])
def test_unchanged_contents_of_plugins(version: str) -> None:
    plugin = ('<plugin name="p" filename="q"><pose frame="a">1 0 0 0 0 0</pose><axis><xyz>1 0 0'
              '</xyz><use_parent_model_frame>1</use_parent_model_frame></axis>'
              '<pose relative_to="b"/></plugin>')
    reference = 'frame' if version == '1.6' else 'relative_to'
    data = (f'<sdf version="{version}"><model name="m">{plugin}<link name="a">{plugin}'
            f'<sensor name="s" type="imu"><pose {reference}="a">1 0 0 0 0 0</pose>{plugin}'
            '</sensor></link></model></sdf>').encode()
    robot = sdf_of(data)
    assert robot.links[0].extension.sdf is not None
    assert robot.links[0].extension.sdf.xpath('sensor/pose/@relative_to') == ['a']
    back = urdf_of(to_bytes(convert_to_urdf(robot, Report())))
    for one in (robot, back):
        made = convert_to_sdf(one, Report(), SdfOptions(version='1.9'))
        assert [_elements(etree.tostring(part)) for part in made.iter('plugin')] == [
            _elements(plugin.encode())] * 3
