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

"""URDF read and written: every rule of the format, and all that only SDF has on the way back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
from pathlib import Path
import re
from typing import Any

from lxml import etree
from opencv_tools.robot.compare.compare import differences
from opencv_tools.robot.compare.properties import is_continuous
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf
from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Material, Mesh, Sphere
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import (
    Axis, Dynamics, Extension, Frame, FrameId, Inertial, Joint, Limit, Link, Mimic, MODEL,
    Placement, Robot, Shape)
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.urdf.writer import write_urdf
from opencv_tools.robot.xml.document import DescriptionError, Element, parse, to_bytes
from opencv_tools.robot.xml.report import Report
import pytest
import robots

SDF = 'xmlns:sdf="urn:opencv_tools:sdf" xmlns:preserved="urn:opencv_tools:preserved"'
LINKS = '<link name="a"/><link name="b"/>'
ENDS = '<parent link="a"/><child link="b"/>'
LIMIT = '<limit effort="1" velocity="2"/>'
BLACK = (0.0, 0.0, 0.0, 1.0)
RED = (1.0, 0.0, 0.0, 1.0)


def robot(content: str, report: Report | None = None, root_link: str = '') -> Robot:
    data = f'<robot name="r" {SDF}>{content}</robot>'.encode()
    report = report or Report()
    return read_urdf(parse(data, 'r.urdf', report), report, root_link=root_link)


def joint(content: str, kind: str = 'revolute', name: str = 'j') -> str:
    return f'{LINKS}<joint name="{name}" type="{kind}">{ENDS}{content}</joint>'


def visual(content: str, tag: str = 'visual') -> str:
    return f'<link name="a"><{tag}>{content}</{tag}></link>'


def written(model: Robot, report: Report | None = None) -> Element:
    """Write, and read what is in the file."""
    report = report or Report()
    return parse(to_bytes(write_urdf(model, report)), 'r.urdf', report)


def again(model: Robot) -> Robot:
    return read_urdf(written(model), Report())


BOX = '<geometry><box size="1 2 3"/></geometry>'


@pytest.mark.parametrize(('content', 'place', 'message'), [
    ('', '1: <robot>', 'has no <link>'),
    ('<link/>', '1: <link>', 'has no name'),
    ('<link name=" "/>', '1: <link>', 'has no name'),
    ('<link name="a"/>\n<link name="a"/>', '2: <link>', "name='a' is also"),
    (LINKS + '\n<joint type="fixed"/>', '2: <joint>', 'has no name'),
    (joint('', 'fixed') + f'\n<link name="c"/><joint name="j" type="fixed">{ENDS}</joint>',
     '2: <joint>', "name='j' is also"),
    (joint('', 'hinge'), '1: <joint>', "type='hinge' is not supported; give one of fixed, revol"),
    (f'{LINKS}<joint name="j">{ENDS}</joint>', '1: <joint>', 'has no type=; give one of fixed'),
    (f'{LINKS}<joint name="j" type="fixed"><child link="b"/></joint>', '1: <joint>',
     "joint 'j' has no <parent link=>"),
    (f'{LINKS}<joint name="j" type="fixed"><parent link="b"/></joint>', '1: <joint>',
     "joint 'j' has no <child link=>"),
    (f'{LINKS}<joint name="j" type="fixed">\n<parent link="x"/><child link="b"/></joint>',
     '2: <parent>', "link='x' does not exist, in joint 'j'"),
    (f'{LINKS}<joint name="j" type="fixed">\n<parent link="a"/><child link="x"/></joint>',
     '2: <child>', "link='x' does not exist"),
    (f'{LINKS}<joint name="j" type="fixed">\n<parent/><child link="b"/></joint>', '2: <parent>',
     'has no link='),
    (f'{LINKS}<joint name="j" type="fixed"><parent link="a"/><child link="a"/></joint>',
     '1: <joint>', "joint 'j' has link 'a' as parent and as child"),
    (joint('', 'fixed') + f'\n<joint name="k" type="fixed">{ENDS}</joint>', '2: <joint>',
     "link 'b' is the child of two joints, 'j' and 'k'"),
    (joint('', 'fixed') + '<joint name="k" type="fixed"><parent link="b"/><child link="a"/>'
     '</joint>', '1: <joint>', "kinematic cycle: 'b' -> 'a' -> 'b'"),
    (joint('', 'fixed') + '<joint name="k" type="fixed"><parent link="b"/><child link="a"/>'
     '</joint><link name="alone"/>', '1: <joint>', 'kinematic cycle'),
    (joint('\n<origin xyz="0 0"/>', 'fixed'), '2: <origin>', "xyz='0 0' is not 3 finite numbers"),
    (joint('\n<origin xyz="0 0 nan"/>', 'fixed'), '2: <origin>', 'not 3 finite numbers'),
    (joint('\n<origin rpy="0 0 inf"/>', 'fixed'), '2: <origin>', "rpy='0 0 inf'"),
    (joint('\n<origin quat_xyzw="0 0 0 0"/>', 'fixed'), '2: <origin>', 'is not a rotation'),
    (joint('\n<origin quat_xyzw="0 0 0 1" rpy="0 0 0"/>', 'fixed'), '2: <origin>', 'give one of'),
    (joint('\n<origin xyz="${pi} 0 0"/>', 'fixed'), '2: <origin>', "'${pi} 0 0'"),
    (joint(''), '1: <joint>', 'a revolute joint requires <limit'),
    (joint('', 'prismatic'), '1: <joint>', 'a prismatic joint requires <limit'),
    (joint('\n<limit velocity="1"/>'), '2: <limit>', 'has no effort='),
    (joint('\n<limit effort="1"/>'), '2: <limit>', 'has no velocity='),
    (joint('\n<limit effort="1"/>', 'continuous'), '2: <limit>', 'has no velocity='),
    (joint('\n<limit effort="1" velocity="2" lower="nan"/>'), '2: <limit>', "lower='nan'"),
    (joint(LIMIT + '\n<axis xyz="0 0 0"/>'), '2: <axis>', "xyz='0 0 0' has no direction"),
    (joint('\n<axis xyz="0 0 0"/>', 'planar'), '2: <axis>', 'planar joint'),
    (joint(LIMIT + '\n<axis xyz="0 1"/>'), '2: <axis>', 'not 3 finite numbers'),
    (joint(LIMIT + '\n<dynamics damping="x"/>'), '2: <dynamics>', "damping='x'"),
    (joint(LIMIT + '\n<mimic/>'), '2: <mimic>', 'has no joint='),
    (joint(LIMIT + '\n<mimic joint="j" multiplier="x"/>'), '2: <mimic>', "multiplier='x'"),
    (joint(LIMIT + '<mimic joint="j"/>'), '1: <joint>', "mimic cycle: 'j' -> 'j'"),
    (visual('<geometry>\n<box/></geometry>'), '2: <box>', 'has no size='),
    (visual('<geometry>\n<box size="1 1"/></geometry>'), '2: <box>', "size='1 1'"),
    (visual('<geometry>\n<box size="x 1 1"/></geometry>'), '2: <box>', "size='x 1 1'"),
    (visual('<geometry>\n<cylinder radius="1"/></geometry>'), '2: <cylinder>', 'has no length='),
    (visual('<geometry>\n<mesh filename="a" scale="1 1"/></geometry>'), '2: <mesh>',
     "scale='1 1'"),
    ('<link name="a">\n<inertial><inertia/></inertial></link>', '2: <inertial>',
     'has no <mass>'),
    ('<link name="a"><inertial>\n<mass/><inertia/></inertial></link>', '2: <mass>',
     'has no value='),
    ('<link name="a"><inertial><mass value="1"/>\n<inertia ixx="x"/></inertial></link>',
     '2: <inertia>', "ixx='x'"),
    (visual(BOX + '<material name="m">\n<color rgba="1 1 1"/></material>'), '2: <color>',
     "rgba='1 1 1' is not 4 finite numbers"),
    (visual(BOX + '<material name="m">\n<color/></material>'), '2: <color>', 'rgba='),
    ('<link name="a"/>\n<sdf:frame name="f" attached_to="x"/>', '2: <frame>', "'x'"),
    (LINKS + f'\n<joint name="j" type="floating" sdf:type="odd">{ENDS}</joint>', '2: <joint>',
     "type='odd'"),
])
def test_errors_name_place_and_value(content: str, place: str, message: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        robot(content)
    assert str(caught.value).startswith(f'r.urdf:{place}: '), str(caught.value)
    assert message in str(caught.value)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(('text', 'message'), [
    ('<sdf version="1.11"/>', '<sdf>: is not URDF; its root is <sdf>'),
    ('<robot/>', '<robot>: has no <link>'),
])
def test_another_root_is_refused(text: str, message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        read_urdf(parse(text.encode(), 'r.urdf', Report()), Report())


def test_a_quaternion_is_a_rotation_too() -> None:
    model = robot(joint('<origin xyz="1 2 3" quat_xyzw="0 0 1 1"/>', 'fixed'))
    assert model.joints[0].placement.pose.xyz == (1.0, 2.0, 3.0)
    assert model.joints[0].placement.pose.rpy == pytest.approx((0, 0, math.pi / 2), abs=1e-15)
    assert again(model).joints == model.joints


def test_several_roots_are_named_and_one_is_chosen() -> None:
    content = joint('', 'fixed') + '<link name="c"/><link name="d"/>'
    with pytest.raises(DescriptionError, match=r"r\.urdf: .*--root: 'a', 'c', 'd'"):
        robot(content)
    report = Report()
    chosen = robot(content, report, 'a')
    assert [link.name for link in chosen.links] == ['a', 'b']
    assert [note.name for note in report.warnings] == ['c', 'd']
    with pytest.raises(DescriptionError, match="--root 'b' is no root"):
        robot(content, root_link='b')


@pytest.mark.parametrize(('content', 'element', 'message'), [
    (visual('<geometry><box size="1 -1 1"/></geometry>'), 'box', "size='1 -1 1' is negative"),
    (visual('<geometry><sphere radius="-1"/></geometry>'), 'sphere', 'negative'),
    (joint('<limit lower="1" upper="-1" effort="1" velocity="1"/>'), 'limit', 'lower=1.0 is grea'),
    (visual(BOX + '<material name="m"/>'), 'material', 'is not defined'),
    ('<link name="a"/><gazebo reference="x"><mu1>1</mu1></gazebo>', 'gazebo', "'x' is not a link"),
    ('<link name="a"><inertial><mass value="-1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" '
     'izz="1"/></inertial></link>', 'mass', 'negative'),
    (visual(BOX + '<material name="m"><color rgba="1 0 0 1"/></material></visual><visual>' + BOX
            + '<material name="m"><color rgba="0 0 0 1"/></material>'), 'material', 'elsewhere'),
])
def test_warnings(content: str, element: str, message: str) -> None:
    report = Report()
    robot(content, report)
    assert [note.element for note in report.warnings] == [element]
    assert message in report.warnings[0].message


@pytest.mark.parametrize('content', [
    '', '<geometry/>', '<geometry><cone/></geometry>', '<geometry><cone/><box/></geometry>',
    '<geometry><mesh scale="1 1 1"/></geometry>',
])
@pytest.mark.parametrize('tag', ['visual', 'collision'])
def test_a_shape_that_urdfdom_does_not_read_is_carried(content: str, tag: str) -> None:
    report = Report()
    model = robot(visual(f'<origin xyz="0 0 1"/>{content}</{tag}><{tag}>{BOX}', tag), report)
    (link,) = model.links
    assert [note.element for note in report.warnings] == [tag]
    assert 'it is left out' in report.warnings[0].message
    (shape,) = getattr(link, f'{tag}s')
    assert isinstance(shape.geometry, Box)
    left = next(iter(written(model).iterfind(f'link/{tag}[2]')))
    assert left.find('origin') is not None
    assert (left.find('geometry') is None) == (not content)


def test_moments_that_are_not_there_are_0() -> None:
    for inertia in ('', '<inertia/>', '<inertia ixy="0" iyy="0"/>'):
        link, = robot(f'<link name="a"><inertial><mass value="2"/>{inertia}</inertial></link>'
                      ).links
        assert link.inertial
        assert (link.inertial.mass, link.inertial.inertia) == (2.0, (0.0,) * 6)


def test_a_scale_of_one_number_is_for_all_axes() -> None:
    model = robot(visual('<geometry><mesh filename="a" scale="0.5"/></geometry>'))
    assert model.links[0].visuals[0].geometry == Mesh('a', (0.5, 0.5, 0.5))


def test_a_world_that_is_not_there_is_an_empty_link() -> None:
    report = Report()
    model = robot('<link name="a"/><joint name="j" type="fixed"><parent link="world"/>'
                  '<child link="a"/></joint>', report)
    assert [note.element for note in report.warnings] == ['joint']
    assert [link.name for link in model.links] == ['a', 'world']
    assert [link.get('name') for link in written(model).iterfind('link')] == ['a', 'world']


def test_a_mimic_of_no_joint_is_carried() -> None:
    report = Report()
    model = robot(joint(LIMIT + '<mimic joint="x" offset="1"/>'), report)
    assert [note.element for note in report.warnings] == ['mimic']
    assert model.joints[0].axes[0].mimic is None
    mimic = written(model).find('joint/mimic')
    assert mimic is not None
    assert dict(mimic.attrib) == {'joint': 'x', 'offset': '1'}


def test_sizes_of_nothing_are_fine() -> None:
    report = Report()
    robot(visual('<geometry><box size="0 0 0"/></geometry>'), report)
    assert not report.notes


def test_joints_are_in_their_parents_and_links_in_their_joints() -> None:
    model = robot('<link name="a"/><link name="b"/><link name="c"/>'
                  f'<joint name="j" type="fixed">{ENDS}<origin xyz="1 2 3" rpy="0 0 1.5708"/>'
                  '</joint><joint name="k" type="floating"><parent link="b"/><child link="c"/>'
                  '</joint>')
    assert [link.placement for link in model.links] == [
        Placement(Pose(), MODEL), Placement(Pose(), FrameId('joint', 'j')),
        Placement(Pose(), FrameId('joint', 'k'))]
    assert [one.placement for one in model.joints] == [
        Placement(Pose((1.0, 2.0, 3.0), (0.0, 0.0, 1.5708)), FrameId('link', 'a')),
        Placement(Pose(), FrameId('link', 'b'))]
    assert model.source == 'r.urdf'


@pytest.mark.parametrize(('written_geometry', 'geometry'), [
    ('<box size="1 2 3"/>', Box((1.0, 2.0, 3.0))),
    ('<sphere radius="0.1"/>', Sphere(0.1)),
    ('<cylinder radius="1" length="2"/>', Cylinder(1.0, 2.0)),
    ('<capsule radius="1" length="2"/>', Capsule(1.0, 2.0)),
    ('<mesh filename="package://p/a b.stl"/>', Mesh('package://p/a b.stl')),
    ('<mesh filename="a" scale="1 1 0.123456789012345"/>', Mesh('a', (1.0, 1.0,
                                                                      0.123456789012345))),
])
@pytest.mark.parametrize('tag', ['visual', 'collision'])
def test_geometry_there_and_back(written_geometry: str, geometry: object, tag: str) -> None:
    model = robot(visual(f'<origin xyz="0.1 0 0"/><geometry>{written_geometry}</geometry>', tag))
    shape = (model.links[0].visuals + model.links[0].collisions)[0]
    assert shape.geometry == geometry
    assert shape.placement == Placement(Pose((0.1, 0.0, 0.0)), FrameId('link', 'a'))
    assert again(model) == model


def test_elements_of_others_beside_a_shape_are_carried() -> None:
    model = robot(visual('<geometry><sdf:cone/><sphere radius="0.1"/><sdf:plane/></geometry>'))
    for made in (model, again(model)):
        shape, = made.links[0].visuals
        assert shape.geometry == Sphere(0.1) and shape.extension.urdf is not None
        assert [child.tag for child in shape.extension.urdf.find('geometry')] == [  # type: ignore
            '{urn:opencv_tools:sdf}cone', '{urn:opencv_tools:sdf}plane']


@pytest.mark.parametrize(('kind', 'content', 'axes'), [
    ('fixed', '', ()),
    ('fixed', '<axis xyz="0 0 0"/><limit/>', ()),
    ('floating', '', ()),
    ('continuous', '', (Axis((1.0, 0.0, 0.0)),)),
    ('continuous', '<axis xyz="0 0 2"/><limit lower="1" effort="3" velocity="4"/>',
     (Axis((0.0, 0.0, 2.0), Limit(effort=3.0, velocity=4.0)),)),
    ('planar', '<axis xyz="0 0 1"/>', (Axis((0.0, 0.0, 1.0)),)),
    ('revolute', LIMIT, (Axis((1.0, 0.0, 0.0), Limit(0.0, 0.0, 1.0, 2.0)),)),
    ('prismatic', '<limit lower="-1e16" upper="inf" effort="2e16" velocity="0"/>',
     (Axis((1.0, 0.0, 0.0), Limit(velocity=0.0)),)),
    ('revolute', LIMIT + '<dynamics damping="0.5"/>',
     (Axis((1.0, 0.0, 0.0), Limit(0.0, 0.0, 1.0, 2.0), Dynamics(0.5)),)),
    ('revolute', LIMIT + '<mimic joint="k" offset="2"/>',
     (Axis((1.0, 0.0, 0.0), Limit(0.0, 0.0, 1.0, 2.0), None, Mimic('k', 1.0, 2.0)),)),
])
def test_axes_there_and_back(kind: str, content: str, axes: tuple[Axis, ...]) -> None:
    model = robot(f'{joint(content, kind)}<link name="c"/><joint name="k" type="continuous">'
                  '<parent link="b"/><child link="c"/></joint>')
    assert model.joints[0].axes == axes
    assert model.joints[0].type == kind
    back = again(model)
    assert back.joints[0].axes == axes
    assert etree.tostring(written(back)) == etree.tostring(written(model))


def test_revolute_joint_without_limits_stays_revolute() -> None:
    model = robot(joint('<limit lower="-1e16" upper="1e17" effort="1" velocity="2"/>'))
    assert model.joints[0].type == 'revolute'
    limit = written(model).find('joint/limit')
    assert limit is not None and limit.get('upper') == '1e+16'
    assert is_continuous(model.joints[0])


def test_one_limit_is_written_with_a_number_for_the_other() -> None:
    model = robot(joint('<limit lower="0" upper="1e16" effort="1" velocity="inf"/>'))
    assert dict(written(model).find('joint/limit').attrib) == {  # type: ignore[union-attr]
        'lower': '0', 'upper': '1e+16', 'effort': '1', 'velocity': '1e+16'}


@pytest.mark.parametrize(('content', 'material'), [
    ('<material name="m"><color rgba="1 0 0 1"/></material>',
     Material('m', RED, RED, BLACK, BLACK)),
    ('<material name=""><color rgba="1 0 0 1"/></material>', Material('', RED, RED, BLACK, BLACK)),
    ('<material><texture filename="t.png"/></material>', Material(texture='t.png')),
    ('<material name="shared"/>', Material('shared', BLACK, BLACK, BLACK, BLACK, 't')),
    ('<material name="other"/>', Material('other', RED, RED, BLACK, BLACK)),
    ('<material name="m"><color rgba="1 0 0 1"/></material><preserved:sdf><material>'
     '<ambient>0 0 0 1</ambient></material></preserved:sdf>', Material('m', RED, BLACK)),
    ('<preserved:sdf><material><emissive>0 0 0 1</emissive></material></preserved:sdf>',
     Material(emissive=BLACK)),
    ('<preserved:sdf><material/></preserved:sdf>', Material()),
    ('', None),
])
def test_materials_there_and_back(content: str, material: Material | None) -> None:
    model = robot(visual(f'{BOX}{content}') + '<material name="shared"><color rgba="0 0 0 1"/>'
                  '<texture filename="t"/></material><link name="b"><visual>' + BOX
                  + '<material name="other"><color rgba="1 0 0 1"/></material></visual></link>'
                  f'<joint name="j" type="fixed">{ENDS}</joint>')
    assert model.links[0].visuals[0].material == material
    assert again(model).links == model.links


def test_one_name_has_one_look_in_the_file() -> None:
    shapes = tuple(Shape(name, Placement(Pose(), FrameId('link', 'a')), Sphere(1.0),
                         Material(material, color, color, BLACK, BLACK))
                   for name, material, color in (('', 'm', RED), ('x', 'm', BLACK),
                                                 ('', '', RED), ('', '', BLACK), ('', 'm', RED)))
    report = Report()
    model = Robot('r', (Link('a', Placement(Pose(), MODEL), visuals=shapes),))
    names = [one.get('name') for one in written(model, report).iter('material')]
    assert names == ['m', 'a_x', 'a_visual', 'a_visual_1', 'm']
    assert [note.name for note in report.warnings] == ['m']


@pytest.mark.parametrize('content', [
    '<link name="a"/><transmission name="t"><type>x</type></transmission>',
    '<link name="a"/><ros2_control name="t" type="system"><joint name="x"/></ros2_control>',
    '<link name="a"/><gazebo><odd x="1"/></gazebo>',
    '<link name="a"/><gazebo reference="a"><material>Gazebo/Red</material></gazebo>',
    '<link name="a"/><gazebo reference="a" x="1"/>',
    '<link name="a" type="x"><more>1</more></link>',
    visual(BOX + '<odd/>'),
    visual(BOX.replace('<box', '<box odd="1"')),
    visual(BOX + '<material name="m" odd="1"><color rgba="1 0 0 1" odd="2"/></material>'),
    joint(LIMIT + '<safety_controller k_velocity="1"/><calibration rising="0"/>'),
    joint('<limit lower="1" upper="2" effort="3" velocity="4"/>', 'continuous'),
    joint('<axis xyz="0 0 1"/><limit lower="0"/><mimic joint="x"/>', 'fixed'),
    joint(LIMIT + '<dynamics damping="1" odd="2"/><origin xyz="1 0 0" odd="3"/>'),
    '<link name="a"/><x:y xmlns:x="urn:x" x:z="1"/>',
])
def test_what_is_not_understood_comes_out_again(content: str) -> None:
    data = f'<robot name="r" version="1.0">{content}</robot>'.encode()

    def facts(root: Element) -> set[tuple[str, ...]]:
        tree = root.getroottree()
        plain = [(re.sub(r'\[\d+\]', '', tree.getelementpath(one)), one) for one in root.iter()]
        return {(path, *pair) for path, element in plain
                for pair in [*element.items(), ('', (element.text or '').strip())]}

    root, report = parse(data, 'r.urdf', Report()), Report()
    result = written(read_urdf(root, report), report)
    assert facts(root) <= facts(result)
    assert not report.notes


def test_gazebo_blocks_give_sdf_what_is_sdf() -> None:
    model = robot(joint(LIMIT) + """
        <gazebo><plugin name="p" filename="p.so"/><odd/></gazebo>
        <gazebo reference="a"><sensor name="s" type="imu"><pose>1 0 0 0 0 0</pose></sensor>
        <mu1>1</mu1><gravity>false</gravity></gazebo>
        <gazebo reference="j"><sensor name="f" type="imu"/>
        <provideFeedback>1</provideFeedback></gazebo>""")

    def tags(element: Element | None) -> list[object]:
        return [] if element is None else [child.tag for child in element]

    assert tags(model.extension.sdf) == ['plugin']
    assert tags(model.links[0].extension.sdf) == ['sensor', 'gravity']
    assert tags(model.joints[0].extension.sdf) == ['sensor']
    assert model.extension.urdf is not None
    assert [tags(part) for part in model.extension.urdf] == [
        ['odd'], ['mu1'], ['provideFeedback']]
    blocks = written(model).findall('gazebo')
    assert [(block.get('reference'), tags(block)) for block in blocks] == [
        (None, ['plugin']), ('a', ['sensor', 'gravity']), ('j', ['sensor']), (None, ['odd']),
        ('a', ['mu1']), ('j', ['provideFeedback'])]


@pytest.mark.parametrize('part', [
    '<plugin name="p"/>', '<plugin name=" " filename="p.so"/>',
    '<sensor name="s" type="imu"><plugin filename="p.so"/></sensor>'])
def test_a_plugin_that_sdf_refuses_stays_in_its_block(part: str) -> None:
    report = Report()
    model = robot(f'<link name="a"/><gazebo reference="a">{part}</gazebo>', report)
    assert 'the element is preserved unchanged' in report.warnings[0].message
    assert model.links[0].extension.sdf is None
    assert model.extension.urdf is not None
    assert len(model.extension.urdf.findall('gazebo/*')) == 1


def test_numbers_that_c_cannot_read_are_0() -> None:
    model = robot(joint('<origin xyz="1e-320 0 2.3e-308"/>', 'fixed'))
    origin = written(model).find('joint/origin')
    assert origin is not None
    assert origin.get('xyz') == '0 0 2.3e-308'


def baked() -> Robot:
    """Give a robot as SDF has it: joints away from the frames of their child links."""
    def shape(link: str, extension: Extension = Extension()) -> Shape:  # noqa: B008
        geometry = None if extension.sdf is not None else Sphere(1.0)
        return Shape('s', Placement(Pose((0.1, 0.2, 0.3), (0.4, 0.5, 0.6)),
                                    FrameId('link', link)), geometry, None, extension)

    def extra(text: str) -> Extension:
        return Extension(None, etree.fromstring(text))

    links = (
        Link('a', Placement(Pose((1.0, 0.0, 0.0)), MODEL), None, (shape('a'),)),
        Link('b', Placement(Pose((0.0, 2.0, 0.0), (0.3, 0.2, 0.1)), MODEL),
             Inertial(Placement(Pose((0.0, 0.0, 0.1)), FrameId('link', 'b')), 2.0,
                      (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
             (shape('b', extra('<visual><geometry><plane/></geometry></visual>')),), (shape('b'),),
             extra('<link><sensor name="s" type="imu"><pose>1 2 3 0 0 0</pose></sensor>'
                   '<sensor name="t" type="imu"/><sensor name="u" type="imu">'
                   '<pose relative_to="f" degrees="true">0 0 0 0 0 90</pose>'
                   '</sensor><odd>1</odd></link>')),
        Link('c', Placement(Pose((0.0, 0.0, 3.0)), MODEL), None, (shape('c'),)),
    )
    joints = (
        Joint('j', 'revolute', 'a', 'b', Placement(Pose((0.5, 0.0, 0.0), (0.0, 0.25, 0.0)),
                                                   FrameId('link', 'b')),
              (Axis((0.0, 0.0, 1.0), Limit(-1.0, 1.0)),)),
        Joint('k', 'universal', 'b', 'c', Placement(Pose(), FrameId('link', 'c')),
              (Axis((0.0, 0.0, 1.0), Limit(-1.0, 1.0)), Axis((1.0, 0.0, 0.0), None, Dynamics(1.0),
                                                             Mimic('j', 2.0)))),
        Joint('l', 'ball', 'c', 'b', Placement(Pose((0.0, 0.0, 0.7)), FrameId('link', 'b')), (),
              True),
        Joint('m', 'revolute', 'c', 'a', Placement(Pose(), FrameId('link', 'a')),
              (Axis((0.0, 1.0, 0.0), Limit(-1.0, 1.0)),), True),
    )
    frames = (Frame('f', FrameId('link', 'b'), Placement(Pose((0.0, 9.0, 0.0)),
                                                         FrameId('joint', 'j'))),
              Frame('g', MODEL, Placement(Pose(), MODEL)))
    return Robot('r', links, joints, frames, 'b', extra('<model><static>1</static><odd/></model>'))


def test_what_hangs_on_a_joint_away_from_its_link_is_where_it_was_and_goes_back() -> None:
    model, report = baked(), Report()
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


def test_writing_again_writes_the_same_tags() -> None:
    first = written(baked())
    second = written(read_urdf(first, Report()))
    assert sorted(str(element.tag) for element in second.iter()) == sorted(
        str(element.tag) for element in first.iter())


def test_several_roots_are_not_written() -> None:
    model = replace(baked(), joints=())
    with pytest.raises(DescriptionError, match="by --root: 'a', 'b', 'c'"):
        write_urdf(model, Report())


def test_the_world_stays_the_world() -> None:
    model = robot('<link name="world"/><link name="a"/><joint name="j" type="fixed"><parent '
                  'link="world"/><child link="a"/></joint>')
    assert model.links[0].is_world
    assert again(model) == model


def test_origins_that_move_nothing_are_not_written() -> None:
    model = robot(joint('<origin xyz="0 0 0" rpy="0 0 0"/>', 'fixed'))
    assert not [*written(model).iter('origin')]


def test_no_namespace_is_declared_that_nothing_uses() -> None:
    assert b'xmlns' not in to_bytes(write_urdf(robot('<link name="a"/>'), Report()))


def test_long_chains_are_read_and_written_in_linear_time() -> None:
    def check(count: int) -> None:
        links = ''.join(f'<link name="l{index}"/>' for index in range(count + 1))
        joints = ''.join(f'<joint name="j{index}" type="fixed"><origin xyz="0 0 1"/><parent '
                         f'link="l{index}"/><child link="l{index + 1}"/></joint>'
                         for index in range(count))
        assert len(again(robot(links + joints)).joints) == count

    assert robots.is_linear(check)


@pytest.fixture(name='judge')
def yourdfpy_judge(tmp_path: Path) -> Callable[[Robot], Any]:
    """Load what is written with a reader of others."""
    yourdfpy = pytest.importorskip(
        'yourdfpy', reason='no package of ROS has it: pip install yourdfpy')

    def load(model: Robot) -> Any:
        path = tmp_path / 'r.urdf'
        path.write_bytes(to_bytes(write_urdf(model, Report())))
        loaded = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
        assert loaded.validate()
        return loaded

    return load


def test_yourdfpy_finds_links_where_joints_are(judge: Callable[[Robot], Any]) -> None:
    model = baked()
    kinematics = Kinematics(model)
    loaded = judge(model)
    for link in ('b', 'c'):
        frame = FrameId('joint', kinematics.parent_joint[link].name)
        pose = kinematics.between(FrameId('link', 'a'), frame).transform()
        matrix = loaded.get_transform(link, 'a')
        assert matrix[:3, 3] == pytest.approx(pose.translation, abs=1e-12)
        assert matrix[:3, :3].ravel() == pytest.approx(pose.rotation, abs=1e-12)


def test_yourdfpy_reads_the_same_numbers(judge: Callable[[Robot], Any]) -> None:
    model = robot(f"""<material name="m"><color rgba="0.9 0 0.1 1"/></material>
        <link name="a"><visual name="v"><origin xyz="1 2 3" rpy="0 1.5707963267948966 0"/>
        <geometry><mesh filename="package://p/a.stl" scale="1 2 0.123456789"/></geometry>
        <material name="m"/></visual></link><link name="b"/>
        <joint name="j" type="revolute">{ENDS}<axis xyz="0 0 2"/><limit lower="-1" upper="1"
        effort="3" velocity="4"/><mimic joint="k" multiplier="-2"/></joint><link name="c"/>
        <joint name="k" type="prismatic"><parent link="b"/><child link="c"/><limit lower="0"
        upper="1e16" effort="1" velocity="1"/></joint>""")
    loaded = judge(model).robot
    shape = loaded.links[0].visuals[0]
    assert shape.geometry.mesh.filename == 'package://p/a.stl'
    assert list(shape.geometry.mesh.scale) == [1, 2, 0.123456789]
    assert list(shape.material.color.rgba) == [0.9, 0, 0.1, 1]
    joints = {one.name: one for one in loaded.joints}
    assert joints['j'].mimic.multiplier == -2
    assert joints['k'].limit.upper == 1e16


def back_from_sdf(content: str, report: Report | None = None) -> Element:
    """Convert URDF to SDF and back."""
    root = convert_to_sdf(robot(content), Report(), inertial='zero', version='1.9')
    read = read_sdf(parse(to_bytes(root), 'r.sdf', Report()), Report())
    return convert_to_urdf(read, report or Report())


@pytest.mark.parametrize(('kind', 'limit', 'written_limit'), [
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
def test_limits_come_back(kind: str, limit: dict[str, str], written_limit: dict[str, str]) -> None:
    words = ' '.join(f'{name}="{value}"' for name, value in limit.items())
    report = Report()
    content = joint(f'<axis xyz="0 0 1"/><limit {words}/>', kind)
    root = back_from_sdf(content, report)
    found = root.find('joint')
    assert found is not None and found.get('type') == kind
    assert [dict(one.attrib) for one in found.findall('limit')] == [{**limit, **written_limit}]
    assert report.warnings == []
    found = differences(robot(content), read_urdf(root, Report()))
    assert [one for one in found if one.element == 'joint'] == []


def test_limits_of_joints_without_an_axis_are_complete() -> None:
    root = back_from_sdf(joint('<limit lower="0" upper="1"/>', 'fixed'))
    assert dict(root.find('joint/limit').attrib) == {  # type: ignore[union-attr]
        'lower': '0', 'upper': '1', 'effort': '1e+16', 'velocity': '1e+16'}


@pytest.mark.parametrize(('content', 'attributes'), [
    ('<dynamics/>', []),
    ('<dynamics armature="1"/>', [{'armature': '1', 'damping': '0'}]),
    ('<dynamics friction="0"/>', [{'friction': '0'}]),
])
@pytest.mark.parametrize('kind', ['continuous', 'fixed'])
def test_dynamics_say_something(kind: str, content: str, attributes: list[dict[str, str]]) -> None:
    root = back_from_sdf(joint(f'<axis xyz="0 0 1"/>{content}', kind))
    assert [dict(one.attrib) for one in root.iterfind('joint/dynamics')] == attributes


@pytest.mark.parametrize(('content', 'message'), [
    ('<safety_controller/>', "joint 'j': has no k_velocity=, which URDF requires"),
    ('<safety_controller k_velocity="fast"/>', "k_velocity='fast' is not a finite number"),
    ('<calibration falling="1e400"/>', "falling='1e400' is not a finite number"),
    ('<mimic/>', 'has no joint='),
    ('<dynamics damping="inf"/>', "damping='inf'"),
])
def test_numbers_of_joints_that_urdf_refuses(content: str, message: str) -> None:
    with pytest.raises(DescriptionError, match=re.escape(message)):
        back_from_sdf(joint(content, 'fixed'))


@pytest.mark.parametrize(('version', 'back'), [
    ('1.0', '1.0'), ('1.2', '1.2'), ('1', '1.0'), ('2.0', '1.0')])
def test_version_that_urdf_has(version: str, back: str) -> None:
    text = f'<robot name="r" version="{version}"><link name="a"/></robot>'
    model = read_urdf(parse(text.encode(), 'r.urdf', Report()), Report())
    report = Report()
    root = convert_to_urdf(model, report, inertial='zero')
    assert root.get('version') == back
    assert [version in note.message for note in report.warnings] == [True] * (version != back)


def test_materials_of_the_robot_have_a_name_each() -> None:
    report = Report()
    red = '<material name="red"><color rgba="1 0 0 1"/></material>'
    root = back_from_sdf(f'{red}{red}<material name="red_again"/>{red}<link name="a"/>', report)
    assert root.xpath('material/@name') == ['red', 'red_again_1', 'red_again', 'red_again_2']
    assert len(report.warnings) == 2


def test_colors_are_cut_and_come_back_unless_changed() -> None:
    content = ('<material name="red"><color rgba="2 0 0 1"/></material>'
               f'<link name="a"><visual>{BOX}<material name="blue"><color rgba="0 -1 1 1"/>'
               '</material></visual></link>')
    report = Report()
    root = back_from_sdf(content, report)
    assert root.xpath('//color/@rgba') == ['0 0 1 1', '1 0 0 1']
    assert [note.name for note in report.warnings] == ['red', 'blue']
    model = read_urdf(parse(to_bytes(root), 'r.urdf', Report()), Report())
    material = model.links[0].visuals[0].material
    assert material is not None and material.color == (0.0, -1.0, 1.0, 1.0)
    kept = model.extension.urdf
    assert kept is not None and kept.xpath('material/color/@rgba') == ['2 0 0 1']
    color = root.find('link/visual/material/color')
    assert color is not None
    color.set('rgba', '1 1 1 1')
    material = read_urdf(root, Report()).links[0].visuals[0].material
    assert material is not None and material.color == (1.0, 1.0, 1.0, 1.0)


def test_robot_name_is_flat() -> None:
    text = '<sdf version="1.7"><model name="a::b"><link name="a"/></model></sdf>'
    report = Report()
    model = read_sdf(parse(text.encode(), 'r.sdf', Report()), Report())
    assert convert_to_urdf(model, report, inertial='zero').get('name') == 'a__b'
    assert [note.name for note in report.warnings] == ['a::b']
