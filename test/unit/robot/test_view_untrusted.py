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

"""Robots from an untrusted text, and the meshes that they may name."""

from __future__ import annotations

import os
from pathlib import Path

from opencv_tools.robot.view.untrusted import text_content
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report
import pytest


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Install a package with a mesh; its source has another one, and a folder beside it, too."""
    package = tmp_path / 'install' / 'share' / 'arm'
    source = tmp_path / 'src' / 'arm'
    for folder in (package / 'meshes', source / 'meshes'):
        folder.mkdir(parents=True)
    (package / 'meshes' / 'a.stl').write_bytes(b'inside')
    (source / 'meshes' / 'b.stl').write_bytes(b'source')
    (source / 'package.xml').write_text('<package><name>arm</name></package>')
    (tmp_path / 'outside.stl').write_bytes(b'outside')
    (tmp_path / 'secret.txt').write_bytes(b'secret')
    (package / 'meshes' / 'b.stl').symlink_to(source / 'meshes' / 'b.stl')
    (package / 'meshes' / 'out.stl').symlink_to(tmp_path / 'outside.stl')
    (package / 'meshes' / 'text.stl').symlink_to(tmp_path / 'secret.txt')
    (package / 'up').symlink_to(tmp_path)
    monkeypatch.setenv('AMENT_PREFIX_PATH', os.pathsep.join(('', str(tmp_path / 'install'))))
    monkeypatch.setenv('GZ_SIM_RESOURCE_PATH', str(tmp_path))
    return package


def found(uri: str) -> tuple[str, str]:
    """Return the reason why a mesh is not shown, and the name of its file."""
    text = (f'<robot name="r"><link name="l"><visual><geometry><mesh filename="{uri}"/>'
            '</geometry></visual></link></robot>')
    (mesh,) = text_content(text.encode(), 'text', Report()).meshes.files
    return mesh.reason, mesh.path.name if mesh.path else ''


def test_meshes_of_installed_packages(package: Path) -> None:
    assert found('package://arm/meshes/a.stl') == ('', 'a.stl')
    assert found('package://arm/meshes/b.stl') == ('', 'b.stl')  # as of --symlink-install


@pytest.mark.parametrize(('uri', 'reason'), [
    ('package://arm/meshes/out.stl', 'it is a link out of its package'),
    ('package://arm/up/outside.stl', 'it is a link out of its package'),
    ('package://arm/meshes/text.stl', 'it is a link out of its package'),
    ('package://arm/../../../outside.stl', 'it is not of the form package://PACKAGE/FILE'),
    ('package://arm/meshes/../meshes/a.stl', 'it is not of the form package://PACKAGE/FILE'),
    ('package://../outside.stl', 'it is not of the form package://PACKAGE/FILE'),
    ('package://arm/{outside}', 'it is not of the form package://PACKAGE/FILE'),
    ('{outside}', 'it is not of the form package://PACKAGE/FILE'),
    ('file://{outside}', 'it is not of the form package://PACKAGE/FILE'),
    ('model://arm/meshes/a.stl', 'it is not of the form package://PACKAGE/FILE'),
    ('outside.stl', 'it is not of the form package://PACKAGE/FILE'),
    ('http://localhost/a.stl', 'it is not of the form package://PACKAGE/FILE'),
    ('package://other/meshes/a.stl', 'it is not in an installed package of this computer'),
    ('package://arm/meshes/none.stl', 'it is not in an installed package of this computer'),
    ('package://arm/meshes', 'the page shows only stl, obj, dae, glb')])
def test_mesh_that_is_not_shown(uri: str, reason: str, package: Path) -> None:
    outside = package.parents[2] / 'outside.stl'
    assert outside.is_file()
    assert found(uri.format(outside=outside)) == (reason, '')


def test_files_that_a_mesh_names(package: Path) -> None:
    for name in ('../install/share/arm/meshes/a.png', 'outside.png'):
        (package.parents[2] / 'src' / name).write_bytes(b'image')
    (package / 'meshes' / 'a.obj').write_text('mtllib a.mtl\n')
    outside = package.parents[2] / 'src' / 'outside.png'
    (package / 'meshes' / 'a.mtl').write_text(
        f'map_Kd a.png\nmap_Kd {outside}\nmap_Kd file://{outside}\nmap_Kd ../up/src/outside.png\n')
    text = ('<robot name="r"><link name="l"><visual><geometry>'
            '<mesh filename="package://arm/meshes/a.obj"/></geometry></visual></link></robot>')
    meshes = text_content(text.encode(), 'text', Report()).meshes.files
    assert {mesh.path.name for mesh in meshes if mesh.path} == {'a.obj', 'a.mtl', 'a.png'}
    assert [mesh.reason for mesh in meshes if not mesh.path] == [
        'it is not in the package of its mesh'] * 2


def test_xacro_is_not_executed() -> None:
    text = ('<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="a"/>'
            '{}</robot>')
    content = text_content(text.format('').encode(), 'text', Report())
    assert content.document['robots'][0]['name'] == 'r'
    with pytest.raises(DescriptionError, match='text:1: <property>: is not expanded here'):
        text_content(text.format('<xacro:property name="a" value="1"/>').encode(), 'text',
                     Report())


def test_sdf_is_refused() -> None:
    with pytest.raises(DescriptionError, match='is not URDF; its root is <sdf>'):
        text_content(b'<sdf version="1.7"><include><uri>model://a</uri></include></sdf>', 'text',
                     Report())
