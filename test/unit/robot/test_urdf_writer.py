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

"""Writer of URDF: geometries, frames, limits, extensions of SDF and reading by yourdfpy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
from pathlib import Path
from typing import Any

from opencv_tools.robot.compare.compare import differences
from opencv_tools.robot.convert import convert_to_urdf, UrdfOptions
from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Mesh, Sphere
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import FrameId, Placement, Robot
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.urdf.writer import write_urdf
from opencv_tools.robot.xml.document import DescriptionError, parse, to_bytes
from opencv_tools.robot.xml.report import Report
import pytest
from rows import each_row
from urdf_models import ENDS, joint, read, robot_of_sdf, round_trip, through_sdf, visual, written


def test_limit_on_one_side_only() -> None:
    model = read(joint('<limit lower="0" upper="1e16" effort="1" velocity="inf"/>'))
    assert dict(written(model).find('joint/limit').attrib) == {  # type: ignore[union-attr]
        'lower': '0', 'upper': '1e+16', 'effort': '1', 'velocity': '1e+16'}


def test_joint_frames_away_from_their_links() -> None:
    model, report = robot_of_sdf(), Report()
    root = written(model, report)
    assert [element.get('name') for element in root.iterfind('joint')] == ['j', 'k']
    back = read_urdf(root, Report())
    one, other = Kinematics(model), Kinematics(back)
    for kind, things in (('link', model.links), ('joint', model.joints), ('frame', model.frames)):
        for thing in things:
            frame = FrameId(kind, thing.name)
            assert one.pose(frame).translation == pytest.approx(other.pose(frame).translation,
                                                                abs=1e-14)
            assert one.pose(frame).rotation == pytest.approx(other.pose(frame).rotation, abs=1e-14)
    for link, copy in zip(model.links, back.links):
        for shape, same in zip(link.visuals + link.collisions, copy.visuals + copy.collisions):
            assert (shape.name, shape.geometry) == (same.name, same.geometry)
            assert one.placement_pose(shape.placement).translation == pytest.approx(
                other.placement_pose(same.placement).translation, abs=1e-14)
    assert [replace(joint, placement=model.joints[0].placement) for joint in back.joints] == [
        replace(joint, placement=model.joints[0].placement) for joint in model.joints]
    assert back.canonical_link == 'b'
    assert back.links[1].visuals[0].extension.sdf is not None
    assert back.links[1].extension.sdf is not None
    sensors = {part.get('name'): part for part in back.links[1].extension.sdf}
    assert [float(word) for word in sensors['s'].findtext('pose', '').split()] == pytest.approx(
        [1, 2, 3, 0, 0, 0], abs=1e-14)
    assert sensors['t'].find('pose') is None
    turned = one.within(FrameId('link', 'b'), Placement(
        Pose((0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2)), FrameId('frame', 'f')))
    assert [float(word) for word in sensors['u'].findtext('pose', '').split()] == pytest.approx(
        [*turned.xyz, *turned.rpy], abs=1e-14)
    reported = {(note.element, note.name) for note in report.warnings}
    assert reported == {('visual', 's'), ('joint', 'k'), ('joint', 'l'), ('joint', 'm')}
    assert {note.element for note in report.notes if note.level == 'preserved'} == {
        '@canonical_link', 'geometry', 'pose', 'odd', 'axis', 'axis2', 'frame', 'sensor',
        'static'}


def test_second_writing_has_the_same_tags() -> None:
    first = written(robot_of_sdf())
    second = written(read_urdf(first, Report()))
    assert sorted(str(element.tag) for element in second.iter()) == sorted(
        str(element.tag) for element in first.iter())


def test_several_roots_are_refused() -> None:
    model = replace(robot_of_sdf(), joints=())
    with pytest.raises(DescriptionError, match="sdf_to_urdf --root: 'a', 'b', 'c'"):
        convert_to_urdf(model, Report())


def test_unused_namespaces_are_not_declared() -> None:
    assert b'xmlns' not in to_bytes(write_urdf(read('<link name="a"/>'), Report()))


@pytest.fixture(name='load')
def yourdfpy_loader(tmp_path: Path) -> Callable[[Robot], Any]:
    """Return a function that loads a written robot with yourdfpy."""
    yourdfpy = pytest.importorskip(
        'yourdfpy', reason='not packaged for ROS: pip install yourdfpy')

    def load_robot(model: Robot) -> Any:
        path = tmp_path / 'r.urdf'
        path.write_bytes(to_bytes(write_urdf(model, Report())))
        loaded = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
        assert loaded.validate()
        return loaded

    return load_robot


def test_frames_of_links_in_yourdfpy(load: Callable[[Robot], Any]) -> None:
    model = robot_of_sdf()
    kinematics = Kinematics(model)
    loaded = load(model)
    for link in ('b', 'c'):
        frame = FrameId('joint', kinematics.parent_joint[link].name)
        pose = kinematics.between(FrameId('link', 'a'), frame).transform()
        matrix = loaded.get_transform(link, 'a')
        assert matrix[:3, 3] == pytest.approx(pose.translation, abs=1e-12)
        assert matrix[:3, :3].ravel() == pytest.approx(pose.rotation, abs=1e-12)


def test_numbers_in_yourdfpy(load: Callable[[Robot], Any]) -> None:
    model = read(f"""<material name="m"><color rgba="0.9 0 0.1 1"/></material>
        <link name="a"><visual name="v"><origin xyz="1 2 3" rpy="0 1.5707963267948966 0"/>
        <geometry><mesh filename="package://p/a.stl" scale="1 2 0.123456789"/></geometry>
        <material name="m"/></visual></link><link name="b"/>
        <joint name="j" type="revolute">{ENDS}<axis xyz="0 0 2"/><limit lower="-1" upper="1"
        effort="3" velocity="4"/><mimic joint="k" multiplier="-2"/></joint><link name="c"/>
        <joint name="k" type="prismatic"><parent link="b"/><child link="c"/><limit lower="0"
        upper="1e16" effort="1" velocity="1"/></joint>""")
    loaded = load(model).robot
    shape = loaded.links[0].visuals[0]
    assert shape.geometry.mesh.filename == 'package://p/a.stl'
    assert list(shape.geometry.mesh.scale) == [1, 2, 0.123456789]
    assert list(shape.material.color.rgba) == [0.9, 0, 0.1, 1]
    joints = {one.name: one for one in loaded.joints}
    assert joints['j'].mimic.multiplier == -2
    assert joints['k'].limit.upper == 1e16


@each_row(('kind', 'limit', 'written_limit'), [
    ('revolute', {'lower': '-1', 'upper': '1', 'effort': '-1', 'velocity': '-2.5'}, {}),
    ('prismatic', {'lower': '-1', 'upper': '1', 'effort': '-1', 'velocity': '3'}, {}),
    ('continuous', {'effort': '-1', 'velocity': '-1'}, {}),
    ('continuous', {'lower': '-1', 'upper': '1', 'effort': '-1', 'velocity': '-1'}, {}),
    ('continuous', {'lower': '-1', 'upper': '1', 'effort': '1e20', 'velocity': '1e18'},
     {'effort': '1e+16', 'velocity': '1e+16'}),
    ('revolute', {'lower': '-1', 'upper': '1', 'effort': '-1e20', 'velocity': '1e400'},
     {'effort': '1e+16', 'velocity': '1e+16'}),
    ('revolute', {'lower': '-1e16', 'upper': '1e17', 'effort': '1', 'velocity': '1'},
     {'lower': '-1e+16', 'upper': '1e+16'}),
])
def test_limits_after_conversion_to_sdf_and_back(
        kind: str, limit: dict[str, str], written_limit: dict[str, str]) -> None:
    words = ' '.join(f'{name}="{value}"' for name, value in limit.items())
    report = Report()
    content = joint(f'<axis xyz="0 0 1"/><limit {words}/>', kind)
    root = through_sdf(content, report)
    found = root.find('joint')
    assert found is not None and found.get('type') == kind
    assert [dict(one.attrib) for one in found.findall('limit')] == [{**limit, **written_limit}]
    assert report.warnings == []
    found = differences(read(content), read_urdf(root, Report()))
    assert [one for one in found if one.element == 'joint'] == []


def test_robot_name_without_double_colons() -> None:
    text = '<sdf version="1.7"><model name="a::b"><link name="a"/></model></sdf>'
    report = Report()
    model = read_sdf(parse(text.encode(), 'r.sdf', Report()), Report())
    assert convert_to_urdf(model, report, UrdfOptions(inertial='zero')).get('name') == 'a__b'
    assert [note.name for note in report.warnings] == ['a::b']


@each_row(('written_geometry', 'geometry'), [
    ('<box size="1 2 3"/>', Box((1.0, 2.0, 3.0))),
    ('<sphere radius="0.1"/>', Sphere(0.1)),
    ('<cylinder radius="1" length="2"/>', Cylinder(1.0, 2.0)),
    ('<capsule radius="1" length="2"/>', Capsule(1.0, 2.0)),
    ('<mesh filename="package://p/a b.stl"/>', Mesh('package://p/a b.stl')),
    ('<mesh filename="a" scale="1 1 0.123456789012345"/>', Mesh('a', (1.0, 1.0,
                                                                      0.123456789012345))),
])
@each_row('tag', ['visual', 'collision'])
def test_geometry_in_a_round_trip(written_geometry: str, geometry: object, tag: str) -> None:
    model = read(visual(f'<origin xyz="0.1 0 0"/><geometry>{written_geometry}</geometry>', tag))
    shape = (model.links[0].visuals + model.links[0].collisions)[0]
    assert shape.geometry == geometry
    assert shape.placement == Placement(Pose((0.1, 0.0, 0.0)), FrameId('link', 'a'))
    assert round_trip(model) == model


def test_subnormal_numbers_are_zero() -> None:
    model = read(joint('<origin xyz="1e-320 0 2.3e-308"/>', 'fixed'))
    origin = written(model).find('joint/origin')
    assert origin is not None
    assert origin.get('xyz') == '0 0 2.3e-308'


def test_identity_origin_is_not_written() -> None:
    model = read(joint('<origin xyz="0 0 0" rpy="0 0 0"/>', 'fixed'))
    assert not [*written(model).iter('origin')]
