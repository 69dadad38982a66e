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

"""Expansion of xacro: properties, macros, packages, includes, arguments and errors."""

from __future__ import annotations

import os
from pathlib import Path
import sys

from opencv_tools.robot.xacro.expand import expand
from opencv_tools.robot.xacro.process import is_xacro
from opencv_tools.robot.xml.document import DescriptionError, parse
from opencv_tools.robot.xml.report import Report
import pytest
from xacro_files import attribute, ENDLESS, expanded, HEAD, link_name, MESH

# The commands expand xacro in a separate process.
pytestmark = pytest.mark.process


@pytest.mark.parametrize(('text', 'expected'), [
    ('<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro"/>', True),
    ('<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"/>', True),
    ('<robot><a xmlns:x="http://www.ros.org/wiki/xacro"/></robot>', True),
    ('<robot name="r"/>', False),
    ('<robot name="r" xmlns:sdf="urn:opencv_tools:sdf"/>', False),
])
def test_namespace_of_xacro(text: str, expected: bool) -> None:
    assert is_xacro(parse(text.encode(), 'a', Report())) is expected


def test_properties_macros_and_arguments(tmp_path: Path) -> None:
    root = expanded(tmp_path / 'a.xacro', """
        <xacro:arg name="size" default="1"/>
        <xacro:property name="half" value="${pi/2}"/>
        <xacro:macro name="wheel" params="name"><link name="${name}_wheel"/></xacro:macro>
        <xacro:wheel name="left"/><xacro:wheel name="right"/>
        <joint rpy="0 ${half} 0" size="$(arg size)"/>""", {'size': '7'})
    assert [link.get('name') for link in root.iter('link')] == ['left_wheel', 'right_wheel']
    assert attribute(root, 'rpy') == '0 1.5707963267948966 0'
    assert attribute(root, 'size') == '7'
    assert not is_xacro(root)


def test_second_expansion_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / 'a.urdf'
    data = f'{HEAD}<link name="a b"/></robot>'.encode()
    once = expand(str(path), data, {}, Report())
    assert expand(str(path), once, {}, Report()) == once


@pytest.mark.parametrize('written', [
    'file://$(find some_pkg)/meshes/a.stl', '$(find some_pkg)/meshes/a.stl',
    'file://${folder}/a.stl', '${folder}/a.stl', 'file:$(find some_pkg)/meshes/a.stl',
    'file:/$(find some_pkg)/meshes/a.stl', 'file:///$(find some_pkg)/meshes/a.stl',
    'file://localhost$(find some_pkg)/meshes/a.stl', 'FILE:///${folder}/a.stl',
])
@pytest.mark.parametrize('is_there', [True, False])
def test_package_paths_become_uris(
        written: str, is_there: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if is_there:
        (tmp_path / 'share' / 'some_pkg').mkdir(parents=True)
        monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    report = Report()
    root = expanded(tmp_path / 'a.xacro', '<xacro:property name="folder" '
                    'value="$(find some_pkg)/meshes"/>' + MESH.format(written), report=report)
    assert attribute(root, 'filename') == 'package://some_pkg/meshes/a.stl'
    assert not report.notes


PLUGIN = '<gazebo><plugin name="p">\n<parameters>{}</parameters><uri>{}</uri></plugin></gazebo>'


@pytest.mark.parametrize(('written', 'path', 'uri'), [
    ('$(find p)/c.yaml', '{}/c.yaml', 'package://p/c.yaml'),
    ('file://$(find p)/c.yaml', 'file://{}/c.yaml', 'package://p/c.yaml'),
    ('a $(find p) b $(find p)', 'a {0} b {0}', 'a package://p b package://p')])
@pytest.mark.parametrize('find', ['path', 'package'])
def test_package_path_in_the_text_of_a_plugin(
        find: str, written: str, path: str, uri: str, tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / 'share' / 'p'
    folder.mkdir(parents=True)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    report = Report()
    text = f'{HEAD}{PLUGIN.format(written, written)}</robot>'.encode()
    root = parse(expand(str(tmp_path / 'a.xacro'), text, {}, report, find), 'a.xacro', report)
    assert root.findtext('.//parameters') == (path.format(folder) if find == 'path' else uri)
    assert 'package://p' in root.findtext('.//uri', '')
    assert {(note.element, note.line) for note in report.warnings} == {('parameters', 2)}


def test_package_path_of_a_missing_package_is_a_uri(tmp_path: Path) -> None:
    report = Report()
    root = expanded(tmp_path / 'a.xacro', PLUGIN.format('$(find no_pkg)/c.yaml', ''),
                    report=report)
    assert root.findtext('.//parameters') == 'package://no_pkg/c.yaml'
    assert 'because the package is not found' in report.warnings[0].message


@pytest.mark.parametrize(('variable', 'folder', 'value'), [
    ('AMENT_PREFIX_PATH', 'share/p', '.'), ('ROS_PACKAGE_PATH', 'p', '.'),
    ('ROS_PACKAGE_PATH', 'p', 'p'), ('ROS_PACKAGE_PATH', 'stack/p', '.'),
])
def test_includes_from_installed_packages(
        variable: str, folder: str, value: str, tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ('AMENT_PREFIX_PATH', 'ROS_PACKAGE_PATH'):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(variable, f'/nowhere:{tmp_path / value}')
    (tmp_path / folder).mkdir(parents=True)
    (tmp_path / folder / 'part.xacro').write_text(f'{HEAD}<link name="${{size}}"/></robot>')
    (tmp_path / folder / 'sizes.yaml').write_text('size: 5')
    root = expanded(tmp_path / 'a.xacro', """<xacro:property name="size"
        value="${xacro.load_yaml('$(find p)/sizes.yaml')['size']}"/>
        <xacro:include filename="$(find p)/part.xacro"/>""")
    assert link_name(root) == '5'


def test_relative_and_optional_includes(tmp_path: Path) -> None:
    (tmp_path / 'sub').mkdir()
    (tmp_path / 'sub' / 'b.xacro').write_text(f'{HEAD}<xacro:include filename="c.xacro"/></robot>')
    (tmp_path / 'sub' / 'c.xacro').write_text(f'{HEAD}<link name="deep"/></robot>')
    root = expanded(tmp_path / 'a.xacro', '<xacro:include filename="sub/b.xacro"/>'
                    '<xacro:include filename="sub/none.xacro" optional="true"/>')
    assert link_name(root) == 'deep'


def test_second_include_of_a_file(tmp_path: Path) -> None:
    (tmp_path / 'b.xacro').write_text(f'{HEAD}<link name="b"/></robot>')
    assert len(expanded(tmp_path / 'a.xacro', '<xacro:include filename="b.xacro"/>' * 2)) == 2


def test_includes_of_standard_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'b.xacro').write_text(f'{HEAD}<link name="b"/></robot>')
    data = f'{HEAD}<xacro:include filename="b.xacro"/></robot>'.encode()
    assert b'<link name="b">' in expand('-', data, {}, Report())


def test_unknown_argument_is_reported(tmp_path: Path) -> None:
    report = Report()
    expanded(tmp_path / 'a.xacro', '<xacro:arg name="a" default="1"/><link name="$(arg b)"/>',
             {'a': '1', 'b': '2', 'c': '3'}, report)
    assert [(note.name, note.message) for note in report.warnings] == [
        ('c', "is not an argument of this file, which has 'a', 'b'; it is ignored")]


def test_messages_of_xacro_are_warnings(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    report = Report()
    expanded(tmp_path / 'a.xacro', '<xacro:property name="pi" value="3"/>'
             '<a b="${xacro.warning(\'look here\')}"/>', report=report)
    assert [note.message for note in report.warnings] == ['redefining global symbol: pi',
                                                          'look here']
    assert capfd.readouterr() == ('', '')


@pytest.mark.parametrize(('content', 'line', 'tag', 'message'), [
    ('\n<link name="${nothing}"/>', 2, 'link', "name 'nothing' is not defined"),
    ('\n<link>${1/0}</link>', 2, 'link', 'division by zero'),
    ('\n<link name="${1 +}"/>', 2, 'link', 'invalid syntax when evaluating expression'),
    ('\n<link name="${x"/>', 2, 'link', 'invalid expression'),
    ('\n<link name="${__import__(1)}"/>', 2, 'link', '__import__'),
    ('\n\n<link name="$(arg missing)"/>', 3, 'link', '--arg missing:=VALUE'),
    ('\n<link name="$(nothing at all)"/>', 2, 'link', 'Unknown substitution command'),
    ('\n<link name="$(env NOT_SET_AT_ALL)"/>', 2, 'link', 'NOT_SET_AT_ALL'),
    ('\n<link name="$(find a/../../b)"/>', 2, 'link', 'is not the name of a package'),
    ('\n<xacro:nothing/>', 2, 'xacro:nothing', 'unknown macro name'),
    ('\n<xacro:if value="maybe"/>', 2, 'xacro:if', 'not a boolean expression'),
    ('\n<xacro:property value="1"/>', 2, 'xacro:property', "missing attribute 'name'"),
    ('\n<xacro:macro name="m" params="x"/>\n<xacro:m/>', 3, 'xacro:m', 'Undefined parameters [x]'),
    ('\n<xacro:macro name="m" params="x">\n<link size="${x*y}"/></xacro:macro>\n<xacro:m x="1"/>',
     3, 'link', "name 'y' is not defined"),
    ('\n<xacro:property name="a" value="${b}"/><xacro:property name="b" value="${a}"/>'
     '\n<link name="${a}"/>', 3, 'link', 'circular variable definition'),
    ('\n<xacro:include filename="none.xacro"/>', 2, 'xacro:include', 'none.xacro'),
    ('\n<xacro:include filename="$(find no_pkg)/b.xacro"/>', 2, 'xacro:include', "'no_pkg'"),
    ('\n<link name="${xacro.load_yaml(\'no.yaml\')}"/>', 2, 'link', 'no.yaml'),
    ('\n<link name="${xacro.load_yaml(\'$(find no_pkg)/a\')}"/>', 2, 'link', "'no_pkg'"),
    ('\n<xacro:include filename="a.xacro"/>', 2, 'xacro:include', 'includes itself'),
    ('\n<xacro:include filename="*.xacro"/>', 2, 'xacro:include', 'includes itself'),
    (ENDLESS, 1, 'xacro:m', 'infinite recursion'),
    ('\n<a b="${xacro.fatal(\'no way\')}"/>', 2, 'a', 'no way'),
    ('\n<xacro:include filename="pipe"/>', 2, 'xacro:include', 'is a named pipe; only regular'),
    ('\n<xacro:include filename="p*e"/>', 2, 'xacro:include', 'cannot be read'),
    ('\n<link name="${xacro.load_yaml(\'pipe\')}"/>', 2, 'link', 'is a named pipe'),
    ('\n<link name="${xacro.load_yaml(\'/dev/zero\')}"/>', 2, 'link', 'is a device'),
    ('\n<link name="${\'a\' * 10**18}"/>', 2, 'link', 'needs more memory than'),
])
def test_errors(
        content: str, line: int, tag: str, message: str, tmp_path: Path,
        capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv('NOT_SET_AT_ALL', raising=False)
    path = tmp_path / 'a.xacro'
    os.mkfifo(tmp_path / 'pipe')
    with pytest.raises(DescriptionError) as caught:
        expanded(path, content)
    text = str(caught.value)
    assert text.startswith(f'{path}:{line}: <{tag}>: '), text
    assert message in text
    assert '\n' not in text and '\ue000' not in text and len(text) < 800
    assert capfd.readouterr() == ('', '')


@pytest.mark.thorough
def test_limit_of_macro_calls(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r'a\.xacro:2: <xacro:m>: more than 5000'):
        expanded(tmp_path / 'a.xacro', '<xacro:macro name="m" params="n">\n<xacro:if value="${n}">'
                 '<xacro:m n="${n-1}"/><xacro:m n="${n-1}"/></xacro:if></xacro:macro>'
                 '<xacro:m n="30"/>')


def test_nested_macros(tmp_path: Path) -> None:
    root = expanded(tmp_path / 'a.xacro', '<xacro:macro name="m" params="n"><link name="l${n}"/>'
                    '<xacro:if value="${n}"><xacro:m n="${n-1}"/></xacro:if></xacro:macro>'
                    '<xacro:m n="99"/>')
    assert len(root) == 100


@pytest.mark.parametrize(('content', 'message'), [
    ('<robot>\n<link>', ':2: not well-formed'),
    ('<!DOCTYPE r [\n<!ENTITY a "b">]><robot/>', ':2: <!ENTITY>: entity declarations are'),
    ('<a>' * 10_000 + '</a>' * 10_000, 'nested more than 256 deep'),
])
def test_invalid_included_file(content: str, message: str, tmp_path: Path) -> None:
    (tmp_path / 'b.xacro').write_text(content)
    with pytest.raises(DescriptionError) as caught:
        expanded(tmp_path / 'a.xacro', '<xacro:include filename="b.xacro" optional="true"/>')
    assert str(caught.value).startswith(str(tmp_path / 'b.xacro'))
    assert message in str(caught.value)


@pytest.mark.parametrize('encoding', ['utf-8', 'utf-16'])
def test_entities_in_every_encoding(encoding: str) -> None:
    text = f'<?xml version="1.0" encoding="{encoding}"?><!DOCTYPE r [<!ENTITY a "b">]>'
    with pytest.raises(DescriptionError, match='entity declarations are not supported'):
        expand('a.xacro', f'{text}{HEAD}&a;</robot>'.encode(encoding), {}, Report())


def test_include_cycle(tmp_path: Path) -> None:
    (tmp_path / 'b.xacro').write_text(f'{HEAD}\n<xacro:include filename="a.xacro"/></robot>')
    with pytest.raises(DescriptionError) as caught:
        expanded(tmp_path / 'a.xacro', '<xacro:include filename="b.xacro"/>')
    assert str(caught.value).startswith(f'{tmp_path}/b.xacro:2: <xacro:include>: file ')
    assert str(caught.value).endswith("a.xacro' includes itself through other files")


def test_expansion_after_an_error(tmp_path: Path) -> None:
    argument = '<xacro:arg name="x" default="1"/>'
    for content in ('<link name="${nothing}"/>', ENDLESS, '<xacro:include filename="none"/>'):
        with pytest.raises(DescriptionError):
            expanded(tmp_path / 'a.xacro', argument + content)
        assert len(expanded(tmp_path / 'a.xacro', f'{argument}<link name="$(arg x)"/>')) == 1


def test_missing_package_xacro(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'xacro', None)
    with pytest.raises(DescriptionError, match=r'a\.xacro: .*pip install xacro'):
        expand('a.xacro', b'<robot/>', {}, Report())


@pytest.mark.parametrize('name', ['arm_description', 'other'])
def test_own_package_without_a_workspace(
        name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ('AMENT_PREFIX_PATH', 'ROS_PACKAGE_PATH'):
        monkeypatch.delenv(variable, raising=False)
    folder = tmp_path / 'checkout'
    (folder / 'urdf' / 'parts').mkdir(parents=True)
    (folder / 'package.xml').write_text('<package><name>arm_description</name></package>')
    part = PLUGIN.format(f'$(find {name})/c.yaml', f'$(find {name})/d')
    (folder / 'urdf' / 'parts' / 'p.xacro').write_text(f'{HEAD}{part}</robot>')
    monkeypatch.chdir(folder / 'urdf')
    include = '<xacro:include filename="$(find arm_description)/urdf/parts/p.xacro"/>'
    (folder / 'urdf' / 'a.xacro').touch()
    (tmp_path / 'link.xacro').symlink_to(folder / 'urdf' / 'a.xacro')
    for path in (folder / 'urdf' / 'a.xacro', Path('a.xacro'), tmp_path / 'link.xacro'):
        root = expanded(path, include)
        assert root.findtext('.//parameters') == (
            f'{folder}/c.yaml' if name == 'arm_description' else 'package://other/c.yaml')
        assert root.findtext('.//uri') == f'package://{name}/d'
