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

"""Xacro: what it expands to, and what is said of every way in which that goes wrong."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
import os
from pathlib import Path
import sys

from opencv_tools.robot.xacro import process as xacro_process
from opencv_tools.robot.xacro.errors import to_description_error
from opencv_tools.robot.xacro.expand import expand, is_xacro
from opencv_tools.robot.xacro.process import expand_apart, Limits
from opencv_tools.robot.xml.document import DescriptionError, Element, parse
from opencv_tools.robot.xml.report import Report
import pytest
import xacro

# xacro is expanded in a process of its own.
pytestmark = pytest.mark.process

HEAD = '<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">'
MESH = '<link name="a"><visual><geometry><mesh filename="{}"/></geometry></visual></link>'


def expanded(path: Path, content: str, arguments: Mapping[str, str] | None = None,
             report: Report | None = None) -> Element:
    path.write_text(HEAD + content + '</robot>')
    report = report or Report()
    data = expand(str(path), path.read_bytes(), arguments or {}, report)
    return parse(data, str(path), report)


def attribute(root: Element, name: str) -> str:
    return str(root.xpath(f'string(.//*/@{name})'))


def link_name(root: Element) -> str:
    return str(root.xpath('string(link/@name)'))


@pytest.mark.parametrize(('text', 'expected'), [
    ('<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro"/>', True),
    ('<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"/>', True),
    ('<robot><a xmlns:x="http://www.ros.org/wiki/xacro"/></robot>', True),
    ('<robot name="r"/>', False),
    ('<robot name="r" xmlns:sdf="urn:opencv_tools:sdf"/>', False),
])
def test_the_namespace_tells_xacro(text: str, expected: bool) -> None:
    assert is_xacro(parse(text.encode(), 'a', Report())) is expected


def test_properties_macros_and_arguments_are_expanded(tmp_path: Path) -> None:
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


def test_elements_stay_in_their_lines(tmp_path: Path) -> None:
    (tmp_path / 'b.xacro').write_text(f'{HEAD}' + '\n' * 50 + '<link name="deep"/></robot>')
    root = expanded(tmp_path / 'a.xacro', """
        <!-- a
             comment -->
        <xacro:macro name="m" params="name"><link name="${name}"/></xacro:macro>
        <first a="&lt;&quot;&#10;&amp;">&lt;${1 + 1}<![CDATA[<]]></first>
        <xacro:m name="x"/>
        <xacro:include filename="b.xacro"/>

        <last b="1" a="2"/>""")
    assert [(one.tag, one.sourceline) for one in root] == [
        ('first', 5), ('link', 5), ('link', 5), ('last', 9)]
    assert (root[0].get('a'), root[0].text) == ('<"\n&', '<2<')
    assert root[3].keys() == ['b', 'a']


def test_expanding_again_changes_nothing(tmp_path: Path) -> None:
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
def test_packages_stay_packages(written: str, is_there: bool, tmp_path: Path,
                                monkeypatch: pytest.MonkeyPatch) -> None:
    if is_there:
        (tmp_path / 'share' / 'some_pkg').mkdir(parents=True)
        monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    report = Report()
    root = expanded(tmp_path / 'a.xacro', '<xacro:property name="folder" '
                    'value="$(find some_pkg)/meshes"/>' + MESH.format(written), report=report)
    assert attribute(root, 'filename') == 'package://some_pkg/meshes/a.stl'
    assert not report.notes


def test_a_path_elsewhere_is_a_uri_too_and_said(tmp_path: Path) -> None:
    report = Report()
    root = expanded(tmp_path / 'a.xacro', '<gazebo><plugin name="p">\n<parameters>$(find p)/c.yaml'
                    '</parameters></plugin></gazebo><mesh filename="$(find p)/a"/>', report=report)
    assert root.findtext('.//parameters') == 'package://p/c.yaml'
    assert [(note.element, note.line) for note in report.warnings] == [('parameters', 2)]


@pytest.mark.parametrize(('variable', 'folder', 'value'), [
    ('AMENT_PREFIX_PATH', 'share/p', '.'), ('ROS_PACKAGE_PATH', 'p', '.'),
    ('ROS_PACKAGE_PATH', 'p', 'p'), ('ROS_PACKAGE_PATH', 'stack/p', '.'),
])
def test_packages_that_are_there_are_included(variable: str, folder: str, value: str,
                                              tmp_path: Path, monkeypatch: pytest.MonkeyPatch
                                              ) -> None:
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


def test_includes_are_relative_to_the_file(tmp_path: Path) -> None:
    (tmp_path / 'sub').mkdir()
    (tmp_path / 'sub' / 'b.xacro').write_text(f'{HEAD}<xacro:include filename="c.xacro"/></robot>')
    (tmp_path / 'sub' / 'c.xacro').write_text(f'{HEAD}<link name="deep"/></robot>')
    root = expanded(tmp_path / 'a.xacro', '<xacro:include filename="sub/b.xacro"/>'
                    '<xacro:include filename="sub/none.xacro" optional="true"/>')
    assert link_name(root) == 'deep'


def test_a_file_may_be_included_twice(tmp_path: Path) -> None:
    (tmp_path / 'b.xacro').write_text(f'{HEAD}<link name="b"/></robot>')
    assert len(expanded(tmp_path / 'a.xacro', '<xacro:include filename="b.xacro"/>' * 2)) == 2


def test_standard_input_includes_from_the_working_directory(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'b.xacro').write_text(f'{HEAD}<link name="b"/></robot>')
    data = f'{HEAD}<xacro:include filename="b.xacro"/></robot>'.encode()
    assert b'<link name="b">' in expand('-', data, {}, Report())


def test_an_argument_that_a_file_does_not_have_is_said(tmp_path: Path) -> None:
    report = Report()
    expanded(tmp_path / 'a.xacro', '<xacro:arg name="a" default="1"/><link name="$(arg b)"/>',
             {'a': '1', 'b': '2', 'c': '3'}, report)
    assert [(note.name, note.message) for note in report.warnings] == [
        ('c', "is not an argument of this file, which has 'a', 'b'; it is ignored")]


def test_what_xacro_says_is_a_warning(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    report = Report()
    expanded(tmp_path / 'a.xacro', '<xacro:property name="pi" value="3"/>'
             '<a b="${xacro.warning(\'look here\')}"/>', report=report)
    assert [note.message for note in report.warnings] == ['redefining global symbol: pi',
                                                          'look here']
    assert capfd.readouterr() == ('', '')


ENDLESS = '<xacro:macro name="m"><xacro:m/></xacro:macro>\n<xacro:m/>'


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
def test_failures_are_one_line_with_a_place(
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


def test_an_error_without_words_has_a_reason() -> None:
    error = to_description_error(KeyError(), 'a.xacro')
    assert str(error) == 'a.xacro: cannot be expanded: KeyError'


def test_macros_that_call_each_other_ever_more_often_end(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r'a\.xacro:2: <xacro:m>: more than 5000'):
        expanded(tmp_path / 'a.xacro', '<xacro:macro name="m" params="n">\n<xacro:if value="${n}">'
                 '<xacro:m n="${n-1}"/><xacro:m n="${n-1}"/></xacro:if></xacro:macro>'
                 '<xacro:m n="30"/>')


def test_macros_may_be_nested_as_deep_as_robots_need(tmp_path: Path) -> None:
    root = expanded(tmp_path / 'a.xacro', '<xacro:macro name="m" params="n"><link name="l${n}"/>'
                    '<xacro:if value="${n}"><xacro:m n="${n-1}"/></xacro:if></xacro:macro>'
                    '<xacro:m n="99"/>')
    assert len(root) == 100


@pytest.mark.parametrize(('content', 'message'), [
    ('<robot>\n<link>', ':2: not well-formed'),
    ('<!DOCTYPE r [\n<!ENTITY a "b">]><robot/>', ':2: <!ENTITY>: entity declarations are'),
    ('<a>' * 10_000 + '</a>' * 10_000, 'nested more than 256 deep'),
])
def test_included_files_are_checked_like_others(content: str, message: str, tmp_path: Path
                                                ) -> None:
    (tmp_path / 'b.xacro').write_text(content)
    with pytest.raises(DescriptionError) as caught:
        expanded(tmp_path / 'a.xacro', '<xacro:include filename="b.xacro" optional="true"/>')
    assert str(caught.value).startswith(str(tmp_path / 'b.xacro'))
    assert message in str(caught.value)


@pytest.mark.parametrize('encoding', ['utf-8', 'utf-16'])
def test_entities_are_refused_in_every_encoding(encoding: str) -> None:
    text = f'<?xml version="1.0" encoding="{encoding}"?><!DOCTYPE r [<!ENTITY a "b">]>'
    with pytest.raises(DescriptionError, match='entity declarations are not supported'):
        expand('a.xacro', f'{text}{HEAD}&a;</robot>'.encode(encoding), {}, Report())


def test_a_circle_of_includes_is_told(tmp_path: Path) -> None:
    (tmp_path / 'b.xacro').write_text(f'{HEAD}\n<xacro:include filename="a.xacro"/></robot>')
    with pytest.raises(DescriptionError) as caught:
        expanded(tmp_path / 'a.xacro', '<xacro:include filename="b.xacro"/>')
    assert str(caught.value).startswith(f'{tmp_path}/b.xacro:2: <xacro:include>: file ')
    assert str(caught.value).endswith("a.xacro' includes itself through other files")


@pytest.mark.parametrize('content', ['<link name="a"/>', '<link name="${nothing}"/>', ENDLESS,
                                     '<xacro:include filename="none"/>'])
def test_xacro_is_left_as_it_was(content: str, tmp_path: Path) -> None:
    substitution = sys.modules['xacro.substitution_args']
    names = ('parse', 'abs_filename_spec', 'handle_macro_call', 'filestack', 'macrostack',
             'verbosity', 'all_includes', 'substitution_args_context')
    before = {name: getattr(xacro, name) for name in names}
    copies = {name: str(value) for name, value in before.items()}
    find, finds = substitution._eval_find, substitution._eval_dict['find']
    with suppress(DescriptionError):
        expanded(tmp_path / 'a.xacro', '<xacro:arg name="x" default="1"/>' + content)
    assert all(getattr(xacro, name) is value for name, value in before.items())
    assert {name: str(value) for name, value in before.items()} == copies
    assert (substitution._eval_find, substitution._eval_dict['find']) == (find, finds)


LAUGHS = '<xacro:property name="a0" value="lollollol"/>' + ''.join(
    f'<xacro:property name="a{n + 1}" value="{f"${{a{n}}}" * 10}"/>' for n in range(12))
SLOW = '9**9**9'
# As slow, and does not heed signals.
DEAF = 'max(range(10**15))'


@pytest.mark.process
@pytest.mark.parametrize(('content', 'limits', 'message'), [
    (LAUGHS + '\n<link name="${a12}"/>', Limits(memory=200_000_000),
     ':2: <link>: needs more memory than the limit'),
    ('\n<link name="${[[n] for n in range(10**9)]}"/>', Limits(memory=200_000_000),
     'needs more memory than the limit'),
    ('\n<link name="${\'a\' * 10**10}"/>', Limits(), ':2: <link>: needs more memory'),
    (f'\n<link name="${{{SLOW}}}"/>', Limits(seconds=1),
     ':2: <link>: expansion needs more than 1 s of processor time; look for an expression'),
    (f'\n<link name="${{{DEAF}}}"/>', Limits(seconds=1, grace=0),
     ': expansion needs more than 1 s of processor time'),
    (f'\n<link name="${{{SLOW}}}"/>', Limits(wait=0.5), ': expansion timed out after 0.5 s; lo'),
    (f'\n<link name="${{{DEAF}}}"/>', Limits(wait=0.5, grace=0), ': expansion timed out'),
])
def test_what_would_take_all_memory_or_time(content: str, limits: Limits, message: str,
                                            tmp_path: Path) -> None:
    path = tmp_path / 'a.xacro'
    report = Report()
    data = f'{HEAD}{content}</robot>'.encode()
    with pytest.raises(DescriptionError) as caught:
        expand_apart(str(path), data, {}, report, limits)
    assert str(caught.value).startswith(str(path))
    assert message in str(caught.value)
    assert '\n' not in str(caught.value)


@pytest.mark.process
def test_a_process_of_its_own_says_the_same(tmp_path: Path) -> None:
    path = tmp_path / 'a.xacro'
    for content in ('<xacro:arg name="a" default="1"/>\n<a b="$(arg a)" c="$(find p)"/>',
                    '<xacro:property name="pi" value="3"/>\n<link name="${nothing}"/>',
                    '<xacro:arg'):
        data = f'{HEAD}{content}</robot>'.encode()
        said = []
        for expanding in (expand, expand_apart):
            report = Report(str(path))
            try:
                result = expanding(str(path), data, {'a': '\u00fc', 'c': '3'}, report).decode()
            except DescriptionError as err:
                result = str(err)
            said.append((result, report))
        assert said[0] == said[1]


@pytest.mark.parametrize(('script', 'message'), [
    ('import nothing_at_all', "cannot be expanded: ModuleNotFoundError: No module named 'nothing"),
    ('raise MemoryError', 'needs more memory than the limit'),
    ('import sys; sys.exit(3)', 'cannot be expanded: the process ended with exit status 3'),
    ('pass', 'cannot be expanded: the process ended with exit status 0')])
@pytest.mark.process
def test_a_process_that_ends_without_a_reply(script: str, message: str,
                                             monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xacro_process, '_START', script)
    with pytest.raises(DescriptionError, match=f'^a[.]xacro: {message}'):
        expand_apart('a.xacro', f'{HEAD}</robot>'.encode(), {}, Report())


@pytest.mark.process
def test_what_others_print_is_no_part_of_the_reply(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'sitecustomize.py').write_text('print("good morning")')
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    data = f'{HEAD}<link name="a"/></robot>'.encode()
    assert b'morning' not in expand_apart('a.xacro', data, {}, Report())
    assert capfd.readouterr() == ('', '')


def test_without_xacro_its_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'xacro', None)
    with pytest.raises(DescriptionError, match=r'a\.xacro: .*pip install xacro'):
        expand('a.xacro', b'<robot/>', {}, Report())
