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

"""Meshes: formats, volumes and moments of inertia, and what cannot be computed."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
import os
from pathlib import Path
import struct

import numpy as np
from numpy.typing import NDArray
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf
from opencv_tools.robot.geometry import Box, Mesh
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.meshes import LFS_POINTER, mesh_solid, NoSolidError, solid_of
from opencv_tools.robot.xml.document import to_bytes
from opencv_tools.robot.xml.report import Report
import pytest

# A box of 1, 2 and 3 m whose centre is at 10, 20 and 30 m, as polygons seen from outside.
SIZE, CENTRE = (1.0, 2.0, 3.0), (10.0, 20.0, 30.0)
CORNERS = [tuple(middle + sign * size / 2 for middle, sign, size in zip(CENTRE, signs, SIZE))
           for signs in product((-1, 1), repeat=3)]
SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
TRIANGLES = [corners for a, b, c, d in SIDES for corners in ((a, b, c), (a, c, d))]
Save = Callable[[Path], None]


def save_binary(path: Path, triangles: NDArray[np.float64] | None = None) -> None:
    """Write a binary STL, whose header begins as that of a text."""
    if triangles is None:
        triangles = np.array(CORNERS)[TRIANGLES]
    rows = (struct.pack('<12fH', 0, 0, 0, *triangle.ravel(), 0) for triangle in triangles)
    path.write_bytes(b'solid'.ljust(80) + struct.pack('<I', len(triangles)) + b''.join(rows))


def save_text(path: Path) -> None:
    """Write an STL as text."""
    path.write_text('solid box\n' + ''.join(
        'facet normal 0 0 0\nouter loop\n'
        + ''.join(' vertex {} {} {}\n'.format(*CORNERS[corner]) for corner in corners)
        + 'endloop\nendfacet\n' for corners in TRIANGLES) + 'endsolid\n')


def save_obj(path: Path) -> None:
    """Write an OBJ of quadrilaterals with texture coordinates."""
    path.write_text(
        '# a box\n\n' + ''.join('v {} {} {} 1.0\n'.format(*corner) for corner in CORNERS)
        + 'vt 0 0\n' + ''.join(
            'f ' + ' '.join(f'{corner + 1}/1' for corner in side) + '\n' for side in SIDES))


def save_obj_from_the_end(path: Path) -> None:
    """Write an OBJ whose sides count the corners from the last one."""
    path.write_text(
        ''.join('v {} {} {}\n'.format(*corner) for corner in CORNERS)
        + ''.join('f ' + ' '.join(f'{corner - 8}' for corner in side) + '\n' for side in SIDES))


def save_inside_out(path: Path) -> None:
    """Write a binary STL whose triangles are seen from inside."""
    save_binary(path, np.array(CORNERS)[TRIANGLES][:, ::-1])


@pytest.mark.parametrize(('name', 'save'), [
    ('a.stl', save_binary), ('a.STL', save_text), ('a.obj', save_obj),
    ('a.obj', save_obj_from_the_end), ('a.stl', save_inside_out)])
@pytest.mark.parametrize('scale', [None, (2.0, 0.5, -1.0)])
def test_formats(name: str, save: Save, scale: tuple[float, float, float] | None,
                 tmp_path: Path) -> None:
    save(tmp_path / name)
    found = mesh_solid(Mesh(name, scale), [tmp_path])
    x, y, z = (size * abs(factor) for size, factor in zip(SIZE, scale or (1, 1, 1)))
    expected = solid_of(Box((x, y, z)))
    assert found.volume == pytest.approx(expected.volume)
    assert found.moments == pytest.approx(expected.moments, abs=1e-9)
    assert found.centre == pytest.approx(
        [middle * factor for middle, factor in zip(CENTRE, scale or (1, 1, 1))])


def test_moments_of_trimesh(tmp_path: Path) -> None:
    trimesh = pytest.importorskip('trimesh', reason='not packaged for ROS: pip install trimesh')
    ring = trimesh.creation.torus(2.0, 0.5)
    ring.apply_transform(trimesh.transformations.euler_matrix(0.3, -0.5, 0.7))
    ring.apply_translation((3.0, -1.0, 0.5))
    ring.export(tmp_path / 'ring.stl')
    found, expected = mesh_solid(Mesh('ring.stl'), [tmp_path]), trimesh.load(tmp_path / 'ring.stl')
    assert expected.is_volume
    assert found.volume == pytest.approx(expected.volume)
    assert found.centre == pytest.approx(expected.center_mass)
    moments = expected.moment_inertia / expected.volume
    assert found.moments == pytest.approx(moments[np.triu_indices(3)], abs=1e-9)


@pytest.mark.parametrize(('name', 'content', 'reason'), [
    ('a.stl', None, 'a.stl is not found; add its folder to GZ_SIM_RESOURCE_PATH'),
    ('a.stl', LFS_POINTER, 'a.stl is a Git LFS pointer; run `git lfs pull`'),
    ('a.obj', LFS_POINTER, 'a.obj is a Git LFS pointer; run `git lfs pull`'),
    ('a.dae', b'', 'only .stl and .obj are read'),
    ('a.stl', b'', 'a.stl has no triangles'),
    ('a.stl', b'vertex 0 0 0\nvertex 1 0 0\n', 'a.stl is damaged'),
    ('a.stl', b'vertex a b c\n' * 3, 'a.stl is damaged'),
    ('a.obj', b'v 0 0 0\nf 1 2 3\n', 'a.obj is damaged'),
    ('a.obj', b'v 0 0 0\nf 0 0 0\n', 'a.obj is damaged'),
    ('a.obj', b'v 0 0\nf 1 1 1\n', 'a.obj is damaged'),
    ('a.obj', b'v 1e999 0 0\nf 1 1 1\n', 'numbers that are not finite'),
    ('a.obj', b'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n', 'it is not closed'),
    ('a.obj', b'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 3 2 1\n', 'it encloses no volume')])
def test_mesh_without_a_volume(name: str, content: bytes | None, reason: str, tmp_path: Path
                               ) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(NoSolidError, match=reason):
        mesh_solid(Mesh(name), [tmp_path])


def test_special_and_large_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / 'pipe.stl')
    with (tmp_path / 'large.stl').open('wb') as file:
        file.truncate(60_000_000)
    for name, reason in (('pipe.stl', 'a named pipe'), ('large.stl', 'larger than 50000000')):
        with pytest.raises(NoSolidError, match=reason):
            mesh_solid(Mesh(name), [tmp_path])
    with pytest.raises(NoSolidError, match='is not on this computer'):
        mesh_solid(Mesh('https://example.org/a.stl'), [tmp_path])


def test_auto_inertial_of_a_mesh_there_and_back(tmp_path: Path) -> None:
    model = tmp_path / 'box'
    model.mkdir()
    save_binary(model / 'box.stl')
    (model / 'model.sdf').write_text(
        '<sdf version="1.11"><model name="m"><link name="a"><inertial auto="true"/>'
        '<collision name="c"><density>500</density><geometry><mesh><uri>model://box/box.stl</uri>'
        '</mesh></geometry></collision></link></model></sdf>')
    report = Report()
    urdf = convert_to_urdf(read_robot(str(model), report)[0], report)
    assert urdf.xpath('link/inertial/mass/@value') == ['3000']
    assert urdf.xpath('link/inertial/origin/@xyz') == ['10 20 30']
    (model / 'robot.urdf').write_bytes(to_bytes(urdf))
    back = convert_to_sdf(read_robot(str(model / 'robot.urdf'), report)[0], report)
    assert back.xpath('model/link/inertial/@auto') == ['true']
    assert report.warnings == []


def test_mesh_of_the_own_package(tmp_path: Path) -> None:
    folder = tmp_path / 'checkout'
    (folder / 'urdf').mkdir(parents=True)
    (folder / 'package.xml').write_text('<package><name>arm_description</name></package>')
    save_binary(folder / 'box.stl')
    for uri in ('package://arm_description/box.stl', 'model://arm_description/box.stl'):
        assert mesh_solid(Mesh(uri), [folder / 'urdf']).volume == pytest.approx(6)
    with pytest.raises(NoSolidError, match='is not found'):
        mesh_solid(Mesh('package://other/box.stl'), [folder / 'urdf'])
