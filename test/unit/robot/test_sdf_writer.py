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

"""Writer of SDF: links, joints, frames, the world and extensions in every version."""

from __future__ import annotations

from dataclasses import replace
import math

from lxml import etree
from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Geometry, Material, Mesh, Sphere
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import (
    Axis, Extension, FrameId, Inertial, Limit, Link, Mimic, MODEL, Placement, Robot, RobotFrame,
    Shape)
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.fragments import frame_to_element
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.xml.document import DescriptionError, parse
from opencv_tools.robot.xml.report import Report
import pytest
from rows import each_row
from sdf_models import (
    HALF, reread, TURNED, urdf_robot, VERSIONS, with_axis, with_geometry, with_shape, written)


def test_link_poses_without_zero_poses() -> None:
    model = written(urdf_robot())
    poses = model.xpath('link/pose')
    assert [pose.getparent().get('name') for pose in poses] == ['arm', 'hand']
    assert poses[0].text == '0.1 0.2 0.3 0 0 1.5708' and not poses[0].attrib
    assert model.find('joint/pose') is None
    assert model.findtext('joint/parent') == 'base' and model.findtext('joint/child') == 'arm'


def test_relative_poses_keep_their_numbers() -> None:
    poses = written(urdf_robot(), relative=True).xpath('link/pose')
    assert [(pose.get('relative_to'), pose.text) for pose in poses] == [
        ('base', '0.1 0.2 0.3 0 0 1.5708'), ('arm', '0.1 0.2 0.3 0 0 1.5708')]


def test_world_is_not_a_link() -> None:
    robot = urdf_robot()
    links = (replace(robot.links[0], name='world'), *robot.links[1:])
    joints = (replace(robot.joints[0], parent='world', placement=Placement(
        TURNED, FrameId('link', 'world'))), robot.joints[1])
    robot = replace(robot, links=links, joints=joints)
    model = written(robot, relative=True)
    assert model.xpath('link/@name') == ['arm', 'hand']
    assert model.findtext('joint/parent') == 'world'
    assert model.xpath('link/pose/@relative_to') == ['arm']
    assert {link.name for link in reread(robot).links} == {'world', 'arm', 'hand'}


def test_errors_of_robots() -> None:
    world = Link(name='world', placement=Placement(Pose(), MODEL))
    with pytest.raises(DescriptionError, match='has no links'):
        written(Robot(name='r', links=(world,)))
    robot = urdf_robot()
    robot = replace(robot, links=(*robot.links[:2], replace(
        world, placement=robot.links[2].placement)), joints=(robot.joints[0], replace(
            robot.joints[1], child='world')))
    with pytest.raises(DescriptionError, match="has the child 'world'"):
        written(robot)


def test_frames() -> None:
    frame = RobotFrame(name='tip', attached_to=FrameId('link', 'hand'),
                       placement=Placement(TURNED, FrameId('link', 'hand')))
    robot = urdf_robot(frames=(frame,), canonical_link='hand')
    report = Report()
    model = written(robot, report)
    made = model.find('frame')
    assert made is not None and dict(made.attrib) == {'name': 'tip', 'attached_to': 'hand'}
    assert made.findtext('pose') == '0.1 0.2 0.3 0 0 1.5708' and not report.notes
    assert model.get('canonical_link') == 'hand'
    assert reread(robot, '1.7').frames == (frame,)


def test_frame_attached_to_an_unsupported_joint() -> None:
    frame = RobotFrame(name='tip', attached_to=FrameId('joint', 'hand_joint'),
                       placement=Placement(Pose(), FrameId('joint', 'hand_joint')))
    made = written(urdf_robot('floating', frames=(frame,))).find('frame')
    assert made is not None and made.get('attached_to') == 'hand'
    kept = frame_to_element(frame, Pose())
    assert kept.get('attached_to') == 'hand_joint'


def test_restored_and_preserved_extensions() -> None:
    robot = urdf_robot(extension=Extension(
        urdf=etree.fromstring('<robot version="1"><transmission name="t"/></robot>'),
        sdf=etree.fromstring('<model><static>true</static><plugin name="p"/></model>')))
    link = replace(robot.links[0], extension=Extension(
        urdf=etree.fromstring('<link name="x"/>'),
        sdf=etree.fromstring('<link><pose/><sensor><pose relative_to="arm"/></sensor></link>')))
    robot = replace(robot, links=(link, *robot.links[1:]))
    report = Report()
    model = written(robot, report)
    assert model.findtext('static') == 'true'
    kept = model.find('{urn:opencv_tools:preserved}urdf')
    assert kept is not None and kept.find('transmission') is not None
    assert kept.get('version') == '1'
    assert model[0].get('{urn:opencv_tools:urdf}name') == 'x'
    assert [(note.level, note.element) for note in report.notes] == [
        ('preserved', '@version'), ('preserved', 'transmission')]
    assert model.xpath('link/sensor/pose/@relative_to') == ['arm']
    # Extensions are not changed.
    assert link.extension.sdf is not None
    assert link.extension.sdf.xpath('sensor/pose/@relative_to') == ['arm']


@each_row('geometry', [
    Box((1.0, 2.0, 0.1)), Sphere(0.5), Cylinder(1.0, 2.0), Capsule(1.0, 2.0), Mesh('model://a/b'),
    Mesh('b.stl', (0.001, 0.001, 1 / 3))])
def test_round_trip_of_geometries(geometry: Geometry) -> None:
    for version in ('1.7', '1.8', '1.12'):
        assert reread(with_geometry(geometry), version).links[0].visuals[0].geometry == geometry


def test_capsule_becomes_a_cylinder_before_1_8() -> None:
    report = Report()
    model = written(with_geometry(Capsule(1.0, 2.0)), report, '1.7')
    assert model.findtext('.//cylinder/length') == '4'
    assert [note.element for note in report.warnings] == ['capsule']


def test_restored_geometry() -> None:
    rest = etree.fromstring(
        '<visual><geometry><plane><size>1 1</size></plane></geometry></visual>')
    shape = Shape(name='v', placement=Placement(Pose(), FrameId('link', 'a')), geometry=None,
                  extension=Extension(sdf=rest))
    assert len(written(with_shape(shape)).findall('.//geometry')) == 1
    assert written(with_shape(shape)).findtext('.//geometry/plane/size') == '1 1'
    assert written(with_geometry(None)).find('.//geometry/empty') is not None


def test_material_merged_with_unread_parts() -> None:
    rest = etree.fromstring(
        '<visual xmlns:c="urn:opencv_tools:preserved"><material c:part="true"><script/>'
        '<pbr c:part="true"><metal c:part="true"><roughness>1</roughness></metal></pbr></material>'
        '<transparency>0.5</transparency></visual>')
    material = Material(name='red', color=(1.0, 0.0, 0.0, 1.0), specular=(0.1, 0.2, 0.9, 1.0),
                        texture='a.png')
    shape = Shape(name='v', placement=Placement(TURNED, FrameId('link', 'a')),
                  geometry=Sphere(1.0), material=material, extension=Extension(sdf=rest))
    made = written(with_shape(shape)).find('link/visual')
    assert made is not None
    assert made.findtext('pose') == '0.1 0.2 0.3 0 0 1.5708'
    assert made.find('material').get('{urn:opencv_tools:urdf}name') == 'red'  # type: ignore
    assert made.findtext('material/diffuse') == '1 0 0 1'
    assert made.findtext('material/specular') == '0.1 0.2 0.9 1'
    assert made.find('material/ambient') is None and made.find('material/script') is not None
    assert [child.tag for child in made.find('material/pbr/metal')] == [  # type: ignore
        'albedo_map', 'roughness']
    assert made.findtext('transparency') == '0.5'


def test_inertial() -> None:
    link = Link(name='a', placement=Placement(Pose(), MODEL), inertial=Inertial(
        Placement(TURNED, FrameId('link', 'a')), 0.1, (1.0, 0.1, 0.2, 2.0, 0.3, 3.0)))
    made = written(Robot(name='r', links=(link,))).find('link/inertial')
    assert made is not None
    assert [child.text for child in made.iter() if not len(child)] == [
        '0.1 0.2 0.3 0 0 1.5708', '0.1', '1', '0.1', '0.2', '2', '0.3', '3']


def test_second_inertial_stays_separate() -> None:
    text = ('<sdf version="1.11"><model name="m"><link name="a"><inertial><mass>2</mass>'
            '</inertial><inertial><inertia><ixx>3</ixx></inertia></inertial></link></model></sdf>')
    link = written(read_sdf(parse(text.encode(), '', Report()), Report())).find('link')
    assert link is not None
    assert [inertial.findtext('mass') for inertial in link] == ['2', None]
    assert link.xpath('inertial/inertia/ixx/text()') == ['1', '3']


def test_pose_of_a_joint_away_from_its_child() -> None:
    robot = urdf_robot()
    links = (*robot.links[:1], *(replace(link, placement=replace(
        link.placement, pose=Pose((1.0, 0.0, 0.0)))) for link in robot.links[1:]))
    assert written(replace(robot, links=links)).findtext('joint/pose') == '-1 0 0 0 0 0'


@each_row('version', VERSIONS)
@each_row('kind', ['fixed', 'revolute', 'continuous', 'prismatic', 'floating',
                   'planar', 'screw'])
def test_round_trip_of_joint_types_by_version(version: str, kind: str) -> None:
    robot = urdf_robot(kind)
    limit = Limit(-1.0, 2.0) if kind == 'revolute' else None
    robot = replace(robot, joints=tuple(replace(joint, axes=tuple(
        replace(axis, limit=limit) for axis in joint.axes)) for joint in robot.joints))
    other = reread(robot, version)
    assert [joint.type for joint in other.joints] == [kind, kind]
    assert [joint.axes for joint in other.joints] == [joint.axes for joint in robot.joints]
    for link in robot.links:
        frame = FrameId('link', link.name)
        one, two = Kinematics(robot).pose(frame), Kinematics(other).pose(frame)
        assert math.dist((*one.rotation, *one.translation),
                         (*two.rotation, *two.translation)) < 1e-12


def test_unit_axis_in_the_joint_frame() -> None:
    robot = with_axis(Axis((3.0, 0.0, 4.0)))
    robot = replace(robot, joints=(replace(robot.joints[0], placement=Placement(
        Pose(rpy=(0.0, 0.0, HALF)), FrameId('link', 'base'))), robot.joints[1]))
    element = written(robot).find('joint/axis/xyz')
    assert element is not None
    assert tuple(map(float, (element.text or '').split())) == pytest.approx((0.6, 0.0, 0.8))
    assert element.get('{urn:opencv_tools:urdf}xyz') == '3 0 4'


def test_mimic_by_version() -> None:
    robot = with_axis(Axis((0.0, 0.0, 1.0), Limit(0.0, 1.0), mimic=Mimic('hand_joint', 2.0, 0.1)))
    report = Report()
    mimic = written(robot, report).find('joint/axis/mimic')
    assert mimic is not None and mimic.get('joint') == 'hand_joint' and not report.notes
    assert [child.text for child in mimic] == ['2', '0.1', '0']
    old = written(robot, report, '1.10')
    assert old.find('joint/axis/mimic') is None
    assert dict(old.find('joint/{urn:opencv_tools:urdf}mimic').attrib) == {  # type: ignore
        'joint': 'hand_joint', 'multiplier': '2', 'offset': '0.1'}
    assert [note.level for note in report.notes] == ['preserved']
    for version in ('1.10', '1.11'):
        assert reread(robot, version).joints[0].axes == robot.joints[0].axes


@pytest.mark.parametrize('kind', ['floating', 'planar'])
def test_unsupported_joint_types(kind: str) -> None:
    report = Report()
    model = written(urdf_robot(kind), report, relative=True)
    assert not model.findall('joint')
    assert model.find('{urn:opencv_tools:urdf}joint').get('type') == kind  # type: ignore
    assert model.xpath('link[@name="arm"]/pose/@relative_to') == ['base']
    assert [note.name for note in report.warnings] == ['arm_joint', 'hand_joint']


def test_round_trip_of_an_unlimited_revolute_joint() -> None:
    robot = with_axis(Axis((0.0, 0.0, 1.0), Limit(effort=1.0, velocity=2.0)))
    for version in VERSIONS:
        result = reread(robot, version).joints[0]
        assert (result.type, result.axes) == ('revolute', robot.joints[0].axes)
        assert written(robot, version=version).find('joint').get('type') == (  # type: ignore
            'revolute')
