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

"""Shipped robots and files of the tutorial, in both formats."""

from __future__ import annotations

from collections.abc import Iterator
import math
from pathlib import Path
import struct

from lxml import etree
from opencv_tools.robot.cli import robot_compare, sdf_to_urdf, urdf_to_sdf
from opencv_tools.robot.compare.compare import differences
from opencv_tools.robot.frames.listing import frames
from opencv_tools.robot.geometry import Box, Mesh
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.model import Robot
from opencv_tools.robot.xacro.expand import expand
from opencv_tools.robot.xml.report import Report
import pytest

ROOT = Path(__file__).parents[3]
XACRO = ROOT / 'urdf' / 'my_robot.urdf.xacro'
URDF = ROOT / 'urdf' / 'my_robot.urdf'
SDF = ROOT / 'sdf' / 'my_robot' / 'model.sdf'
ARM_URDF = ROOT / 'urdf' / 'my_arm.urdf'
ARM_SDF = ROOT / 'sdf' / 'my_arm' / 'model.sdf'
MESH = ROOT / 'meshes' / 'my_robot' / 'robot_base.stl'
TUTORIAL_URDF = ROOT / 'test' / 'data' / 'robots' / 'urdf' / 'tutorial_my_robot.urdf'
TUTORIAL_SDF = ROOT / 'test' / 'data' / 'robots' / 'sdf' / 'tutorial_my_robot.sdf'

ROUNDING = 4e-6  # the tutorial writes 1.5708 for pi/2, which is 3.7e-6 more

# Default values of SDF elements.
DEFAULTS = {'static': 'false', 'pose': (0.0,) * 6, 'scale': (1.0,) * 3}


def read(path: Path) -> Robot:
    return read_robot(str(path), Report())[0]


def to_sdf(path: Path, folder: Path, *options: str) -> Path:
    """Convert a file to SDF by the command."""
    output = folder / f'{path.name}.sdf'
    assert urdf_to_sdf([str(path), '-o', str(output), *options]) == 0
    return output


def to_urdf(path: Path, folder: Path) -> Path:
    """Convert a file to URDF by the command."""
    output = folder / f'{path.name}.urdf'
    assert sdf_to_urdf([str(path), '-o', str(output)]) == 0
    return output


def same(one: Path, other: Path, tolerance: float = 1e-12) -> bool:
    """Return whether two files describe the same robot."""
    return differences(read(one), read(other), tolerance=tolerance) == []


def values(path: Path) -> dict[str, object]:
    """Return the values of all SDF elements, without defaults and other namespaces."""
    return dict(_values(etree.parse(path).getroot()[0], ''))


def _values(element: etree._Element, above: str) -> Iterator[tuple[str, object]]:
    tag = element.tag
    if not isinstance(tag, str) or tag.startswith('{') or tag == 'script':
        return  # the material Gazebo/White of URDF is the colour of the tutorial's SDF
    path = f'{above}/{tag}{element.get("name", "")}'
    if element.get('type'):
        yield f'{path}@type', element.get('type')
    children = list(element)
    text = (element.text or '').strip()
    if text and not children:
        try:
            value: object = tuple(map(float, text.split()))
        except ValueError:
            value = text
        if value != DEFAULTS.get(tag):
            yield path, value
    elif not children:
        yield path, None
    for child in children:
        yield from _values(child, path)


def agree(one: dict[str, object], other: dict[str, object], tolerance: float) -> bool:
    """Return whether two files have the same values, numbers within a tolerance."""
    return one.keys() == other.keys() and all(
        other[path] == (pytest.approx(value, abs=tolerance) if isinstance(value, tuple) else value)
        for path, value in one.items())


def box(robot: Robot) -> tuple[float, float, float]:
    geometry = robot.links[1].collisions[0].geometry
    assert isinstance(geometry, Box)
    return geometry.size


def mesh(robot: Robot) -> str:
    geometry = robot.links[1].visuals[0].geometry
    assert isinstance(geometry, Mesh)
    return geometry.uri


def test_urdf_equals_expanded_xacro() -> None:
    expanded = etree.fromstring(expand(str(XACRO), XACRO.read_bytes(), {}, Report()))
    shipped = etree.parse(URDF).getroot()

    def content(root: etree._Element) -> list[tuple[object, dict[object, object]]]:
        return [(element.tag, dict(element.attrib)) for element in root.iter(etree.Element)]

    assert content(expanded) == content(shipped)


SHIPPED = pytest.mark.parametrize(('urdf', 'sdf'), [(URDF, SDF), (ARM_URDF, ARM_SDF)],
                                  ids=['my_robot', 'my_arm'])


@SHIPPED
def test_same_robot_in_both_formats(urdf: Path, sdf: Path) -> None:
    assert robot_compare([str(urdf), str(sdf), '--tolerance', '1e-12']) == 0
    assert read(urdf).name == read(sdf).name == sdf.parent.name == urdf.stem
    config = etree.parse(sdf.parent / 'model.config')
    assert config.findtext('name') == sdf.parent.name
    assert config.findtext('sdf') == sdf.name
    assert config.xpath('string(sdf/@version)') == etree.parse(sdf).getroot().get('version')


def test_xacro_equals_sdf() -> None:
    assert same(XACRO, SDF)


@SHIPPED
def test_conversion_of_urdf_to_sdf(urdf: Path, sdf: Path, tmp_path: Path) -> None:
    converted = to_sdf(urdf, tmp_path, '--poses', 'model')  # the tutorial's convention
    assert same(converted, sdf)
    assert same(converted, urdf)
    assert agree(values(converted), values(sdf), 0)


@SHIPPED
def test_conversion_with_relative_poses(urdf: Path, sdf: Path, tmp_path: Path) -> None:
    converted = to_sdf(urdf, tmp_path, '--poses', 'relative')
    assert same(converted, sdf)
    assert same(converted, urdf)


@SHIPPED
def test_conversion_of_sdf_to_urdf(urdf: Path, sdf: Path, tmp_path: Path) -> None:
    converted = to_urdf(sdf, tmp_path)
    assert same(converted, urdf)
    assert same(converted, sdf)


def test_mesh_uri_of_the_package(tmp_path: Path) -> None:
    converted = to_urdf(SDF, tmp_path)
    assert mesh(read(converted)) == 'package://opencv_tools/meshes/my_robot/robot_base.stl'


@pytest.mark.parametrize('path', [ARM_URDF, ARM_SDF], ids=['urdf', 'sdf'])
def test_complete_and_movable_arm(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (urdf_to_sdf if path == ARM_URDF else sdf_to_urdf)([str(path), '--strict']) == 0
    assert capsys.readouterr().err == ''
    robot = read(path)
    for link in robot.links:
        assert link.inertial is not None and link.inertial.mass > 0
        assert len(link.visuals) == len(link.collisions) == 1
        assert link.visuals[0].geometry == link.collisions[0].geometry
    for joint in robot.joints:
        limit = joint.axes[0].limit
        assert limit is not None and limit.lower < limit.upper
        assert math.isfinite(limit.effort) and math.isfinite(limit.velocity)
    assert [joint.type for joint in robot.joints] == ['continuous', 'revolute', 'prismatic']
    # The shoulder and the elbow are at 90 degrees, and the slide is at 0.1 m.
    links = frames(robot, {'shoulder': math.pi / 2, 'elbow': math.pi / 2, 'slide': 0.1})['links']
    assert links['forearm']['pose'][:3] == pytest.approx([0, 0, 0.5])
    assert links['tool']['pose'][:3] == pytest.approx([0, 0.45, 0.5])


@pytest.mark.parametrize('source', [URDF, XACRO, SDF])
def test_sdf_values_of_the_tutorial(source: Path, tmp_path: Path) -> None:
    tutorial = values(TUTORIAL_SDF)
    assert len(tutorial) == 13
    # The URIs of the mesh differ between the files of the tutorial and this package.
    uri = next(path for path in tutorial if path.endswith('/uri'))
    tutorial[uri] = 'model://opencv_tools/meshes/my_robot/robot_base.stl'
    assert agree(values(source if source == SDF else to_sdf(source, tmp_path)), tutorial, ROUNDING)


@pytest.mark.parametrize('path', [XACRO, URDF, SDF, TUTORIAL_URDF, TUTORIAL_SDF],
                         ids=lambda path: path.name)
def test_poses_of_the_tutorial_in_every_file(path: Path, tmp_path: Path) -> None:
    converted = to_urdf(path, tmp_path) if path.suffix == '.sdf' else to_sdf(path, tmp_path)
    for file in (path, converted):
        listing = frames(read(file), {})
        assert (listing['robot'], listing['root']) == ('my_robot', 'base_footprint')
        assert list(listing['links']) == ['base_footprint', 'base_link']
        base = listing['links']['base_link']
        assert base['parent'] == 'base_footprint'
        assert base['pose'] == [0, 0, 0.2, 1, 0, 0, 0]
        assert base['collisions'][0]['pose'] == pytest.approx([0, 0, 0.05, 1, 0, 0, 0], abs=1e-15)
        # The visual is 0.1 m behind and rotated by 90 degrees about x, then about z.
        assert base['visuals'][0]['pose'] == pytest.approx(
            [-0.1, 0, 0.2, 0.5, 0.5, 0.5, 0.5], abs=ROUNDING)
        assert listing['joints']['base_joint']['type'] == 'fixed'
        assert listing['joints']['base_joint']['pose'] == [0, 0, 0.2, 1, 0, 0, 0]


@pytest.mark.parametrize(('path', 'thickness', 'uri'), [
    (TUTORIAL_URDF, 0.01, '://my_robot/meshes/my_robot/robot_base.stl'),
    (TUTORIAL_SDF, 0.1, '://my_robot/meshes/robot_base.stl'),
])
def test_kept_differences_between_the_tutorial_files(
        path: Path, thickness: float, uri: str, tmp_path: Path) -> None:
    converted = to_urdf(path, tmp_path) if path.suffix == '.sdf' else to_sdf(path, tmp_path)
    new = 'package' if path.suffix == '.sdf' else 'model'
    assert same(converted, path)
    assert box(read(converted)) == (0.7, 0.3, thickness)
    assert mesh(read(converted)) == new + uri


def test_colours_of_the_tutorial(tmp_path: Path) -> None:
    for path in (to_sdf(TUTORIAL_URDF, tmp_path), SDF, to_sdf(URDF, tmp_path)):
        material = read(path).links[1].visuals[0].material
        assert material is not None
        assert material.color == material.ambient == (1, 1, 1, 1)
        assert material.specular == material.emissive == (0, 0, 0, 1)


def test_gazebo_material_round_trip(tmp_path: Path) -> None:
    (tmp_path / 'back').mkdir()
    back = to_urdf(to_sdf(URDF, tmp_path), tmp_path / 'back')
    blocks = etree.parse(back).getroot().findall('gazebo')
    assert [(block.get('reference'), block.findtext('material')) for block in blocks] == [
        ('base_link', 'Gazebo/White')]
    names = [material.get('name') for material in etree.parse(back).getroot().iter('material')
             if material.get('name')]
    assert names == ['White']


def test_closed_mesh_over_the_collision_box() -> None:
    data = MESH.read_bytes()
    count, = struct.unpack_from('<I', data, 80)
    assert len(data) == 84 + 50 * count < 20_000
    assert not data.startswith(b'solid')
    facets = [struct.unpack_from('<12f', data, 84 + 50 * number) for number in range(count)]
    edges: set[tuple[tuple[float, ...], tuple[float, ...]]] = set()
    for facet in facets:
        a, b, c = facet[3:6], facet[6:9], facet[9:12]
        for edge in ((a, b), (b, c), (c, a)):
            assert edge not in edges
            edges.add(edge)
    # Each edge exists once in each direction, so the surface is closed and oriented.
    assert {(end, start) for start, end in edges} == edges

    robot = read(URDF)
    kinematics = Kinematics(robot)
    visual, collision = robot.links[1].visuals[0], robot.links[1].collisions[0]
    place = kinematics.placement_pose(visual.placement)
    points = [place.apply((facet[i], facet[i + 1], facet[i + 2]))
              for facet in facets for i in (3, 6, 9)]
    centre = kinematics.placement_pose(collision.placement).translation
    for axis, length in enumerate(box(robot)):
        coordinates = [point[axis] for point in points]
        assert min(coordinates) == pytest.approx(centre[axis] - length / 2, abs=1e-6)
        assert max(coordinates) == pytest.approx(centre[axis] + length / 2, abs=1e-6)
    # Normals point outwards, away from the centre of the convex mesh.
    for facet in facets:
        normal = place.rotate((facet[0], facet[1], facet[2]))
        corner = place.apply((facet[3], facet[4], facet[5]))
        outwards = math.fsum(n * (p - c) for n, p, c in zip(normal, corner, centre))
        assert outwards > 0.04
        assert math.hypot(*normal) == pytest.approx(1, abs=1e-6)
