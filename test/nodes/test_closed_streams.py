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

"""Executables whose standard input, output or error is closed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import subprocess

from closed_streams import CLOSED, closing
from conftest import executable, NodeProcess, read_manifest
import pytest
from waiting import LONGEST_SECONDS

Start = Callable[..., NodeProcess]
URDF = '<robot name="a"><link name="b"/></robot>'


def numbers(*closed: str) -> list[int]:
    return [CLOSED.index(stream) for stream in closed]


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('closed', [('2>&-',), CLOSED])
def test_nodes_work_without_standard_streams(
        closed: tuple[str, ...], start: Start, tmp_path: Path) -> None:
    recorder = start('img_subscriber', within=closing(*closed), output_dir=tmp_path / 'out',
                     file_name='f{seq}.npy', max_frames=3)
    publisher = start('img_publisher', within=closing(*closed), source='pattern:64x48')
    assert recorder.finish() == 0, recorder.output
    assert len(read_manifest(tmp_path / 'out')) == 3
    for number in numbers(*closed):
        link = Path(f'/proc/{publisher.pid}/fd/{number}')
        assert str(link.readlink()) == '/dev/null'
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output


@pytest.mark.quick_cases(1)
@pytest.mark.process
@pytest.mark.parametrize('closed', [('>&-',), ('2>&-',), CLOSED])
def test_robot_commands_work_without_standard_streams(
        closed: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / 'a.urdf').write_text(URDF)
    for name, *words in (('urdf_to_sdf', 'a.urdf', '-o', 'a.sdf'), ('robot_frames', 'a.urdf'),
                         ('robot_compare', 'a.urdf', 'a.sdf'), ('sdf_to_urdf', 'a.sdf')):
        finished = subprocess.run(
            [*closing(*closed), executable(name), *words], cwd=tmp_path, input='',
            capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
        assert finished.returncode == 0, (name, finished.stderr)
    assert (tmp_path / 'a.sdf').read_text().startswith('<?xml')
