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

"""Reader of URDF: roots, joints, axes, limits and frames."""

from __future__ import annotations

import math
import re

from lxml import etree
from opencv_tools.robot.compare.properties import is_continuous
from opencv_tools.robot.model import Axis, Dynamics, FrameId, Limit, Mimic, MODEL, Placement
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.xml.document import DescriptionError, Element, parse
from opencv_tools.robot.xml.report import Report
import pytest
import robots
from rows import each_row
from urdf_models import (
    BOX, check_error, ENDS, joint, LIMIT, LINKS, read, round_trip, visual, written)


@each_row(('content', 'location', 'message'), [
    (joint('', 'hinge'), '1: <joint>', "type='hinge' is not supported; give one of fixed, revol"),
    (f'{LINKS}<joint name="j">{ENDS}</joint>', '1: <joint>', 'has no type=; give one of fixed'),
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
    ('<link name="a"/>\n<sdf:frame name="f" attached_to="x"/>', '2: <frame>', "'x'"),
    (LINKS + f'\n<joint name="j" type="floating" sdf:type="odd">{ENDS}</joint>', '2: <joint>',
     "type='odd'"),
])
def test_errors(content: str, location: str, message: str) -> None:
    check_error(content, location, message)


@pytest.mark.parametrize(('text', 'message'), [
    ('<sdf version="1.11"/>', '<sdf>: is not URDF; its root is <sdf>'),
    ('<robot/>', '<robot>: has no <link>'),
])
def test_other_root_element(text: str, message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        read_urdf(parse(text.encode(), 'r.urdf', Report()), Report())


def test_quaternion_of_an_origin() -> None:
    model = read(joint('<origin xyz="1 2 3" quat_xyzw="0 0 1 1"/>', 'fixed'))
    assert model.joints[0].placement.pose.xyz == (1.0, 2.0, 3.0)
    assert model.joints[0].placement.pose.rpy == pytest.approx((0, 0, math.pi / 2), abs=1e-15)
    assert round_trip(model).joints == model.joints


def test_choice_of_one_root_link() -> None:
    content = joint('', 'fixed') + '<link name="c"/><link name="d"/>'
    with pytest.raises(DescriptionError, match=r"r\.urdf: .*--root: 'a', 'c', 'd'"):
        read(content)
    report = Report()
    chosen = read(content, report, 'a')
    assert [link.name for link in chosen.links] == ['a', 'b']
    assert [note.name for note in report.warnings] == ['c', 'd']
    with pytest.raises(DescriptionError, match="--root 'b' is not a root link"):
        read(content, root_link='b')


@each_row(('content', 'element', 'message'), [
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
    read(content, report)
    assert [note.element for note in report.warnings] == [element]
    assert message in report.warnings[0].message


@pytest.mark.parametrize('name', ['effort', 'velocity', 'acceleration', 'deceleration', 'jerk'])
@pytest.mark.parametrize(('version', 'value', 'is_wrong'), [
    ('1.2', '-3', True), ('1.2', '-0.25', True), ('1.2', '3', False), ('1.1', '-3', False)])
def test_negative_limit_of_version_1_2(name: str, version: str, value: str, is_wrong: bool
                                       ) -> None:
    report = Report()
    limits = {'effort': '1', 'velocity': '1', 'lower': '0', 'upper': '1', name: value}
    text = joint('<limit ' + ' '.join(f'{key}="{one}"' for key, one in limits.items()) + '/>')
    read_urdf(parse(f'<robot name="r" version="{version}">{text}</robot>'.encode(), 'r.urdf',
                    report), report)
    assert [note.message for note in report.warnings if 'negative' in note.message] == (
        [f'{name}={value!r} is negative'] if is_wrong else [])


@pytest.mark.parametrize(('version', 'read_as'), [
    ('1.10', '1.2'), ('2.0', '1.2'), ('0.9', '1.0'), ('abc', '1.0')])
def test_unknown_version_is_read_as_the_nearest(version: str, read_as: str) -> None:
    report = Report()
    read_urdf(parse(f'<robot name="r" version="{version}"><link name="a"/></robot>'.encode(),
                    'r.urdf', report), report)
    warning, = report.warnings
    assert warning.message.endswith(f'the file is read as {read_as!r}')


def test_warning_of_an_undefined_element_promises_no_conversion() -> None:
    report = Report()
    read('<link name="a"><odd/></link>', report)
    assert [note.message for note in report.warnings] == [
        'is not defined in <link> by URDF and has no effect']


def test_mimic_of_an_unknown_joint_is_preserved() -> None:
    report = Report()
    model = read(joint(LIMIT + '<mimic joint="x" offset="1"/>'), report)
    assert [note.element for note in report.warnings] == ['mimic']
    assert model.joints[0].axes[0].mimic is None
    mimic = written(model).find('joint/mimic')
    assert mimic is not None
    assert dict(mimic.attrib) == {'joint': 'x', 'offset': '1'}


def test_frames_of_placements() -> None:
    model = read('<link name="a"/><link name="b"/><link name="c"/>'
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


@each_row(('kind', 'content', 'axes'), [
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
def test_axes_in_a_round_trip(kind: str, content: str, axes: tuple[Axis, ...]) -> None:
    model = read(f'{joint(content, kind)}<link name="c"/><joint name="k" type="continuous">'
                 '<parent link="b"/><child link="c"/></joint>')
    assert model.joints[0].axes == axes
    assert model.joints[0].type == kind
    back = round_trip(model)
    assert back.joints[0].axes == axes
    assert etree.tostring(written(back)) == etree.tostring(written(model))


def test_revolute_joint_with_unlimited_limits() -> None:
    model = read(joint('<limit lower="-1e16" upper="1e17" effort="1" velocity="2"/>'))
    assert model.joints[0].type == 'revolute'
    limit = written(model).find('joint/limit')
    assert limit is not None and limit.get('upper') == '1e+16'
    assert is_continuous(model.joints[0])


@each_row('content', [
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
def test_unread_parts_are_written_again(content: str) -> None:
    data = f'<robot name="r" version="1.0">{content}</robot>'.encode()

    def facts(root: Element) -> set[tuple[str, ...]]:
        tree = root.getroottree()
        plain = [(re.sub(r'\[\d+\]', '', tree.getelementpath(one)), one) for one in root.iter()]
        return {(path, *pair) for path, element in plain
                for pair in [*element.items(), ('', (element.text or '').strip())]}

    root, report = parse(data, 'r.urdf', Report()), Report()
    result = written(read_urdf(root, report), report)
    assert facts(root) <= facts(result)
    undone = 'is not defined in|no effect in SDF'
    assert [note for note in report.notes if not re.search(undone, note.message)] == []


@pytest.mark.thorough
def test_linear_cost_of_long_chains() -> None:
    def check(count: int) -> None:
        links = ''.join(f'<link name="l{index}"/>' for index in range(count + 1))
        joints = ''.join(f'<joint name="j{index}" type="fixed"><origin xyz="0 0 1"/><parent '
                         f'link="l{index}"/><child link="l{index + 1}"/></joint>'
                         for index in range(count))
        assert len(round_trip(read(links + joints)).joints) == count

    assert robots.is_linear(check)
