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

"""Processes that are copies of a prepared one behave as fresh ones do."""

from __future__ import annotations

import os
from pathlib import Path
import signal
import subprocess

from child_processes import Child
from conftest import executable, NodeProcess
from prepared import programs
import pytest

pytestmark = pytest.mark.process
COMMAND = ['--ros-args', '-p', 'source:=pattern:64x48', '-p', 'wait_for_subscribers:=1']


def publisher(folder: Path, *words: str, **environment: str) -> NodeProcess:
    """Start a prepared publisher."""
    return NodeProcess([executable('img_publisher'), *(words or COMMAND)], folder / 'node.log',
                       {**os.environ, **environment}, is_prepared=True)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('words', [('--help',), ('0',), ('--ros-args', '-p', 'source:=none.mp4')])
def test_output_and_status_equal_those_of_a_fresh_process(
        tmp_path: Path, words: tuple[str, ...]) -> None:
    prepared = publisher(tmp_path, *words, ROS_DOMAIN_ID=os.environ['ROS_DOMAIN_ID'])
    fresh = subprocess.run([executable('img_publisher'), *words], stdout=subprocess.PIPE,
                           stderr=subprocess.STDOUT, text=True, cwd=tmp_path, check=False)
    assert prepared.finish() == fresh.returncode

    def without_time(output: str) -> list[str]:
        return [line.partition(']: ')[2] or line for line in output.splitlines()]

    assert without_time(prepared.output) == without_time(fresh.stdout)


@pytest.mark.parametrize(('number', 'status'), [
    (signal.SIGINT, 0), (signal.SIGTERM, 0), (signal.SIGKILL, -signal.SIGKILL)])
def test_status_after_a_signal(tmp_path: Path, number: int, status: int) -> None:
    process = publisher(tmp_path)
    process.wait_for('Waiting for 1')
    assert process.is_running()
    assert Path(f'/proc/{process.pid}/comm').read_text() == 'img_publisher\n'
    process.interrupt(number)
    assert process.finish() == status
    assert not process.is_running()
    process.kill()  # does nothing after the end


def test_own_terminal(tmp_path: Path) -> None:
    child = Child('node', [executable('img_publisher'), *COMMAND], tmp_path, on_terminal=True)
    child.wait_for(lambda: 'Waiting for 1' in child.output, 'the first line')
    child.press_ctrl_c()
    assert child.finish() == 0


@pytest.mark.parametrize('variable', [
    'PYTHONPATH', 'LD_LIBRARY_PATH', 'OPENBLAS_NUM_THREADS', 'OPENCV_TOOLS_TRANSPORT'])
def test_variables_of_the_imports(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str) -> None:
    command = [executable('img_publisher'), '--help']
    programs()
    monkeypatch.setenv(variable, str(tmp_path))
    with (tmp_path / 'log').open('w') as log:
        assert programs().start(command, tmp_path, stdin=0, output=log.fileno()) is None
