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

"""Reader of SDF links: poses, geometries, materials and inertials."""

from __future__ import annotations

from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Material, Mesh, Sphere
from opencv_tools.robot.model import FrameId, MODEL, Placement
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.xml.report import Report
import pytest
from rows import each_row
from sdf_models import read, TWO


@each_row(('version', 'attribute'), [
    ('1.5', 'frame'), ('1.6', 'frame'), ('1.6', 'relative_to'), ('1.7', 'relative_to'),
    ('1.12', 'relative_to')])
def test_pose_reference_by_version(version: str, attribute: str) -> None:
    robot = read(f'<link name="a"/><link name="b"><pose {attribute}="a">1 0 0 0 0 0</pose></link>',
                 version)
    assert robot.links[1].placement.relative_to == FrameId('link', 'a')


@pytest.mark.parametrize(('version', 'attributes', 'expected'), [
    ('1.6', 'frame="a" relative_to="b"', FrameId('link', 'a')),
    ('1.6', 'frame="" relative_to="b"', MODEL),
    ('1.7', 'frame="a" relative_to="b"', FrameId('link', 'b'))])
def test_pose_with_both_references(version: str, attributes: str, expected: FrameId) -> None:
    robot = read(f'{TWO}<link name="c"><pose {attributes}>1 0 0 0 0 0</pose></link>', version)
    assert robot.links[2].placement.relative_to == expected


def test_old_pose_reference_is_ignored_since_1_7() -> None:
    report = Report()
    robot = read('<link name="a"/><link name="b"><pose frame="a"/></link>', '1.7', report)
    assert robot.links[1].placement.relative_to == MODEL
    assert 'frame=' in report.warnings[0].message


@each_row(('geometry', 'expected'), [
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


@each_row('geometry', ['plane', 'empty', 'heightmap', 'ellipsoid', 'cone'])
def test_preserved_geometries(geometry: str) -> None:
    made = read(f'<link name="a"><visual name="v"><geometry><{geometry}/></geometry></visual>'
                '</link>').links[0].visuals[0]
    assert made.geometry is None and made.extension.sdf is not None
    assert made.extension.sdf.find(f'geometry/{geometry}') is not None


def test_missing_geometry_becomes_empty() -> None:
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
    assert made.material == Material(name='red', color=(1, 0, 0, 1), ambient=(0.9, 0, 0, 1),
                                     texture='a.png')
    assert made.extension.sdf is not None
    assert [child.tag for child in made.extension.sdf.iter()] == [
        'visual', 'material', 'script', 'pbr', 'metal', 'roughness']


def test_default_inertials() -> None:
    robot = read('<link name="a"/><link name="b"><inertial/></link><link name="c"><inertial>'
                 '<mass>0</mass><inertia><ixx>2</ixx><ixy>0.1</ixy></inertia></inertial></link>')
    none, default, other = (link.inertial for link in robot.links)
    assert none is None and default is not None and other is not None
    assert (default.mass, default.inertia) == (1, (1, 0, 0, 1, 0, 1))
    assert (other.mass, other.inertia) == (0, (2, 0.1, 0, 1, 0, 1))


@pytest.mark.parametrize('attribute', ['frame', 'relative_to'])
def test_ignored_reference_of_an_inertial_pose(attribute: str) -> None:
    report = Report()
    robot = read(f'<link name="a"/><link name="b"><inertial><pose {attribute}="a">1 0 0 0 0 0'
                 '</pose></inertial></link>', '1.6', report)
    assert robot.links[1].inertial is not None
    assert robot.links[1].inertial.placement == Placement(Pose((1, 0, 0)), FrameId('link', 'b'))
    assert [note.element for note in report.warnings] == ['inertial']
