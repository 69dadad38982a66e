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

"""Colours of Gazebo's materials, and links, joints and frames of ``<gazebo>``."""

from __future__ import annotations

from pathlib import Path

from lxml import etree
from opencv_tools.robot.compare.compare import differences
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf, SdfOptions
from opencv_tools.robot.load import read_element, read_robot
from opencv_tools.robot.model import FrameId, Robot
from opencv_tools.robot.xml.document import DescriptionError, parse, to_bytes
from opencv_tools.robot.xml.report import Report
import pytest

BODY = ('<link name="{0}"><inertial><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" '
        'iyz="0" izz="1"/></inertial><visual><geometry><sphere radius="1"/></geometry>{1}'
        '</visual></link>')
JOINT = ('<joint name="j" type="fixed"><origin xyz="0 0 1" rpy="0.1 0 0"/><parent link="a"/>'
         '<child link="b"/></joint>')
LOOP = ('<joint name="loop" type="revolute"><pose>0 0 0.5 0 0 0</pose><parent>b</parent>'
        '<child>a</child><axis><xyz>0 1 0</xyz><limit><lower>-0.25</lower><upper>0.5</upper>'
        '</limit></axis></joint>')


def read(text: str) -> Robot:
    robot, _ = read_element(parse(text.encode(), 'r', Report()), Report())
    return robot


def urdf(block: str, material: str = '') -> str:
    links = BODY.format('a', material) + BODY.format('b', '')
    return f'<robot name="r">{links}{JOINT}{block}</robot>'


@pytest.mark.parametrize(('name', 'color', 'ambient'), [
    ('Yellow', '1 1 0 1', '1 1 0 1'), ('SkyBlue', '0 0 1 1', '0.13 0.44 0.7 1'),
    ('RedTransparent', '1 0 0 0.5', '1 0 0 0.5'), ('Wood', '', '')])
def test_colors_of_gazebo_both_ways(name: str, color: str, ambient: str) -> None:
    text = urdf(f'<gazebo reference="a"><material>Gazebo/{name}</material></gazebo>')
    sdf = convert_to_sdf(read(text), Report())
    material = sdf.find('model/link[@name="a"]/visual/material')
    assert material is not None and material.findtext('script/name') == f'Gazebo/{name}'
    assert material.findtext('diffuse', '') == color
    assert material.findtext('ambient', '') == ambient
    for tag in ('diffuse', 'ambient', 'specular', 'emissive'):
        etree.strip_elements(material, tag)
    back = convert_to_urdf(read(to_bytes(sdf).decode()), Report())
    assert back.findtext('gazebo/material') == f'Gazebo/{name}'
    assert back.xpath('string(link/visual/material/color/@rgba)') == color
    assert differences(read(text), read(to_bytes(back).decode()), everything=True) == []


def test_color_of_the_file_beside_a_material_of_gazebo() -> None:
    sdf = convert_to_sdf(read(urdf(
        '<gazebo reference="a"><material>Gazebo/Red</material></gazebo>',
        '<material name="m"><color rgba="0 0.25 1 1"/></material>')), Report())
    material = sdf.find('model/link[@name="a"]/visual/material')
    assert material is not None and material.findtext('diffuse') == '0 0.25 1 1'
    assert material.findtext('script/name') == 'Gazebo/Red'


def test_parts_of_the_model_in_gazebo() -> None:
    text = urdf(f'<gazebo>{LOOP}<frame name="tip" attached_to="b"><pose>0 0 7 0 0 0</pose></frame>'
                '<link name="c"><pose>1 2 3 0 0 0</pose><inertial><mass>5</mass></inertial></link>'
                '<joint name="k" type="fixed"><parent>b</parent><child>c</child></joint></gazebo>')
    robot = read(text)
    assert [joint.name for joint in robot.joints if joint.is_loop] == ['loop']
    assert [frame.attached_to for frame in robot.frames] == [FrameId('link', 'b')]
    report = Report()
    sdf = convert_to_sdf(robot, report)
    assert report.warnings == []
    assert sdf.xpath('model/joint/@name') == ['j', 'loop', 'k']
    assert sdf.xpath('model/frame/@name | model/link[3]/@name') == ['c', 'tip']
    back = convert_to_urdf(read(to_bytes(sdf).decode()), Report())
    for other in (sdf, back):
        assert differences(robot, read(to_bytes(other).decode()), everything=True) == []
    assert differences(robot, read(urdf('')), everything=True) != []


def test_joint_of_gazebo_between_unknown_links() -> None:
    with pytest.raises(DescriptionError, match="'b2'"):
        read(urdf(f'<gazebo>{LOOP.replace("<parent>b", "<parent>b2")}</gazebo>'))


@pytest.mark.parametrize('fixed', ['frames', 'keep', 'lump'])
def test_link_of_gazebo_without_an_inertial_weighs_as_in_gazebo(fixed: str) -> None:
    robot = read(urdf('<gazebo><link name="c"/><joint name="k" type="fixed"><parent>b</parent>'
                      '<child>c</child></joint></gazebo>'))
    sdf = convert_to_sdf(robot, Report(), SdfOptions(fixed=fixed))
    for other in (robot, read(to_bytes(sdf).decode())):
        assert sum(link.inertial.mass for link in other.links if link.inertial) == 5


def test_massless_link_beside_a_link_of_gazebo_stays_massless() -> None:
    text = ('<robot name="r"><link name="a"/><gazebo><link name="c"><inertial><mass>5</mass>'
            '</inertial></link><joint name="k" type="revolute"><parent>a</parent><child>c</child>'
            '<axis><xyz>0 0 1</xyz></axis></joint></gazebo></robot>')
    sdf = convert_to_sdf(read(text), Report())
    assert ('inertial', 'a', 'presence') in {
        (found.element, found.name, found.property) for found in differences(
            read(text), read(to_bytes(sdf).decode()))}


@pytest.mark.parametrize('block', [
    '<link name="a"/>', '<link name="b"/>', '<frame name="j" attached_to="a"/>',
    '<joint name="j" type="fixed"><parent>a</parent><child>b</child></joint>'])
def test_name_of_gazebo_that_the_robot_has(block: str, tmp_path: Path) -> None:
    path = tmp_path / 'k.urdf'
    path.write_text(urdf(f'<gazebo>{block}</gazebo>'))
    with pytest.raises(DescriptionError, match=r'k\.urdf:.* is already the name of ') as caught:
        read_robot(str(path), Report())
    assert 'line 0' not in str(caught.value)


@pytest.mark.parametrize(('link', 'words'), [
    ('a', 'moves the link in Gazebo, and is not converted'), ('b', 'has no effect in SDF')])
def test_pose_of_gazebo(link: str, words: str) -> None:
    report = Report()
    root = f'<gazebo reference="{link}"><pose>1 1 1 0 0 0</pose></gazebo>'
    read_element(parse(urdf(root).encode(), 'a.urdf', report), report)
    assert [note.message for note in report.warnings] == [
        f'{words}; the element is preserved unchanged']
