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

"""Links of fixed joints that become frames, and links again."""

from __future__ import annotations

from pathlib import Path
from random import Random
import xml.etree.ElementTree as ElementTree

import numpy as np
from opencv_tools.robot.cli import sdf_to_urdf, urdf_to_sdf
from opencv_tools.robot.compare.compare import differences
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf, SdfOptions
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.lumping import lump_fixed, with_massless, without_massless
from opencv_tools.robot.model import FrameId, Inertial, Link, Robot
from opencv_tools.robot.renaming import with_original_names
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.xml.document import parse, to_bytes
from opencv_tools.robot.xml.report import Report
import pytest
import robots
from rows import each_row

ARM = b"""<robot name="arm">
  <link name="base"><inertial><mass value="2"/>
    <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
  <link name="plate"><inertial><mass value="2"/>
    <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>
    <visual name="base"><origin xyz="0 0 1"/><geometry><sphere radius="1"/></geometry></visual>
  </link>
  <link name="tip"/>
  <joint name="screws" type="fixed"><parent link="base"/><child link="plate"/>
    <origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/></joint>
  <joint name="hinge" type="continuous"><parent link="plate"/><child link="tip"/>
    <origin xyz="1 0 0"/><axis xyz="0 0 1"/></joint>
  <gazebo reference="plate"><sensor name="eye" type="imu"/></gazebo>
</robot>"""


def urdf(data: bytes) -> Robot:
    return read_urdf(parse(data, 'arm.urdf', Report()), Report())


def about_the_origin(inertial: Inertial, kinematics: Kinematics) -> np.ndarray:
    """Return moments of inertia in the frame of the model."""
    pose = kinematics.placement_pose(inertial.placement)
    xx, xy, xz, yy, yz, zz = inertial.inertia
    rotation = np.reshape(pose.rotation, (3, 3))
    own = rotation @ [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]] @ rotation.T
    p = np.array(pose.translation)
    return own + inertial.mass * (p @ p * np.eye(3) - np.outer(p, p))


def test_total_inertial_of_two_point_masses() -> None:
    robot = lump_fixed(urdf(ARM), Report())
    assert [link.name for link in robot.links] == ['base', 'tip']
    inertial = robot.links[0].inertial
    assert inertial is not None
    assert (inertial.mass, inertial.placement.pose.xyz) == (4.0, (0.5, 0.0, 0.0))
    # Two masses of 2 kg at a distance of 0.5 m: 2 * 2 * 0.25 about y and z.
    assert inertial.inertia == pytest.approx((0, 0, 0, 1, 0, 1))


def test_poses_of_lumped_shapes_links_and_frames() -> None:
    report = Report()
    robot = lump_fixed(urdf(ARM), report)
    kinematics = Kinematics(robot)
    visual, = robot.links[0].visuals
    assert kinematics.placement_pose(visual.placement).translation == (1, 0, 1)
    assert kinematics.pose(FrameId('link', 'tip')).translation == pytest.approx((1, 1, 0))
    assert kinematics.pose(FrameId('frame', 'plate')).translation == (1, 0, 0)
    assert [(note.element, note.name) for note in report.warnings] == [('joint', 'screws')]


def test_sensor_pose_in_the_frame_of_a_lumped_link() -> None:
    root = convert_to_sdf(urdf(ARM), Report(), SdfOptions(fixed='lump'))
    pose = root.find("model/link[@name='base']/sensor/pose")
    assert pose is not None and pose.get('relative_to') == 'plate'
    frame = root.find("model/frame[@name='plate']")
    assert frame is not None and frame.get('attached_to') == 'base'


def test_shape_names_with_the_name_of_their_link() -> None:
    shape = '<visual{}><geometry><sphere radius="1"/></geometry></visual>'
    own = shape.format(' name="base"').encode()
    unnamed = shape.format('').encode()
    robot = urdf(ARM.replace(b'<link name="base">', b'<link name="base">' + own)
                 .replace(b'<link name="plate">', b'<link name="plate">' + unnamed))
    names = [visual.name for visual in lump_fixed(robot, Report()).links[0].visuals]
    assert names == ['base', '', 'plate_base']


def test_plugin_that_names_a_frame() -> None:
    report = Report()
    plugin = b"""<gazebo><plugin name="imu" filename="i.so"><link_name>plate</link_name>
        <joint>screws</joint><base>base</base><frame_id>plate</frame_id></plugin></gazebo>"""
    lump_fixed(urdf(ARM.replace(b'</robot>', plugin + b'</robot>')), report)
    notes = [note for note in report.warnings if note.element == 'plugin']
    assert [(note.name, note.message.partition(',')[0]) for note in notes] == [
        ('imu', "<link_name> names 'plate'"), ('imu', "<joint> names 'screws'")]


def test_preserved_fixed_joint() -> None:
    block = b'<gazebo reference="screws"><preserveFixedJoint>true</preserveFixedJoint></gazebo>'
    robot = lump_fixed(urdf(ARM.replace(b'</robot>', block + b'</robot>')), Report())
    assert [joint.name for joint in robot.joints] == ['screws', 'hinge']


@each_row('seed', range(12))
def test_mass_and_poses_of_random_robots(seed: int) -> None:
    robot = urdf(ElementTree.tostring(robots.urdf(Random(seed), 20)))
    lumped = lump_fixed(robot, Report())
    before, after = Kinematics(robot), Kinematics(lumped)
    assert len(lumped.links) == len(robot.links) - sum(
        joint.type == 'fixed' for joint in robot.joints)

    def inertials(links: tuple[Link, ...]) -> list[Inertial]:
        return [link.inertial for link in links if link.inertial]

    assert sum(one.mass for one in inertials(lumped.links)) == pytest.approx(
        sum(one.mass for one in inertials(robot.links)))
    np.testing.assert_allclose(
        sum(about_the_origin(one, after) for one in inertials(lumped.links)),
        sum(about_the_origin(one, before) for one in inertials(robot.links)), atol=1e-9)
    places = [sorted(np.round(kinematics.placement_pose(shape.placement).translation, 9).tolist()
                     for link in one.links for shape in (*link.visuals, *link.collisions))
              for one, kinematics in ((robot, before), (lumped, after))]
    assert places[0] == places[1]


def test_lumped_robot_read_from_sdf() -> None:
    lumped = lump_fixed(urdf(ARM), Report())
    root = convert_to_sdf(urdf(ARM), Report(), SdfOptions(fixed='lump'))
    again = with_original_names(read_sdf(parse(to_bytes(root), 'arm.sdf', Report()), Report()))
    before, after = Kinematics(lumped), Kinematics(again)
    for frame in ('plate', 'screws'):
        assert after.pose(FrameId('frame', frame)).translation == pytest.approx(
            before.pose(FrameId('frame', frame)).translation)


def test_fixed_joint_with_a_sensor_stays() -> None:
    data = ARM.replace(b'reference="plate"', b'reference="screws"')
    model = convert_to_sdf(urdf(data), Report(), SdfOptions(fixed='lump'))[0]
    assert model.xpath('joint[@name="screws"]/sensor/@name') == ['eye']
    assert model.xpath('frame') == []


def test_lumped_link_has_each_setting_once() -> None:
    data = ARM.replace(b'</robot>', b"""
        <gazebo reference="base"><selfCollide>true</selfCollide></gazebo>
        <gazebo reference="plate"><selfCollide>false</selfCollide>
        <turnGravityOff>true</turnGravityOff></gazebo>
        <gazebo reference="screws"><provideFeedback>true</provideFeedback></gazebo></robot>""")
    model = convert_to_sdf(urdf(data), Report(), SdfOptions(fixed='lump'))[0]
    assert model.xpath('link[@name="base"]/self_collide/text()') == ['true']
    assert model.xpath('link[@name="base"]/gravity/text()') == ['false']
    assert model.xpath('frame/physics') == []


LOOP = """<sdf version="1.11"><model name="m"><link name="a"/><link name="b"/><link name="c"/>
<joint name="j" type="fixed"><parent>a</parent><child>b</child></joint>
<joint name="k" type="revolute"><parent>b</parent><child>c</child><axis><xyz>0 0 1</xyz></axis>
</joint><joint name="l" type="revolute"><pose>0 2 0 0 0 0</pose><parent>c</parent><child>b</child>
<axis><xyz>0 0 1</xyz></axis></joint></model></sdf>
"""


def test_lumped_child_of_a_joint_that_closes_a_loop(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ('a.sdf', 'b.urdf', 'c.sdf')]
    paths[0].write_text(LOOP)
    assert sdf_to_urdf([str(paths[0]), '-o', str(paths[1])]) == 0
    assert urdf_to_sdf([str(paths[1]), '-o', str(paths[2]), '--fixed', 'lump']) == 0
    robot = read_robot(str(paths[2]), Report())[0]
    assert [(joint.name, joint.parent, joint.child, joint.is_loop) for joint in robot.joints] == [
        ('k', 'a', 'c', False), ('l', 'c', 'a', True)]
    pose = Kinematics(robot).pose(FrameId('joint', 'l'))
    assert pose.translation == pytest.approx((0, 2, 0))


def test_lumped_links_of_a_joint_that_closes_a_loop(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [tmp_path / name for name in ('a.sdf', 'b.urdf', 'c.sdf')]
    paths[0].write_text(
        '<sdf version="1.9"><model name="m"><link name="a"/><link name="b"/>' + ''.join(
            f'<joint name="{name}" type="fixed"><pose>{x} 0 0 0 0 0</pose><parent>a</parent>'
            '<child>b</child></joint>' for x, name in enumerate('jk')) + '</model></sdf>')
    assert sdf_to_urdf([str(paths[0]), '-o', str(paths[1])]) == 0
    assert urdf_to_sdf([str(paths[1]), '-o', str(paths[2]), '--fixed', 'lump']) == 0
    assert "'k': lumped: both its links are link 'a' now" in capsys.readouterr().err
    robot = read_robot(str(paths[2]), Report())[0]
    assert ([link.name for link in robot.links], robot.joints) == (['a'], ())
    kinematics = Kinematics(robot)
    assert {frame.name: kinematics.pose(FrameId('frame', frame.name)).translation[0]
            for frame in robot.frames} == pytest.approx({'b': 0, 'j': 0, 'k': 1})


INERTIA = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
#: Links without mass above, between and below links with mass, also at joints that move.
TOOL = f"""<robot name="arm">
<link name="foot"><visual><origin xyz="0 0 7"/><geometry><sphere radius="1"/></geometry></visual>
</link><link name="plinth"/>
<link name="base"><inertial><origin xyz="0.1 0 0"/><mass value="2"/>{INERTIA}</inertial></link>
<link name="flange"/>
<link name="wheel"><inertial><mass value="0.625"/>{INERTIA}</inertial></link>
<link name="tool"><collision name="c"><origin xyz="3 0 0"/><geometry><box size="1 2 3"/></geometry>
</collision></link>
<link name="finger"><inertial><mass value="0.25"/>{INERTIA}</inertial></link>
<joint name="a" type="fixed"><origin xyz="0 0 0.3" rpy="0.1 0.2 0.3"/>
<parent link="foot"/><child link="plinth"/></joint>
<joint name="base" type="fixed"><origin xyz="0.7 0 0" rpy="0 0 1"/>
<parent link="plinth"/><child link="base"/></joint>
<joint name="turn" type="revolute"><origin xyz="0 1 0" rpy="1 0 0"/>
<parent link="base"/><child link="flange"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="2" effort="3" velocity="4"/></joint>
<joint name="c" type="fixed"><origin xyz="0 0.2 0" rpy="0 0.5 0"/>
<parent link="flange"/><child link="wheel"/></joint>
<joint name="tool" type="fixed"><origin xyz="0 0 1" rpy="0 0 0.7"/>
<parent link="wheel"/><child link="tool"/></joint>
<joint name="slide" type="prismatic"><origin xyz="0 5 0"/>
<parent link="tool"/><child link="finger"/><axis xyz="1 1 0"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint>
<gazebo reference="tool"><sensor name="eye" type="contact"><contact><collision>c</collision>
</contact></sensor><turnGravityOff>true</turnGravityOff><mu1>0.3</mu1></gazebo>
<gazebo reference="c"><sensor name="scale" type="imu"/></gazebo>
<gazebo reference="a"><provideFeedback>true</provideFeedback></gazebo></robot>"""


def without_sensor(text: str = TOOL) -> Robot:
    """Return the robot whose fixed joint ``c`` may become a frame."""
    return urdf(text.replace('<sensor name="scale" type="imu"/>', '').encode())


def sdf_of(robot: Robot, options: SdfOptions = SdfOptions()) -> Robot:  # noqa: B008
    data = to_bytes(convert_to_sdf(robot, Report(), options))
    return read_sdf(parse(data, 'arm.sdf', Report()), Report())


def test_frames_in_place_of_links_without_mass() -> None:
    report = Report()
    root = convert_to_sdf(without_sensor(), report)
    assert root.xpath('model/link/@name') == ['base', 'wheel', 'finger']
    assert root.xpath('model/joint/@name') == ['turn', 'slide']
    assert root.xpath('model/joint/child/text()') == ['wheel', 'finger']
    frames = {frame.get('name'): frame.get('attached_to')
              for frame in root.iterfind('model/frame')}
    assert {name: frames[name] for name in ('foot', 'plinth', 'flange', 'tool')} == {
        'foot': 'base', 'plinth': 'base', 'flange': 'wheel', 'tool': 'wheel'}
    assert root.xpath('model/link[@name="wheel"]/sensor/contact/collision/text()') == ['tool_c']
    assert root.xpath('model/link/gravity/text()') == ['false']
    assert [note for note in report.warnings if note.element == 'link'] == []


@pytest.mark.parametrize('relative', [False, True], ids=['model', 'relative'])
@pytest.mark.parametrize('position', [0.0, 0.71])
def test_places_of_everything_in_links_without_mass(relative: bool, position: float) -> None:
    robot = without_sensor()
    converted = sdf_of(robot, SdfOptions(relative=relative))
    before, after = (Kinematics(one) for one in (robot, converted))
    poses = [one.forward({'turn': [position], 'slide': [position / 2]}) for one in (before, after)]
    for kind in ('foot', 'plinth', 'base', 'flange', 'wheel', 'tool', 'finger'):
        there = FrameId('link', kind)
        if there not in poses[1]:
            there = FrameId('frame', kind)
        for one in (0, 1):
            np.testing.assert_allclose(
                poses[1][there][one], poses[0][FrameId('link', kind)][one], atol=1e-12)
    visual, collision = converted.links[0].visuals[0], converted.links[1].collisions[0]
    for shape, former in ((visual, robot.links[0].visuals[0]),
                          (collision, robot.links[5].collisions[0])):
        np.testing.assert_allclose(after.placement_pose(shape.placement).translation,
                                   before.placement_pose(former.placement).translation, atol=1e-12)


@pytest.mark.parametrize('relative', [False, True], ids=['model', 'relative'])
def test_links_without_mass_after_the_way_back(relative: bool) -> None:
    robot, report = without_sensor(), Report()
    there = sdf_of(robot, SdfOptions(relative=relative))
    back = urdf(to_bytes(convert_to_urdf(there, report)))
    assert report.warnings == []
    assert differences(robot, there, tolerance=1e-12) == []
    assert differences(robot, back, tolerance=1e-12, everything=True) == []
    for kind in ('links', 'joints', 'frames'):
        assert [one.name for one in getattr(back, kind)] == [
            one.name for one in getattr(robot, kind)]
    assert [link.inertial is None for link in back.links] == [
        link.inertial is None for link in robot.links]


def test_joint_that_must_stay_keeps_its_links_without_mass() -> None:
    report = Report()
    root = convert_to_sdf(urdf(TOOL.encode()), report)
    assert root.xpath('model/joint[@name="c"]/sensor/@name') == ['scale']
    assert root.xpath('model/link/@name') == ['base', 'flange', 'wheel', 'finger']
    assert ['has no <inertial>: massless' in note.message for note in report.warnings
            if note.element == 'link'] == [True]


@each_row(('mass', 'moment'), [('0', '0'), ('0.0', '0'), ('-0e5', '0'), ('0', '0.5')])
def test_links_of_mass_0_are_links_without_mass(mass: str, moment: str) -> None:
    element, report = ElementTree.fromstring(TOOL), Report()
    for name in ('foot', 'flange', 'tool'):
        link = element.find(f'link[@name="{name}"]')
        assert link is not None
        inertial = robots.add(link, 'inertial')
        robots.add(inertial, 'mass', value=mass)
        robots.add(inertial, 'inertia', **dict.fromkeys(('ixx', 'iyy', 'izz'), moment),
                   **dict.fromkeys(('ixy', 'ixz', 'iyz'), '0'))
    robot = without_sensor(ElementTree.tostring(element, encoding='unicode').replace(' />', '/>'))
    assert sum(link.inertial is not None for link in robot.links) == 6
    root = convert_to_sdf(robot, report)
    assert root.xpath('model/link/@name') == ['base', 'wheel', 'finger']
    assert root.xpath('model/link/inertial/mass/text()') == ['2', '0.625', '0.25']
    assert ['without its moments' in note.message for note in report.warnings
            if note.element == 'inertial'] == [True] * (3 if moment != '0' else 0)
    there = sdf_of(robot)
    back = urdf(to_bytes(convert_to_urdf(there, Report())))
    for one in (there, back):
        assert (differences(robot, one, tolerance=1e-12) == []) is (moment == '0')


@each_row('options', [SdfOptions(), SdfOptions(inertial='keep'), SdfOptions(inertial='zero'),
                      SdfOptions(inertial='default')])
def test_link_of_mass_0_that_moves(options: SdfOptions) -> None:
    report = Report()
    robot = without_sensor(TOOL.replace('<mass value="0.25"/>' + INERTIA, '<mass value="0"/>'))
    root = convert_to_sdf(robot, report, options)
    mass = {'zero': ['0'], 'default': ['1']}.get(options.inertial, [])
    assert root.xpath('model/link[@name="finger"]/inertial/mass/text()') == mass
    assert any('massless in URDF, 1 kg in SDF' in note.message for note in report.warnings) is (
        not mass)


@each_row('options', [SdfOptions(fixed='keep'), SdfOptions(inertial='keep'),
                      SdfOptions(inertial='zero'), SdfOptions(inertial='default')])
def test_options_that_keep_links_without_mass(options: SdfOptions) -> None:
    assert len(convert_to_sdf(without_sensor(), Report(), options).findall('model/link')) == 7


def test_robot_without_any_mass_keeps_its_links() -> None:
    report = Report()
    robot = urdf(b"""<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="fixed">
        <parent link="a"/><child link="b"/></joint></robot>""")
    root = convert_to_sdf(robot, report)
    assert root.xpath('model/*/@name') == ['a', 'b', 'j']
    assert len(report.warnings) == 1


def test_canonical_link_is_the_host_of_the_first_link() -> None:
    text = TOOL.replace('<link name="plinth"/>', '', 1).replace(
        '<link name="base">', f'<link name="aside"><inertial><mass value="1"/>{INERTIA}</inertial>'
        '</link><link name="plinth"/><joint name="z" type="continuous"><parent link="foot"/>'
        '<child link="aside"/></joint><link name="base">', 1)
    robot = without_massless(without_sensor(text), Report())
    assert (robot.links[0].name, robot.canonical_link) == ('aside', 'base')
    root = sdf_of(without_sensor(text))
    joint = next(joint for joint in root.joints if joint.name == 'z')
    assert (joint.parent, joint.child) == ('base', 'aside')


def test_edited_frames_stay_frames() -> None:
    root = convert_to_sdf(without_sensor(), Report())
    joint = root.find('model/frame[@name="a"]')
    assert joint is not None
    root[0].remove(joint)
    robot = read_sdf(parse(to_bytes(root), 'a.sdf', Report()), Report())
    assert [link.name for link in with_massless(robot).links] == ['base', 'wheel', 'finger']
    assert convert_to_urdf(robot, Report()).xpath('link/@name') == ['base', 'wheel', 'finger']


@each_row('seed', range(12))
def test_random_robots_without_some_masses(seed: int) -> None:
    root = robots.urdf(Random(seed), 20)
    random = Random(seed)
    for link in root.iter('link'):
        for inertial in link.findall('inertial') if random.random() < 0.5 else ():
            link.remove(inertial)
    robot = urdf(ElementTree.tostring(root))
    there = sdf_of(robot)
    assert differences(robot, with_original_names(there), tolerance=1e-12) == []
    back = urdf(to_bytes(convert_to_urdf(there, Report())))
    assert differences(robot, back, tolerance=1e-12, everything=True) == []


def test_difference_of_a_mass_that_only_sdf_has() -> None:
    robot = urdf(ARM)  # its tip moves and has no mass
    found, mass, *others = differences(robot, sdf_of(robot))
    assert (found.element, found.name, found.property, found.a, found.b) == (
        'inertial', 'tip', 'presence', 'no', '1 kg')
    assert (mass.element, mass.property, mass.size) == ('robot', 'mass', 1.0)
    assert {difference.element for difference in others} == {'robot'}


def test_mass_of_a_link_of_sdf_without_an_inertial() -> None:
    def model(arm: str) -> bytes:
        return ('<sdf version="1.9"><model name="m"><link name="base"><inertial><mass>0.625</mass>'
                f'</inertial></link><link name="arm">{arm}</link><joint name="j" type="fixed">'
                '<parent>base</parent><child>arm</child></joint></model></sdf>').encode()

    report = Report()
    robot = read_sdf(parse(model(''), 'm.sdf', Report()), Report())
    assert convert_to_urdf(robot, report).xpath('link/inertial/mass/@value') == ['0.625', '1']
    assert report.warnings == []
    written = ('<inertial><mass>1</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia>'
               '</inertial>')
    assert differences(robot, read_sdf(parse(model(written), 'm.sdf', Report()), Report())) == []
