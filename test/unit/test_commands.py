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
from collections.abc import Callable
import os
from pathlib import Path
import re
import subprocess
import sys

import opencv_tools.commands
from opencv_tools.convert.cli import main as convert
from opencv_tools.robot.cli import robot_compare, robot_frames, sdf_to_urdf, urdf_to_sdf
import pytest

SETUP = Path(__file__).parents[2] / 'setup.py'


def test_entry_points_of_the_package() -> None:
    lines = [constant.value for constant in ast.walk(ast.parse(SETUP.read_text()))
             if isinstance(constant, ast.Constant) and ' = ' in f'{constant.value}']
    names = [line.partition(' = ')[0] for line in lines]
    assert len(names) == 9
    assert lines == [f'{name} = opencv_tools.commands:{name}' for name in names]
    assert all(callable(getattr(opencv_tools.commands, name)) for name in names)


@pytest.mark.process
def test_imports_before_signals_are_handled() -> None:
    script = ('import sys; before = {*sys.modules}; import opencv_tools.commands; '
              'print(len({*sys.modules} - before), {"argparse", "numpy"} & {*sys.modules})')
    finished = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                              timeout=60, check=True)
    count, _, slow = finished.stdout.strip().partition(' ')
    assert int(count) < 30 and slow == 'set()'


@pytest.mark.parametrize('main', [
    convert, robot_compare, robot_frames, sdf_to_urdf, urdf_to_sdf])
def test_version(
        main: Callable[[list[str]], int], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(['--version'])
    assert ended.value.code in (None, 0)
    assert re.fullmatch(r'[a-z]+(_[a-z]+)+ ([0-9]+\.[0-9]+\.[0-9]+|from its source)\n',
                        capsys.readouterr().out)


@pytest.mark.process
@pytest.mark.parametrize(('command', 'asked', 'threads'), [
    ('img_convert', '', '1'), ('img_viewer', '', '1'), ('robot_frames', '', '1'),
    ('img_filter', '', 'as numpy chooses'), ('img_publisher', '2', '2')])
def test_threads_of_numpy(command: str, asked: str, threads: str) -> None:
    script = ('import os, sys, opencv_tools.commands as commands\n'
              'sys.argv[1:] = ["--help"]\n'
              'try:\n    getattr(commands, sys.argv[0])()\n'
              'except SystemExit:\n    pass\n'
              'print(os.environ.get("OPENBLAS_NUM_THREADS", "as numpy chooses"))')
    environment = {**os.environ, 'OPENBLAS_NUM_THREADS': asked}
    if not asked:
        del environment['OPENBLAS_NUM_THREADS']
    finished = subprocess.run(
        [sys.executable, '-c', f'import sys; sys.argv[0] = {command!r}\n{script}'],
        env=environment, capture_output=True, text=True, timeout=60, check=True)
    assert finished.stdout.splitlines()[-1] == threads
