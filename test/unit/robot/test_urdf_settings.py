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

"""Settings of <gazebo reference>, and the elements of SDF with the same meaning."""

from __future__ import annotations

from lxml import etree
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf, SdfOptions, UrdfOptions
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.urdf.settings import Setting, SETTINGS
from opencv_tools.robot.xml.document import Element, parse, to_bytes
from opencv_tools.robot.xml.report import Report
import pytest
from rows import each_row
from sdf_models import read as read_model
from urdf_models import joint, LIMIT, read

SPHERE = '<geometry><sphere radius="1"/></geometry>'
ROBOT = joint(LIMIT).replace(
    '<link name="a"/>', f'<link name="a"><collision>{SPHERE}</collision><collision name="c">'
    f'{SPHERE}</collision><visual>{SPHERE}</visual><visual name="v">{SPHERE}</visual></link>')
SDF_SPHERE = '<geometry><sphere><radius>1</radius></sphere></geometry>'


def sdf_of(content: str) -> tuple[Element, Report]:
    """Convert URDF to SDF, and return the model."""
    report = Report()
    robot = read(ROBOT + content, report)
    return convert_to_sdf(robot, report, SdfOptions(inertial='zero'))[0], report


def urdf_of(content: str) -> tuple[Element, Report]:
    """Convert a link of SDF with this content to URDF."""
    report = Report()
    robot = read_model(f'<link name="a">{content}</link>', report=report)
    return convert_to_urdf(robot, report, UrdfOptions(inertial='zero')), report


def settings_in(urdf: Element) -> list[tuple[str | None, str, str | None]]:
    """Return reference, tag and text of the settings."""
    return [(element.get('reference'), str(child.tag), child.text)
            for element in urdf.iterchildren('gazebo') for child in element]


def collision(surface: str, name: str = 'c') -> str:
    """Return the text of a collision of SDF."""
    return f'<collision name="{name}">{SDF_SPHERE}{surface}</collision>'


@pytest.mark.parametrize('setting', SETTINGS, ids=lambda setting: setting.tag)
def test_every_setting_there_and_back(setting: Setting) -> None:
    tag, owner = setting.tag, setting.owner
    flags = ('selfCollide', 'turnGravityOff', 'cfmDamping', 'implicitSpringDamper',
             'provideFeedback', 'static')
    text = {'fdir1': '0 1 0', 'maxContacts': '5'}.get(tag, 'true' if tag in flags else '0.5')
    reference = {'joint': 'j', 'model': None}.get(owner, 'a')
    attribute = f' reference="{reference}"' if reference else ''
    model, report = sdf_of(f'<gazebo{attribute}><{tag}>{text}</{tag}></gazebo>')
    assert [note.message for note in report.warnings] == []
    is_shape = owner in ('visual', 'collision')
    prefix = f'link/{owner}' if is_shape else f'{owner}[@name="{reference}"]'
    prefix = prefix if reference else '.'
    expected = 'false' if tag == 'turnGravityOff' else text
    for path in setting.paths:
        found = model.xpath(f'{prefix}/{path}/text()')
        assert found == [expected] * (2 if is_shape else 1)
    assert model.xpath('//*[local-name()="urdf"]') == []
    back = convert_to_urdf(read_sdf(parse(to_bytes(model.getparent()), 'r.sdf', Report()),
                                    Report()), Report())
    assert settings_in(back) == [(reference, tag, text)]


@each_row(('content', 'words'), [
    ('<gazebo reference="a"><mu>0.5</mu></gazebo>', 'no effect in SDF'),
    ('<gazebo reference="j"><mu1>0.5</mu1></gazebo>', 'no effect in SDF'),
    ('<gazebo reference="a"><mu1>rough</mu1></gazebo>', "'rough' is not a number"),
    ('<gazebo reference="a"><kp>1e5x</kp></gazebo>', "'1e5x' is not a number"),
    ('<gazebo reference="a"><mu1>0x10</mu1></gazebo>', "'0x10' is not a number"),
    ('<gazebo reference="a"><minDepth value="nan"/></gazebo>', "'nan' is not a number"),
    ('<gazebo reference="a"><fdir1>1 0 0 0</fdir1></gazebo>', "'1 0 0 0' is not 3 numbers"),
    ('<gazebo reference="a"><fdir1>1 0</fdir1></gazebo>', "'1 0' is not 3 numbers"),
    ('<gazebo reference="a"><dampingFactor>1 2</dampingFactor></gazebo>', "'1 2' is not a number"),
    ('<gazebo reference="j"><stopErp>1_0</stopErp></gazebo>', "'1_0' is not a number"),
    ('<gazebo reference="a"><maxContacts>3.7</maxContacts></gazebo>', "'3.7' is not an integer"),
    ('<gazebo reference="a"><maxContacts>1e1</maxContacts></gazebo>', "'1e1' is not an integer"),
    ('<gazebo reference="a"><maxContacts>-2147483649</maxContacts></gazebo>', 'is outside of -2'),
    ('<gazebo reference="a"><collision><max_contacts>0.5</max_contacts></collision></gazebo>',
     "'0.5' is not an integer"),
    ('<gazebo reference="a"><visual><visibility_flags>-3</visibility_flags></visual></gazebo>',
     "'-3' is not an integer from 0"),
    ('<gazebo reference="a"><mu1/></gazebo>', 'has no value'),
    ('<gazebo reference="a"><turnGravityOff>2</turnGravityOff></gazebo>', "'2' is not true")])
def test_setting_without_an_effect_has_a_warning(content: str, words: str) -> None:
    model, report = sdf_of(content)
    assert words in report.warnings[0].message
    assert len(model.xpath('*[local-name()="urdf"]/gazebo/*')) == 1
    assert model.xpath('//surface | //velocity_decay | //physics') == []


@each_row(('content', 'tags'), [
    ('<velocity_decay><linear>{}</linear></velocity_decay>' * 2, ['velocity_decay']),
    ('<gravity>{}</gravity></gazebo><gazebo reference="a"><gravity>0</gravity>', ['gravity']),
    ('<kinematic>{}</kinematic>' * 4, ['kinematic'] * 3),
    ('<light name="l{}" type="point"/><light name="m" type="point"/>', []),
    ('<audio_source><uri>{}</uri></audio_source>' * 2, [])])
def test_second_element_that_a_link_has_once_has_a_warning(content: str, tags: list[str]) -> None:
    model, report = sdf_of(f'<gazebo reference="a">{content.replace("{}", "1")}</gazebo>')
    assert [(note.element, note.message) for note in report.warnings] == [
        (tag, 'has no effect: an earlier one counts') for tag in tags]
    assert model.xpath('*[local-name()="urdf"]/gazebo/*') == []


@each_row('text', ['0', '-3', '+7', '40.', '300.00', '2147483647'])
def test_integers_of_gazebo(text: str) -> None:
    model, report = sdf_of(f'<gazebo reference="a"><maxContacts>{text}</maxContacts></gazebo>')
    assert report.warnings == []
    assert model.xpath('//max_contacts/text()') == [text, text]


def test_infinite_friction() -> None:
    model, report = sdf_of('<gazebo reference="a"><mu1>inf</mu1></gazebo>')
    assert report.warnings == []
    assert model.xpath('.//mu/text()') == ['inf', 'inf']


@each_row('content', [
    '<gazebo reference="j"><preserveFixedJoint>true</preserveFixedJoint></gazebo>',
    '<gazebo reference="j"><disableFixedJointLumping>true</disableFixedJointLumping></gazebo>',
    '<gazebo reference="b"><material>Gazebo/Red</material></gazebo>',
    '<gazebo reference="b"><mu1>0.5</mu1></gazebo>'])
def test_setting_that_sdf_does_not_need_stays_without_a_warning(content: str) -> None:
    model, report = sdf_of(content)
    assert len(model.xpath('*[local-name()="urdf"]/gazebo/*')) == 1
    assert report.warnings == []


def test_spring_of_a_joint_without_an_axis_stays_preserved() -> None:
    text = '<dynamics><spring_stiffness>3</spring_stiffness></dynamics>'
    robot = read_model('<link name="a"/><link name="b"/><joint name="j" type="revolute2">'
                       f'<parent>a</parent><child>b</child><axis><xyz>0 0 1</xyz>{text}</axis>'
                       '</joint>')
    urdf = convert_to_urdf(robot, Report(), UrdfOptions(inertial='zero'))
    assert settings_in(urdf) == []
    assert urdf.xpath('joint//spring_stiffness/text()') == ['3']


def test_value_in_an_attribute() -> None:
    model, report = sdf_of('<gazebo reference="a"><mu1 value="0.2"/></gazebo>')
    assert model.xpath('//mu/text()') == ['0.2', '0.2']
    assert report.warnings == []


def test_last_of_several_values() -> None:
    model, report = sdf_of('<gazebo reference="a"><mu1>1</mu1></gazebo>'
                           '<gazebo reference="a"><mu1>2</mu1><mu2>3</mu2></gazebo>')
    assert model.xpath('//mu/text()') == ['2', '2']
    assert ["'2' replaces another" in note.message for note in report.warnings] == [True]


def test_rest_of_the_surface_is_in_the_block() -> None:
    urdf, report = urdf_of(collision(
        '<surface><friction><ode><mu>0.5</mu><slip1>2</slip1></ode></friction></surface>'))
    assert settings_in(urdf) == [('a', 'mu1', '0.5'), ('a', 'collision', None)]
    assert urdf.xpath('gazebo/collision/surface/friction/ode/slip1/text()') == ['2']
    assert urdf.xpath('link//ode') == []
    assert report.warnings == []


def test_contents_for_all_shapes_of_a_link_there_and_back() -> None:
    content = """<gazebo reference="a"><material>Gazebo/SkyBlue</material>
        <visual><transparency>0.375</transparency></visual><collision><surface><bounce>
        <restitution_coefficient>0.25</restitution_coefficient></bounce></surface>
        <max_contacts>7</max_contacts></collision><mu1>0.125</mu1></gazebo>
        <gazebo reference="j"><physics><ode><limit><cfm>0.5</cfm></limit></ode></physics>
        <gearbox_ratio>2.5</gearbox_ratio></gazebo>
        <gazebo><pose>1 2 3 0 0 0.5</pose><static>yes</static></gazebo>"""
    model, report = sdf_of(content)
    assert report.warnings == []
    for path, texts in (
            ('visual/material/script/name', ['Gazebo/SkyBlue'] * 2),
            ('visual/transparency', ['0.375'] * 2), ('collision/max_contacts', ['7'] * 2),
            ('collision/surface/bounce/restitution_coefficient', ['0.25'] * 2),
            ('collision/surface/friction/ode/mu', ['0.125'] * 2)):
        assert model.xpath(f'link[@name="a"]/{path}/text()') == texts
    assert model.xpath('joint/physics/ode/limit/cfm/text()') == ['0.5']
    assert model.xpath('joint/gearbox_ratio/text()') == ['2.5']
    assert model.xpath('pose/text() | static/text()') == ['1 2 3 0 0 0.5', 'true']
    there = read_sdf(parse(to_bytes(model.getparent()), 'r.sdf', Report()), Report())
    back = convert_to_urdf(there, Report())
    assert back.xpath('gazebo/visual/transparency/text()') == ['0.375']
    assert back.xpath('gazebo[@reference]/material/text()') == ['Gazebo/SkyBlue']
    robot = read_urdf(parse(to_bytes(back), 'r.urdf', Report()), Report())
    again = convert_to_sdf(robot, Report())
    assert again.xpath('model/link/visual/material/script/*/text()') == model.xpath(
        'link/visual/material/script/*/text()')


@each_row('content', ['<odd/>', '<sensor name="s" type="imu"/>', '<include/>'])
def test_element_of_the_model_without_an_effect_has_a_warning(content: str) -> None:
    _, report = sdf_of(f'<gazebo>{content}</gazebo>')
    assert ['no effect in SDF' in note.message for note in report.warnings] == [True]


@pytest.mark.parametrize('other', ['', '<max_contacts>5</max_contacts>'])
def test_different_collisions_keep_their_values(other: str) -> None:
    urdf, report = urdf_of(collision('<max_contacts>4</max_contacts>') + collision(other, 'd'))
    assert settings_in(urdf) == []
    assert urdf.xpath('link/collision[1]/*/max_contacts/text()') == ['4']
    assert 'has one value of <max_contacts>' in report.warnings[0].message


@pytest.mark.parametrize('decay', ['<linear>1</linear>', '<linear>1</linear><angular>2</angular>'])
def test_velocity_decay_of_two_values_stays_as_it_is(decay: str) -> None:
    urdf, report = urdf_of(f'<velocity_decay>{decay}</velocity_decay>')
    kept, = urdf.findall('gazebo/velocity_decay')
    assert ''.join(f'<{child.tag}>{child.text}</{child.tag}>' for child in kept) == decay
    assert report.warnings == []


@pytest.mark.parametrize('content', [
    '<gravity>false</gravity><gravity>true</gravity>',
    '<self_collide>true</self_collide><self_collide>false</self_collide>',
    collision('<max_contacts>3</max_contacts><max_contacts>9</max_contacts>'),
    collision('<laser_retro>1</laser_retro><laser_retro>2</laser_retro>')])
def test_order_of_repeated_elements(content: str) -> None:
    report = Report()
    robot = read_urdf(parse(to_bytes(urdf_of(content)[0]), 'r.urdf', report), report)
    sdf = convert_to_sdf(robot, report, SdfOptions(inertial='zero'))[0]
    first, second = etree.fromstring(f'<a>{content}</a>').iter(
        'gravity', 'self_collide', 'max_contacts', 'laser_retro')
    assert [leaf.text for leaf in sdf.iter(first.tag)] == [first.text, second.text]
    assert report.warnings == []


def test_order_of_repeated_static() -> None:
    robot = read_model('<link name="a"/><static>1</static><static>0</static>')
    urdf = convert_to_urdf(robot, Report(), UrdfOptions(inertial='zero'))
    assert settings_in(urdf) == [(None, 'static', '1')]
    robot = read_urdf(parse(to_bytes(urdf), 'r.urdf', Report()), Report())
    sdf = convert_to_sdf(robot, Report(), SdfOptions(inertial='zero'))[0]
    assert [leaf.text for leaf in sdf.iter('static')] == ['1', '0']


@pytest.mark.parametrize('content', [
    '<surface><friction><ode><mu>0.2</mu></ode></friction></surface>'
    '<surface><contact><ode><kp>5</kp></ode></contact></surface>',
    '<surface><contact><ode><kd>3</kd></ode></contact></surface>'
    '<surface><bounce><threshold>7</threshold></bounce></surface>'])
def test_second_surface_stays_without_an_effect(content: str) -> None:
    urdf = urdf_of(collision(content))[0]
    assert [tag for _, tag, _ in settings_in(urdf)] in (['mu1'], ['kd'])
    robot = read_urdf(parse(to_bytes(urdf), 'r.urdf', Report()), Report())
    sdf = convert_to_sdf(robot, Report(), SdfOptions(inertial='zero'))[0]
    assert [[leaf.text for leaf in surface.iter() if not len(leaf)]
            for surface in sdf.iter('surface')] == [[leaf.text] for leaf in etree.fromstring(
                f'<a>{content}</a>').iter('mu', 'kd', 'kp', 'threshold')]
