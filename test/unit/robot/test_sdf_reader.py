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

import math

from opencv_tools.robot.convert import convert_to_sdf
from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Material, Mesh, Sphere
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import (
    Dynamics, FrameId, Joint, Limit, Mimic, MODEL, Placement, Robot)
from opencv_tools.robot.pose import Pose, Vector
from opencv_tools.robot.sdf.fragments import axis_from_element, frame_from_element
from opencv_tools.robot.sdf.joint_reader import mark_loops
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.xml.document import DescriptionError, parse
from opencv_tools.robot.xml.report import Report
import pytest
import robots

TWO = '<link name="a"/><link name="b"/>'
HALF = math.pi / 2


def read(content: str, version: str = '1.9', report: Report | None = None,
         attributes: str = '') -> Robot:
    """Read a model of some content."""
    return read_text(f'<sdf version="{version}" xmlns:urdf="urn:opencv_tools:urdf" '
                     f'xmlns:preserved="urn:opencv_tools:preserved">\n'
                     f'<model name="m" {attributes}>{content}</model></sdf>', report)


def read_text(text: str, report: Report | None = None, model: str = '') -> Robot:
    report = report or Report()
    return read_sdf(parse(text.encode(), 'robot.sdf', report), report, model=model)


def joint(content: str = '', kind: str = 'fixed', name: str = 'j', parent: str = 'a',
          child: str = 'b') -> str:
    return (f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>'
            f'{content}</joint>')


def near(one: Vector, other: Vector) -> bool:
    return math.dist(one, other) < 1e-12


def test_links_are_placed_in_the_model_and_joints_in_their_child() -> None:
    robot = read(TWO.replace('"b"/>', '"b"><pose>0 0 0.20 0 0 1.5</pose></link>')
                 + joint('<pose>1 0 0 0 0 0</pose>'))
    assert robot.name == 'm' and robot.source == 'robot.sdf'
    assert robot.links[1].placement == Placement(Pose((0, 0, 0.2), (0, 0, 1.5)), MODEL)
    assert robot.joints == (Joint('j', 'fixed', 'a', 'b', Placement(
        Pose((1, 0, 0)), FrameId('link', 'b'))),)
    assert robot.joints[0].line == 2


@pytest.mark.parametrize(('version', 'attribute'), [
    ('1.5', 'frame'), ('1.6', 'frame'), ('1.6', 'relative_to'), ('1.7', 'relative_to'),
    ('1.12', 'relative_to')])
def test_reference_of_a_pose_by_version(version: str, attribute: str) -> None:
    robot = read(f'<link name="a"/><link name="b"><pose {attribute}="a">1 0 0 0 0 0</pose></link>',
                 version)
    assert robot.links[1].placement.relative_to == FrameId('link', 'a')


@pytest.mark.parametrize(('version', 'attributes', 'expected'), [
    ('1.6', 'frame="a" relative_to="b"', FrameId('link', 'a')),
    ('1.6', 'frame="" relative_to="b"', MODEL),
    ('1.7', 'frame="a" relative_to="b"', FrameId('link', 'b'))])
def test_both_references_of_a_pose(version: str, attributes: str, expected: FrameId) -> None:
    robot = read(f'{TWO}<link name="c"><pose {attributes}>1 0 0 0 0 0</pose></link>', version)
    assert robot.links[2].placement.relative_to == expected


def test_old_reference_means_nothing_in_a_new_version() -> None:
    report = Report()
    robot = read('<link name="a"/><link name="b"><pose frame="a"/></link>', '1.7', report)
    assert robot.links[1].placement.relative_to == MODEL
    assert 'frame=' in report.warnings[0].message


@pytest.mark.parametrize(('pose', 'expected'), [
    ('<pose/>', Pose()),
    ('<pose degrees="true">1 2 3 180 0 90</pose>', Pose((1, 2, 3), (math.pi, 0, HALF))),
    ('<pose rotation_format="euler_rpy">1 2 3 0.1 0 0</pose>', Pose((1, 2, 3), (0.1, 0, 0))),
    ('<pose rotation_format="quat_xyzw">1 2 3 0 0 0 2</pose>', Pose((1, 2, 3))),
    ('<pose rotation_format="quat_xyzw">1 2 3 0 0 1 1</pose>', Pose((1, 2, 3), (0, 0, HALF)))])
def test_pose_texts(pose: str, expected: Pose) -> None:
    placed = read(f'<link name="a">{pose}</link>').links[0].placement.pose
    assert placed.xyz == expected.xyz and near(placed.rpy, expected.rpy)


@pytest.mark.parametrize(('content', 'message'), [
    ('<link name="a"><pose>1 2 3</pose></link>', "<pose>: '1 2 3' is not 6 finite numbers"),
    ('<link name="a"><pose>1 2 nan 0 0 0</pose></link>', 'is not 6 finite numbers'),
    ('<link name="a"><pose rotation_format="quat_xyzw">0 0 0 0 0 0</pose></link>', 'is not 7 fin'),
    ('<link name="a"><pose rotation_format="quat_xyzw">0 0 0 0 0 0 0</pose></link>', 'non-zero'),
    ('<link name="a"><pose rotation_format="quat_xyzw" degrees="1">0 0 0 0 0 0 1</pose></link>',
     'quaternion'),
    ('<link name="a"><pose rotation_format="x">0 0 0 0 0 0</pose></link>', "rotation_format='x'"),
    ('<link name="a"><pose degrees="x">0 0 0 0 0 0</pose></link>', "degrees='x'"),
    ('<link name="a"><pose relative_to="x"/></link>', "relative_to 'x' is not a link"),
    ('<link name="a"><pose relative_to="b"/></link><link name="b"><pose relative_to="a"/></link>',
     "placement cycle: 'a' -> 'b' -> 'a'"),
    ('<link name="a"/><frame name="f" attached_to="g"/><frame name="g" attached_to="f"/>',
     "placement cycle: 'f' -> 'g' -> 'f'"),
    ('<link name="a"/><frame name="f" attached_to="x"/>', "attached_to 'x' is not a link"),
    ('<link name="a"/><frame name="__f__"/>', "'__f__' is reserved"),
    ('<link name="world"/>', "'world' is reserved"),
    ('<link name="a::b"/>', "'a::b' contains '::'"),
    ('<link/>', '<link>: has no name'),
    ('', "<model>: model 'm' has no links"),
    ('<model name="n"/>', "model 'm' has no links"),
    ('<link name="a"/><link name="a"/>', "'a' is already the name of <link> in line 2"),
    ('<link name="a"/><frame name="a"/>', "'a' is already the name of <link> in line 2"),
    ('<link name="a"/><model name="a"><link name="b"/></model>', "'a' is already the name"),
    (TWO + joint(child='x'), "<child> 'x' is not a link"),
    (TWO + joint(parent='x'), "<parent> 'x' is not a link"),
    (TWO + joint(child='world'), "<child> is 'world'"),
    (TWO + joint(child='a'), "connects link 'a' with itself"),
    (TWO + joint(child='j'), "attachment cycle: 'j' -> 'j'"),
    (TWO + '<joint name="j" type="fixed"><parent>a</parent></joint>', 'has no <child>'),
    (TWO + joint(kind='piston'), "type='piston' is not supported; use one of fixed, revolute"),
    (TWO + joint(kind='floating'), "type='floating'"),
    (TWO + joint('<axis><xyz>0 0 0</xyz></axis>', 'revolute'), "<xyz>: is '0 0 0'"),
    (TWO + joint('<axis><xyz>1 0</xyz></axis>', 'revolute'), 'is not 3 finite numbers'),
    (TWO + joint('<axis><xyz expressed_in="x">1 0 0</xyz></axis>', 'revolute'), "_in 'x'"),
    (TWO + joint('<axis><limit><lower>nan</lower></limit></axis>', 'revolute'), "'nan' is not"),
    (TWO + joint('<axis/><urdf:mimic xmlns:urdf="urn:opencv_tools:urdf" joint="x"/>', 'revolute'),
     "mimics 'x', which is not a joint"),
    ('<link name="a"><visual name="v"><geometry><box><size/></box></geometry></visual></link>',
     "'' is not 3 finite numbers"),
    ('<link name="a"><visual name="v"><geometry><mesh/></geometry></visual></link>', 'no <uri>'),
    ('<link name="a"><visual><geometry/></visual></link>', '<visual>: has no name'),
    ('<link name="a"><visual name="v"><geometry/></visual><visual name="v"/></link>',
     "'v' is already the name of another visual"),
    ('<link name="a"><inertial><mass>inf</mass></inertial></link>', "<mass>: 'inf' is not"),
])
def test_errors(content: str, message: str) -> None:
    with pytest.raises(DescriptionError) as error:
        read(content)
    assert message in str(error.value)
    assert str(error.value).startswith('robot.sdf:2: <') and '\n' not in str(error.value)


@pytest.mark.parametrize(('attribute', 'message'), [
    ('canonical_link="x"', "canonical_link 'x' is not a link"),
    ('canonical_link="f"', "canonical_link='f' is a frame"),
    ('placement_frame="x"', "placement_frame 'x' is not a link")])
def test_errors_of_the_model(attribute: str, message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        read('<link name="a"/><frame name="f"/>', attributes=attribute)


@pytest.mark.parametrize(('text', 'message'), [
    ('<robot name="r"/>', 'is not SDF'),
    ('<sdf><model name="m"/></sdf>', 'has no version; use 1.2 to 1.12'),
    ('<sdf version="1.1"><model name="m"/></sdf>', "version='1.1' is not supported"),
    ('<sdf version="x"><model name="m"/></sdf>', "version='x' is not supported"),
    (f'<sdf version="1.{"9" * 5000}"><model name="m"/></sdf>', "...' is not supported"),
    ('<sdf version="1.9"/>', 'has no model'),
    ('<sdf version="1.9"><light name="l"/></sdf>', 'has no model'),
    ('<sdf version="1.9"><model><link name="a"/></model></sdf>', '<model>: has no name'),
    ('<sdf version="1.9"><model name="m"/><model name="n"/></sdf>',
     'has 2 models; select one with --model: m, n')])
def test_errors_of_the_file(text: str, message: str) -> None:
    with pytest.raises(DescriptionError, match=message.replace('.', '[.]')):
        read_text(text)


def test_newer_version_is_read_with_a_warning() -> None:
    report = Report()
    read('<link name="a"/>', '1.13', report)
    assert 'read as 1.12' in report.warnings[0].message


def test_model_of_a_world_is_chosen_and_the_rest_is_reported() -> None:
    text = ('<sdf version="1.9"><world name="w"><light name="l"/><light name="k"/><gravity/>'
            '<model name="m"><link name="a"/></model><model name="n"><link name="b"/></model>'
            '</world></sdf>')
    report = Report()
    assert read_text(text, report, 'n').links[0].name == 'b'
    assert [note.element for note in report.warnings] == ['light', 'gravity', 'model']
    assert "'l', 'k'" in report.warnings[0].message
    with pytest.raises(DescriptionError, match="has no model 'x'; select one of m, n"):
        read_text(text, model='x')


@pytest.mark.parametrize('version', ['1.4', '1.6'])
def test_old_versions_may_use_a_name_twice(version: str) -> None:
    visual = '<visual name="v"><geometry/></visual>'
    robot = read(f'<link name="a">{visual * 2}</link><link name="b"><pose frame="x"/></link>'
                 '<link name="x"/>' + joint(name='x'), version)
    assert len(robot.links[0].visuals) == 2
    assert robot.links[1].placement.relative_to == FrameId('link', 'x')


@pytest.mark.parametrize(('version', 'extra', 'attribute', 'expected'), [
    ('1.4', '', '', (0, -1, 0)),
    ('1.4', '<use_parent_model_frame>0</use_parent_model_frame>', '', (1, 0, 0)),
    ('1.4', '<use_parent_model_frame>0</use_parent_model_frame>', 'expressed_in="a"', (0, -1, 0)),
    ('1.5', '', 'expressed_in="__model__"', (0, -1, 0)),
    ('1.6', '', 'expressed_in="a"', (0, -1, 0)),
    ('1.6', '<use_parent_model_frame>1</use_parent_model_frame>', 'expressed_in="b"', (0, -1, 0)),
    ('1.5', '', '', (1, 0, 0)),
    ('1.6', '<use_parent_model_frame>1</use_parent_model_frame>', '', (0, -1, 0)),
    ('1.6', '<use_parent_model_frame>0</use_parent_model_frame>', '', (1, 0, 0)),
    ('1.7', '', '', (1, 0, 0)),
    ('1.7', '', 'expressed_in="__model__"', (0, -1, 0)),
    ('1.7', '', 'expressed_in="a"', (0, -1, 0)),
    ('1.12', '', 'expressed_in="b"', (1, 0, 0))])
def test_axis_is_in_the_frame_that_the_version_says(
        version: str, extra: str, attribute: str, expected: Vector) -> None:
    robot = read(f'<link name="a"/><link name="b"><pose>0 0 1 0 0 {HALF}</pose></link>' + joint(
        f'<axis><xyz {attribute}>1 0 0</xyz>{extra}</axis>', 'prismatic'), version)
    assert near(robot.joints[0].axes[0].xyz, expected)


def test_parent_model_frame_means_nothing_in_a_new_version() -> None:
    report = Report()
    text = '<axis><use_parent_model_frame>{}</use_parent_model_frame></axis>'
    robot = read(f'<link name="a"/><link name="b"><pose>0 0 1 {HALF} 0 0</pose></link>'
                 + joint(text.format('1'), 'prismatic'), '1.7', report)
    assert robot.joints[0].axes[0].xyz == (0, 0, 1)
    assert [note.message[:33] for note in report.warnings] == ['use_parent_model_frame is ignored']
    read(TWO + joint(text.format('0'), 'prismatic'), '1.7', quiet := Report())
    assert not quiet.warnings


def test_axis_keeps_its_numbers_where_frames_are_parallel() -> None:
    robot = read('<link name="a"/><link name="b"><pose>0.1 0.2 0.3 0 0 0</pose></link>' + joint(
        '<axis><xyz>0.1 0.7 -3</xyz></axis>', 'prismatic'), '1.4')
    assert robot.joints[0].axes[0].xyz == (0.1, 0.7, -3.0)


@pytest.mark.parametrize(('now', 'expected'), [('0 0 1', (0, 0, 2)), ('0 1 0', (0, 1, 0))])
def test_axis_as_urdf_had_it_unless_it_was_changed(now: str, expected: Vector) -> None:
    robot = read(TWO + joint(f'<axis><xyz urdf:xyz="0 0 2">{now}</xyz></axis>', 'prismatic'))
    assert robot.joints[0].axes[0].xyz == expected


def test_both_axes_and_what_they_say() -> None:
    robot = read(TWO + joint(
        '<axis><limit><lower>-1</lower><upper>2</upper><effort>-1</effort></limit>'
        '<dynamics><damping>0.5</damping><spring_stiffness>3</spring_stiffness></dynamics></axis>'
        '<axis2><xyz>1 0 0</xyz><limit><upper>1e16</upper><velocity>4</velocity></limit></axis2>',
        'universal'))
    first, second = robot.joints[0].axes
    assert first.xyz == (0, 0, 1) and first.limit == Limit(-1, 2)
    assert first.dynamics == Dynamics(0.5)
    assert second.limit == Limit(velocity=4)
    rest = robot.joints[0].extension.sdf
    assert rest is not None and rest.findtext('axis/dynamics/spring_stiffness') == '3'
    assert rest.find('axis2') is None


@pytest.mark.parametrize(('kind', 'limit', 'expected'), [
    ('revolute', '', 'continuous'),
    ('revolute', '<limit/>', 'continuous'),
    ('revolute', '<limit><lower>-1e16</lower><upper>1e16</upper></limit>', 'continuous'),
    ('revolute', '<limit><lower>-inf</lower><upper>inf</upper></limit>', 'continuous'),
    ('revolute', '<limit><lower>-1</lower></limit>', 'revolute'),
    ('prismatic', '', 'prismatic'),
    ('screw', '', 'screw'), ('revolute2', '', 'revolute2'), ('gearbox', '', 'gearbox')])
def test_types_and_unlimited_joints(kind: str, limit: str, expected: str) -> None:
    robot = read(TWO + joint(f'<axis>{limit}</axis>', kind))
    assert robot.joints[0].type == expected


def test_limits_of_a_continuous_joint_are_kept_but_mean_nothing() -> None:
    made = read(TWO + joint('<axis><limit><lower>-1</lower><effort>2</effort></limit></axis>',
                            'continuous')).joints[0]
    assert made.axes[0].limit == Limit(effort=2)
    assert made.extension.sdf is not None
    assert made.extension.sdf.findtext('axis/limit/lower') == '-1'


def test_axis_of_a_fixed_joint_is_kept_but_means_nothing() -> None:
    made = read(TWO + joint('<axis><xyz>0 0 0</xyz></axis>')).joints[0]
    assert made.axes == () and made.extension.sdf is not None


def test_axis_that_stands_for_a_fixed_joint_is_not_kept() -> None:
    text = joint('<axis/>', 'revolute').replace('type=', 'urdf:type="fixed" type=')
    made = read(TWO + text, '1.4').joints[0]
    assert (made.type, made.axes, made.extension.sdf) == ('fixed', (), None)


@pytest.mark.parametrize(('lower', 'reported'), [
    ('2', ['lower=2.0 is greater than upper=1.0']), ('1', []), ('0', [])])
def test_limits_the_wrong_way_round_are_reported(lower: str, reported: list[str]) -> None:
    report = Report()
    read(TWO + joint(f'<axis><limit><lower>{lower}</lower><upper>1</upper></limit></axis>',
                     'revolute'), report=report)
    assert [note.message for note in report.warnings] == reported


def test_mimic_with_its_reference() -> None:
    axis = '<axis><mimic joint="k"><multiplier>2</multiplier><offset>1</offset>{}</mimic></axis>'
    leader = '<link name="c"/>' + joint('<axis/>', 'prismatic', 'k', child='c')
    for reference, offset in (('', 1.0), ('<reference>3</reference>', -5.0)):
        robot = read(TWO + leader + joint(axis.format(reference), 'prismatic'), '1.11')
        assert robot.joints[1].axes[0].mimic == Mimic('k', 2.0, offset)


def test_mimic_and_capsule_and_joint_of_urdf() -> None:
    robot = read(
        '<link name="a"><collision name="c"><geometry><cylinder><radius>1</radius><length>4'
        '</length></cylinder><urdf:capsule radius="1" length="2"/></geometry></collision></link>'
        '<link name="b"/><link name="c"/>'
        + joint('<axis/><urdf:mimic joint="k" multiplier="2"/>', 'prismatic')
        + joint(name='k', kind='planar', child='c').replace('joint name', 'urdf:joint name')
        .replace('/joint>', '/urdf:joint>'), '1.6')
    assert robot.links[0].collisions[0].geometry == Capsule(1, 2)
    assert robot.joints[0].axes[0].mimic == Mimic('k', 2)
    assert robot.joints[0].extension.urdf is None
    assert robot.joints[1].type == 'planar' and robot.extension.urdf is None


@pytest.mark.parametrize(('geometry', 'expected'), [
    ('<box><size>1 2 3</size></box>', Box((1, 2, 3))),
    ('<sphere><radius>1</radius></sphere>', Sphere(1)),
    ('<cylinder><radius>1</radius><length>2</length></cylinder>', Cylinder(1, 2)),
    ('<capsule><radius>1</radius><length>2</length></capsule>', Capsule(1, 2)),
    ('<mesh><uri>model://m/a.stl</uri></mesh>', Mesh('model://m/a.stl')),
    ('<mesh><uri>a.stl</uri><scale>1 1 0.001</scale></mesh>', Mesh('a.stl', (1, 1, 0.001)))])
def test_geometries(geometry: str, expected: object) -> None:
    robot = read(f'<link name="a"><collision name="c"><geometry>{geometry}</geometry></collision>'
                 '</link>')
    assert robot.links[0].collisions[0].geometry == expected
    assert robot.links[0].collisions[0].extension.sdf is None


@pytest.mark.parametrize('geometry', ['plane', 'empty', 'heightmap', 'ellipsoid', 'cone'])
def test_geometries_that_urdf_has_no_word_for_are_kept(geometry: str) -> None:
    made = read(f'<link name="a"><visual name="v"><geometry><{geometry}/></geometry></visual>'
                '</link>').links[0].visuals[0]
    assert made.geometry is None and made.extension.sdf is not None
    assert made.extension.sdf.find(f'geometry/{geometry}') is not None


def test_no_geometry_is_an_empty_one() -> None:
    report = Report()
    made = read('<link name="a"><visual name="v"/><visual name="w"><geometry/></visual></link>',
                report=report).links[0].visuals
    for one in made:
        assert one.extension.sdf is not None
        assert one.extension.sdf.find('geometry/empty') is not None
    assert [note.message for note in report.warnings] == ['has no <geometry>']


def test_material() -> None:
    made = read(
        '<link name="a"><visual name="v"><pose>1 0 0 0 0 0</pose><geometry><sphere>'
        '<radius>1</radius></sphere></geometry><material '
        'urdf:name="red"><diffuse>1 0 0</diffuse><ambient>0.9 0 0 1</ambient><script/>'
        '<pbr><metal><albedo_map>a.png</albedo_map><roughness>1</roughness></metal></pbr>'
        '</material></visual></link>').links[0].visuals[0]
    assert made.placement == Placement(Pose((1, 0, 0)), FrameId('link', 'a'))
    assert made.material == Material('red', (1, 0, 0, 1), (0.9, 0, 0, 1), texture='a.png')
    assert made.extension.sdf is not None
    assert [child.tag for child in made.extension.sdf.iter()] == [
        'visual', 'material', 'script', 'pbr', 'metal', 'roughness']


def test_inertials_have_the_defaults_of_sdf() -> None:
    robot = read('<link name="a"/><link name="b"><inertial/></link><link name="c"><inertial>'
                 '<mass>0</mass><inertia><ixx>2</ixx><ixy>0.1</ixy></inertia></inertial></link>')
    none, default, other = (link.inertial for link in robot.links)
    assert none is None and default is not None and other is not None
    assert (default.mass, default.inertia) == (1, (1, 0, 0, 1, 0, 1))
    assert (other.mass, other.inertia) == (0, (2, 0.1, 0, 1, 0, 1))


@pytest.mark.parametrize('attribute', ['frame', 'relative_to'])
def test_inertials_are_in_their_link(attribute: str) -> None:
    report = Report()
    robot = read(f'<link name="a"/><link name="b"><inertial><pose {attribute}="a">1 0 0 0 0 0'
                 '</pose></inertial></link>', '1.6', report)
    assert robot.links[1].inertial is not None
    assert robot.links[1].inertial.placement == Placement(Pose((1, 0, 0)), FrameId('link', 'b'))
    assert [note.element for note in report.warnings] == ['inertial']


def test_frames_and_joints_on_them() -> None:
    report = Report()
    robot = read(
        TWO + '<frame name="f" attached_to="b"><pose>1 0 0 0 0 0</pose></frame>'
        '<frame name="g" attached_to="f"><pose relative_to="a"/></frame><frame name="h"/>'
        + joint('<pose>0 1 0 0 0 0</pose>', parent='__model__', child='g'), report=report)
    f, g, h = robot.frames
    assert (f.attached_to, f.placement.relative_to) == (FrameId('link', 'b'),) * 2
    assert (g.attached_to, g.placement.relative_to) == (FrameId('frame', 'f'),
                                                        FrameId('link', 'a'))
    assert (h.attached_to, h.placement.relative_to) == (MODEL, MODEL)
    made = robot.joints[0]
    assert (made.parent, made.child) == ('a', 'b')
    assert made.placement == Placement(Pose((0, 1, 0)), FrameId('frame', 'g'))
    assert [note.message for note in report.notes] == [
        "<parent> is frame '__model__'; converted to its link 'a'",
        "<child> is frame 'g'; converted to its link 'b'"]


def test_world_is_a_link_where_joints_are_fastened_to_it() -> None:
    robot = read('<pose>1 0 0 0 0 0</pose><link name="a"/>' + joint(parent='world', child='a'))
    assert robot.links[-1].is_world
    assert robot.links[-1].placement.pose.xyz == (-1, 0, 0)
    assert robot.canonical_link == ''
    assert robot.extension.sdf is not None and robot.extension.sdf.findtext('pose')


def test_pose_of_a_placement_frame_is_settled() -> None:
    report = Report()
    robot = read(f'<pose>5 0 0 0 0 0</pose><link name="a"><pose>0 2 0 0 0 {HALF}</pose></link>',
                 attributes='placement_frame="a"', report=report)
    assert robot.extension.sdf is not None and not robot.extension.sdf.attrib
    numbers = tuple(map(float, (robot.extension.sdf.findtext('pose') or '').split()))
    assert numbers == pytest.approx((3, 0, 0, 0, 0, -HALF), abs=1e-12)
    assert report.notes[0].element == 'pose'


@pytest.mark.parametrize(('content', 'attributes', 'expected'), [
    (TWO, '', ''), (TWO, 'canonical_link="b"', 'b'), (TWO, 'canonical_link="a"', 'a'),
    ('<model name="n" canonical_link="b">' + TWO + '</model>', '', 'n::b'),
    ('<model name="n">' + TWO + '</model><link name="c"/>', '', ''),
    ('<model name="n">' + TWO + '</model><link name="c"/>', 'canonical_link="n::a"', 'n::a')])
def test_canonical_link(content: str, attributes: str, expected: str) -> None:
    assert read(content, attributes=attributes).canonical_link == expected


NESTED = (
    '<link name="base"/><model name="arm" placement_frame="tip"><pose relative_to="f">1 0 0 0 0 0'
    '</pose><static>true</static><link name="base"/><link name="tip"><pose>0 0 2 0 0 0</pose>'
    '</link><frame name="g" attached_to="tip"/><joint name="j" type="revolute"><parent>base'
    '</parent><child>tip</child><axis><mimic joint="k"/></axis></joint><joint name="k" '
    'type="revolute"><parent>world</parent><child>base</child><axis/></joint></model>'
    '<frame name="f"><pose>0 5 0 0 0 0</pose></frame>'
    '<joint name="j" type="fixed"><parent>base</parent><child>arm::g</child></joint>'
    '<joint name="i" type="fixed"><parent>arm</parent><child>base</child></joint>')


def test_the_axis_of_a_fixed_joint_names_frames_of_the_whole_model() -> None:
    model = read('<link name="a"/><model name="n"><link name="a"/><link name="b"/>' + joint(
        '<axis><xyz expressed_in="a">1 0 0</xyz></axis>') + '</model>' + joint(
        name='k', child='n::a'))
    (rest,) = (one.extension.sdf for one in model.joints if one.name == 'n::j')
    assert rest is not None
    xyz = rest.find('axis/xyz')
    assert xyz is not None
    assert xyz.get('expressed_in') == 'n__a'


def test_what_has_no_text_any_more_has_no_attributes() -> None:
    # No limit is written as none, and an attribute of it has nothing to stand on.
    model = read(TWO + joint('<axis><limit><lower odd="1">-1e17</lower><upper>1</upper></limit>'
                             '</axis>', 'revolute'))
    there = convert_to_sdf(model, Report(), version='1.9')
    assert [child.tag for child in there.iterfind('model/joint/axis/limit/*')] == ['upper']


def test_nested_model_is_flattened() -> None:
    report = Report()
    robot = read(NESTED, '1.11', report)
    assert [link.name for link in robot.links] == ['base', 'arm::base', 'arm::tip', 'world']
    assert [one.name for one in robot.joints] == ['j', 'i', 'arm::j', 'arm::k']
    assert [frame.name for frame in robot.frames] == ['f', 'arm::__model__', 'arm::g']
    assert robot.frames[1].attached_to == FrameId('link', 'arm::base')
    assert robot.joints[1].parent == 'arm::base'
    assert robot.joints[2].axes[0].mimic == Mimic('arm::k')
    kinematics = Kinematics(robot)
    # The pose of the model is that of its tip.
    assert near(kinematics.pose(FrameId('link', 'arm::tip')).translation, (1, 5, 0))
    assert near(kinematics.pose(FrameId('frame', 'arm::__model__')).translation, (1, 5, -2))
    assert [note.element for note in report.warnings] == ['static']


def test_model_in_a_model_in_a_model() -> None:
    robot = read('<model name="x"><pose>1 0 0 0 0 0</pose><model name="y"><pose>0 1 0 0 0 0</pose>'
                 '<link name="a"><sensor name="s"><pose relative_to="a">0 0 0 0 0 0</pose>'
                 '</sensor></link></model></model>')
    assert robot.links[0].name == 'x::y::a'
    assert Kinematics(robot).pose(FrameId('link', 'x::y::a')).translation == (1, 1, 0)
    rest = robot.links[0].extension.sdf
    assert rest is not None
    assert rest.xpath('sensor/pose/@relative_to') == ['x::y::a']


def test_static_model_without_links_moves_with_the_model_around_it() -> None:
    robot = read('<link name="a"/><model name="n"><pose>1 0 0 0 0 0</pose><static>true</static>'
                 '<frame name="f"><pose>0 2 0 0 0 0</pose></frame></model>' + joint(child='n::f')
                 .replace('>a<', '>world<'))
    assert [frame.name for frame in robot.frames] == ['n::__model__', 'n::f']
    kinematics = Kinematics(robot)
    assert set(kinematics.attached_links().values()) == {FrameId('link', 'a')}
    assert kinematics.pose(FrameId('frame', 'n::f')).translation == (1, 2, 0)
    assert (robot.joints[0].parent, robot.joints[0].child) == ('world', 'a')


def test_what_is_not_read_is_kept() -> None:
    robot = read('<static>true</static><plugin name="p"/><preserved:urdf>'
                 '<transmission name="t"/></preserved:urdf><link '
                 'name="a" urdf:name="x"><sensor name="s" type="imu"><pose frame="a"/></sensor>'
                 '</link>', '1.6')
    assert robot.extension.sdf is not None and robot.extension.urdf is not None
    assert [child.tag for child in robot.extension.sdf] == ['static', 'plugin']
    assert [child.tag for child in robot.extension.urdf] == ['transmission']
    link = robot.links[0].extension
    assert link.urdf is not None and link.urdf.get('name') == 'x'
    # It is kept in the words of newer versions.
    assert link.sdf is not None and link.sdf.xpath('sensor/pose/@relative_to') == ['a']


def loops(*pairs: str, canonical: str = '') -> list[bool]:
    joints = [Joint(f'j{index}', 'fixed', pair[0], pair[1], Placement(Pose(), MODEL))
              for index, pair in enumerate(pairs)]
    links = sorted(set(''.join(pairs)))
    return [joint.is_loop for joint in mark_loops(joints, links, canonical)]


def test_loops_are_marked() -> None:
    assert loops('ab', 'bc') == [False, False]
    assert loops('ab', 'ac', 'bd', 'cd') == [False, False, False, True]
    assert loops('ac', 'bc') == [False, True]
    assert loops('ab', 'bc', 'ca') == [False, False, True]
    assert loops('ab', 'bc', 'ca', canonical='b') == [True, False, False]
    assert loops('bc', 'cb', 'ab') == [False, True, False]
    assert loops('ab', 'ba', 'cd', 'dc') == [False, True, False, True]


def test_loop_is_read_as_one() -> None:
    robot = read(TWO + joint() + joint(name='k', parent='b', child='a'))
    assert [one.is_loop for one in robot.joints] == [False, True]
    assert Kinematics(robot).roots == ['a']


def test_axis_and_frame_for_others() -> None:
    root = parse(b'<x><axis><xyz>0 2 0</xyz></axis><frame name="f" attached_to="a">'
                 b'<pose relative_to="__model__">1 0 0 0 0 0</pose></frame></x>', '', Report())
    assert axis_from_element(root[0]).xyz == (0, 2, 0)
    frame = frame_from_element(root[1], lambda name, element: FrameId('link', name))
    assert frame.attached_to == FrameId('link', 'a')
    assert frame.placement == Placement(Pose((1, 0, 0)), MODEL)


@pytest.mark.parametrize(('text', 'line'), [
    ('<sdf version="1.9">\n<model name="m"><link name="a"><gz:x gz:y="1"/></link></model></sdf>',
     2),
    ('<sdf version="1.9">\n<!-- a -- b --->\n<model name="m"><link name="a"/></model></sdf>', 3),
    ('some text\n<?xml version="1.0"?>\n<sdf version="1.9"><model name="m"><link name="a"/>'
     '</model></sdf>', 3),
    ('\n\n<?xml version="1.0"?><sdf version="1.9"><model name="m"><link name="a"/>'
     '</model></sdf>', 3)])
def test_what_public_files_get_wrong_is_read_with_a_warning(text: str, line: int) -> None:
    report = Report()
    robot = read_text(text, report)
    assert robot.links[0].line == line
    assert [note.element for note in report.warnings] == ['sdf']
    assert 'not well-formed XML' in report.warnings[0].message


def test_long_chain_is_read_in_linear_time() -> None:
    def check(count: int) -> None:
        content = ''.join(
            f'<link name="l{index}"><pose relative_to="{f"l{index - 1}" if index else ""}">'
            f'0 0 1 0 0 0</pose></link>' for index in range(count))
        content += ''.join(joint(name=f'j{index}', parent=f'l{index}', child=f'l{index + 1}')
                           for index in range(count - 1))
        last = FrameId('link', f'l{count - 1}')
        assert Kinematics(read(content)).pose(last).translation == (0, 0, count)

    assert robots.is_linear(check)
