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

"""Rules of the URDF parser that a written robot keeps."""

from __future__ import annotations

import re

from lxml import etree
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf, UrdfOptions
from opencv_tools.robot.geometry import Capsule
from opencv_tools.robot.model import Robot
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.xml.document import DescriptionError, parse, to_bytes
from opencv_tools.robot.xml.report import Report
import pytest
from rows import each_row
from urdf_models import BOX, joint, through_sdf


def read_text(content: str) -> Robot:
    text = f'<robot name="r">{content}</robot>'
    return read_urdf(parse(text.encode(), 'r.urdf', Report()), Report())


def test_complete_limits_of_fixed_joints() -> None:
    root = through_sdf(joint('<limit lower="0" upper="1"/>', 'fixed'))
    assert dict(root.find('joint/limit').attrib) == {  # type: ignore[union-attr]
        'lower': '0', 'upper': '1', 'effort': '1e+16', 'velocity': '1e+16'}


@each_row(('content', 'attributes'), [
    ('<dynamics/>', []),
    ('<dynamics armature="1"/>', [{'armature': '1', 'damping': '0'}]),
    ('<dynamics friction="0"/>', [{'friction': '0'}]),
])
@each_row('kind', ['continuous', 'fixed'])
def test_dynamics_have_a_number(kind: str, content: str, attributes: list[dict[str, str]]) -> None:
    root = through_sdf(joint(f'<axis xyz="0 0 1"/>{content}', kind))
    assert [dict(one.attrib) for one in root.iterfind('joint/dynamics')] == attributes


@each_row(('content', 'message'), [
    ('<safety_controller/>', "joint 'j': has no k_velocity=, which URDF requires"),
    ('<safety_controller k_velocity="fast"/>', "k_velocity='fast' is not a finite number"),
    ('<calibration falling="1e400"/>', "falling='1e400' is not a finite number"),
    ('<mimic/>', 'has no joint='),
    ('<dynamics damping="inf"/>', "damping='inf'"),
])
def test_invalid_numbers_of_joints(content: str, message: str) -> None:
    with pytest.raises(DescriptionError, match=re.escape(message)):
        through_sdf(joint(content, 'fixed'))


@each_row(('version', 'back'), [
    ('1.0', '1.0'), ('1.2', '1.2'), ('1', '1.0'), ('2.0', '1.2'), ('1.10', '1.2'),
    ('01.1', '1.1'), ('1.01', '1.1'), (' +1.2', '1.2')])
def test_version_of_urdf(version: str, back: str) -> None:
    text = f'<robot name="r" version="{version}"><link name="a"/></robot>'
    report = Report()
    model = read_urdf(parse(text.encode(), 'r.urdf', Report()), report)
    root = convert_to_urdf(model, report, UrdfOptions(inertial='zero'))
    assert root.get('version') == back
    assert [version in note.message for note in report.warnings] == [True] * (
        version in ('1', '2.0', '1.10'))


def test_unique_names_of_shared_materials() -> None:
    report = Report()
    red = '<material name="red"><color rgba="1 0 0 1"/></material>'
    root = through_sdf(f'{red}{red}<material name="red_again"/>{red}<link name="a"/>', report)
    assert root.xpath('material/@name') == ['red', 'red_again_1', 'red_again', 'red_again_2']
    assert len(report.warnings) == 2


def test_clamped_colors() -> None:
    content = ('<material name="red"><color rgba="2 0 0 1"/></material>'
               f'<link name="a"><visual>{BOX}<material name="blue"><color rgba="0 -1 1 1"/>'
               '</material></visual></link>')
    report = Report()
    root = through_sdf(content, report)
    assert root.xpath('//color/@rgba') == ['0 0 1 1', '1 0 0 1']
    assert [note.name for note in report.warnings] == ['red']  # SDF had the other one


CAPSULE = ('<sdf version="1.9"><model name="m"><link name="a"><collision name="c"><geometry>'
           '<capsule><radius>0.125</radius><length>0.75</length></capsule></geometry></collision>'
           '</link></model></sdf>')


@pytest.mark.parametrize(('version', 'written', 'tags'), [
    ('', None, ['cylinder', 'capsule']), ('1.0', None, ['cylinder', 'capsule']),
    ('1.1', '1.1', ['capsule']), ('1.2', '1.2', ['capsule'])])
def test_written_version_of_a_robot_with_a_capsule(
        version: str, written: str | None, tags: list[str]) -> None:
    robot, report = read_sdf(parse(CAPSULE.encode(), 'm.sdf', Report()), Report()), Report()
    root = convert_to_urdf(robot, report, UrdfOptions(version=version))
    assert root.get('version') == written
    geometry = root.find('link/collision/geometry')
    assert geometry is not None and [etree.QName(one).localname for one in geometry] == tags
    assert [note.element for note in report.warnings if 'capsule' in note.text()] == (
        [] if written else ['capsule'])
    back = read_urdf(parse(to_bytes(root), 'm.urdf', Report()), Report())
    assert back.links[0].collisions[0].geometry == Capsule(0.125, 0.75)


@pytest.mark.parametrize(('own', 'chosen', 'written'), [
    ('', '', None), ('1.1', '', '1.1'), ('1.2', '', '1.2'), ('1.2', '1.0', '1.0'),
    ('1.1', '1.2', '1.2')])
def test_written_version_is_that_of_the_original(
        own: str, chosen: str, written: str | None) -> None:
    version, report = f'version="{own}"' if own else '', Report()
    content = joint('<limit lower="0" upper="1" effort="1" velocity="2" acceleration="4"/>')
    data = f'<robot name="r" {version}>{content}</robot>'.encode()
    robot = read_urdf(parse(data, 'r.urdf', Report()), Report())
    sdf = read_sdf(parse(to_bytes(convert_to_sdf(robot, Report())), 'r.sdf', Report()), Report())
    root = convert_to_urdf(sdf, report, UrdfOptions(version=chosen))
    assert root.get('version') == written
    assert root.xpath('string(joint/limit/@acceleration)') == '4' * (own == written == '1.2')
    assert ['acceleration=' in note.message for note in report.warnings].count(True) == (
        own == '1.2' and written != '1.2')


@pytest.mark.parametrize(('version', 'written'), [
    ('1.0', ['-2', '3']), ('1.1', ['-2', '3']), ('1.2', ['1e+16', '3'])])
def test_negative_effort_by_version(version: str, written: list[str]) -> None:
    text = joint('<limit lower="0" upper="1" effort="-2" velocity="3"/>', 'revolute')
    root = convert_to_urdf(read_text(text), Report(), UrdfOptions(version=version))
    assert root.xpath('joint/limit/@effort | joint/limit/@velocity') == written


def test_negative_acceleration_means_no_limit() -> None:
    limit = '<limit lower="0" upper="1" acceleration="-2" deceleration="-0.5" jerk="4"/>'
    data = f'<robot name="r" version="1.2">{joint(limit, "revolute")}</robot>'.encode()
    robot = read_urdf(parse(data, 'r.urdf', Report()), Report())
    root = convert_to_urdf(robot, Report(), UrdfOptions(version='1.2'))
    assert root.xpath('joint/limit/@*[position() > 4]') == ['1e+16', '1e+16', '4']


def test_order_of_limits_by_version() -> None:
    text = joint('<limit lower="2" upper="1" effort="1" velocity="3"/>', 'revolute')
    robot = read_text(text)
    convert_to_urdf(robot, Report(), UrdfOptions(version='1.1'))
    with pytest.raises(DescriptionError, match=r"lower='2' is greater than upper='1'.*--urdf-v"):
        convert_to_urdf(robot, Report(), UrdfOptions(version='1.2'))
