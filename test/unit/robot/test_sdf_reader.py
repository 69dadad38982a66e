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

"""Reader of SDF: placements, nested models, the world, and errors."""

from __future__ import annotations

from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import FrameId, Joint, Mimic, MODEL, Placement
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report
import pytest
import robots
from rows import each_row
from sdf_models import HALF, joint, near, read, read_text, TWO

NESTED = (
    '<link name="base"/><model name="arm" placement_frame="tip"><pose relative_to="f">1 0 0 0 0 0'
    '</pose><static>true</static><link name="base"/><link name="tip"><pose>0 0 2 0 0 0</pose>'
    '</link><frame name="g" attached_to="tip"/><joint name="j" type="revolute"><parent>base'
    '</parent><child>tip</child><axis><mimic joint="k"/></axis></joint><joint name="k" '
    'type="revolute"><parent>world</parent><child>base</child><axis/></joint></model>'
    '<frame name="f"><pose>0 5 0 0 0 0</pose></frame>'
    '<joint name="j" type="fixed"><parent>base</parent><child>arm::g</child></joint>'
    '<joint name="i" type="fixed"><parent>arm</parent><child>base</child></joint>')


def test_default_placements_of_links_and_joints() -> None:
    robot = read(TWO.replace('"b"/>', '"b"><pose>0 0 0.20 0 0 1.5</pose></link>')
                 + joint('<pose>1 0 0 0 0 0</pose>'))
    assert robot.name == 'm' and robot.source == 'robot.sdf'
    assert robot.links[1].placement == Placement(Pose((0, 0, 0.2), (0, 0, 1.5)), MODEL)
    assert robot.joints == (Joint(name='j', type='fixed', parent='a', child='b',
                                  placement=Placement(Pose((1, 0, 0)), FrameId('link', 'b'))),)
    assert robot.joints[0].line == 2


@each_row(('content', 'message'), [
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
def test_errors_in_the_contents_of_a_model(content: str, message: str) -> None:
    with pytest.raises(DescriptionError) as error:
        read(content)
    assert message in str(error.value)
    assert str(error.value).startswith('robot.sdf:2: <') and '\n' not in str(error.value)


@pytest.mark.parametrize(('attribute', 'message'), [
    ('canonical_link="x"', "canonical_link 'x' is not a link"),
    ('canonical_link="f"', "canonical_link='f' is a frame"),
    ('placement_frame="x"', "placement_frame 'x' is not a link")])
def test_errors_in_attributes_of_a_model(attribute: str, message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        read('<link name="a"/><frame name="f"/>', attributes=attribute)


@each_row(('text', 'message'), [
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
def test_errors_in_a_file(text: str, message: str) -> None:
    with pytest.raises(DescriptionError, match=message.replace('.', '[.]')):
        read_text(text)


def test_frames_and_joints_between_frames() -> None:
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


def test_world_link_of_a_fixed_joint() -> None:
    robot = read('<pose>1 0 0 0 0 0</pose><link name="a"/>' + joint(parent='world', child='a'))
    assert robot.links[-1].is_world
    assert robot.links[-1].placement.pose.xyz == (-1, 0, 0)
    assert robot.canonical_link == ''
    assert robot.extension.sdf is not None and robot.extension.sdf.findtext('pose')


def test_placement_frame_of_the_robot() -> None:
    report = Report()
    robot = read(f'<pose>5 0 0 0 0 0</pose><link name="a"><pose>0 2 0 0 0 {HALF}</pose></link>',
                 attributes='placement_frame="a"', report=report)
    assert robot.extension.sdf is not None and not robot.extension.sdf.attrib
    numbers = tuple(map(float, (robot.extension.sdf.findtext('pose') or '').split()))
    assert numbers == pytest.approx((3, 0, 0, 0, 0, -HALF), abs=1e-12)
    assert report.notes[0].element == 'pose'


def test_flattened_nested_model() -> None:
    report = Report()
    robot = read(NESTED, '1.11', report)
    assert [link.name for link in robot.links] == ['base', 'arm::base', 'arm::tip', 'world']
    assert [one.name for one in robot.joints] == ['j', 'i', 'arm::j', 'arm::k']
    assert [frame.name for frame in robot.frames] == ['f', 'arm::__model__', 'arm::g']
    assert robot.frames[1].attached_to == FrameId('link', 'arm::base')
    assert robot.joints[1].parent == 'arm::base'
    assert robot.joints[2].axes[0].mimic == Mimic('arm::k')
    kinematics = Kinematics(robot)
    # The pose of the model places its link tip.
    assert near(kinematics.pose(FrameId('link', 'arm::tip')).translation, (1, 5, 0))
    assert near(kinematics.pose(FrameId('frame', 'arm::__model__')).translation, (1, 5, -2))
    assert [note.element for note in report.warnings] == ['static']


def test_model_nested_twice() -> None:
    robot = read('<model name="x"><pose>1 0 0 0 0 0</pose><model name="y"><pose>0 1 0 0 0 0</pose>'
                 '<link name="a"><sensor name="s"><pose relative_to="a">0 0 0 0 0 0</pose>'
                 '</sensor></link></model></model>')
    assert robot.links[0].name == 'x::y::a'
    assert Kinematics(robot).pose(FrameId('link', 'x::y::a')).translation == (1, 1, 0)
    rest = robot.links[0].extension.sdf
    assert rest is not None
    assert rest.xpath('sensor/pose/@relative_to') == ['x::y::a']


def test_preserved_unread_elements() -> None:
    robot = read('<static>true</static><plugin name="p"/><preserved:urdf>'
                 '<transmission name="t"/></preserved:urdf><link '
                 'name="a" urdf:name="x"><sensor name="s" type="imu"><pose frame="a"/></sensor>'
                 '</link>', '1.6')
    assert robot.extension.sdf is not None and robot.extension.urdf is not None
    assert [child.tag for child in robot.extension.sdf] == ['static', 'plugin']
    assert [child.tag for child in robot.extension.urdf] == ['transmission']
    link = robot.links[0].extension
    assert link.urdf is not None and link.urdf.get('name') == 'x'
    # Preserved SDF uses the attributes of newer versions.
    assert link.sdf is not None and link.sdf.xpath('sensor/pose/@relative_to') == ['a']


@each_row(('text', 'line'), [
    ('<sdf version="1.9">\n<model name="m"><link name="a"><gz:x gz:y="1"/></link></model></sdf>',
     2),
    ('<sdf version="1.9">\n<!-- a -- b --->\n<model name="m"><link name="a"/></model></sdf>', 3),
    ('some text\n<?xml version="1.0"?>\n<sdf version="1.9"><model name="m"><link name="a"/>'
     '</model></sdf>', 3),
    ('\n\n<?xml version="1.0"?><sdf version="1.9"><model name="m"><link name="a"/>'
     '</model></sdf>', 3)])
def test_common_errors_of_public_files_are_warnings(text: str, line: int) -> None:
    report = Report()
    robot = read_text(text, report)
    assert robot.links[0].line == line
    assert [note.element for note in report.warnings] == ['sdf']
    assert 'not well-formed XML' in report.warnings[0].message


@pytest.mark.thorough
def test_linear_cost_of_a_long_chain() -> None:
    def check(count: int) -> None:
        content = ''.join(
            f'<link name="l{index}"><pose relative_to="{f"l{index - 1}" if index else ""}">'
            f'0 0 1 0 0 0</pose></link>' for index in range(count))
        content += ''.join(joint(name=f'j{index}', parent=f'l{index}', child=f'l{index + 1}')
                           for index in range(count - 1))
        last = FrameId('link', f'l{count - 1}')
        assert Kinematics(read(content)).pose(last).translation == (0, 0, count)

    assert robots.is_linear(check)
