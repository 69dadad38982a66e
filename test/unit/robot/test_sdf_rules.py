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

"""Names, colours and inertials that the SDF parser accepts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from lxml import etree
import numpy as np
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf, SdfOptions
from opencv_tools.robot.geometry import Material, Sphere
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.model import FrameId, Inertial, Link, MODEL, Placement, Robot, Shape
from opencv_tools.robot.physical import is_physical
from opencv_tools.robot.pose import Pose, Tensor
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.sdf.rules import find_flaw, keep_sdf_rules, parsed_elements
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.xml.document import DescriptionError, Element, parse, to_bytes
from opencv_tools.robot.xml.numbers import number_text
from opencv_tools.robot.xml.passthrough import URDF_NAME, URDF_TAG
from opencv_tools.robot.xml.report import Report
import pytest
import robots
from rows import each_row
from sdf_models import with_shape


DATA = Path(__file__).parents[2] / 'data' / 'robots'
BLACK = (0.0, 0.0, 0.0, 1.0)


def check_names(element: Element) -> None:
    """Check names as libsdformat does: without ``::``, and unique among the children."""
    if element.tag == 'plugin' or '{' in element.tag:
        return
    assert '::' not in element.get('name', '')
    names = [child.get('name') for child in element if child.get('name') and child.tag != 'plugin']
    assert len(set(names)) == len(names)
    for child in element:
        check_names(child)


@each_row('fixture', [
    'warning_robot_name_with_double_colon.urdf', 'warning_robot_name_reserved.urdf',
    'warning_sensor_name_with_double_colon.urdf', 'warning_duplicate_sensor_name.urdf',
    'warning_contact_of_a_renamed_collision.urdf'])
@each_row('version', ['1.7', '1.12'])
def test_valid_names_and_restored_names(fixture: str, version: str) -> None:
    path = DATA / 'urdf' / fixture
    robot, _ = read_robot(str(path), Report())
    root = convert_to_sdf(robot, Report(), SdfOptions(version=version))
    model = root[0]
    check_names(root)
    assert not {'world', '__lamp__'} & {name.get('name') for name in (model, *model.iter('light'))}
    result = read_sdf(parse(to_bytes(root), '', Report()), Report())
    back = convert_to_urdf(result, Report())
    before = parse(path.read_bytes(), '', Report())
    assert sorted(before.xpath('//@name')) == sorted(
        name for name in back.xpath('//@name') if name)
    assert before.xpath('//contact/collision/text()') == back.xpath('//contact/collision/text()')


def test_clamped_colours() -> None:
    color = (1.5, 0.5, -1.0, 1.0)
    shape = Shape(name='v', placement=Placement(Pose(), FrameId('link', 'a')),
                  geometry=Sphere(1.0),
                  material=Material(name='red', color=color, ambient=color, specular=BLACK,
                                    emissive=BLACK))
    report = Report()
    root = convert_to_sdf(with_shape(shape), report, SdfOptions(inertial='zero'))
    assert root.findtext('.//diffuse') == root.findtext('.//ambient') == '1 0.5 0 1'
    assert [note.element for note in report.warnings] == ['ambient']
    assert "'1.5 0.5 -1 1' is outside of 0 to 1" in report.warnings[0].message
    result = read_sdf(parse(to_bytes(root), '', Report()), Report())
    material = result.links[0].visuals[0].material
    assert material is not None and material.color == material.ambient == (1.0, 0.5, 0.0, 1.0)


@each_row(('mass', 'inertia'), [
    (1.0, (1.0, 0.0, 0.0, 1.0, 0.0, 3.0)), (-1.0, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
    (1.0, (1.0, 5.0, 0.0, 1.0, 0.0, 1.0)), (1.0, (0.0, 1.0, 0.0, 0.0, 0.0, 0.0))])
def test_impossible_inertials_are_reported(mass: float, inertia: Tensor) -> None:
    report = Report()
    link = Link(name='a', placement=Placement(Pose(), MODEL), inertial=Inertial(
        Placement(Pose(), FrameId('link', 'a')), mass, inertia), line=7)
    root = convert_to_sdf(Robot(name='r', links=(link,)), report)
    assert root.findtext('.//ixy') == number_text(inertia[1])
    assert [(note.element, note.name, note.line) for note in report.warnings] == [
        ('inertial', 'a', 7)]


def test_possible_inertials_by_their_principal_moments() -> None:
    random = np.random.default_rng(1)
    placement = Placement(Pose(), FrameId('link', 'a'))
    outcomes = []
    for _ in range(200):
        turned, _ = np.linalg.qr(random.normal(size=(3, 3)))
        moments = random.uniform(0.1, 1.0, 3)
        matrix = turned @ np.diag(moments) @ turned.T
        inertia = tuple(map(float, matrix[np.triu_indices(3)]))
        outcomes.append(2 * max(moments) <= sum(moments))
        assert is_physical(Inertial(placement, 1.0, inertia)) == outcomes[-1], inertia
    assert 50 < sum(outcomes) < 150


@pytest.mark.parametrize(('fixture', 'names'), [
    ('sdf/ok_contact_of_a_visuals_name.sdf', ['body']),
    ('urdf/warning_contact_of_a_renamed_collision.urdf', ['foot__sole', 'heel'])])
def test_collision_names_of_contact_sensors(fixture: str, names: list[str]) -> None:
    robot, _ = read_robot(str(DATA / fixture), Report())
    link = convert_to_sdf(robot, Report()).find('model/link')
    assert link is not None
    assert link.xpath('sensor/contact/collision/text()') == names
    assert link.xpath('collision/@name')[:len(names)] == names
    assert link.xpath('visual/@name') == ['base_visual']


@each_row(('name', 'new'), [
    ('___', '___'), ('__', '__'), ('____', 'unnamed'), ('__a__', 'a'), ('__a', '__a'),
    ('a::::b', 'a____b')])
def test_reserved_names(name: str, new: str) -> None:
    shape = Shape(name=name, placement=Placement(Pose(), FrameId('link', name)),
                  geometry=Sphere(1.0))
    link = Link(name=name, placement=Placement(Pose(), MODEL), visuals=(shape,))
    root = convert_to_sdf(Robot(name=name, links=(link,)), Report())
    assert root.xpath('.//@name') == [new] * 3


def test_visual_named_world() -> None:
    shape = Shape(name='world', placement=Placement(Pose(), FrameId('link', 'a')),
                  geometry=Sphere(1.0))
    assert convert_to_sdf(with_shape(shape), Report()).xpath('.//visual/@name') == ['a_visual']


def test_linear_cost_of_many_equal_names() -> None:
    def convert(count: int) -> None:
        text = ''.join('<sensor name="s" type="imu"/>' for _ in range(count))
        text = f'<robot name="r"><link name="a"/><gazebo reference="a">{text}</gazebo></robot>'
        robot = read_urdf(parse(text.encode(), '', Report()), Report())
        visuals = tuple(Shape(name='v', placement=Placement(Pose(), FrameId('link', 'a')),
                              geometry=Sphere(1.0))
                        for _ in range(count))
        links = (replace(robot.links[0], visuals=visuals),)
        root = convert_to_sdf(replace(robot, links=links), Report(), SdfOptions(inertial='zero'))
        assert len(set(root.xpath('//@name'))) == 2 * count + 2

    assert robots.is_linear(convert)


def converted_from_gazebo(content: str) -> tuple[list[str], Element]:
    """Return the warnings of reading a part of SDF in URDF, and what the robot becomes in SDF."""
    report = Report()
    text = f'<robot name="r"><link name="a"/><gazebo reference="a">{content}</gazebo></robot>'
    robot = read_urdf(parse(text.encode(), '', report), report)
    flaws = [note.message for note in report.warnings]
    return flaws, convert_to_sdf(robot, report, SdfOptions(inertial='zero'))


@each_row('content', [
    content for content, words in robots.PARTS_OF_SDF if not words])
def test_valid_parts_in_gazebo(content: str) -> None:
    flaws, root = converted_from_gazebo(content)
    assert flaws == []
    assert root.find(f'model/link/{etree.fromstring(content).tag}') is not None


@each_row(('content', 'words'), [
    (content, words) for content, words in robots.PARTS_OF_SDF if words])
def test_invalid_values_stay_in_gazebo(content: str, words: str) -> None:
    flaws, root = converted_from_gazebo(content)
    assert len(flaws) == 1 and words in flaws[0]
    assert root.find(f'model/link/{etree.fromstring(content).tag}') is None
    result = read_sdf(parse(to_bytes(root), '', Report()), Report())
    back = convert_to_urdf(result, Report())
    assert back.xpath('gazebo/@reference') == ['a']
    kept, before = back.xpath('gazebo/*')[0], etree.fromstring(content)
    assert [(one.tag, one.attrib, one.text) for one in kept.iter() if not len(one)] == [
        (one.tag, one.attrib, one.text) for one in before.iter() if not len(one)]


@each_row(('text', 'flaw'), [
    ('<texture><diffuse>a.png</diffuse></texture>', ''),
    ('<material><diffuse>a.png</diffuse></material>', "'a.png' is not 3 or 4 numbers"),
    ('<logical_camera><far>0.05</far></logical_camera>', ''),
    ('<clip><far>0.05</far></clip>', "'0.05' is outside of 0.1 to inf"),
    ('<logical_camera><near>-1</near></logical_camera>', ''),
    ('<camera><noise><stddev>-1</stddev></noise></camera>', ''),
    ('<lidar><noise><stddev>-1</stddev></noise></lidar>', ''),
    ('<x><noise><stddev>-1</stddev></noise></x>', "'-1' is outside of 0 to inf"),
    ('<camera><horizontal_fov>0.05</horizontal_fov></camera>', "'0.05' is outside of 0.1 to 6"),
    ('<bullet><friction>-1</friction></bullet>', "'-1' is outside of 0 to inf"),
    ('<dynamics><friction>-1</friction></dynamics>', '')])
def test_values_of_tags_with_several_meanings(text: str, flaw: str) -> None:
    element = etree.fromstring(text)
    found = ''.join(map(find_flaw, element.iter()))
    assert found.startswith(flaw) and bool(found) == bool(flaw)


def flaws(text: str) -> str:
    """Return why the parser rejects a text of XML, or elements inside."""
    return ''.join(map(find_flaw, etree.fromstring(text).iter()))


@each_row(('path', 'low', 'below', 'least'), [
    *((path, '0', '-1e-9', '0') for path in (
        'bias_stddev', 'bullet/friction', 'coefficient', 'cutoff_angle', 'dynamic_bias_stddev',
        'friction2', 'max_velocity', 'min_velocity', 'mu', 'mu2', 'near', 'patch_radius',
        'restitution_coefficient', 'scale_rate', 'stddev', 'surface_radius',
        'particle_emitter/rate')),
    ('far', '0.1', '0.0999', '0.1'), ('camera/horizontal_fov', '0.1', '0.0999', '0.1')])
def test_least_value_of_the_schema(path: str, low: str, below: str, least: str) -> None:
    *outer, tag = path.split('/')
    element = etree.Element(tag)
    if outer:
        etree.Element(outer[0], name='n', type='point').append(element)
    element.text = low
    assert find_flaw(element) == ''
    element.text = below
    assert find_flaw(element).startswith(f'{below!r} is outside of {least} to ')


@pytest.mark.parametrize(('tag', 'high', 'above', 'bounds'), [
    ('cutoff_angle', '3.141592653', '3.141592654', '0 to 3.14159'),
    ('horizontal_fov', '6.283186', '6.283187', '0.1 to 6.28319'),
    ('restitution_coefficient', '1', '1.0001', '0 to 1')])
def test_greatest_value_of_the_schema(tag: str, high: str, above: str, bounds: str) -> None:
    assert flaws(f'<{tag}>{high}</{tag}>') == ''
    assert flaws(f'<{tag}>{above}</{tag}>') == f'{above!r} is outside of {bounds}'


@each_row(('tag', 'valid', 'invalid', 'expected'), [
    ('mass', ['0', ' 1.5 kg', '1_0', '.5', '5.', '+1e3', '-INF', 'infinity', 'NaN', '-0XfF',
              'infx', '9e307'],
     ['x', '-', '.', '1e309', '-1e309 kg', '0x' + 'f' * 300, 'e3', '\u0967', '\u0131nf'],
     'a number'),
    ('static', ['0', '1', 'true', 'FALSE'], ['2', '-1', 'yes', '1 1'], 'true or false'),
    ('fdir1', ['1 2 3', '1 2 3 x', '0x1 2 3kg', '1 2 3 inf'], ['1 2', '1 2 x', '1 inf 3'],
     '3 numbers'),
    ('ambient', ['1 0 0', '1 0 0 1', 'inf 0 nan'], ['1 0', '1 0 0 1 1', '1 0 x', '1 0 0 x'],
     '3 or 4 numbers'),
    ('pose', ['1 2 3 4 5 6'], ['1 2 3 4 5', '1 2 3 4 5 6 7', '1 2 3 4 5 x', '1 2 3 4 5 inf'],
     '6 finite numbers')])
def test_texts_by_kind(tag: str, valid: list[str], invalid: list[str], expected: str) -> None:
    for text in ('', ' ', *valid):
        assert flaws(f'<{tag}>{text}</{tag}>') == ''
    for text in invalid:
        assert flaws(f'<{tag}>{text}</{tag}>') == f'{text!r} is not {expected}'


@pytest.mark.parametrize(('attribute', 'counts', 'expected'), [
    ('quat_xyzw', [7], '7 finite numbers'), ('euler_rpy', [6], '6 finite numbers')])
def test_pose_by_its_rotation_format(attribute: str, counts: list[int], expected: str) -> None:
    valid = []
    for count in range(5, 9):
        text = ' '.join(['0'] * count)
        found = flaws(f'<pose rotation_format="{attribute}">{text}</pose>')
        assert found in ('', f'{text!r} is not {expected}')
        valid += [count] * (not found)
    assert valid == counts


@each_row(('text', 'flaw'), [
    ('<mass rotation_format="quat_xyzw">1</mass>', ''),
    ('<name>x</name>', ''),
    ('<mass>x<unit/></mass>', ''),  # content that is not a text
    ('<max_contacts>3.7</max_contacts>', ''),  # the text after 3 is ignored
    ('<max_contacts>few</max_contacts>', "'few' is not an integer"),
    ('<max_contacts>2147483648</max_contacts>',
     "'2147483648' is outside of -2.14748e+09 to 2.14748e+09"),
    ('<mu>nan</mu>', ''),
    ('<restitution_coefficient>1_9</restitution_coefficient>', ''),  # the text after 1 is ignored
    ('<mu>-0x1</mu>', "'-0x1' is outside of 0 to inf"),
    ('<rate>-1</rate>', "'-1' is outside of 0 to inf"),
    ('<lidar><x><noise><stddev>-1</stddev></noise></x></lidar>', "'-1' is outside of 0 to inf"),
    ('<x><ray><noise><stddev>-1</stddev></noise></ray></x>', ''),
    ('<logical_camera><horizontal_fov>7</horizontal_fov></logical_camera>', ''),
    ('<gripper name="g"/>', ''),
    ('<gripper name=" "/>', 'has no name=, which SDF requires'),
    ('<projector/>', 'has no name=, which SDF requires'),
    ('<particle_emitter name="p"/>', 'has no type=, which SDF requires'),
    ('<particle_emitter name="p" type="any"/>', ''),
    ('<plugin name="p"/>', 'has no filename=, which SDF requires'),
    ('<light name="l" type="lamp"/>', "type='lamp' is not a type of <light> in SDF")])
def test_flaws_of_elements(text: str, flaw: str) -> None:
    assert flaws(text) == flaw


@each_row(('plugin', 'is_valid'), [
    ('name="p" filename="f"', True), ('name="p"', False), ('filename="f"', False),
    ('name=" " filename="f"', False), ('name="p" filename=" "', False)])
def test_plugin_of_an_element(plugin: str, is_valid: bool) -> None:
    element = etree.fromstring(f'<model><plugin {plugin}/></model>')
    assert find_flaw(element) == (
        '' if is_valid else 'has a <plugin> without filename= or name=, which SDF requires')


def test_elements_that_the_parser_reads() -> None:
    root = etree.fromstring(
        '<a><b><c/><!-- c --><plugin><mass/></plugin></b><x:d xmlns:x="u"><e/></x:d><f/></a>')
    assert [element.tag for element in parsed_elements(root)] == ['a', 'b', 'c', 'f']


def kept(content: str) -> tuple[Element, Report]:
    """Return a link with changed content and the report."""
    report = Report()
    root = parse(f'<sdf><model name="m"><link name="l">\n{content}</link></model></sdf>'.encode(),
                 'a.sdf', report)
    keep_sdf_rules(root, 'a.urdf', report)
    return root[0][0], report


def test_invalid_value_is_an_error_with_its_line() -> None:
    with pytest.raises(DescriptionError) as caught:
        kept('<inertial>\n<mass>x</mass></inertial>')
    assert str(caught.value) == "a.sdf:3: <mass>: 'x' is not a number"


def test_invalid_value_without_a_file() -> None:
    root = etree.Element('sdf')
    etree.SubElement(root, 'mass').text = 'x'
    with pytest.raises(DescriptionError, match=r"^a\.urdf: <mass>: 'x' is not a number$"):
        keep_sdf_rules(root, 'a.urdf', Report())


def test_one_warning_for_equal_colours_of_a_material() -> None:
    material = ('<material><ambient>2 0 0 1</ambient><diffuse>2 0 0 1</diffuse>'
                '<specular>0 0 -1 1</specular><emissive>0 1 0 1</emissive></material>')
    link, report = kept(''.join(f'<visual name="{name}">{material}</visual>' for name in 'vw'))
    assert [(note.element, note.name, note.line, note.message) for note in report.warnings] == [
        (tag, name, 2, f'{text!r} is outside of 0 to 1; clamped to {new!r}')
        for name in ('v', 'w') for tag, text, new in (
            ('ambient', '2 0 0 1', '1 0 0 1'), ('specular', '0 0 -1 1', '0 0 0 1'))]
    assert link.xpath('.//material/*/text()') == 2 * [
        '1 0 0 1', '1 0 0 1', '0 0 0 1', '0 1 0 1']


def test_colour_without_a_name_above() -> None:
    report = Report()
    root = etree.fromstring('<sdf><ambient>2 0 0</ambient></sdf>')
    keep_sdf_rules(root, '', report)
    assert (root.findtext('ambient'), report.warnings[0].name) == ('1 0 0', '')


@pytest.mark.parametrize('text', ['2 0 x', 'x', 'x 2 0 0'])
def test_colour_that_cannot_be_clamped(text: str) -> None:
    with pytest.raises(DescriptionError, match=f"<ambient>: '{text}' is not 3 or 4 numbers$"):
        kept(f'<visual name="v"><material><ambient>{text}</ambient></material></visual>')


@each_row(('content', 'names', 'originals'), [
    ('<light name="world" type="point"/>', ['world_light'], ['world']),
    ('<light name="__a__" type="point"/>', ['a'], ['__a__']),
    ('<gripper name="__a__"/>', ['__a__'], []),
    ('<gripper name="a::b"/>', ['a__b'], ['a::b']),
    ('<light name="a" type="point"/><light name="a" type="point"/>', ['a', 'a_light'], ['a']),
    ('<visual name="a"/><gripper name="a"/>', ['a', 'a_gripper'], ['a']),
    ('<gripper name="a"/><visual name="a"/>', ['a_gripper', 'a'], ['a']),
    ('<visual name="a::b"/><gripper name="c"/>', ['a::b', 'c'], []),  # renamed before
    ('<plugin name="a" filename="f"/><gripper name="a"/>', ['a', 'a'], []),
    ('<!-- a --><gripper name="a"/><x/><x/>', ['a'], []),
    ('<p:x xmlns:p="u" name="a::b"/>', ['a::b'], [])])
def test_names_of_children(content: str, names: list[str], originals: list[str]) -> None:
    link, report = kept(content)
    assert link.xpath('*/@name') == names
    assert [child.get(URDF_NAME) for child in link if child.get(URDF_NAME)] == originals
    renamed = [new for new in names if f'name="{new}"' not in content]
    assert [(note.name, note.line, note.message) for note in report.warnings] == [
        (name, 2, f'renamed to {new!r}, because SDF requires unique names and reserves some')
        for name, new in zip(originals, renamed, strict=True)]


def test_first_name_of_a_child_is_kept() -> None:
    link, _ = kept(f'<gripper name="a::b" u:name="first" xmlns:u="{URDF_TAG[1:-1]}"/>')
    assert (link[0].get('name'), link[0].get(URDF_NAME)) == ('a__b', 'first')


def test_preserved_element_keeps_its_name() -> None:
    link, report = kept(f'<u:x name="a" xmlns:u="{URDF_TAG[1:-1]}"/><gripper name="a"/>')
    assert link.xpath('*/@name') == ['a', 'a_gripper']
    assert [note.element for note in report.warnings] == ['gripper']
