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

"""Commands for robots: input, output, messages and exit status."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO, TextIOWrapper
import json
from pathlib import Path
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

from opencv_tools.robot import model
from opencv_tools.robot.cli import (
    robot_compare, robot_frames, robot_view, sdf_to_urdf, urdf_to_sdf)
import pytest
from waiting import LONGEST_SECONDS

ROOT = Path(__file__).parents[3]
MY_ROBOT = ROOT / 'urdf' / 'my_robot.urdf'
XACRO = ROOT / 'urdf' / 'my_robot.urdf.xacro'
MODEL = ROOT / 'sdf' / 'my_robot' / 'model.sdf'
Text = pytest.CaptureFixture[str]

ARM = """<robot name="arm">
  <link name="base"><inertial><mass value="1"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="left::tip"><inertial><mass value="1"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="swing" type="floating"><parent link="base"/><child link="left::tip"/>
    <origin xyz="0 0 0.30000000000000004"/></joint>
  <transmission name="drive"/>
</robot>
"""
FOREST = """<sdf version="1.9"><world name="garden">
  <light name="sun" type="directional"/>
  <model name="oak" canonical_link="trunk"><link name="trunk"/><link name="bench"/></model>
  <model name="elm"><link name="trunk"/></model>
</world></sdf>
"""


@pytest.fixture()
def arm(tmp_path: Path) -> str:
    path = tmp_path / 'arm.urdf'
    path.write_text(ARM)
    return str(path)


@pytest.fixture()
def forest(tmp_path: Path) -> str:
    path = tmp_path / 'forest.sdf'
    path.write_text(FOREST)
    return str(path)


@pytest.mark.process
def test_conversion_in_a_pipe() -> None:
    command = [sys.executable, '-m', 'opencv_tools.robot.cli']
    there = subprocess.run([*command, 'urdf_to_sdf', '-'], input=MY_ROBOT.read_bytes(),
                           capture_output=True, check=True, timeout=LONGEST_SECONDS)
    back = subprocess.run([*command, 'sdf_to_urdf', '-'], input=there.stdout,
                          capture_output=True, check=True, timeout=LONGEST_SECONDS)
    same = subprocess.run([*command, 'robot_compare', str(MY_ROBOT), '-'], input=back.stdout,
                          capture_output=True, check=True, timeout=LONGEST_SECONDS)
    assert same.stdout.startswith(b'the same robot: links 2, joints 1;')
    assert there.stderr.startswith(b'urdf_to_sdf: warning: <stdin>:')


def test_warnings_and_report(arm: str, tmp_path: Path, capsys: Text) -> None:
    report = tmp_path / 'report.json'
    assert urdf_to_sdf([arm, '-o', str(tmp_path / 'arm.sdf'), '--report', str(report)]) == 0
    out, err = capsys.readouterr()
    assert out == ''
    lines = err.splitlines()
    assert len(lines) == 2
    assert any(line.startswith(f"urdf_to_sdf: warning: {arm}:6: <joint> 'swing': ")
               for line in lines)
    notes = json.loads(report.read_text())
    assert notes['input'] == arm
    assert {(note['element'], note['name'], note['line']) for note in notes['lossy']} == {
        ('joint', 'swing', 6), ('link', 'left::tip', 4)}
    assert [note['element'] for note in notes['preserved']] == ['transmission']


@pytest.mark.parametrize(('command', 'first', 'second'), [
    (urdf_to_sdf, '--output', '--report'), (sdf_to_urdf, '--output', '--report')])
def test_two_outputs_in_one_file(
        command: Callable[[list[str]], int], first: str, second: str, tmp_path: Path,
        capsys: Text) -> None:
    output, link = tmp_path / 'out.svg', tmp_path / 'link.svg'
    output.write_text('before')
    link.symlink_to(output)
    robot = str(MODEL if command is sdf_to_urdf else MY_ROBOT)
    for path in (str(output), f'{tmp_path}/./out.svg', str(link)):
        assert command([robot, first, str(output), second, path]) == 2
        assert capsys.readouterr() == ('', (
            f'{command.__name__}: error: {path}: is the file of {first} and of {second}: give '
            'each a file of its own\n'))
        assert output.read_text() == 'before'


def test_two_outputs_in_one_stream(arm: str, capfd: Text) -> None:
    for path in ('/dev/null', '-'):
        assert urdf_to_sdf([arm, '-o', path, '--report', path]) == 0


@pytest.mark.parametrize('report', ['no/report.json', '.', '/dev/full'])
def test_no_output_with_an_unwritable_report(
        report: str, arm: str, tmp_path: Path, capfd: Text) -> None:
    output = tmp_path / 'out.sdf'
    for arguments in (['-o', str(output)], []):
        assert urdf_to_sdf([arm, *arguments, '--report', str(tmp_path / report)]) == 2
        out, err = capfd.readouterr()
        *warnings, error = err.splitlines()
        assert out == ''
        assert f'{tmp_path / report}: cannot be written: ' in error
        assert len(warnings) == 2
        assert all(line.startswith('urdf_to_sdf: warning: ') for line in warnings)
        assert [path.name for path in tmp_path.iterdir()] == ['arm.urdf']


@pytest.mark.parametrize('output', ['no/out.sdf', '.', '/dev/full'])
def test_no_report_with_an_unwritable_output(
        output: str, arm: str, tmp_path: Path, capfd: Text) -> None:
    report = tmp_path / 'report.json'
    assert urdf_to_sdf([arm, '-o', str(tmp_path / output), '--report', str(report)]) == 2
    assert f'{tmp_path / output}: cannot be written: ' in capfd.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ['arm.urdf']


def test_report_of_gazebo_elements(tmp_path: Path) -> None:
    path = tmp_path / 'robot.urdf'
    path.write_text('<robot name="r"><link name="a"/>\n<gazebo reference="a"><sensor name="s" '
                    'type="imu"/>\n<mu1>1</mu1></gazebo>\n<gazebo><plugin name="p" filename="f"/>'
                    '</gazebo></robot>')
    there, report = str(tmp_path / 'there.sdf'), tmp_path / 'report.json'

    def carried() -> list[tuple[str, str, int, str]]:
        return [(note['element'], note['name'], note['line'], note['message'])
                for note in json.loads(report.read_text())['preserved']]

    assert urdf_to_sdf([str(path), '-o', there, '--report', str(report)]) == 0
    *moved, kept = carried()
    assert moved == [('sensor', 'a', 2, 'moved from <gazebo> into the link'),
                     ('plugin', 'r', 4, 'moved from <gazebo> into the model')]
    assert kept[:3] == ('gazebo', 'r', 0)
    lines = Path(there).read_text().splitlines()
    assert sdf_to_urdf([there, '-o', str(path), '--report', str(report)]) == 0
    word = 'not supported by URDF; preserved in <gazebo>'
    assert [(*note[:2], note[3]) for note in carried()] == [
        ('plugin', 'r', word), ('sensor', 'a', word)]
    assert ['<plugin' in lines[carried()[0][2] - 1], '<sensor' in lines[carried()[1][2] - 1]
            ] == [True, True]


def test_model_folder_as_input(tmp_path: Path, capsys: Text) -> None:
    folder, config = str(MODEL.parent), str(MODEL.parent / 'model.config')
    assert robot_compare([folder, config]) == robot_compare([folder, str(MODEL)]) == 0
    assert robot_frames([folder]) == 0
    for path in (folder, f'{folder}/', config):
        report = tmp_path / 'report.json'
        assert sdf_to_urdf([path, '-o', str(tmp_path / 'out.urdf'), '--report', str(report)]) == 0
        assert json.loads(report.read_text())['input'] == str(MODEL)
    capsys.readouterr()
    assert urdf_to_sdf([folder]) == 2
    assert capsys.readouterr().err == f'urdf_to_sdf: error: {MODEL}: is already SDF\n'


def test_list_and_number_of_differences(tmp_path: Path, capsys: Text) -> None:
    one, other = tmp_path / 'one.urdf', tmp_path / 'other.urdf'
    for path, count in ((one, 1), (other, 61)):
        path.write_text('<robot name="r"><link name="a"/>' + ''.join(
            f'<link name="l{n}"/><joint name="j{n}" type="fixed"><parent link="a"/>'
            f'<child link="l{n}"/></joint>' for n in range(count)) + '</robot>')
    assert robot_compare([str(one), str(other)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + 50 + 2
    assert lines[-2:] == ['... and 70 more; --all shows them', '120 differences']
    assert robot_compare([str(one), str(other), '--all']) == 1
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + 120 + 1
    assert lines[-1] == '120 differences'


def test_exit_status_with_strict(arm: str, tmp_path: Path) -> None:
    output = tmp_path / 'out.sdf'
    assert urdf_to_sdf([arm, '-o', str(output), '--strict']) == 1
    assert output.exists()
    assert urdf_to_sdf([str(MY_ROBOT), '-o', str(output), '--strict']) == 1
    assert urdf_to_sdf([str(MY_ROBOT), '-o', str(output), '--strict', '--inertial', 'zero']) == 0


@pytest.mark.parametrize(('choice', 'mass'), [('keep', None), ('zero', '0'), ('default', '1')])
def test_inertial_option(
        choice: str, mass: str | None, tmp_path: Path, capsys: Text) -> None:
    output = tmp_path / 'out.sdf'
    assert urdf_to_sdf([str(MY_ROBOT), '-o', str(output), '--inertial', choice]) == 0
    links = ElementTree.parse(output).findall('model/link')
    assert [link.findtext('inertial/mass') for link in links] == [mass, mass]
    warning = "<link> 'base_footprint': has no <inertial>, like 'base_link': massless in URDF"
    assert (warning in capsys.readouterr().err) == (choice == 'keep')


@pytest.mark.parametrize(('choice', 'uri'), [
    ('model', 'model://opencv_tools/'), ('package', 'package://opencv_tools/'),
    ('keep', 'package://opencv_tools/')])
def test_mesh_uri_option(choice: str, uri: str, capsys: Text) -> None:
    assert urdf_to_sdf([str(MY_ROBOT), '--mesh-uri', choice]) == 0
    assert f'<uri>{uri}meshes/my_robot/robot_base.stl</uri>' in capsys.readouterr().out


def test_name_round_trip(arm: str, tmp_path: Path, capsys: Text) -> None:
    there, back = str(tmp_path / 'arm.sdf'), str(tmp_path / 'back.urdf')
    assert urdf_to_sdf([arm, '-o', there]) == 0
    assert '"left__tip"' in Path(there).read_text()
    assert sdf_to_urdf([there, '-o', back]) == 0
    assert '<link name="left::tip">' in Path(back).read_text()
    assert '<transmission name="drive"/>' in Path(back).read_text()
    assert robot_compare([arm, there]) == robot_compare([arm, back]) == 0
    assert robot_compare([arm, str(MY_ROBOT)]) == 1
    assert 'base_footprint' in capsys.readouterr().out


def test_model_and_root_options(forest: str, capsys: Text) -> None:
    assert sdf_to_urdf([forest]) == 2
    assert '--model' in capsys.readouterr().err
    assert sdf_to_urdf([forest, '--model', 'oak']) == 2
    err = capsys.readouterr().err
    assert '--root' in err and "'trunk', 'bench'" in err
    assert sdf_to_urdf([forest, '--model', 'oak', '--root', 'bench']) == 0
    out, err = capsys.readouterr()
    assert '<link name="bench"/>' in out and 'trunk' not in out
    assert "'trunk'" in err and 'sun' in err
    assert 'canonical_link' not in out  # it is left out
    assert sdf_to_urdf([forest, '--model', 'elm', '--root', 'acorn']) == 2
    assert "'acorn'" in capsys.readouterr().err


def test_atomic_output(arm: str, tmp_path: Path, capsys: Text) -> None:
    output = tmp_path / 'out.sdf'
    output.write_text('precious')
    assert urdf_to_sdf([str(MODEL), '-o', str(output)]) == 2
    assert 'is already SDF' in capsys.readouterr().err
    assert output.read_text() == 'precious'
    assert urdf_to_sdf([arm, '-o', str(tmp_path / 'no' / 'such.sdf')]) == 2
    assert 'cannot be written: No such file' in capsys.readouterr().err
    link = tmp_path / 'link.sdf'
    link.symlink_to(output)
    assert urdf_to_sdf([arm, '-o', str(link)]) == 0
    assert link.is_symlink() and output.read_text().startswith('<?xml')
    assert sorted(path.name for path in tmp_path.iterdir()) == ['arm.urdf', 'link.sdf', 'out.sdf']


def test_output_to_a_loop_of_links(arm: str, tmp_path: Path, capsys: Text) -> None:
    loop = tmp_path / 'loop'
    loop.symlink_to(loop)
    for path in (loop, loop / 'out.sdf'):
        assert urdf_to_sdf([arm, '-o', str(path)]) == 2
        assert f'{path}: cannot be written: Too many levels of sym' in capsys.readouterr().err
    assert loop.is_symlink()


@pytest.mark.parametrize(('command', 'option'), [
    (urdf_to_sdf, '--output'), (urdf_to_sdf, '--report'), (sdf_to_urdf, '--output'),
    (robot_frames, '--conventions'), (robot_view, '--html')])
@pytest.mark.parametrize('kind', ['same', 'relative', 'link', 'hard link', 'folder'])
def test_output_that_is_an_input(
        command: Callable[[list[str]], int], option: str, kind: str, tmp_path: Path,
        capsys: Text, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, link = tmp_path / 'model.sdf', tmp_path / 'link.svg'
    robot.write_bytes(MODEL.read_bytes())
    output = {'link': link, 'hard link': link, 'relative': Path('model.sdf')}.get(kind, robot)
    monkeypatch.chdir(tmp_path)
    if kind == 'link':
        output.symlink_to(robot)
    elif kind == 'hard link':
        output.hardlink_to(robot)
    assert command([str(tmp_path if kind == 'folder' else robot), option, str(output)]) == 2
    assert capsys.readouterr() == ('', (
        f'{command.__name__}: error: {output}: is read by the command, but {option} would '
        'replace it: give another file\n'))
    assert robot.read_bytes() == MODEL.read_bytes()


@pytest.mark.process
def test_output_that_is_the_file_of_standard_input(arm: str) -> None:
    with Path(arm).open('rb') as file:
        finished = subprocess.run(
            [sys.executable, '-m', 'opencv_tools.robot.cli', 'urdf_to_sdf', '-', '-o', arm],
            stdin=file, capture_output=True, text=True, check=False, timeout=LONGEST_SECONDS)
    assert (finished.returncode, finished.stdout) == (2, '')
    assert 'is read by the command, but --output would replace it' in finished.stderr
    assert Path(arm).read_text() == ARM


def test_output_that_is_the_second_input(arm: str, tmp_path: Path) -> None:
    other = tmp_path / 'other.urdf'
    other.write_bytes(Path(arm).read_bytes())
    assert robot_view([arm, str(other), '--html', str(other)]) == 2
    assert other.read_bytes() == Path(arm).read_bytes()


@pytest.mark.parametrize('version', ['1.7', '1.8', '1.9', '1.10', '1.12'])
def test_every_sdf_version(version: str, tmp_path: Path) -> None:
    output = str(tmp_path / 'out.sdf')
    assert urdf_to_sdf([str(MY_ROBOT), '-o', output, '--sdf-version', version]) == 0
    assert f'version="{version}"' in Path(output).read_text()
    assert robot_compare([str(MY_ROBOT), output]) == 0


@pytest.mark.parametrize('arguments', [
    ['--sdf-version', '1.13'], ['--sdf-version', 'new'], ['--sdf-version', '1.6']])
def test_unsupported_sdf_versions(arguments: list[str], capsys: Text) -> None:
    assert urdf_to_sdf([str(MY_ROBOT), *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == '' and len(err.splitlines()) == 1


@pytest.mark.parametrize('arguments', [
    ['--poses', 'global'], ['--arg', 'x'], ['--arg', ':=1'], ['--arg', '=1'], ['--no-such-option'],
    []])
def test_usage_errors(arguments: list[str], capsys: Text) -> None:
    with pytest.raises(SystemExit) as exit_:
        urdf_to_sdf([str(MY_ROBOT), *arguments] if arguments else [])
    assert exit_.value.code == 2
    assert 'usage: urdf_to_sdf' in capsys.readouterr().err


def test_xacro_arguments(tmp_path: Path, capsys: Text) -> None:
    path = tmp_path / 'arm.urdf.xacro'
    path.write_text('<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'
                    '<xacro:arg name="size" default="1"/><xacro:arg name="name" default="base"/>'
                    '<link name="$(arg name)"><collision><geometry>'
                    '<sphere radius="${2 * $(arg size)}"/></geometry></collision></link></robot>')
    for arguments, written in [
            (['size:=0.25', 'name=a:=b'], ['<radius>0.5</radius>', '<link name="a:=b">']),
            (['size=0.25', 'name:=a=b', 'sise:=0.25'],
             ['<radius>0.5</radius>', '<link name="a=b">'])]:
        given = [word for argument in arguments for word in ('--arg', argument)]
        assert urdf_to_sdf([str(path), *given]) == 0
        output, errors = capsys.readouterr()
        assert all(text in output for text in written)
    assert (f"urdf_to_sdf: warning: {path}: <xacro:arg> 'sise': is not an argument of this file, "
            "which has 'name', 'size'; it is ignored\n") in errors
    assert urdf_to_sdf([str(XACRO), '--arg', 'size=1']) == 0
    assert 'which has none; it is ignored' in capsys.readouterr().err
    assert urdf_to_sdf([str(MY_ROBOT), '--arg', 'size:=1']) == 0
    assert "'size'" in capsys.readouterr().err


def test_frames_as_json(capsys: Text) -> None:
    assert robot_frames([str(MODEL), '--format', 'json']) == 0
    out = capsys.readouterr().out
    assert out.startswith('{\n  "robot": "my_robot",\n')
    listing = json.loads(out)
    assert set(listing) == {'robot', 'root', 'links', 'joints'}
    assert listing['links']['base_link']['pose'] == [0, 0, 0.2, 1, 0, 0, 0]
    assert listing['links']['base_link']['collisions'][0]['pose'][2] == pytest.approx(0.05)


def test_escaped_control_characters(tmp_path: Path, capsys: Text) -> None:
    path = tmp_path / 'red.urdf'
    link = '<link name="a&#x9b;31m"/>'  # what some terminals take for the beginning of a command
    for links, status in ((link, 0), (2 * link, 2)):
        path.write_text(f'<robot name="r">{links}</robot>')
        assert robot_frames([str(path)]) == status
    shown = capsys.readouterr()
    for text in shown:
        assert '\x9b' not in text
        assert r'a\x9b31m' in text


def test_names_with_line_ends(tmp_path: Path, capsys: Text) -> None:
    for number, name in enumerate(('a&#10;link  FAKE      world', 'b')):
        (tmp_path / f'{number}.urdf').write_text(f'<robot name="r"><link name="{name}"/></robot>')
    first, second = (str(tmp_path / f'{number}.urdf') for number in (0, 1))
    assert robot_frames([first]) == 0
    assert robot_compare([first, second]) == 1
    shown = capsys.readouterr().out
    assert not [line for line in shown.splitlines() if line.startswith('link  FAKE')]
    assert shown.count(r'a\nlink  FAKE') == 3  # a link, its frame, a difference


def test_frames_at_a_position(tmp_path: Path, capsys: Text) -> None:
    path = tmp_path / 'lift.urdf'
    path.write_text('<robot name="lift"><link name="a"/><link name="b"/><joint name="up" '
                    'type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 0 2"/>'
                    '<limit upper="1" effort="1" velocity="1"/></joint></robot>')
    for position in ('up=0.5', 'up:=0.5'):
        assert robot_frames([str(path), '--joint', position, '--format', 'json']) == 0
        assert json.loads(capsys.readouterr().out)['links']['b']['pose'][:3] == [0, 0, 0.5]
    assert robot_frames([str(path), '--joint', 'down=0.5']) == 2
    assert "'down' does not exist; the movable joints are 'up'\n" in capsys.readouterr().err
    for wrong in ('up=nan', 'up', '=1', ':=1'):
        with pytest.raises(SystemExit):
            robot_frames([str(path), '--joint', wrong])


def test_deprecated_name_of_a_frame() -> None:
    with pytest.warns(DeprecationWarning, match='model.Frame is called RobotFrame'):
        assert model.Frame is model.RobotFrame
    with pytest.raises(AttributeError, match="no attribute 'Frames'"):
        _ = model.Frames


def test_deprecated_plot(tmp_path: Path, capsys: Text) -> None:
    for option in ('--plot', '--conventions'):
        assert robot_frames([str(MODEL), option, str(tmp_path / f'{option}.svg')]) == 0
        said = capsys.readouterr().err
        assert ('--plot is deprecated and draws the same as --conventions' in said) == (
            option == '--plot')
    one, other = (path.read_bytes() for path in sorted(tmp_path.iterdir()))
    assert one == other


def test_picture_beside_the_list(tmp_path: Path, capsys: Text) -> None:
    picture = tmp_path / 'frames.svg'
    robot = tmp_path / 'robot.urdf'
    robot.write_text('<robot name="r"><link name="base_link"/></robot>')
    assert robot_frames([str(robot), '--conventions', str(picture)]) == 0
    assert 'base_link' in capsys.readouterr().out
    assert b'<svg' in picture.read_bytes()


def test_standard_input_of_a_comparison(monkeypatch: pytest.MonkeyPatch, capsys: Text) -> None:
    monkeypatch.setattr(sys, 'stdin', TextIOWrapper(BytesIO(MY_ROBOT.read_bytes())))
    assert robot_compare(['-', '-']) == 2
    assert 'standard input' in capsys.readouterr().err
    assert robot_compare(['-', str(MODEL)]) == 0
