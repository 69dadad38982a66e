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

"""Links of fixed joints that become frames, and frames that become links."""

from __future__ import annotations

from pathlib import Path
from random import Random
import xml.etree.ElementTree as ElementTree

import numpy as np
from opencv_tools.robot.cli import robot_compare, sdf_to_urdf, urdf_to_sdf
from opencv_tools.robot.convert import convert_to_sdf, lump_fixed, SdfOptions
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.model import FrameId, Inertial, Link, Robot
from opencv_tools.robot.renaming import with_original_names
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.trees import with_frame_links
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
    root = convert_to_sdf(urdf(ARM), Report(), SdfOptions(lump=True))
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
    root = convert_to_sdf(urdf(ARM), Report(), SdfOptions(lump=True))
    again = with_original_names(read_sdf(parse(to_bytes(root), 'arm.sdf', Report()), Report()))
    before, after = Kinematics(lumped), Kinematics(again)
    for frame in ('plate', 'screws'):
        assert after.pose(FrameId('frame', frame)).translation == pytest.approx(
            before.pose(FrameId('frame', frame)).translation)


def test_fixed_joint_with_a_sensor_stays() -> None:
    data = ARM.replace(b'reference="plate"', b'reference="screws"')
    model = convert_to_sdf(urdf(data), Report(), SdfOptions(lump=True))[0]
    assert model.xpath('joint[@name="screws"]/sensor/@name') == ['eye']
    assert model.xpath('frame') == []


def test_lumped_link_has_each_setting_once() -> None:
    data = ARM.replace(b'</robot>', b"""
        <gazebo reference="base"><selfCollide>true</selfCollide></gazebo>
        <gazebo reference="plate"><selfCollide>false</selfCollide>
        <turnGravityOff>true</turnGravityOff></gazebo>
        <gazebo reference="screws"><provideFeedback>true</provideFeedback></gazebo></robot>""")
    model = convert_to_sdf(urdf(data), Report(), SdfOptions(lump=True))[0]
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


FRAMES = """<sdf version="1.9"><model name="m"><link name="base"/>
<link name="arm"><pose>1 0 0 0 0 0.5</pose></link>
<joint name="hinge" type="revolute"><parent>base</parent><child>arm</child>
<axis><xyz>0 0 1</xyz></axis></joint>
<frame name="optical" attached_to="arm"><pose>0.1 0 0 -1.5708 0 -1.5708</pose></frame>
<frame name="tip" attached_to="optical"><pose relative_to="base">0 3 0 0 0 0</pose></frame>
<frame name="axle" attached_to="hinge"/><frame name="floor"><pose>0 0 -1 0 0 0</pose></frame>
</model></sdf>
"""


@pytest.mark.parametrize('position', [0.0, 0.7])
def test_frames_as_links(tmp_path: Path, position: float) -> None:
    paths = [tmp_path / name for name in ('a.sdf', 'b.urdf', 'c.sdf')]
    paths[0].write_text(FRAMES)
    assert sdf_to_urdf([str(paths[0]), '-o', str(paths[1]), '--frames', 'links']) == 0
    assert urdf_to_sdf([str(paths[1]), '-o', str(paths[2]), '--fixed', 'lump']) == 0
    poses = [Kinematics(read_robot(str(path), Report())[0]).forward({'hinge': [position]})
             for path in paths]
    for name in ('optical', 'tip', 'axle', 'floor'):
        original, link, frame = (
            np.hstack([one[FrameId(kind, name)].rotation, one[FrameId(kind, name)].translation])
            for one, kind in zip(poses, ('frame', 'link', 'frame')))
        np.testing.assert_allclose(link, original, atol=1e-12)
        np.testing.assert_allclose(frame, original, atol=1e-12)
    assert robot_compare([str(paths[0]), str(paths[2])]) == 0
    tree = read_robot(str(paths[1]), Report())[0]
    assert {joint.child: joint.parent for joint in tree.joints} == {
        'arm': 'base', 'optical': 'arm', 'tip': 'arm', 'axle': 'arm', 'floor': 'base'}


def test_names_of_links_for_frames() -> None:
    robot = read_sdf(parse(FRAMES.replace('"tip"', '"optical_joint"').encode(), '', Report()),
                     Report())
    result = with_frame_links(robot, Report())
    names = [*(link.name for link in result.links), *(joint.name for joint in result.joints)]
    assert len(set(names)) == len(names) == 11
    assert {'optical', 'optical_joint', 'axle', 'floor'} < {link.name for link in result.links}
    assert result.frames == ()
