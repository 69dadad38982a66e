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

from opencv_tools.base.arguments import package_version
import opencv_tools.commands
import pytest
from waiting import LONGEST_SECONDS

SETUP = Path(__file__).parents[2] / 'setup.py'


LINES = [f'{constant.value}' for constant in ast.walk(ast.parse(SETUP.read_text()))
         if isinstance(constant, ast.Constant) and ' = ' in f'{constant.value}']
NAMES = [line.partition(' = ')[0] for line in LINES]


def test_entry_points_of_the_package() -> None:
    assert len(NAMES) == 11
    assert [f'{name} = opencv_tools.commands:{name}' for name in NAMES] == LINES
    assert all(callable(getattr(opencv_tools.commands, name)) for name in NAMES)


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
              'sys.argv[1:] = ["--help"]\n'
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


def test_version_without_installation(monkeypatch: pytest.MonkeyPatch) -> None:
    def version(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr('importlib.metadata.version', version)
    assert package_version() == 'unknown'
