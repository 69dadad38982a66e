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

"""Writer of SDF links: geometries, materials and inertials."""

from __future__ import annotations

from lxml import etree
from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Geometry, Material, Mesh, Sphere
from opencv_tools.robot.model import (
    Extension, FrameId, Inertial, Link, MODEL, Placement, Robot, Shape)
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.xml.document import parse
from opencv_tools.robot.xml.report import Report
import pytest
from sdf_models import reread, TURNED, with_geometry, with_shape, written


@pytest.mark.parametrize('geometry', [
    Box((1.0, 2.0, 0.1)), Sphere(0.5), Cylinder(1.0, 2.0), Capsule(1.0, 2.0), Mesh('model://a/b'),
    Mesh('b.stl', (0.001, 0.001, 1 / 3))])
def test_round_trip_of_geometries(geometry: Geometry) -> None:
    for version in ('1.4', '1.7', '1.8', '1.12'):
        assert reread(with_geometry(geometry), version).links[0].visuals[0].geometry == geometry


def test_capsule_becomes_a_cylinder_before_1_8() -> None:
    report = Report()
    model = written(with_geometry(Capsule(1.0, 2.0)), report, '1.7')
    assert model.findtext('.//cylinder/length') == '4'
    assert [note.element for note in report.warnings] == ['capsule']


def test_restored_geometry() -> None:
    rest = etree.fromstring(
        '<visual><geometry><plane><size>1 1</size></plane></geometry></visual>')
    shape = Shape(name='v', placement=Placement(Pose(), FrameId('link', 'a')), geometry=None,
                  extension=Extension(sdf=rest))
    assert len(written(with_shape(shape)).findall('.//geometry')) == 1
    assert written(with_shape(shape)).findtext('.//geometry/plane/size') == '1 1'
    assert written(with_geometry(None)).find('.//geometry/empty') is not None


def test_material_merged_with_unread_parts() -> None:
    rest = etree.fromstring(
        '<visual xmlns:c="urn:opencv_tools:preserved"><material c:part="true"><script/>'
        '<pbr c:part="true"><metal c:part="true"><roughness>1</roughness></metal></pbr></material>'
        '<transparency>0.5</transparency></visual>')
    material = Material(name='red', color=(1.0, 0.0, 0.0, 1.0), specular=(0.1, 0.2, 0.9, 1.0),
                        texture='a.png')
    shape = Shape(name='v', placement=Placement(TURNED, FrameId('link', 'a')),
                  geometry=Sphere(1.0), material=material, extension=Extension(sdf=rest))
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


def test_preserved_texture_before_1_6() -> None:
    shape = Shape(name='v', placement=Placement(Pose(), FrameId('link', 'a')),
                  geometry=Sphere(1.0), material=Material(texture='a.png'))
    report = Report()
    assert written(with_shape(shape), report, '1.5').find('.//pbr') is None
    assert [note.level for note in report.notes] == ['preserved']
    assert reread(with_shape(shape), '1.5').links[0].visuals == (shape,)


def test_inertial() -> None:
    link = Link(name='a', placement=Placement(Pose(), MODEL), inertial=Inertial(
        Placement(TURNED, FrameId('link', 'a')), 0.1, (1.0, 0.1, 0.2, 2.0, 0.3, 3.0)))
    made = written(Robot(name='r', links=(link,))).find('link/inertial')
    assert made is not None
    assert [child.text for child in made.iter() if not len(child)] == [
        '0.1 0.2 0.3 0 0 1.5708', '0.1', '1', '0.1', '0.2', '2', '0.3', '3']


def test_second_inertial_stays_separate() -> None:
    text = ('<sdf version="1.11"><model name="m"><link name="a"><inertial><mass>2</mass>'
            '</inertial><inertial><inertia><ixx>3</ixx></inertia></inertial></link></model></sdf>')
    link = written(read_sdf(parse(text.encode(), '', Report()), Report())).find('link')
    assert link is not None
    assert [inertial.findtext('mass') for inertial in link] == ['2', None]
    assert link.xpath('inertial/inertia/ixx/text()') == ['1', '3']
