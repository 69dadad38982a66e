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

from __future__ import annotations

from dataclasses import replace
import math
from pathlib import Path

from lxml import etree
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf
from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Geometry, Material, Mesh, Sphere
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.model import (
    Axis, Dynamics, Extension, Frame, FrameId, Inertial, Joint, Limit, Link, Mimic, MODEL,
    Placement, Robot, Shape)
from opencv_tools.robot.pose import Pose, Tensor
from opencv_tools.robot.sdf.fragments import axis_to_element, frame_to_element
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.sdf.writer import write_sdf
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.xml.document import DescriptionError, Element, parse, to_bytes
from opencv_tools.robot.xml.numbers import number_text
from opencv_tools.robot.xml.report import Report
import pytest
import robots

DATA = Path(__file__).parents[2] / 'data' / 'robots'
BLACK = (0.0, 0.0, 0.0, 1.0)
HALF = math.pi / 2
TURNED = Pose((0.1, 0.2, 0.3), (0.0, 0.0, 1.5708))
VERSIONS = [f'1.{minor}' for minor in range(4, 13)]


def urdf_robot(kind: str = 'revolute', **changes: object) -> Robot:
    """Build three links in a row, as URDF places them."""
    links = [Link('base', Placement(Pose(), MODEL))]
    joints = []
    for name, parent in (('arm', 'base'), ('hand', 'arm')):
        joints.append(Joint(f'{name}_joint', kind, parent, name,
                            Placement(TURNED, FrameId('link', parent)),
                            () if kind == 'fixed' else (Axis((1.0, 0.0, 0.0)),)))
        links.append(Link(name, Placement(Pose(), FrameId('joint', f'{name}_joint'))))
    robot = Robot('robot', tuple(links), tuple(joints))
    return replace(robot, **changes)  # type: ignore[arg-type]


def written(robot: Robot, report: Report | None = None, version: str = '1.11',
            relative: bool = False) -> Element:
    """Give the model that is written."""
    root = write_sdf(robot, report or Report(), version=version, relative=relative)
    assert root.get('version') == version
    return root[0]


def again(robot: Robot, version: str = '1.11', relative: bool = False) -> Robot:
    """Give what is read of what is written."""
    root = write_sdf(robot, Report(), version=version, relative=relative)
    return read_sdf(parse(to_bytes(root), '', Report()), Report())


def with_axis(axis: Axis, kind: str = 'revolute') -> Robot:
    robot = urdf_robot()
    return replace(robot, joints=(replace(robot.joints[0], type=kind, axes=(axis,)),
                                  robot.joints[1]))


def with_shape(shape: Shape) -> Robot:
    return Robot('robot', (Link('a', Placement(Pose(), MODEL), visuals=(shape,)),))


def with_geometry(geometry: Geometry | None) -> Robot:
    return with_shape(Shape('v', Placement(Pose(), FrameId('link', 'a')), geometry))


def test_links_are_placed_in_the_model_and_zero_poses_are_left_out() -> None:
    model = written(urdf_robot())
    poses = model.xpath('link/pose')
    assert [pose.getparent().get('name') for pose in poses] == ['arm', 'hand']
    assert poses[0].text == '0.1 0.2 0.3 0 0 1.5708' and not poses[0].attrib
    assert model.find('joint/pose') is None
    assert model.findtext('joint/parent') == 'base' and model.findtext('joint/child') == 'arm'


def test_relative_poses_have_the_numbers_as_they_were_written() -> None:
    poses = written(urdf_robot(), relative=True).xpath('link/pose')
    assert [(pose.get('relative_to'), pose.text) for pose in poses] == [
        ('base', '0.1 0.2 0.3 0 0 1.5708'), ('arm', '0.1 0.2 0.3 0 0 1.5708')]


def test_joint_away_from_its_child_has_a_pose() -> None:
    robot = urdf_robot()
    links = (*robot.links[:1], *(replace(link, placement=replace(
        link.placement, pose=Pose((1.0, 0.0, 0.0)))) for link in robot.links[1:]))
    assert written(replace(robot, links=links)).findtext('joint/pose') == '-1 0 0 0 0 0'


@pytest.mark.parametrize('version', VERSIONS)
@pytest.mark.parametrize('kind', ['fixed', 'revolute', 'continuous', 'prismatic', 'floating',
                                  'planar', 'screw'])
def test_every_version_reads_back_the_same(version: str, kind: str) -> None:
    robot = urdf_robot(kind)
    limit = Limit(-1.0, 2.0) if kind == 'revolute' else None
    robot = replace(robot, joints=tuple(replace(joint, axes=tuple(
        replace(axis, limit=limit) for axis in joint.axes)) for joint in robot.joints))
    other = again(robot, version)
    assert [joint.type for joint in other.joints] == [kind, kind]
    assert [joint.axes for joint in other.joints] == [joint.axes for joint in robot.joints]
    for link in robot.links:
        frame = FrameId('link', link.name)
        one, two = Kinematics(robot).pose(frame), Kinematics(other).pose(frame)
        assert math.dist((*one.rotation, *one.translation),
                         (*two.rotation, *two.translation)) < 1e-12


@pytest.mark.parametrize('version', ['1.3', '1.13', '2.0', 'x', '1'])
def test_versions_that_are_not_written(version: str) -> None:
    with pytest.raises(DescriptionError, match=r'1[.]4 to 1[.]12'):
        write_sdf(urdf_robot(), Report(), version=version)


def test_old_versions_have_no_relative_poses() -> None:
    with pytest.raises(DescriptionError, match=r'use version 1[.]7'):
        write_sdf(urdf_robot(), Report(), version='1.6', relative=True)


@pytest.mark.parametrize(('version', 'xyz'), [('1.4', (0.0, 0.6, 0.8)), ('1.5', (0.6, 0.0, 0.8))])
def test_axes_are_of_unit_length_and_in_the_frame_of_the_version(
        version: str, xyz: tuple[float, ...]) -> None:
    robot = with_axis(Axis((3.0, 0.0, 4.0)))
    robot = replace(robot, joints=(replace(robot.joints[0], placement=Placement(
        Pose(rpy=(0.0, 0.0, HALF)), FrameId('link', 'base'))), robot.joints[1]))
    element = written(robot, version=version).find('joint/axis/xyz')
    assert element is not None
    assert tuple(map(float, (element.text or '').split())) == pytest.approx(xyz)
    assert element.get('{urn:opencv_tools:urdf}xyz') == '3 0 4'


def test_limits_that_there_are() -> None:
    axis = written(with_axis(Axis((0.0, 0.0, 1.0), Limit(-1.0, effort=5.0),
                                  Dynamics(friction=0.1)))).find('joint/axis')
    assert axis is not None
    assert [(child.tag, child.text) for child in axis.iter() if not len(child)] == [
        ('xyz', '0 0 1'), ('lower', '-1'), ('effort', '5'), ('friction', '0.1')]


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
        assert again(robot, version).joints[0].axes == robot.joints[0].axes


@pytest.mark.parametrize('kind', ['floating', 'planar'])
def test_joints_that_sdf_does_not_have(kind: str) -> None:
    report = Report()
    model = written(urdf_robot(kind), report, relative=True)
    assert not model.findall('joint')
    assert model.find('{urn:opencv_tools:urdf}joint').get('type') == kind  # type: ignore
    assert model.xpath('link[@name="arm"]/pose/@relative_to') == ['base']
    assert [note.name for note in report.warnings] == ['arm_joint', 'hand_joint']


def test_fixed_and_continuous_joints_of_old_versions() -> None:
    report = Report()
    model = written(urdf_robot('fixed'), report, '1.4')
    assert model.xpath('joint/@type') == ['revolute'] * 2
    assert [child.text for child in model.find('joint/axis/limit')] == ['0', '0']  # type: ignore
    assert len(report.warnings) == 2
    model = written(urdf_robot('continuous'), report, '1.5')
    assert model.xpath('joint/@type') == ['revolute'] * 2 and not model.xpath('//limit')
    assert len(report.warnings) == 2


@pytest.mark.parametrize('geometry', [
    Box((1.0, 2.0, 0.1)), Sphere(0.5), Cylinder(1.0, 2.0), Capsule(1.0, 2.0), Mesh('model://a/b'),
    Mesh('b.stl', (0.001, 0.001, 1 / 3))])
def test_geometries_read_back_the_same(geometry: Geometry) -> None:
    for version in ('1.4', '1.7', '1.8', '1.12'):
        assert again(with_geometry(geometry), version).links[0].visuals[0].geometry == geometry


def test_capsule_of_old_versions_is_a_cylinder_as_long() -> None:
    report = Report()
    model = written(with_geometry(Capsule(1.0, 2.0)), report, '1.7')
    assert model.findtext('.//cylinder/length') == '4'
    assert [note.element for note in report.warnings] == ['capsule']


def test_geometry_that_urdf_has_no_word_for_is_put_back() -> None:
    rest = etree.fromstring(
        '<visual><geometry><plane><size>1 1</size></plane></geometry></visual>')
    shape = Shape('v', Placement(Pose(), FrameId('link', 'a')), None,
                  extension=Extension(sdf=rest))
    assert len(written(with_shape(shape)).findall('.//geometry')) == 1
    assert written(with_shape(shape)).findtext('.//geometry/plane/size') == '1 1'
    assert written(with_geometry(None)).find('.//geometry/empty') is not None


def test_material_and_what_is_left_of_it() -> None:
    rest = etree.fromstring(
        '<visual xmlns:c="urn:opencv_tools:preserved"><material c:part="true"><script/>'
        '<pbr c:part="true"><metal c:part="true"><roughness>1</roughness></metal></pbr></material>'
        '<transparency>0.5</transparency></visual>')
    material = Material('red', (1.0, 0.0, 0.0, 1.0), specular=(0.1, 0.2, 0.9, 1.0),
                        texture='a.png')
    shape = Shape('v', Placement(TURNED, FrameId('link', 'a')), Sphere(1.0), material,
                  Extension(sdf=rest))
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


def test_texture_of_old_versions_is_kept() -> None:
    shape = Shape('v', Placement(Pose(), FrameId('link', 'a')), Sphere(1.0),
                  Material(texture='a.png'))
    report = Report()
    assert written(with_shape(shape), report, '1.5').find('.//pbr') is None
    assert [note.level for note in report.notes] == ['preserved']
    assert again(with_shape(shape), '1.5').links[0].visuals == (shape,)


def test_inertial_is_placed_in_its_link() -> None:
    link = Link('a', Placement(Pose(), MODEL), Inertial(
        Placement(TURNED, FrameId('link', 'a')), 0.1, (1.0, 0.1, 0.2, 2.0, 0.3, 3.0)))
    made = written(Robot('r', (link,))).find('link/inertial')
    assert made is not None
    assert [child.text for child in made.iter() if not len(child)] == [
        '0.1 0.2 0.3 0 0 1.5708', '0.1', '1', '0.1', '0.2', '2', '0.3', '3']


def test_world_is_no_link() -> None:
    robot = urdf_robot()
    links = (replace(robot.links[0], name='world'), *robot.links[1:])
    joints = (replace(robot.joints[0], parent='world', placement=Placement(
        TURNED, FrameId('link', 'world'))), robot.joints[1])
    robot = replace(robot, links=links, joints=joints)
    model = written(robot, relative=True)
    assert model.xpath('link/@name') == ['arm', 'hand']
    assert model.findtext('joint/parent') == 'world'
    assert model.xpath('link/pose/@relative_to') == ['arm']
    assert {link.name for link in again(robot).links} == {'world', 'arm', 'hand'}


def test_robots_that_sdf_cannot_have() -> None:
    world = Link('world', Placement(Pose(), MODEL))
    with pytest.raises(DescriptionError, match='has no links'):
        written(Robot('r', (world,)))
    robot = urdf_robot()
    robot = replace(robot, links=(*robot.links[:2], replace(
        world, placement=robot.links[2].placement)), joints=(robot.joints[0], replace(
            robot.joints[1], child='world')))
    with pytest.raises(DescriptionError, match="has the child 'world'"):
        written(robot)


def test_frames_by_version() -> None:
    frame = Frame('tip', FrameId('link', 'hand'), Placement(TURNED, FrameId('link', 'hand')))
    robot = urdf_robot(frames=(frame,), canonical_link='hand')
    report = Report()
    model = written(robot, report)
    made = model.find('frame')
    assert made is not None and dict(made.attrib) == {'name': 'tip', 'attached_to': 'hand'}
    assert made.findtext('pose') == '0.1 0.2 0.3 0 0 1.5708' and not report.notes
    assert model.get('canonical_link') == 'hand'
    old = written(robot, report, '1.6')
    assert old.find('frame') is None and old.get('canonical_link') is None
    assert [note.element for note in report.warnings] == ['model', 'frame']
    assert again(robot, '1.6').frames == (frame,)


def test_frame_on_a_joint_that_sdf_does_not_have_is_on_its_child() -> None:
    frame = Frame('tip', FrameId('joint', 'hand_joint'),
                  Placement(Pose(), FrameId('joint', 'hand_joint')))
    made = written(urdf_robot('floating', frames=(frame,))).find('frame')
    assert made is not None and made.get('attached_to') == 'hand'
    kept = frame_to_element(frame, Kinematics(urdf_robot('floating', frames=(frame,))))
    assert kept.get('attached_to') == 'hand_joint'


def test_what_is_carried_goes_back_or_into_its_namespace() -> None:
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
    old = written(robot, report, '1.6')
    assert old.xpath('link/sensor/pose/@frame') == ['arm']
    # What is carried is never changed.
    assert link.extension.sdf is not None
    assert link.extension.sdf.xpath('sensor/pose/@relative_to') == ['arm']


def test_limits_that_mean_nothing_do_not_come_to_mean_something() -> None:
    robot = urdf_robot('continuous')
    rest = etree.fromstring('<joint xmlns:c="urn:opencv_tools:preserved"><axis c:part="true">'
                            '<limit><lower>-1</lower><effort>2</effort></limit></axis></joint>')
    robot = replace(robot, joints=tuple(
        replace(one, extension=Extension(sdf=rest)) for one in robot.joints))
    for version, lower in (('1.5', None), ('1.6', '-1')):
        report = Report()
        made = written(robot, report, version).find('joint')
        assert made is not None and made.findtext('axis/limit/lower') == lower
        assert made.findtext('axis/limit/effort') == '2'
        reported = [note.element for note in report.warnings]
        assert reported == ([] if lower else ['lower'] * len(robot.joints))


def test_axis_for_others() -> None:
    made = axis_to_element(Axis((0.0, 0.0, 2.0), mimic=Mimic('j')), 'axis2', (1, 12))
    assert made.tag == 'axis2' and made.findtext('xyz') == '0 0 1'
    assert made.find('mimic') is not None
    assert axis_to_element(Axis((0.0, 0.0, 2.0), mimic=Mimic('j')), 'axis', (1, 9)).find(
        'mimic') is None


def test_second_inertial_stays_apart_from_the_first() -> None:
    text = ('<sdf version="1.11"><model name="m"><link name="a"><inertial><mass>2</mass>'
            '</inertial><inertial><inertia><ixx>3</ixx></inertia></inertial></link></model></sdf>')
    link = written(read_sdf(parse(text.encode(), '', Report()), Report())).find('link')
    assert link is not None
    assert [inertial.findtext('mass') for inertial in link] == ['2', None]
    assert link.xpath('inertial/inertia/ixx/text()') == ['1', '3']


def checked_names(element: Element) -> None:
    """Check what libsdformat checks: names without '::', and once among the children."""
    if element.tag == 'plugin' or '{' in element.tag:
        return
    assert '::' not in element.get('name', '')
    names = [child.get('name') for child in element if child.get('name') and child.tag != 'plugin']
    assert len(set(names)) == len(names)
    for child in element:
        checked_names(child)


@pytest.mark.parametrize('fixture', [
    'warning_robot_name_with_double_colon.urdf', 'warning_robot_name_reserved.urdf',
    'warning_sensor_name_with_double_colon.urdf', 'warning_sensors_of_one_name.urdf',
    'warning_contact_of_a_renamed_collision.urdf'])
@pytest.mark.parametrize('version', ['1.4', '1.9', '1.12'])
def test_names_that_sdf_allows_and_those_of_before(fixture: str, version: str) -> None:
    path = DATA / 'urdf' / fixture
    robot, _ = read_robot(str(path), Report())
    root = convert_to_sdf(robot, Report(), version=version)
    model = root[0]
    checked_names(root)
    assert not {'world', '__lamp__'} & {name.get('name') for name in (model, *model.iter('light'))}
    read = read_sdf(parse(to_bytes(root), '', Report()), Report())
    back = convert_to_urdf(read, Report())
    before = parse(path.read_bytes(), '', Report())
    assert sorted(before.xpath('//@name')) == sorted(
        name for name in back.xpath('//@name') if name)
    assert before.xpath('//contact/collision/text()') == back.xpath('//contact/collision/text()')


@pytest.mark.parametrize(('content', 'words'), robots.PARTS_OF_SDF)
def test_values_that_sdf_refuses_stay_in_their_block(content: str, words: str) -> None:
    report = Report()
    text = f'<robot name="r"><link name="a"/><gazebo reference="a">{content}</gazebo></robot>'
    robot = read_urdf(parse(text.encode(), '', report), report)
    flaws = [note.message for note in report.warnings]
    root = convert_to_sdf(robot, report, inertial='zero')
    tag = etree.fromstring(content).tag
    if not words:
        assert flaws == [] and root.find(f'model/link/{tag}') is not None
        return
    assert len(flaws) == 1 and words in flaws[0]
    assert root.find(f'model/link/{tag}') is None
    read = read_sdf(parse(to_bytes(root), '', Report()), Report())
    back = convert_to_urdf(read, Report())
    assert back.xpath('gazebo/@reference') == ['a']
    kept, before = back.xpath('gazebo/*')[0], etree.fromstring(content)
    assert [(one.tag, one.attrib, one.text) for one in kept.iter() if not len(one)] == [
        (one.tag, one.attrib, one.text) for one in before.iter() if not len(one)]


def test_colors_beyond_1_are_cut_and_come_back_unless_changed() -> None:
    color = (1.5, 0.5, -1.0, 1.0)
    shape = Shape('v', Placement(Pose(), FrameId('link', 'a')), Sphere(1.0), Material(
        'red', color, color, BLACK, BLACK))
    report = Report()
    root = convert_to_sdf(with_shape(shape), report, inertial='zero')
    assert root.findtext('.//diffuse') == root.findtext('.//ambient') == '1 0.5 0 1'
    assert [note.element for note in report.warnings] == ['ambient']
    assert "'1.5 0.5 -1 1' is outside of 0 to 1" in report.warnings[0].message
    read = read_sdf(parse(to_bytes(root), '', Report()), Report())
    assert read.links[0].visuals[0].material == shape.material
    for element in root.iter('ambient', 'diffuse'):
        element.text = '0 0 1 1'
    material = read_sdf(root, Report()).links[0].visuals[0].material
    assert material is not None and material.color == material.ambient == (0.0, 0.0, 1.0, 1.0)


@pytest.mark.parametrize(('mass', 'inertia'), [
    (1.0, (1.0, 0.0, 0.0, 1.0, 0.0, 3.0)), (-1.0, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
    (1.0, (1.0, 5.0, 0.0, 1.0, 0.0, 1.0)), (1.0, (0.0, 1.0, 0.0, 0.0, 0.0, 0.0))])
def test_inertia_that_no_body_has_is_reported(mass: float, inertia: Tensor) -> None:
    report = Report()
    link = Link('a', Placement(Pose(), MODEL), Inertial(
        Placement(Pose(), FrameId('link', 'a')), mass, inertia), line=7)
    root = convert_to_sdf(Robot('r', (link,)), report)
    assert root.findtext('.//ixy') == number_text(inertia[1])
    assert [(note.element, note.name, note.line) for note in report.warnings] == [
        ('inertial', 'a', 7)]


@pytest.mark.parametrize(('effort', 'text'), [(-1.0, None), (math.inf, None), (0.0, '0')])
def test_effort_that_is_none(effort: float, text: str | None) -> None:
    robot = with_axis(Axis((0.0, 0.0, 1.0), Limit(-1.0, 1.0, effort, 2.0)))
    assert written(robot).findtext('joint/axis/limit/effort') == text
    for version in VERSIONS:
        assert again(robot, version).joints[0].axes == robot.joints[0].axes


def test_effort_of_before_is_nothing_where_another_is_written() -> None:
    model = written(with_axis(Axis((0.0, 0.0, 1.0), Limit(-1.0, 1.0, -1.0, -1.0))))
    limit = model.find('joint/axis/limit')
    assert limit is not None
    etree.SubElement(limit, 'effort').text = '5'
    root = model.getparent()
    assert root is not None
    read = read_sdf(root, Report()).joints[0]
    assert read.axes[0].limit == Limit(-1.0, 1.0, 5.0, -1.0)
    assert read.extension.sdf is None


def test_revolute_joint_without_limits_comes_back() -> None:
    robot = with_axis(Axis((0.0, 0.0, 1.0), Limit(effort=1.0, velocity=2.0)))
    for version in VERSIONS:
        read = again(robot, version).joints[0]
        assert (read.type, read.axes) == ('revolute', robot.joints[0].axes)
        assert written(robot, version=version).find('joint').get('type') == (  # type: ignore
            'revolute')


@pytest.mark.parametrize(('fixture', 'names'), [
    ('sdf/ok_contact_of_a_visuals_name.sdf', ['body']),
    ('urdf/warning_contact_of_a_renamed_collision.urdf', ['foot__sole', 'heel'])])
def test_contact_sensors_name_the_collision_that_is_written(fixture: str, names: list[str]
                                                            ) -> None:
    robot, _ = read_robot(str(DATA / fixture), Report())
    link = convert_to_sdf(robot, Report()).find('model/link')
    assert link is not None
    assert link.xpath('sensor/contact/collision/text()') == names
    assert link.xpath('collision/@name')[:len(names)] == names
    assert link.xpath('visual/@name') == ['base_visual']


@pytest.mark.parametrize(('name', 'new'), [
    ('___', '___'), ('__', '__'), ('____', 'unnamed'), ('__a__', 'a'), ('__a', '__a'),
    ('a::::b', 'a____b')])
def test_names_that_sdf_keeps_for_itself(name: str, new: str) -> None:
    shape = Shape(name, Placement(Pose(), FrameId('link', name)), Sphere(1.0))
    link = Link(name, Placement(Pose(), MODEL), visuals=(shape,))
    root = convert_to_sdf(Robot(name, (link,)), Report())
    assert root.xpath('.//@name') == [new] * 3


def test_visual_is_not_called_world() -> None:
    shape = Shape('world', Placement(Pose(), FrameId('link', 'a')), Sphere(1.0))
    assert convert_to_sdf(with_shape(shape), Report()).xpath('.//visual/@name') == ['a_visual']


def test_axis_of_a_revolute_joint_without_limits_keeps_what_others_added() -> None:
    model = written(with_axis(Axis((0.0, 0.0, 1.0), Limit())))
    axis, root = model.find('joint/axis'), model.getparent()
    assert axis is not None and root is not None
    etree.SubElement(axis, 'odd').text = '1'
    read = read_sdf(root, Report()).joints[0]
    assert read.type == 'revolute' and read.extension.sdf is not None
    assert read.extension.sdf.findtext('axis/odd') == '1'


def test_many_parts_of_one_name_take_linear_time() -> None:
    def convert(count: int) -> None:
        text = ''.join('<sensor name="s" type="imu"/>' for _ in range(count))
        text = f'<robot name="r"><link name="a"/><gazebo reference="a">{text}</gazebo></robot>'
        robot = read_urdf(parse(text.encode(), '', Report()), Report())
        visuals = tuple(Shape('v', Placement(Pose(), FrameId('link', 'a')), Sphere(1.0))
                        for _ in range(count))
        links = (replace(robot.links[0], visuals=visuals),)
        root = convert_to_sdf(replace(robot, links=links), Report(), inertial='zero')
        assert len(set(root.xpath('//@name'))) == 2 * count + 2

    assert robots.is_linear(convert)
