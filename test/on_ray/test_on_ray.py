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

"""Conversion of bags on a Ray cluster with three nodes, whose processes are killed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import hashlib
import json
import os
from pathlib import Path
import re
import shutil
import signal
import socket
import subprocess
import sys
import uuid

from dataset_bags import Drive
from opencv_tools.datasets.cli import main
import pytest
from ray._private.node import Node
from ray.cluster_utils import Cluster
from waiting import communicate, wait_until

MAIN = 'import sys; from opencv_tools.commands import img_convert; sys.exit(img_convert())'
OPTIONS = ('--format', 'lerobot', '--fps', '30', '--image', 'front=/cam0/image_raw/compressed',
           '--state', '/joint_states.position', '--action', 'next', '--task', 'pick')
NODE = {'num_cpus': 1, 'object_store_memory': 80_000_000, 'memory': 2_000_000_000}
MARK = 'OPENCV_TOOLS_RAY_COMMAND'  # variable of all processes that a command starts
BAGS = 12


@pytest.fixture(scope='module')
def cluster() -> Iterator[Cluster]:
    """Start a cluster with three nodes of one processor each, whose processes are of this host."""
    nodes = Cluster()
    add_nodes(nodes, 3, include_dashboard=False)
    yield nodes
    nodes.shutdown()


def add_nodes(cluster: Cluster, count: int, **options: object) -> list[Node]:
    """Start nodes with one processor each; the first one of a cluster is its head."""
    handler = signal.getsignal(signal.SIGTERM)
    nodes = [cluster.add_node(wait=False, **NODE, **options) for _ in range(count)]
    cluster.wait_for_nodes()
    signal.signal(signal.SIGTERM, handler)  # Ray has set its own
    return nodes


@pytest.fixture(scope='module')
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write bags of different lengths."""
    folder = tmp_path_factory.mktemp('bags')
    for number in range(3):
        Drive(seconds=1.5 + number / 2, first=number).write(folder / f'bag_{number}.mcap')
    for number in range(3, BAGS):
        shutil.copy(folder / f'bag_{number % 3}.mcap', folder / f'bag_{number}.mcap')
    return folder


@pytest.fixture(scope='module')
def expected(bags: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return the files of the set that is converted without Ray, on one processor."""
    folder = tmp_path_factory.mktemp('expected') / 'set'
    command = Command(bags, folder, '--jobs', '1')
    assert command.wait() == (0, ''), command.output
    return contents(folder)


class Command:
    """A process of img_convert that converts bags to a LeRobot data set."""

    def __init__(self, *words: object) -> None:
        self._mark = str(uuid.uuid4())
        self.output = ''
        self._process = subprocess.Popen(
            [sys.executable, '-c', MAIN, *map(str, words), *OPTIONS], text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
            env={**os.environ, MARK: self._mark})

    def wait(self) -> tuple[int, str]:
        """Wait for the end; return the exit status and the lines with errors."""
        output, errors = communicate(self._process)
        self.output = output + errors
        assert 'Traceback' not in self.output, self.output
        return self._process.returncode, ''.join(
            line for line in errors.splitlines(keepends=True) if 'error' in line.lower()
            or 'interrupted' in line)

    def send(self, number: int) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    def processes(self) -> list[str]:
        """Return the command lines of all processes that the command has started, at any depth."""
        found = []
        for process in Path('/proc').glob('[0-9]*'):
            with suppress(OSError):
                if f'{MARK}={self._mark}'.encode() in (process / 'environ').read_bytes():
                    found.append((process / 'cmdline').read_text().replace('\0', ' '))
        return [text for text in found if text]


def contents(folder: Path) -> dict[str, str]:
    """Return the hashes of all files of a folder."""
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in folder.rglob('*') if path.is_file()}


def parts(target: Path) -> list[str]:
    """Return the parts of a set that are complete."""
    folder = target.with_name(f'.{target.name}.parts')
    return [path.parent.name for path in folder.glob('[!.]*/part.json')]


def converted(command: Command) -> list[str]:
    """Return the bags that the command names as converted, in the order of their names."""
    return sorted(re.findall(r'of \d+, (\S+): \d+ rows', command.output))


def workers_within(target: Path) -> list[int]:
    """Return the processes of Ray that are writing a part of a set."""
    folder = str(target.with_name(f'.{target.name}.parts'))
    found = []
    for process in Path('/proc').glob('[0-9]*'):
        with suppress(OSError):
            if (process / 'cmdline').read_bytes().startswith(b'ray::convert_job') and any(
                    str(file.readlink()).startswith(folder)
                    for file in (process / 'fd').iterdir()):
                found.append(int(process.name))
    return found


def parent(pid: int) -> int:
    """Return the parent of a process; 0 if the process has ended."""
    with suppress(OSError):
        return int(re.findall(r'PPid:\t(\d+)', Path(f'/proc/{pid}/status').read_text())[0])
    return 0


def kill_worker(target: Path) -> str:
    """Kill a process in the middle of a part; return the name of its unfinished folder."""
    folder = target.with_name(f'.{target.name}.parts')

    def find_and_kill() -> str:
        for pid in workers_within(target):
            with suppress(OSError):
                os.kill(pid, signal.SIGSTOP)  # so that it is still there when it is killed
                files = [file.readlink() for file in Path(f'/proc/{pid}/fd').iterdir()]
                work = [file.parent.name for file in files if folder in file.parents]
                os.kill(pid, signal.SIGKILL)
                if work:
                    return work[0]
        return ''

    return wait_until(find_and_kill, 'a process that writes a part')


def check(folder: Path, episodes: int, capsys: pytest.CaptureFixture[str]) -> None:
    """Check a set."""
    status = main(['--check', str(folder)])
    output = ''.join(capsys.readouterr())
    assert status == 0, output
    assert f' is complete: {episodes} episodes' in output


def test_lost_worker_and_lost_node(cluster: Cluster, bags: Path, expected: dict[str, str],
                                   tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / 'set'
    lost, = add_nodes(cluster, 1)
    raylet = lost.all_processes['raylet'][0].process.pid
    command = Command(bags, target, '--ray', cluster.address)
    wait_until(lambda: len(parts(target)) >= 1, 'the first part')
    assert kill_worker(target).startswith('.bag_')
    wait_until(lambda: any(parent(pid) == raylet for pid in workers_within(target)),
               'a part that the node writes')
    cluster.remove_node(lost, allow_graceful=False)
    assert len(parts(target)) < BAGS
    assert command.wait() == (0, ''), command.output

    names = sorted(f'bag_{number}.mcap' for number in range(BAGS))
    assert converted(command) == names
    described = json.loads((target / 'meta/opencv_tools/bags.json').read_text())
    assert sorted(part['bag'] for part in described) == names
    assert contents(target) == expected
    assert [path.name for path in tmp_path.iterdir()] == ['set']
    check(target, BAGS, capsys)


def test_broken_bag(cluster: Cluster, bags: Path, tmp_path: Path,
                    capsys: pytest.CaptureFixture[str]) -> None:
    """One broken bag costs one bag, and the next run converts only that."""
    some, target = tmp_path / 'bags', tmp_path / 'set'
    some.mkdir()
    for number in range(4):
        shutil.copy(bags / f'bag_{number}.mcap', some)
    broken = some / 'bag_2.mcap'
    content = broken.read_bytes()
    broken.write_bytes(b'\x89MCAP0\r\n' + bytes(1000))

    command = Command(some, target, '--ray', cluster.address)
    status, errors = command.wait()
    assert status == 1
    first, second = errors.splitlines()
    assert re.search(r'\d of 4, bag_2.mcap: ', first), first
    assert '1 of 4 bags cannot be converted, so no set is written' in second
    assert not target.exists()
    assert len(parts(target)) == 3

    skipping = Command(some, tmp_path / 'skipped', '--ray', cluster.address, '--skip-failed')
    status, errors = skipping.wait()
    assert status == 1
    assert len(errors.splitlines()) == 1, errors
    check(tmp_path / 'skipped', 3, capsys)
    others = ['bag_0.mcap', 'bag_1.mcap', 'bag_3.mcap']
    assert converted(skipping) == others
    described = json.loads((tmp_path / 'skipped/meta/opencv_tools/bags.json').read_text())
    assert [part['bag'] for part in described] == others

    broken.write_bytes(content)
    again = Command(some, target, '--ray', cluster.address)
    assert again.wait() == (0, ''), again.output
    assert '3 of 4 bags are converted already' in again.output
    assert converted(again) == ['bag_2.mcap']
    check(target, 4, capsys)


def test_interrupted_on_a_cluster(cluster: Cluster, bags: Path, tmp_path: Path) -> None:
    target = tmp_path / 'set'
    command = Command(bags, target, '--ray', cluster.address)
    wait_until(lambda: bool(workers_within(target)), 'a part that is written')
    command.send(signal.SIGINT)
    assert command.wait() == (1, 'img_convert: interrupted\n'), command.output
    assert not target.exists()
    wait_until(lambda: not command.processes() and not workers_within(target),
               'the end of all processes')


def test_too_little_memory(cluster: Cluster, bags: Path, tmp_path: Path) -> None:
    command = Command(bags, tmp_path / 'set', '--ray', cluster.address, '--ray-memory', '2001')
    assert command.wait() == (2, (
        'img_convert: error: no node of the Ray cluster has 2001 MB of memory for a bag, the '
        'largest one has 2000 MB; give less with --ray-memory\n'))


def test_local_cluster(bags: Path, expected: dict[str, str], tmp_path: Path) -> None:
    """A cluster of this machine ends with the command, also if a signal ends it."""
    target = tmp_path / 'set'
    command = Command(bags, target, '--ray', 'local')
    wait_until(lambda: bool(parts(target)), 'the first part')
    command.send(signal.SIGTERM)  # which Ray has a handler of its own for
    assert command.wait() == (1, 'img_convert: interrupted\n'), command.output
    assert not target.exists()
    wait_until(lambda: not command.processes(), 'the end of all processes')

    again = Command(bags, target, '--ray', 'local')
    assert again.wait() == (0, ''), again.output
    assert 'bags are converted already' in again.output
    assert contents(target) == expected
    wait_until(lambda: not again.processes(), 'the end of all processes')


@pytest.mark.parametrize('address', ['127.0.0.1:{port}', 'ray://127.0.0.1:{port}', 'nowhere'])
def test_no_cluster(bags: Path, tmp_path: Path, address: str) -> None:
    with socket.socket() as unused:
        unused.bind(('127.0.0.1', 0))  # and nothing listens
        given = address.format(port=unused.getsockname()[1])
        command = Command(bags, tmp_path / 'set', '--ray', given)
        status, errors = command.wait()
    assert status == 2
    assert re.fullmatch(f"img_convert: error: the Ray cluster '{given}' cannot be used: .*; start "
                        'it with: ray start --head\n', errors), command.output
    assert not (tmp_path / 'set').exists()
