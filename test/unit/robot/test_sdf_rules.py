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
from opencv_tools.robot.sdf.rules import find_flaw
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.xml.document import Element, parse, to_bytes
from opencv_tools.robot.xml.numbers import number_text
from opencv_tools.robot.xml.report import Report
import pytest
import robots
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


@pytest.mark.parametrize('fixture', [
    'warning_robot_name_with_double_colon.urdf', 'warning_robot_name_reserved.urdf',
    'warning_sensor_name_with_double_colon.urdf', 'warning_duplicate_sensor_name.urdf',
    'warning_contact_of_a_renamed_collision.urdf'])
@pytest.mark.parametrize('version', ['1.7', '1.9', '1.12'])
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


@pytest.mark.parametrize(('mass', 'inertia'), [
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


@pytest.mark.parametrize(('name', 'new'), [
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


@pytest.mark.parametrize('content', [
    content for content, words in robots.PARTS_OF_SDF if not words])
def test_valid_parts_in_gazebo(content: str) -> None:
    flaws, root = converted_from_gazebo(content)
    assert flaws == []
    assert root.find(f'model/link/{etree.fromstring(content).tag}') is not None


@pytest.mark.parametrize(('content', 'words'), [
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


@pytest.mark.parametrize(('text', 'flaw'), [
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
