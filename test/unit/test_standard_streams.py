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

"""Closed standard input, output and error: no other file gets their descriptors."""

from __future__ import annotations

from collections.abc import Callable
import itertools
import os
from pathlib import Path
import subprocess
import sys

from conftest import DEADLINE, executable, NodeProcess, read_manifest
import pytest

Start = Callable[..., NodeProcess]

CLOSED = ('<&-', '>&-', '2>&-')
URDF = '<robot name="a"><link name="b"/></robot>'


def closing(*closed: str) -> tuple[str, ...]:
    """Return a command that runs another one with closed streams."""
    return 'bash', '-c', f'exec "$@" {" ".join(closed)}', 'bash'


def numbers(*closed: str) -> list[int]:
    return [CLOSED.index(stream) for stream in closed]


@pytest.mark.process
@pytest.mark.parametrize('closed', [
    chosen for count in range(1, 4) for chosen in itertools.combinations(CLOSED, count)])
def test_a_stream_that_is_closed_is_that_of_dev_null(
        closed: tuple[str, ...], tmp_path: Path) -> None:
    script = ('import os, sys\n'
              'links = [f"/proc/self/fd/{number}" for number in range(3)]\n'
              'before = {link for link in links if os.path.exists(link)}\n'
              'from opencv_tools.standard_streams import open_standard_streams\n'
              'open_standard_streams()\n'
              'for link in links:\n'
              '    told = os.readlink(link)\n'
              '    assert (told == "/dev/null") is (link not in before), (link, told)\n'
              'file = open(sys.argv[1], "w")\n'
              'assert file.fileno() > 2\n'
              'print("lost"); print("lost", file=sys.stderr); assert sys.stdin.read() == ""\n'
              'assert not sys.stderr.isatty()\n'
              'file.write("done"); file.close()\n')
    path = tmp_path / 'file'
    subprocess.run([*closing(*closed), sys.executable, '-c', script, str(path)], input='',
                   capture_output=True, text=True, timeout=60, check=True)
    assert path.read_text() == 'done'


@pytest.mark.parametrize('closed', [('2>&-',), CLOSED])
def test_the_nodes_work_without_standard_streams(
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


@pytest.mark.process
@pytest.mark.parametrize('closed', [('>&-',), ('2>&-',), CLOSED])
def test_the_robot_commands_work_without_standard_streams(
        closed: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / 'a.urdf').write_text(URDF)
    for name, *words in (('urdf_to_sdf', 'a.urdf', '-o', 'a.sdf'), ('robot_frames', 'a.urdf'),
                         ('robot_compare', 'a.urdf', 'a.sdf'), ('sdf_to_urdf', 'a.sdf')):
        finished = subprocess.run(
            [*closing(*closed), executable(name), *words], cwd=tmp_path, input='',
            capture_output=True, text=True, timeout=60, check=False)
        assert finished.returncode == 0, (name, finished.stderr)
    assert (tmp_path / 'a.sdf').read_text().startswith('<?xml')


@pytest.mark.process
@pytest.mark.parametrize('stream', ['stdout', 'stderr'])
def test_text_that_a_lost_terminal_never_took_does_not_change_the_status(
        stream: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv('PYTHONUNBUFFERED', raising=False)
    code = ('import sys\n'
            'from opencv_tools.standard_streams import discard_broken_streams\n'
            'sys.stdin.readline()\n'
            f'sys.{stream}.write("no line")\n'
            'discard_broken_streams()\n')
    read, write = os.pipe()
    with subprocess.Popen([sys.executable, '-c', code], stdin=subprocess.PIPE, stdout=write,
                          stderr=write) as process:
        os.close(write)
        os.close(read)
        process.communicate(b'\n', timeout=DEADLINE)
    assert process.returncode == 0
