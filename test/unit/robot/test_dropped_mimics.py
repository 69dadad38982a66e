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

"""Joints that follow a joint which the other format does not have, and limits that repeat."""

from __future__ import annotations

from lxml import etree
from opencv_tools.robot.compare.compare import differences
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf, SdfOptions
from opencv_tools.robot.load import read_element
from opencv_tools.robot.model import Robot
from opencv_tools.robot.xml.document import Element, parse, to_bytes
from opencv_tools.robot.xml.report import Report
import pytest

MASS = ('<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
        '</inertial>')
FOLLOWER = f"""
<robot name="r">
  <link name="base">{MASS}</link>
  <link name="tip"/>
  <link name="arm">{MASS}</link>
  <joint name="pkg::mount" type="fixed"><parent link="base"/><child link="tip"/></joint>
  <joint name="elbow" type="continuous"><parent link="base"/><child link="arm"/>
    <mimic joint="pkg::mount" offset="0.5"/>
    <mimic joint="other"/>
  </joint>
</robot>"""
REPEATED = """
<sdf version="1.9"><model name="r">
  <link name="base"/><link name="hub"/><link name="arm"/>
  <joint name="j" type="{kind}"><parent>base</parent><child>arm</child>
    <axis><xyz>0 0 1</xyz>{limit}</axis><axis2><xyz>0 1 0</xyz>{limit}</axis2></joint>
  <joint name="k" type="fixed"><parent>base</parent><child>hub</child></joint>
</model></sdf>"""


def read(root: Element) -> Robot:
    """Read the file that an element is written to."""
    return read_element(parse(to_bytes(root), 'robot', Report()), Report())[0]


@pytest.mark.parametrize('version', ['1.9', '1.11'])
def test_mimic_of_a_fixed_joint_that_is_a_frame(version: str) -> None:
    robot, report = read(etree.fromstring(FOLLOWER)), Report()
    there = convert_to_sdf(robot, report, SdfOptions(version=version))
    assert [note.element for note in report.warnings if 'as <urdf:mimic>' in note.message] == [
        'mimic']
    assert there.find('.//axis/mimic') is None
    sdf = read(there)
    back = convert_to_urdf(sdf, Report())
    assert back.xpath('joint[@name="elbow"]/mimic/@joint') == ['pkg::mount', 'other']
    for other in (sdf, read(back)):
        assert differences(robot, other, samples=2, tolerance=1e-12) == []


def test_second_mimic_does_not_replace_one_that_is_dropped() -> None:
    there = convert_to_sdf(read(etree.fromstring(FOLLOWER)), Report(), SdfOptions(fixed='lump'))
    assert convert_to_urdf(read(there), Report()).find('joint/mimic') is None


@pytest.mark.parametrize('kind', ['revolute', 'universal'])
@pytest.mark.parametrize('tag', ['lower', 'upper', 'effort', 'velocity'])
def test_first_of_two_limits_that_says_no_limit(kind: str, tag: str) -> None:
    unlimited = '-1e20' if tag == 'lower' else '1e20'
    limit = f'<limit><{tag}>{unlimited}</{tag}><{tag}>0.5</{tag}></limit>'
    robot = read(etree.fromstring(REPEATED.format(kind=kind, limit=limit)))
    there = read(convert_to_urdf(robot, Report()))
    back = convert_to_sdf(there, Report())
    assert [float(text) for text in back.xpath(f'.//axis/limit/{tag}/text()')] == [
        float(unlimited), 0.5]
    for other in (there, read(back)):
        assert differences(robot, other, samples=1, tolerance=1e-12) == []
