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

"""Entry points of the executables: all of them, without long imports."""

from __future__ import annotations

import ast
import importlib.metadata
import os
from pathlib import Path
import subprocess
import sys

import cv2
from opencv_tools.base.arguments import package_version
from opencv_tools.base.info import main as info_main
from opencv_tools.base.remedies import explain_variables, installation, LIBRARIES
import opencv_tools.commands
import pytest
from waiting import LONGEST_SECONDS

SETUP = Path(__file__).parents[2] / 'setup.py'


LINES = [f'{constant.value}' for constant in ast.walk(ast.parse(SETUP.read_text()))
         if isinstance(constant, ast.Constant) and ' = ' in f'{constant.value}']
NAMES = [line.partition(' = ')[0] for line in LINES]


def test_entry_points_of_the_package() -> None:
    assert len(NAMES) == 12
    assert [f'{name} = opencv_tools.commands:{name}' for name in NAMES] == LINES
    assert all(callable(getattr(opencv_tools.commands, name)) for name in NAMES)


@pytest.mark.parametrize(('folder', 'remedy'), [
    ('/usr/lib/python3/dist-packages', "'sudo apt install python3-av' or 'pip install av'"),
    ('/opt/venv/lib/python3.12/site-packages', "'pip install av'")])
def test_apt_is_a_remedy_where_its_packages_are_seen(
        monkeypatch: pytest.MonkeyPatch, folder: str, remedy: str) -> None:
    monkeypatch.setattr(sys, 'path', ['', folder])
    assert installation('av') == f'install it with {remedy} (see Install in the README)'
    assert installation('mcap') == "install it with 'pip install mcap' (see Install in the README)"


@pytest.mark.process
def test_imports_before_signals_are_handled() -> None:
    script = ('import sys; before = {*sys.modules}; import opencv_tools.commands; '
              'print(len({*sys.modules} - before), {"argparse", "numpy"} & {*sys.modules})')
    finished = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                              timeout=LONGEST_SECONDS, check=True)
    count, _, slow = finished.stdout.strip().partition(' ')
    assert int(count) < 30 and slow == 'set()'


@pytest.mark.quick_cases(2)
@pytest.mark.process
@pytest.mark.parametrize(('command', 'asked', 'threads'), [
    ('img_convert', '', '1'), ('img_viewer', '', '1'), ('robot_frames', '', '1'),
    ('img_filter', '', 'as numpy chooses'), ('img_publisher', '2', '2')])
def test_threads_of_numpy(command: str, asked: str, threads: str) -> None:
    script = ('import os, sys, opencv_tools.commands as commands\n'
              'sys.argv[1:] = ["--nonsense"]\n'
              'try:\n    getattr(commands, sys.argv[0])()\n'
              'except SystemExit:\n    pass\n'
              'print(os.environ.get("OPENBLAS_NUM_THREADS", "as numpy chooses"))')
    environment = {**os.environ, 'OPENBLAS_NUM_THREADS': asked}
    if not asked:
        del environment['OPENBLAS_NUM_THREADS']
    finished = subprocess.run(
        [sys.executable, '-c', f'import sys; sys.argv[0] = {command!r}\n{script}'],
        env=environment, capture_output=True, text=True, timeout=LONGEST_SECONDS, check=True)
    assert finished.stdout.splitlines()[-1] == threads


@pytest.mark.process
def test_version_of_all_commands() -> None:
    script = ('import sys, opencv_tools.commands as commands\n'
              'for name in sys.argv[1:]:\n'
              '    sys.argv = [name, "--version"]\n'
              '    try:\n        getattr(commands, name)()\n'
              '    except SystemExit as end:\n        print(end.code)')
    finished = subprocess.run([sys.executable, '-c', script, *NAMES], capture_output=True,
                              text=True, timeout=LONGEST_SECONDS, check=True)
    version = importlib.metadata.version('opencv_tools')
    assert finished.stdout == ''.join(f'{name} {version}\n0\n' for name in NAMES)


@pytest.mark.process
@pytest.mark.parametrize(('option', 'status'), [('--help', 0), ('--version', 0), ('--wrong', 2)])
def test_options_without_any_library(option: str, status: int) -> None:
    # A node's text comes from a file, so neither ROS nor numpy is imported.
    script = ('import sys, opencv_tools.commands as commands\n'
              f'sys.modules.update(dict.fromkeys({[*LIBRARIES]}))\n'
              'for name in sys.argv[2:]:\n'
              '    sys.argv[:2] = [name, sys.argv[1]]\n'
              '    try:\n        getattr(commands, name)()\n'
              '    except SystemExit as end:\n'
              f'        assert (end.code or 0) == {status}, name\n'
              '    else:\n        raise AssertionError(name)')
    finished = subprocess.run([sys.executable, '-c', script, option, *NAMES], text=True,
                              capture_output=True, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, finished.stderr
    output = finished.stderr if status else finished.stdout
    assert output == finished.stdout + finished.stderr
    is_usage = option != '--version'
    shown = [line.split()[1 if is_usage else 0] for line in output.splitlines()
             if line.startswith('usage: ' if is_usage else tuple(NAMES))]
    assert shown[0] == NAMES[0] and {*NAMES} <= {*shown}


@pytest.mark.process
@pytest.mark.parametrize(('command', 'arguments', 'missing', 'status', 'sentence'), [
    ('img_publisher', [], 'cv2', 1, 'OpenCV is needed, but cannot be imported (import of cv2 h'),
    ('img_viewer', [], 'rclpy', 1, 'ROS 2 is needed, but cannot be imported (No mod'),
    ('img_convert', ['pattern', '{seq}.png'], 'cv2', 2, 'OpenCV is needed'),
    ('img_calibrate', ['--board', 'chessboard:9x6:25mm', '.'], 'cv2', 1, 'OpenCV is needed'),
    ('robot_frames', ['-'], 'lxml', 2, 'lxml is needed')])
def test_missing_library_is_one_sentence(
        command: str, arguments: list[str], missing: str, status: int, sentence: str) -> None:
    script = ('import sys, opencv_tools.commands as commands\n'
              f'sys.modules[{missing!r}] = None\n'
              f'sys.argv = {[command, *arguments]}\n'
              f'sys.exit(commands.{command}())')
    finished = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                              timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == status, finished.stderr
    assert finished.stderr.count('\n') == 1
    assert finished.stderr.startswith(f'{command}: error: {sentence}')
    assert 'install it with ' in finished.stderr or 'source an installed ROS' in finished.stderr


@pytest.mark.parametrize('name', ['opencv_tools.nothing', 'nothing', None])
def test_import_error_of_our_own_is_not_hidden(
        monkeypatch: pytest.MonkeyPatch, name: str | None) -> None:
    def main() -> int:
        raise ImportError('a bug', name=name)

    monkeypatch.setattr('opencv_tools.convert.cli.main', main)
    monkeypatch.setattr('opencv_tools.base.signals.handle_signals', lambda *_: None)
    monkeypatch.setattr('opencv_tools.base.signals.ignore_signals', lambda: None)
    with pytest.raises(ImportError, match='a bug'):
        opencv_tools.commands.img_convert()


def test_libraries_have_one_line_each(
        monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, 'mcap', None)
    monkeypatch.setenv('ROS_DISTRO', 'jazzy')
    assert info_main([]) == 0
    head, *lines = capsys.readouterr().out.splitlines()
    assert head.startswith(f'opencv_tools {package_version()}, Python 3.')
    assert head.endswith('ROS_DISTRO jazzy')
    assert len(lines) == len({*LIBRARIES.values()})
    found = {line[:11].strip(): line[12:] for line in lines}
    assert found['OpenCV'].startswith(f'{cv2.__version__[:4]}')
    assert found['mcap'].startswith('missing    MCAP bags')
    assert "'pip install mcap'" in found['mcap']
    assert found['ROS 2'].endswith('nodes and live topics, with rmw_fastrtps_cpp')


def test_version_without_installation(monkeypatch: pytest.MonkeyPatch) -> None:
    def version(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr('importlib.metadata.version', version)
    assert package_version() == 'unknown'


@pytest.mark.parametrize(('domain', 'is_valid'), [
    ('', True), ('0', True), ('42', True), ('232', True), ('233', False), ('300', False),
    ('abc', False), ('-1', False), ('1.5', False), ('9' * 5000, False)])
def test_domains(domain: str, is_valid: bool) -> None:
    sentence = explain_variables({'ROS_DOMAIN_ID': domain})
    assert sentence == ('' if is_valid else (
        f'ROS_DOMAIN_ID is {domain[:40]!r}: set it to a number from 0 to 232, or unset it'))


def test_middleware_that_is_not_installed(tmp_path: Path) -> None:
    index = tmp_path / 'share' / 'ament_index' / 'resource_index' / 'rmw_typesupport'
    index.mkdir(parents=True)
    for name in ('rmw_implementation', 'rmw_other_cpp'):
        (index / name).touch()
    for wanted in ('', 'rmw_other_cpp'):
        assert explain_variables(
            {'AMENT_PREFIX_PATH': f'/none:{tmp_path}', 'RMW_IMPLEMENTATION': wanted}) == ''
    sentence = explain_variables(
        {'AMENT_PREFIX_PATH': str(tmp_path), 'RMW_IMPLEMENTATION': 'rmw_zenoh_cpp'})
    assert sentence.startswith("RMW_IMPLEMENTATION is 'rmw_zenoh_cpp', but only ")
    assert sentence.endswith("is installed: type 'unset RMW_IMPLEMENTATION'")


@pytest.mark.process
@pytest.mark.parametrize('variable', ['ROS_DOMAIN_ID=300', 'RMW_IMPLEMENTATION=rmw_none_cpp'])
def test_variable_with_which_ros_cannot_start(variable: str) -> None:
    name, _, value = variable.partition('=')
    script = ('import sys; from opencv_tools.commands import img_viewer; '
              'sys.argv = ["img_viewer"]; sys.exit(img_viewer())')
    finished = subprocess.run(
        [sys.executable, '-c', script], capture_output=True, text=True, check=False,
        env={**os.environ, name: value}, timeout=LONGEST_SECONDS)
    assert finished.returncode == 2
    assert finished.stderr.startswith(f'img_viewer: error: {name} is {value!r}')
    assert finished.stderr.count('\n') == 1
