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

"""Included SDF models: search for their files, overrides, merges and errors."""

from __future__ import annotations

from pathlib import Path
import re

from opencv_tools.robot.convert import convert_to_urdf
from opencv_tools.robot.geometry import Mesh
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.model import FrameId, Robot
from opencv_tools.robot.sdf import includes
from opencv_tools.robot.sdf.includes import file_of_model, MAX_INCLUDES, SEARCH_VARIABLES
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.xml.document import DescriptionError, parse
from opencv_tools.robot.xml.report import Report
import pytest

ARM = ('<pose>0 0 1 0 0 0</pose><link name="base"/><link name="tip"><pose>0 0 2 0 0 0</pose>'
       '<visual name="v"><geometry><mesh><uri>meshes/a.stl</uri></mesh></geometry></visual></link>'
       '<joint name="j" type="fixed"><parent>base</parent><child>tip</child></joint>')


@pytest.fixture(autouse=True)
def _no_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in SEARCH_VARIABLES:
        monkeypatch.delenv(name, raising=False)


def sdf(content: str, version: str = '1.9') -> str:
    return f'<sdf version="{version}">{content}</sdf>'


def put(path: Path, content: str = f'<model name="arm">{ARM}</model>', version: str = '1.9'
        ) -> Path:
    """Write an SDF file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(sdf(content, version))
    return path


def configure(folder: Path, *entries: tuple[str, str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / 'model.config').write_text('<model>' + ''.join(
        f'<sdf version="{version}">{name}</sdf>' for version, name in entries) + '</model>')


def read(folder: Path, content: str, report: Report | None = None, search: tuple[str, ...] = (),
         model: str = '', version: str = '1.9') -> Robot:
    """Read SDF as the file robots/robot.sdf of a folder."""
    path = str(folder / 'robots' / 'robot.sdf')
    report = report or Report()
    root = parse(sdf(content, version).encode(), path, report)
    return read_sdf(root, report, model=model, search=search)


def robot_with(include: str, attributes: str = '') -> str:
    return (f'<model name="m"><link name="a"/><include {attributes}>{include}</include></model>')


@pytest.mark.parametrize(('uri', 'file'), [
    ('model://arm', 'robots/arm/model.sdf'),
    ('model://arm', 'arm/model.sdf'),
    ('model://arm/other.sdf', 'arm/other.sdf'),
    ('model://arm', 'models/arm/model.sdf'),
    ('package://arm', 'models/arm/model.sdf'),
    ('arm', 'robots/arm/model.sdf'),
    ('arm/model.sdf', 'arm/model.sdf'),
    ('../arm/model.sdf', 'arm/model.sdf'),
    ('file://arm', 'models/arm/model.sdf'),
    ('file://{folder}/x/model.sdf', 'x/model.sdf'),
    ('{folder}/x', 'x/model.sdf')])
def test_resolved_uris(tmp_path: Path, uri: str, file: str) -> None:
    put(tmp_path / file)
    (tmp_path / 'robots').mkdir(exist_ok=True)
    uri = uri.format(folder=tmp_path)
    robot = read(tmp_path, robot_with(f'<uri>{uri}</uri>'), search=(str(tmp_path / 'models'),))
    assert [link.name for link in robot.links] == ['a', 'arm::base', 'arm::tip']


@pytest.mark.parametrize('variable', SEARCH_VARIABLES)
def test_search_path_of_the_environment(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str) -> None:
    put(tmp_path / 'far' / 'arm' / 'model.sdf')
    monkeypatch.setenv(variable, f'/nowhere:{tmp_path / "far"}')
    assert len(read(tmp_path, robot_with('<uri>model://arm</uri>')).links) == 3


@pytest.mark.parametrize(('entries', 'expected'), [
    ((('1.4', 'a.sdf'), ('1.9', 'b.sdf'), ('1.10', 'c.sdf')), 'c'),
    ((('1.10', 'c.sdf'), ('1.99', 'a.sdf')), 'c'),
    ((('1.99', 'a.sdf'),), 'a')])
def test_newest_version_in_a_model_config(
        tmp_path: Path, entries: tuple[tuple[str, str], ...], expected: str) -> None:
    configure(tmp_path / 'arm', *entries)
    for name in 'abc':
        put(tmp_path / 'arm' / f'{name}.sdf', f'<model name="of_{name}"><link name="l"/></model>')
    robot = read(tmp_path, robot_with('<uri>model://arm</uri>'))
    assert robot.links[1].name == f'of_{expected}::l'


@pytest.mark.parametrize(('entries', 'expected'), [
    ((('1.4', 'a.sdf'), ('1.9', 'b.sdf'), ('1.10', 'c.sdf')), 'c.sdf'),
    ((('1.99', 'a.sdf'), ('1.6', 'sub/b.sdf'), ('1.7', '')), 'sub/b.sdf')])
def test_model_file_in_a_model_config(
        tmp_path: Path, entries: tuple[tuple[str, str], ...], expected: str) -> None:
    configure(tmp_path, *entries)
    assert file_of_model(str(tmp_path / 'model.config')) == str(tmp_path / expected)
    (tmp_path / 'model.sdf').touch()
    assert file_of_model(str(tmp_path)) == str(tmp_path / expected)


def test_model_file_without_a_model_config(tmp_path: Path) -> None:
    (tmp_path / 'model.sdf').touch()
    assert file_of_model(str(tmp_path)) == str(tmp_path / 'model.sdf')


def test_other_paths_are_unchanged(tmp_path: Path) -> None:
    for path in ('-', str(tmp_path / 'none'), str(tmp_path / 'model.config'), '/dev/null'):
        assert file_of_model(path) == path


@pytest.mark.parametrize(('config', 'message'), [
    (None, 'is a folder without model.config and model.sdf; name a file'),
    ('<model/>', 'model.config has no <sdf> with a'), ('<model>', 'not well-formed XML')])
def test_errors_of_folders_without_a_model(
        tmp_path: Path, config: str | None, message: str) -> None:
    if config is not None:
        (tmp_path / 'model.config').write_text(config)
    with pytest.raises(DescriptionError) as error:
        file_of_model(str(tmp_path))
    assert str(error.value).startswith(str(tmp_path)) and message in str(error.value)


def test_limit_of_included_elements(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(includes, 'MAX_ELEMENTS', 1000)
    put(tmp_path / 'arm' / 'model.sdf', f'<model name="m"><link name="l"/>{"<a/>" * 97}</model>')
    content = ('<model name="m"><link name="a"/>' + ''.join(
        f'<include><uri>model://arm</uri><name>{n}</name></include>' for n in range(10)))
    assert len(read(tmp_path, f'{content}</model>').links) == 11
    with pytest.raises(DescriptionError, match='more than 1000 elements; include fewer models'):
        read(tmp_path, f'{content}<include><uri>model://arm</uri></include></model>')


def test_overrides_of_an_include(tmp_path: Path) -> None:
    put(tmp_path / 'arm' / 'model.sdf')
    robot = read(tmp_path, robot_with(
        '<uri>model://arm</uri><name>left</name><pose relative_to="a">5 0 0 0 0 0</pose>'
        '<placement_frame>tip</placement_frame>'))
    assert robot.links[2].name == 'left::tip'
    kinematics = Kinematics(robot)
    assert kinematics.pose(FrameId('link', 'left::tip')).translation == (5, 0, 0)
    assert kinematics.pose(FrameId('link', 'left::base')).translation == (5, 0, -2)


def test_pose_of_a_model_included_without_pose(tmp_path: Path) -> None:
    put(tmp_path / 'arm' / 'model.sdf')
    robot = read(tmp_path, robot_with('<uri>model://arm</uri>'))
    assert Kinematics(robot).pose(FrameId('link', 'arm::tip')).translation == (0, 0, 3)


def test_included_robot_of_a_world(tmp_path: Path) -> None:
    put(tmp_path / 'arm' / 'model.sdf', f'<model name="arm"><static>0</static>{ARM}</model>')
    put(tmp_path / 'sun' / 'model.sdf', '<light name="sun"/>')
    report = Report()
    robot = read(tmp_path, '<world name="w"><include><uri>model://sun</uri></include><include>'
                 '<uri>model://arm</uri><name>x</name><pose>1 0 0 0 0 0</pose><static>true'
                 '</static><plugin name="p"/></include></world>', report)
    assert robot.name == 'x' and [link.name for link in robot.links] == ['base', 'tip']
    assert robot.extension.sdf is not None and not robot.extension.sdf.attrib
    assert robot.extension.sdf.findtext('pose') == '1 0 0 0 0 0'
    assert [static.text for static in robot.extension.sdf.findall('static')] == ['true']
    assert robot.extension.sdf.find('plugin') is not None
    assert [note.element for note in report.warnings] == ['include']


def test_selection_by_the_name_of_an_include(tmp_path: Path) -> None:
    put(tmp_path / 'arm' / 'model.sdf')
    world = ('<world name="w"><include><uri>model://arm</uri></include><include><uri>model://arm'
             '</uri><name>b</name></include><include><uri>model://gone</uri></include></world>')
    assert read(tmp_path, world, model='b').name == 'b'
    assert read(tmp_path, world, model='arm').name == 'arm'
    with pytest.raises(DescriptionError, match='3 models; select one with --model: arm, b, gone'):
        read(tmp_path, world)


def test_three_nested_includes(tmp_path: Path) -> None:
    put(tmp_path / 'c' / 'model.sdf', '<model name="c"><link name="l"/></model>', '1.5')
    put(tmp_path / 'b' / 'model.sdf', '<model name="b"><pose>0 0 1 0 0 0</pose>'
        '<include><uri>model://c</uri><pose>0 1 0 0 0 0</pose></include></model>', '1.8')
    put(tmp_path / 'b2' / 'model.sdf', '<include><uri>model://b</uri><name>d</name></include>')
    robot = read(tmp_path, robot_with('<uri>model://b2</uri>'))
    assert robot.links[1].name == 'd::c::l'
    assert Kinematics(robot).pose(FrameId('link', 'd::c::l')).translation == (0, 1, 1)


def test_merged_model(tmp_path: Path) -> None:
    put(tmp_path / 'arm' / 'model.sdf', f'<model name="arm">{ARM}<joint name="k" type="fixed">'
        '<parent>__model__</parent><child>tip</child></joint></model>')
    report = Report()
    robot = read(tmp_path, robot_with('<uri>model://arm</uri><pose>3 0 0 0 0 0</pose>',
                                      'merge="true"'), report)
    assert [link.name for link in robot.links] == ['a', 'base', 'tip']
    assert [frame.name for frame in robot.frames] == ['_merged__arm__model__']
    assert robot.joints[1].parent == 'base'
    assert Kinematics(robot).pose(FrameId('link', 'tip')).translation == (3, 0, 2)
    assert not report.warnings


def test_canonical_link_of_a_merged_model(tmp_path: Path) -> None:
    put(tmp_path / 'arm' / 'model.sdf')
    robot = read(tmp_path, '<model name="m"><include merge="1"><uri>model://arm</uri></include>'
                 '<link name="a"/></model>')
    assert robot.canonical_link == 'base'


def test_error_of_duplicate_names_in_a_merge(tmp_path: Path) -> None:
    put(tmp_path / 'arm' / 'model.sdf', '<model name="arm"><link name="a"/></model>')
    with pytest.raises(DescriptionError, match="'a' is already the name of <link>"):
        read(tmp_path, robot_with('<uri>model://arm</uri>', 'merge="true"'))


def test_mesh_path_relative_to_the_first_file(tmp_path: Path) -> None:
    put(tmp_path / 'arm' / 'model.sdf')
    robot = read(tmp_path, robot_with('<uri>model://arm</uri>'))
    assert robot.links[2].visuals[0].geometry == Mesh('../arm/meshes/a.stl')


def test_mesh_path_of_a_nested_include(tmp_path: Path) -> None:
    put(tmp_path / 'arm' / 'model.sdf')
    put(tmp_path / 'robots' / 'far' / 'model.sdf',
        '<model name="c"><include><uri>../../arm</uri></include></model>')
    robot = read(tmp_path, robot_with('<uri>far</uri>'))
    assert robot.links[2].visuals[0].geometry == Mesh('../arm/meshes/a.stl')


def test_omitted_parts_of_an_include(tmp_path: Path) -> None:
    put(tmp_path / 'arm' / 'model.sdf', f'<model name="arm">{ARM}<plugin name="p"/></model>')
    report = Report()
    read(tmp_path, robot_with('<uri>model://arm</uri><static>true</static>'), report)
    assert [note.element for note in report.warnings] == ['plugin', 'static']


def test_version_of_an_included_file(tmp_path: Path) -> None:
    put(tmp_path / 'arm' / 'model.sdf', '<model name="arm"><link name="a"/><link name="b">'
        '<pose frame="a">0 0 0 0 0 1.5707963267948966</pose></link><joint name="j" '
        'type="prismatic"><parent>a</parent><child>b</child><axis><xyz>1 0 0</xyz></axis></joint>'
        '</model>', '1.4')
    robot = read(tmp_path, robot_with('<uri>model://arm</uri>'))
    assert robot.joints[0].axes[0].xyz == pytest.approx((0, -1, 0))


def test_file_names_in_notes(tmp_path: Path) -> None:
    arm = put(tmp_path / 'arm' / 'model.sdf', """
        <model name="arm">

        <link name="l"><p:q/><!-- -- --><sensor name="s" type="imu"/></link>
        <joint name="j" type="fixed"><parent>l</parent><child>k</child></joint><link name="k"/>
        <plugin name="p"/><urdf:x xmlns:urdf="urn:opencv_tools:urdf"/></model>""")
    outer = tmp_path / 'robots' / 'robot.sdf'
    put(outer, robot_with('<uri>model://arm</uri><static>1</static>').replace(
        '</model>', '<joint name="h" type="fixed"><parent>a</parent><child>arm::l</child></joint>'
        '</model>') + '<light name="sun" type="point"/>')
    report = Report()
    robot, _ = read_robot(str(outer), report)
    convert_to_urdf(robot, report)
    notes = {(note.source, note.line, note.element) for note in report.notes}
    assert {(str(arm), 4, 'sdf'), (str(arm), 4, 'link'), (str(arm), 4, 'sensor'),
            (str(arm), 5, 'joint'), (str(arm), 6, 'plugin'), (str(arm), 6, 'x'),
            (str(outer), 1, 'static'), (str(outer), 1, 'light')} <= notes
    assert {source for source, _, _ in notes} == {str(arm), str(outer)}
    assert all(line <= 1 for source, line, _ in notes if source == str(outer))
    assert all(type(note.line) is int for note in report.notes)


def test_file_names_in_errors(tmp_path: Path) -> None:
    arm = put(tmp_path / 'arm' / 'model.sdf', '<model name="arm"><link name="l"/><link name="k"/>'
              '\n<joint name="j" type="revolute"><parent>l</parent><child>k</child><axis><xyz>'
              '0 0 1</xyz><limit><lower>0</lower><upper>1</upper></limit><mimic joint="j"/></axis>'
              '</joint></model>', '1.11')
    with pytest.raises(DescriptionError, match=f'^{re.escape(str(arm))}:2: <joint>: mimic cycle'):
        read(tmp_path, robot_with('<uri>model://arm</uri>'))


FUEL = 'https://fuel.gazebosim.org/1.0/OpenRobotics/models/'


@pytest.mark.parametrize(('uri', 'name'), [
    (f'{FUEL}Oak%20Tree', 'v10'), (f'{FUEL}Oak%20Tree/tip', 'v10'), (f'{FUEL}oak tree/9/', 'v9'),
    (f'{FUEL}Oak tree', 'v10')])
def test_model_that_gazebo_has_downloaded(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, uri: str, name: str) -> None:
    monkeypatch.setenv('GZ_FUEL_CACHE_PATH', str(tmp_path / 'cache'))
    tree = tmp_path / 'cache' / 'fuel.gazebosim.org' / 'openrobotics' / 'models' / 'oak tree'
    for version in ('9', '10', '7.bak'):
        put(tree / version / 'model.sdf', f'<model name="v{version}"><link name="l"/></model>')
    robot = read(tmp_path, robot_with(f'<uri>{uri}</uri>'))
    assert f'{name}::l' in {link.name for link in robot.links}


@pytest.mark.parametrize('uri', [
    f'{FUEL}oak tree/8', f'{FUEL}gone', f'{FUEL}..%2f..%2fopenrobotics', f'{FUEL}%2e%2e',
    'https://other.example/1.0/OpenRobotics/models/oak tree'])
def test_model_that_gazebo_has_not_downloaded(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, uri: str) -> None:
    monkeypatch.setenv('GZ_FUEL_CACHE_PATH', str(tmp_path / 'cache'))
    tree = tmp_path / 'cache' / 'fuel.gazebosim.org' / 'openrobotics'
    for folder in (tree / 'models' / 'oak tree' / '9', tree / '1'):
        put(folder / 'model.sdf', '<model name="m"><link name="l"/></model>')
    with pytest.raises(DescriptionError, match='is not on this computer; download the model'):
        read(tmp_path, robot_with(f'<uri>{uri}</uri>'))


@pytest.mark.parametrize(('uri', 'message'), [
    (f'model://{"a" * 300}', 'is not found'),
    ('https://fuel.gazebosim.org/1.0/x/models/y', 'download the model and add its folder'),
    ('http://x/y', 'download the model'),
    ('ftp://x/y', "'ftp://x/y' is not supported"),
    ('', "<uri> '' does not name a file"),
    ('model://', 'does not name a file'),
    ('model://gone', "'model://gone' is not found, searched {folder}/robots/gone, "
                     '{folder}/gone, {folder}/models/gone; add the folder that contains the model '
                     'with --path'),
    ('urdf', '{folder}/robots/urdf/model.sdf is a URDF; convert it'),
    ('other', 'is not SDF: its root is <x>'),
    ('light', 'has no model'),
    ('two', 'has 2 models; include a file with one'),
    ('circle', 'include cycle: {folder}/robots/circle/model.sdf -> {folder}/robots/circle2'),
    ('config', 'has no <sdf> with a file name'),
    ('lost', 'is not found'),
    ('bomb', f'more than {MAX_INCLUDES} includes')])
def test_errors_of_includes(tmp_path: Path, uri: str, message: str) -> None:
    robots = tmp_path / 'robots'
    put(robots / 'light' / 'model.sdf', '<light name="l"/>')
    put(robots / 'two' / 'model.sdf', '<model name="a"/><model name="b"/>')
    put(robots / 'circle' / 'model.sdf', robot_with('<uri>model://circle2</uri>'))
    put(robots / 'circle2' / 'model.sdf', robot_with('<uri>model://circle</uri>'))
    configure(robots / 'config')
    configure(robots / 'lost', ('1.9', 'gone.sdf'))
    for name, text in (('urdf', '<robot name="r"/>'), ('other', '<x/>')):
        put(robots / name / 'model.sdf').write_text(text)
    put(robots / 'bomb20' / 'model.sdf')
    for depth in range(20):
        includes = ''.join(
            f'<include><name>{name}</name><uri>model://bomb{depth + 1}</uri></include>'
            for name in 'ab')
        put(robots / f'bomb{depth or ""}' / 'model.sdf', f'<model name="m">{includes}</model>')
    with pytest.raises(DescriptionError) as error:
        read(tmp_path, robot_with(f'<uri>{uri}</uri>'), search=(str(tmp_path / 'models'),))
    assert message.format(folder=tmp_path) in str(error.value)
    assert '\n' not in str(error.value) and '<include>: ' in str(error.value)


def test_placement_frame_without_pose(tmp_path: Path) -> None:
    put(tmp_path / 'arm' / 'model.sdf')
    with pytest.raises(DescriptionError, match='but no <pose>'):
        read(tmp_path, robot_with('<uri>model://arm</uri><placement_frame>tip</placement_frame>'))


def test_file_that_includes_itself(tmp_path: Path) -> None:
    text = robot_with('<uri>robot.sdf</uri>')
    put(tmp_path / 'robots' / 'robot.sdf', text)
    with pytest.raises(DescriptionError, match=r'include cycle: (.*/robot[.]sdf) -> \1$'):
        read(tmp_path, text)
