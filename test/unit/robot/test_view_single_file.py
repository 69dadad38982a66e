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

"""The page as one file, the modules that it consists of, and the library in it."""

from __future__ import annotations

from base64 import b64decode
import gzip
import hashlib
from html import unescape
import json
from pathlib import Path
import re

from opencv_tools.robot.cli import robot_view
from opencv_tools.robot.view.single_file import LIBRARY, MODULES, read_page
import pytest

ROOT = Path(__file__).parents[3]
PAGE = ROOT / 'opencv_tools' / 'robot' / 'view' / 'page'
ROBOT = ROOT / 'urdf' / 'my_robot.urdf'
MESH = ROOT / 'meshes' / 'my_robot' / 'robot_base.stl'


def document_of(page: str) -> dict:
    return json.loads(re.search(
        r'<script id="robot" type="application/json">(.*?)</script>', page, re.DOTALL)[1])


def content_of(mesh: dict) -> bytes:
    assert mesh['packed']
    return gzip.decompress(b64decode(mesh['data']))


def test_one_file_with_its_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / 'robot.html'
    assert robot_view([str(ROBOT), '--html', str(path)]) == 0
    page = path.read_text()
    mesh, = document_of(page)['meshes']
    assert content_of(mesh) == MESH.read_bytes()
    assert capsys.readouterr().err.splitlines()[-1] == (
        f'{path}: {path.stat().st_size} bytes; files of meshes 1 of 1, {MESH.stat().st_size} '
        'bytes')
    assert '/page/' not in page
    assert '<title>my_robot</title>' in page


def test_one_file_without_meshes(tmp_path: Path) -> None:
    path = tmp_path / 'robot.html'
    assert robot_view([str(ROBOT), '--html', str(path), '--no-meshes']) == 0
    mesh, = document_of(path.read_text())['meshes']
    assert 'data' not in mesh
    assert mesh['reason'] == 'meshes are left out by --no-meshes'


def test_policy_has_the_hashes_of_all_scripts(tmp_path: Path) -> None:
    path = tmp_path / 'robot.html'
    robot_view([str(ROBOT), '--html', str(path)])
    page = path.read_text()
    policy = unescape(re.search(r'Content-Security-Policy" content="(.*?)"', page)[1])
    assert policy.startswith("default-src 'none'; ")
    assert 'unsafe' not in policy and 'http' not in policy
    for tag in ('script', 'style'):
        for text in re.findall(f'<{tag}(?: type="module")?>(.*?)</{tag}>', page, re.DOTALL):
            digest = hashlib.sha256(text.encode()).digest()
            assert digest in [b64decode(one) for one in re.findall(r"'sha256-(.*?)'", policy)]


def test_markup_in_names_stays_text(tmp_path: Path) -> None:
    name = '</title></script><script>alert(1)</script>'
    robot = tmp_path / 'robot.urdf'
    escaped = name.replace('<', '&lt;')
    robot.write_text(f'<robot name="{escaped}"><link name="{escaped}"/></robot>')
    assert robot_view([str(robot), '--html', str(tmp_path / 'robot.html')]) == 0
    page = (tmp_path / 'robot.html').read_text()
    assert '<script>alert' not in page
    assert document_of(page)['robots'][0]['links'][0]['name'] == name


def test_error_of_a_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / 'robot.urdf'
    path.write_text('<robot name="r"><link/></robot>')
    assert robot_view([str(path), '--html', str(tmp_path / 'robot.html')]) == 2
    assert 'has no name=' in capsys.readouterr().err
    assert not (tmp_path / 'robot.html').exists()


def test_standard_input_without_html(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (['-'], ['-', '-', '--html', 'robot.html']):
        assert robot_view(arguments) == 2
        assert ('only one robot can be on standard input, and only with --html: give a file'
                ) in capsys.readouterr().err


def test_modules_are_in_the_order_of_their_imports() -> None:
    assert {path.name for path in PAGE.glob('*.js')} == {*MODULES, LIBRARY}
    known: set[str] = set()
    for name in MODULES:
        text = (PAGE / name).read_text()
        imports = re.findall(r"^import \{[^}]*\} from '\./([a-z]+\.js)';$", text, re.MULTILINE)
        assert len(imports) == len(re.findall(r'^import', text, re.MULTILINE))
        assert {*imports} <= known, name
        known.add(name)


def test_names_of_modules_differ() -> None:
    names = [name for module in MODULES for name in re.findall(
        r'^(?:export )?(?:async )?(?:const|let|function|class) (\w+)',
        (PAGE / module).read_text(), re.MULTILINE)]
    assert sorted(names) == sorted(set(names))


def test_page_never_reads_text_as_html() -> None:
    for name in MODULES:
        assert not re.search(r'innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(|'
                             r'new Function', (PAGE / name).read_text())


def test_library_is_the_one_of_its_hash() -> None:
    folder = ROOT / 'third_party' / 'three'
    sums = dict(reversed(line.split()) for line in (
        folder / 'SHA256SUMS').read_text().splitlines())
    assert set(sums) == {LIBRARY, 'three_license.txt'}
    for name, digest in sums.items():
        assert hashlib.sha256((PAGE / name).read_bytes()).hexdigest() == digest
    assert (folder / 'LICENSE').read_bytes() == (PAGE / 'three_license.txt').read_bytes()
    version = json.loads((folder / 'package.json').read_text())['dependencies']['three']
    assert f'three.js {version},'.encode() in (PAGE / LIBRARY).read_bytes()[:200]


def test_files_that_are_served() -> None:
    assert set(read_page()) == {*MODULES, LIBRARY, 'index.html', 'view.css'}


def test_content_of_meshes(tmp_path: Path) -> None:
    data = [b'v 0 0 0\n' * length for length in (0, 1, 7, 1000, 1_000_000)]
    for number, one in enumerate(data):
        (tmp_path / f'{number}.stl').write_bytes(one)
    (tmp_path / 'a.obj').write_text('mtllib a.mtl\n')
    (tmp_path / 'a.mtl').write_text('map_Kd a.png\n')
    (tmp_path / 'a.png').write_bytes(b'picture')
    visuals = ''.join(f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
                      for name in (*(f'{number}.stl' for number in range(6)), 'a.obj'))
    (tmp_path / 'robot.urdf').write_text(
        f'<robot name="r"><link name="a">{visuals}</link></robot>')
    assert robot_view([str(tmp_path / 'robot.urdf'), '--html', str(tmp_path / 'a.html')]) == 0
    assert (tmp_path / 'a.html').stat().st_size < 1_000_000
    *found, lost, picture, material, mesh = document_of((tmp_path / 'a.html').read_text())[
        'meshes']
    assert [content_of(mesh) for mesh in found] == data
    assert 'data' not in lost and lost['reason'].startswith('it is not found')
    # A picture is compressed, and has an address of its own in the page.
    assert (picture['packed'], b64decode(picture['data'])) == (False, b'picture')
    assert content_of(material) == b'map_Kd a.png\n'
    assert content_of(mesh) == b'mtllib a.mtl\n'


def test_page_keeps_the_permissions_of_its_file(tmp_path: Path) -> None:
    path = tmp_path / 'robot.html'
    for mode in (0o600, 0o664):
        path.touch()
        path.chmod(mode)
        assert robot_view([str(ROBOT), '--html', str(path)]) == 0
        assert path.stat().st_mode & 0o7777 == mode


def test_warnings_of_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / 'a.obj').write_text('mtllib a.mtl\nmtllib b.mtl\n')
    (tmp_path / 'a.mtl').write_text('map_Kd a.png\n')
    (tmp_path / 'robot.urdf').write_text(
        '<robot name="r"><link name="a"><visual><geometry><mesh filename="a.obj"/></geometry>'
        '</visual><collision><geometry><mesh filename="c.stl"/></geometry></collision></link>'
        '</robot>')
    assert robot_view([str(tmp_path / 'robot.urdf'), '--html', str(tmp_path / 'a.html')]) == 0
    reason = 'it is not found; add its folder to GZ_SIM_RESOURCE_PATH'
    assert sorted(capsys.readouterr().err.splitlines()[:-1]) == [
        f'robot_view: warning: {name}: {reason}'
        for name in ('material b.mtl', 'mesh c.stl', 'texture a.png')]
