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

"""Where meshes of the page are found, and which files are never read."""

from __future__ import annotations

import os
from pathlib import Path

from opencv_tools.robot.meshes import LFS_POINTER
from opencv_tools.robot.view import mesh_files
from opencv_tools.robot.view.mesh_files import MeshFile, MeshFiles, NoMeshError
import pytest


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Create a package with a robot and a mesh, below a folder with another mesh."""
    package = tmp_path / 'source' / 'my_package'
    for folder in ('urdf', 'meshes'):
        (package / folder).mkdir(parents=True)
    (package / 'package.xml').write_text('<package><name>my_package</name></package>')
    (package / 'meshes' / 'a.stl').write_bytes(b'inside')
    (tmp_path / 'outside.stl').write_bytes(b'outside')
    return package


def find(package: Path, uri: str) -> MeshFile:
    meshes = MeshFiles()
    meshes.search(str(package / 'urdf' / 'robot.urdf'))
    return meshes.files[meshes.add(uri)]


@pytest.mark.parametrize('uri', [
    'package://my_package/meshes/a.stl', 'model://my_package/meshes/a.stl', 'meshes/a.stl',
    '../meshes/a.stl', 'model://meshes/a.stl', 'file://{package}/meshes/a.stl',
    'package://my_package/urdf/../meshes/a.stl'])
def test_mesh_that_is_found(uri: str, package: Path) -> None:
    found = find(package, uri.format(package=package))
    assert (found.reason, found.kind, found.size) == ('', 'stl', len(b'inside'))
    assert found.path == package / 'meshes' / 'a.stl'


@pytest.mark.parametrize('uri', [
    'package://my_package/../../outside.stl', '../../../outside.stl', '{outside}',
    'file://{outside}', 'file:///%2e%2e/{outside}', 'model://../../outside.stl',
    'package://../../outside.stl'])
def test_mesh_outside_of_the_packages(uri: str, package: Path) -> None:
    outside = package.parents[1] / 'outside.stl'
    assert outside.is_file()
    found = find(package, uri.format(outside=outside))
    assert found.path is None
    assert found.reason


@pytest.mark.parametrize(('uri', 'reason'), [
    ('package://my_package/meshes/b.stl', 'it is not found; add its folder to '
     'GZ_SIM_RESOURCE_PATH'),
    ('file://{outside}', 'it is outside of the folder of the robot, of its packages and of '
     'GZ_SIM_RESOURCE_PATH'),
    ('package://my_package/package.xml', 'the page shows only stl, obj, dae, glb'),
    ('https://example.org/a.stl', 'it is not on this computer'),
    ('package://my_package/meshes/\0.stl', 'it is not found; add its folder to '
     'GZ_SIM_RESOURCE_PATH'),
])
def test_reason_of_a_missing_mesh(uri: str, reason: str, package: Path) -> None:
    outside = package.parents[1] / 'outside.stl'
    assert find(package, uri.format(outside=outside)).reason == reason


def test_mesh_of_an_installed_package(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    share, source = tmp_path / 'prefix' / 'share' / 'my_package', package / 'meshes' / 'a.stl'
    share.mkdir(parents=True)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path / 'prefix'))
    # colcon build --symlink-install
    for path in (package / 'package.xml', source):
        (share / path.name).symlink_to(path)
    (share / 'out.stl').symlink_to(tmp_path / 'outside.stl')
    meshes = MeshFiles()
    for folder in (share, tmp_path / 'elsewhere' / 'urdf'):
        meshes.search(str(folder / 'robot.urdf'))
        assert meshes.files[meshes.add('package://my_package/a.stl')].path == source
        assert meshes.files[meshes.add('package://my_package/out.stl')].reason.startswith(
            'it is outside of')


def test_link_to_another_file(package: Path) -> None:
    (package / 'meshes' / 'key.stl').symlink_to(package / 'package.xml')
    found = find(package, 'package://my_package/meshes/key.stl')
    assert (found.path, found.reason) == (None, 'it is a link to a file of another kind')


def test_link_out_of_the_folder(package: Path) -> None:
    (package / 'meshes' / 'out.stl').symlink_to(package.parents[1] / 'outside.stl')
    (package / 'meshes' / 'in.stl').symlink_to('a.stl')
    (package / 'up').symlink_to(package.parents[1])
    for uri in ('meshes/out.stl', 'package://my_package/meshes/out.stl',
                'package://my_package/up/outside.stl'):
        assert find(package, uri).reason.startswith('it is outside of'), uri
    assert find(package, 'meshes/in.stl').path == package / 'meshes' / 'a.stl'


def test_file_that_is_not_regular(package: Path) -> None:
    os.mkfifo(package / 'meshes' / 'pipe.stl')
    (package / 'meshes' / 'folder.stl').mkdir()
    (package / 'meshes' / 'loop.stl').symlink_to('loop.stl')
    for name in ('pipe', 'folder', 'loop'):
        found = find(package, f'package://my_package/meshes/{name}.stl')
        assert found.reason == 'it is not a regular file', name


@pytest.mark.parametrize('name', ['a.stl', 'b.obj', 'c.dae', 'd.glb', 'e.mtl', 'f.png'])
def test_pointer_of_git_lfs(name: str, package: Path) -> None:
    (package / 'meshes' / name).write_bytes(
        LFS_POINTER + b'oid sha256:4d7a214614ab2935c943f9e0ff69d22eadbb8f32b1\nsize 12345\n')
    (package / 'meshes' / 'a.obj').write_text('mtllib e.mtl\nmtllib g.mtl\n')
    (package / 'meshes' / 'g.mtl').write_text('map_Kd f.png\n')
    meshes = MeshFiles()
    meshes.search(str(package / 'urdf' / 'robot.urdf'))
    meshes.add(f'meshes/{name}')
    meshes.add('meshes/a.obj')
    found = {Path(file.uri).name: file.reason for file in meshes.files if 'LFS' in file.reason}
    assert found == {name: 'it is a Git LFS pointer; run `git lfs pull`'}
    assert package / 'meshes' / name in meshes.missing  # the page waits for its content


@pytest.mark.parametrize('replaced', ['a.stl', ''])
def test_mesh_that_is_replaced_by_a_link(replaced: str, package: Path) -> None:
    meshes = MeshFiles()
    meshes.search(str(package / 'urdf' / 'robot.urdf'))
    number = meshes.add('package://my_package/meshes/a.stl')
    other = package / 'other'
    other.mkdir()
    (other / 'a.stl').symlink_to(package.parents[1] / 'outside.stl')
    path = package / 'meshes' / replaced
    path.rename(package / 'old')
    path.symlink_to(other / replaced)
    with pytest.raises(NoMeshError, match='cannot be read: '):
        meshes.read(number)


def test_mesh_of_a_gigabyte(package: Path) -> None:
    with (package / 'meshes' / 'a.stl').open('wb') as file:
        file.truncate(1_000_000_000)
    found = find(package, 'package://my_package/meshes/a.stl')
    assert found.path is None
    assert found.reason == (
        'it has 1000000000 bytes, but 50000000 are the limit of a file')


def test_meshes_beyond_the_total(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh_files, 'MAX_TOTAL', 10)
    (package / 'meshes' / 'b.stl').write_bytes(b'inside')
    meshes = MeshFiles()
    meshes.search(str(package / 'urdf' / 'robot.urdf'))
    numbers = [meshes.add(f'package://my_package/meshes/{name}.stl') for name in 'aba']
    assert numbers == [0, 1, 0]
    assert [file.reason for file in meshes.files] == [
        '', 'it has 6 bytes and the files before it 6, but 10 are the limit of all files']
    monkeypatch.setattr(mesh_files, 'MAX_TOTAL', 100)
    monkeypatch.setattr(mesh_files, 'MAX_FILES', 2)
    meshes.add('meshes/a.stl')
    assert meshes.files[2].reason == '2 files are the limit'


def test_mesh_that_has_gone(package: Path) -> None:
    meshes = MeshFiles()
    meshes.search(str(package / 'urdf' / 'robot.urdf'))
    number = meshes.add('package://my_package/meshes/a.stl')
    assert meshes.read(number) == b'inside'
    (package / 'meshes' / 'a.stl').unlink()
    with pytest.raises(NoMeshError, match='cannot be read: No such file'):
        meshes.read(number)


def parts(package: Path, name: str, text: str) -> dict[str, MeshFile]:
    """Return the files that a mesh names, by their names in it."""
    (package / 'meshes' / name).write_text(text)
    (package / 'meshes' / 'a.png').write_bytes(b'picture')
    meshes = MeshFiles()
    meshes.search(str(package / 'urdf' / 'robot.urdf'))
    number = meshes.add(f'package://my_package/meshes/{name}')
    return {part: meshes.files[one] for part, one in meshes.files[number].parts.items()}


def test_materials_and_textures_of_obj(package: Path) -> None:
    (package / 'meshes' / 'my colours.mtl').write_text(
        'newmtl a\nmap_Kd a.png\r\nnewmtl b\n map_Kd -s 1 1 1 b.png \nmap_Ks c.png\n')
    found = parts(package, 'm.obj', 'mtllib my colours.mtl\nv 0 0 0\n')
    assert [*found] == ['my colours.mtl', 'a.png', 'b.png']
    assert [one.role for one in found.values()] == ['material', 'texture', 'texture']
    assert found['a.png'].path == package / 'meshes' / 'a.png'
    assert (found['a.png'].kind, found['a.png'].uri) == ('png', 'a.png')
    assert found['b.png'].reason == 'it is not found; add its folder to GZ_SIM_RESOURCE_PATH'


@pytest.mark.parametrize('name', ['a.png', './a.png', '../meshes/a.png', '..\\meshes\\a.png',
                                  '%61.png', 'package://my_package/meshes/a.png', 'only.png'])
def test_texture_of_collada(name: str, package: Path) -> None:
    textures = package / 'materials' / 'textures'  # of a model of Gazebo
    textures.mkdir(parents=True)
    (textures / 'only.png').write_bytes(b'picture')
    image = f'<image id="a" name="a"><init_from> {name} </init_from></image>'
    surface = '<surface type="2D"><init_from>a</init_from></surface>'
    found = parts(package, 'm.dae', f'<COLLADA>{image}{surface}</COLLADA>')
    assert [(part, one.reason) for part, one in found.items()] == [(name, '')]


@pytest.mark.parametrize(('name', 'reason'), [
    ('../../../outside.png', 'it is outside of'), ('{outside}', 'it is outside of'),
    ('file://{outside}', 'it is outside of'), ('https://example.org/a.png', 'it is not on this'),
    ('a.svg', 'the page shows only png, jpg, jpeg'), ('../package.xml', 'the page shows only'),
    ('key.png', 'it is a link to a file of another kind'), ('\0.png', 'it is not found'),
    ('a.stl', 'the page shows only'), ('', 'the page shows only')])
def test_texture_that_is_not_read(name: str, reason: str, package: Path) -> None:
    outside = package.parents[1] / 'outside.png'
    outside.write_bytes(b'secret')
    (package / 'meshes' / 'key.png').symlink_to(package / 'package.xml')
    found, = parts(package, 'm.dae', '<image><init_from>' + name.format(outside=outside)
                   + '</init_from></image>').values()
    assert found.path is None
    assert found.reason.startswith(reason)


def test_mesh_that_names_many_files(package: Path) -> None:
    text = ''.join(f'<image><init_from>{number}.png</init_from></image>' for number in range(1000))
    assert len(parts(package, 'm.dae', text)) == mesh_files.MAX_NAMED


def test_meshes_that_are_left_out(package: Path) -> None:
    meshes = MeshFiles(is_shown=False)
    meshes.search(str(package / 'urdf' / 'robot.urdf'))
    assert meshes.files[meshes.add('package://my_package/meshes/a.stl')].reason == (
        'meshes are left out by --no-meshes')
