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

"""Reader of SDF joints: types, axes, mimics and loops."""

from __future__ import annotations

from lxml import etree
from opencv_tools.robot.geometry import Capsule
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import (
    Axis, Dynamics, Joint, Limit, Link, Mimic, MODEL, Placement, Robot)
from opencv_tools.robot.pose import Pose, Vector
from opencv_tools.robot.sdf.reader import mark_loops, read_sdf
from opencv_tools.robot.xml.report import Report
import pytest
from rows import each_row
from sdf_models import HALF, joint, near, read, TWO, with_axis, written


def loops(*pairs: str, canonical: str = '') -> list[bool]:
    """Return which joints between pairs of links are marked as loops."""
    joints = tuple(Joint(name=f'j{index}', type='fixed', parent=pair[0], child=pair[1],
                         placement=Placement(Pose(), MODEL))
                   for index, pair in enumerate(pairs))
    names = sorted(set(''.join(pairs)))
    links = tuple(Link(name=name, placement=Placement(Pose(), MODEL)) for name in names)
    marked = mark_loops(Robot(name='r', links=links, joints=joints), canonical or names[0])
    return [joint.is_loop for joint in marked.joints]


@each_row(('version', 'extra', 'attribute', 'expected'), [
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
def test_axis_frame_by_version(
        version: str, extra: str, attribute: str, expected: Vector) -> None:
    robot = read(f'<link name="a"/><link name="b"><pose>0 0 1 0 0 {HALF}</pose></link>' + joint(
        f'<axis><xyz {attribute}>1 0 0</xyz>{extra}</axis>', 'prismatic'), version)
    assert near(robot.joints[0].axes[0].xyz, expected)


def test_use_parent_model_frame_is_ignored_since_1_7() -> None:
    report = Report()
    text = '<axis><use_parent_model_frame>{}</use_parent_model_frame></axis>'
    robot = read(f'<link name="a"/><link name="b"><pose>0 0 1 {HALF} 0 0</pose></link>'
                 + joint(text.format('1'), 'prismatic'), '1.7', report)
    assert robot.joints[0].axes[0].xyz == (0, 0, 1)
    assert [note.message[:33] for note in report.warnings] == ['use_parent_model_frame is ignored']
    read(TWO + joint(text.format('0'), 'prismatic'), '1.7', quiet := Report())
    assert not quiet.warnings


def test_axis_numbers_in_parallel_frames() -> None:
    robot = read('<link name="a"/><link name="b"><pose>0.1 0.2 0.3 0 0 0</pose></link>' + joint(
        '<axis><xyz>0.1 0.7 -3</xyz></axis>', 'prismatic'), '1.4')
    assert robot.joints[0].axes[0].xyz == (0.1, 0.7, -3.0)


def test_two_axes_with_limits_and_dynamics() -> None:
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


@each_row(('kind', 'limit', 'expected'), [
    ('revolute', '', 'continuous'),
    ('revolute', '<limit/>', 'continuous'),
    ('revolute', '<limit><lower>-1e16</lower><upper>1e16</upper></limit>', 'continuous'),
    ('revolute', '<limit><lower>-inf</lower><upper>inf</upper></limit>', 'continuous'),
    ('revolute', '<limit><lower>-1</lower></limit>', 'revolute'),
    ('prismatic', '', 'prismatic'),
    ('screw', '', 'screw'), ('revolute2', '', 'revolute2'), ('gearbox', '', 'gearbox')])
def test_joint_types_and_unlimited_joints(kind: str, limit: str, expected: str) -> None:
    robot = read(TWO + joint(f'<axis>{limit}</axis>', kind))
    assert robot.joints[0].type == expected


def test_preserved_limits_of_a_continuous_joint() -> None:
    made = read(TWO + joint('<axis><limit><lower>-1</lower><effort>2</effort></limit></axis>',
                            'continuous')).joints[0]
    assert made.axes[0].limit == Limit(effort=2)
    assert made.extension.sdf is not None
    assert made.extension.sdf.findtext('axis/limit/lower') == '-1'


def test_preserved_axis_of_a_fixed_joint() -> None:
    made = read(TWO + joint('<axis><xyz>0 0 0</xyz></axis>')).joints[0]
    assert made.axes == () and made.extension.sdf is not None


def test_removed_axis_of_a_fixed_joint_in_1_4() -> None:
    text = joint('<axis/>', 'revolute').replace('type=', 'urdf:type="fixed" type=')
    made = read(TWO + text, '1.4').joints[0]
    assert (made.type, made.axes, made.extension.sdf) == ('fixed', (), None)


@pytest.mark.parametrize(('lower', 'reported'), [
    ('2', ['lower=2.0 is greater than upper=1.0']), ('1', []), ('0', [])])
def test_lower_limit_above_upper_limit(lower: str, reported: list[str]) -> None:
    report = Report()
    read(TWO + joint(f'<axis><limit><lower>{lower}</lower><upper>1</upper></limit></axis>',
                     'revolute'), report=report)
    assert [note.message for note in report.warnings] == reported


def test_preserved_mimic_capsule_and_joint_of_urdf() -> None:
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


def test_flat_frame_name_in_a_preserved_axis() -> None:
    model = read('<link name="a"/><model name="n"><link name="a"/><link name="b"/>' + joint(
        '<axis><xyz expressed_in="a">1 0 0</xyz></axis>') + '</model>' + joint(
        name='k', child='n::a'))
    (rest,) = (one.extension.sdf for one in model.joints if one.name == 'n::j')
    assert rest is not None
    xyz = rest.find('axis/xyz')
    assert xyz is not None
    assert xyz.get('expressed_in') == 'n__a'


def test_marked_loops() -> None:
    assert loops('ab', 'bc') == [False, False]
    assert loops('ab', 'ac', 'bd', 'cd') == [False, False, False, True]
    assert loops('ac', 'bc') == [False, True]
    assert loops('ab', 'bc', 'ca') == [False, False, True]
    assert loops('ab', 'bc', 'ca', canonical='b') == [True, False, False]
    assert loops('bc', 'cb', 'ab') == [False, True, False]
    assert loops('ab', 'ba', 'cd', 'dc') == [False, True, False, True]
    assert loops('cb', 'bc', 'ab') == [True, False, False]
    # Links before the root of a cycle, which are not in the cycle.
    assert loops('bc', 'cd', 'db', 'ba') == [False, False, True, False]
    assert loops('bc', 'cd', 'db', 'ba', canonical='d') == [False, True, False, False]
    assert loops('ca', 'ab', 'cd', 'de', 'ec') == [False, False, False, False, True]


def test_loop_of_two_joints() -> None:
    robot = read(TWO + joint() + joint(name='k', parent='b', child='a'))
    assert [one.is_loop for one in robot.joints] == [False, True]
    assert Kinematics(robot).roots == ['a']


def test_unknown_element_of_an_unlimited_axis() -> None:
    model = written(with_axis(Axis((0.0, 0.0, 1.0), Limit())))
    axis, root = model.find('joint/axis'), model.getparent()
    assert axis is not None and root is not None
    etree.SubElement(axis, 'odd').text = '1'
    result = read_sdf(root, Report()).joints[0]
    assert result.type == 'revolute' and result.extension.sdf is not None
    assert result.extension.sdf.findtext('axis/odd') == '1'
