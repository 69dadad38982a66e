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

"""Inertials that SDF computes from the density of collisions; the numbers are those of Drake."""

from __future__ import annotations

from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf, SdfOptions
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.model import FrameId, Inertial, Robot
from opencv_tools.robot.pose import rotated_tensor
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.xml.document import DescriptionError, Element, parse, to_bytes
from opencv_tools.robot.xml.report import Report
import pytest
from rows import each_row
from sdf_models import read

BOX = '<geometry><box><size>1 1 1</size></box></geometry>'
TURNED = '<pose>0 1 0 0.1 0.2 0.3</pose>'
CENTRE = 0.86503154, 0.126482403, -0.045620952
MOMENTS = 901.837515, 369.498997, -134.153602, 950.049682, 125.034492, 1247.266491


def link(inertial: str, *collisions: str) -> str:
    """Return the text of a link with collisions."""
    return f'<link name="a">{inertial}' + ''.join(
        f'<collision name="c{index}">{content}</collision>'
        for index, content in enumerate(collisions)) + '</link>'


def inertial_of(robot: Robot) -> Inertial:
    """Return the inertial of the first link."""
    inertial = robot.links[0].inertial
    assert inertial is not None
    return inertial


@each_row(('geometry', 'mass', 'moments', 'height'), [
    ('<box><size>1 2 3</size></box>', 6000, (6500, 5000, 2500), 0),
    ('<sphere><radius>0.7</radius></sphere>', 1436.755040, (281.603988,) * 3, 0),
    ('<cylinder><radius>1</radius><length>2</length></cylinder>', 6283.185307,
     (3665.191429, 3665.191429, 3141.592654), 0),
    ('<capsule><radius>1</radius><length>1</length></capsule>', 7330.382858,
     (5340.707511, 5340.707511, 3246.312409), 0),
    ('<ellipsoid><radii>1 2 3</radii></ellipsoid>', 25132.741229,
     (65345.127195, 50265.482457, 25132.741229), 0),
    ('<cone><radius>0.7</radius><length>1.5</length></cone>', 769.690200,
     (121.514841, 121.514841, 113.144459), -0.375)])
def test_solids(geometry: str, mass: float, moments: tuple[float, ...], height: float) -> None:
    inertial = inertial_of(read(link('<inertial auto="true"/>',
                                     f'<geometry>{geometry}</geometry>')))
    assert inertial.mass == pytest.approx(mass)
    assert inertial.inertia == pytest.approx((moments[0], 0, 0, moments[1], 0, moments[2]))
    assert inertial.placement.pose.xyz == (0, 0, height)


@each_row(('inertial', 'collision', 'mass'), [
    ('<inertial auto="true"/>', '', 1000),
    ('<inertial auto="1"><density>500</density></inertial>', '', 500),
    ('<inertial auto="true"><density>500</density></inertial>', '<density>2700</density>', 2700),
    ('<inertial auto="true"><mass>3</mass></inertial>', '<density>2700</density>', 3),
    ('<inertial auto="false"><mass>4</mass></inertial>', '<density>2700</density>', 4)])
def test_mass_and_density(inertial: str, collision: str, mass: float) -> None:
    found = inertial_of(read(link(inertial, collision + BOX)))
    assert found.mass == pytest.approx(mass)
    expected = 1.0 if 'false' in inertial else mass / 6
    assert found.inertia == pytest.approx((expected, 0, 0, expected, 0, expected))


def test_sum_of_turned_collisions() -> None:
    robot = read(link('<inertial auto="true"><density>500</density></inertial>',
                      f'<density>2700</density><pose>1 0 0 0 0 0.3</pose>{BOX}',
                      f'{TURNED}<geometry><cone><radius>0.7</radius><length>1.5</length></cone>'
                      '</geometry>'))
    found, kinematics = inertial_of(robot), Kinematics(robot)
    centre = kinematics.within(FrameId('link', 'a'), found.placement).transform()
    assert found.mass == pytest.approx(3084.845100)
    assert centre.translation == pytest.approx(CENTRE)
    assert rotated_tensor(found.inertia, centre.rotation) == pytest.approx(MOMENTS)


def urdf_of(text: str) -> tuple[Element, Report]:
    """Convert a link of SDF to URDF."""
    report = Report()
    return convert_to_urdf(read(text, '1.11', report), report), report


def sdf_of(urdf: Element, version: str = '1.11') -> tuple[Element, Report]:
    """Convert URDF to SDF, and return the model."""
    report = Report()
    robot = read_urdf(parse(to_bytes(urdf), 'r.urdf', Report()), report)
    return convert_to_sdf(robot, report, SdfOptions(version=version))[0], report


def test_computed_inertial_there_and_back() -> None:
    urdf, report = urdf_of(link('<inertial auto="true"><density>500</density></inertial>', BOX))
    assert urdf.xpath('link/inertial/mass/@value') == ['500']
    assert report.warnings == []
    model, report = sdf_of(urdf)
    inertial, = model.findall('link/inertial')
    assert dict(inertial.attrib) == {'auto': 'true'}
    assert [(child.tag, child.text) for child in inertial] == [('density', '500')]
    assert report.warnings == []


@pytest.mark.parametrize('version', ['1.10', '1.12'])
def test_changed_mass_counts_on_the_way_back(version: str) -> None:
    urdf, _ = urdf_of(link('<inertial auto="true"/>', BOX))
    urdf.find('link/inertial/mass').set('value', '7')  # type: ignore[union-attr]
    model, report = sdf_of(urdf, version)
    inertial, = model.findall('link/inertial')
    assert (inertial.get('auto'), inertial.findtext('mass')) == (None, '7')
    assert 'auto="true" is omitted' in report.warnings[0].message


def test_version_without_auto_gets_the_numbers() -> None:
    urdf, _ = urdf_of(link('<inertial auto="true"/>', BOX))
    model, report = sdf_of(urdf, '1.10')
    inertial, = model.findall('link/inertial')
    assert (inertial.get('auto'), inertial.findtext('mass')) == (None, '1000')
    assert 'SDF 1.10' in report.warnings[0].message


def test_lumped_auto_inertials_become_one_sum() -> None:
    text = link('<inertial auto="true"/>', BOX) + link('<inertial auto="true"/>', BOX).replace(
        'name="a"', 'name="b"') + (
        '<joint name="j" type="fixed"><parent>a</parent><child>b</child></joint>')
    urdf, _ = urdf_of(text)
    robot = read_urdf(parse(to_bytes(urdf), 'r.urdf', Report()), Report())
    root = convert_to_sdf(robot, Report(), SdfOptions(fixed='lump'))
    inertial, = root.findall('model/link/inertial')
    assert (inertial.get('auto'), inertial.findtext('mass')) == (None, '2000')


def test_collision_without_a_volume_has_a_warning() -> None:
    report = Report()
    robot = read(link('<inertial auto="true"/>', BOX, '<geometry><plane/></geometry>'),
                 report=report)
    assert inertial_of(robot).mass == 1000
    assert "of link 'a': it is no solid" in report.warnings[0].message


def test_density_without_a_finite_mass_is_refused() -> None:
    with pytest.raises(DescriptionError, match='give a smaller density'):
        read(link('<inertial auto="true"/>', '<density>1e308</density><geometry><sphere>'
                  '<radius>1e9</radius></sphere></geometry>'))
