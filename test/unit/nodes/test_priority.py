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

"""Real-time priority of threads, with and without the permission."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import subprocess
import sys
from threading import get_native_id

from conftest import NodeProcess
from opencv_tools.nodes.executable import Executable
from opencv_tools.nodes.subscriber.parameters import RecorderSettings
from opencv_tools.transport.scheduling import explain_refusal, use_priority
import pytest

Start = Callable[..., NodeProcess]

PRIORITY = 7
REAL_TIME = os.SCHED_RR | os.SCHED_RESET_ON_FORK
REFUSAL = f'priority {PRIORITY} is not permitted (Operation not permitted)'
WITHOUT_PERMISSION = ('prlimit', '--rtprio=0:0', *(
    ('setpriv', '--bounding-set=-sys_nice', '--inh-caps=-sys_nice') if os.getuid() == 0 else ()))
NODES = {
    'img_publisher': ('Publishing video frame', {'source': 'pattern', 'encoding': 'mono8'}),
    'img_subscriber': ('Receiving video frame', {}),
    'img_filter': ('Filtering video frame', {'function': 'cv2:flip', 'arguments': '1'}),
    'own.py': ('frame received', {})}
OWN_NODE = f"""
import sys
from threading import Thread
import time
from opencv_tools.frames import FrameNode, main

def create_node():
    node = FrameNode('own')
    node.receive_frames('video_frames', receive)
    return node

def receive(frame):
    Thread(target=time.sleep, args=(100,), daemon=True).start()
    print('frame received', flush=True)

sys.exit(main(create_node, priority={PRIORITY}))
"""


def start_node(start: Start, tmp_path: Path, name: str, *within: str) -> NodeProcess:
    """Start a node with a priority, and a publisher for it, and wait for its first frame."""
    text, parameters = NODES[name]
    if name != 'img_publisher':
        start('img_publisher', source='pattern:64x48@20', publish_rate=0.0)
    program = tmp_path / 'own.py'
    program.write_text(OWN_NODE)
    process = start(str(program) if name == 'own.py' else name, within=within, **parameters,
                    **({} if name == 'own.py' else {'priority': PRIORITY}))
    process.wait_for(text)
    return process


def real_time_threads(pid: int) -> list[str]:
    """Return the names of the threads with a real-time priority; check their priority."""
    names = []
    for task in Path(f'/proc/{pid}/task').iterdir():
        policy = os.sched_getscheduler(int(task.name))
        name = (task / 'comm').read_text().partition('.')[0]
        if policy == os.SCHED_OTHER:
            continue
        assert os.sched_getparam(int(task.name)).sched_priority == PRIORITY
        assert policy == (os.SCHED_RR if name == 'dds' else REAL_TIME)
        names.append('main' if task.name == str(pid) else name)
    return names


def without_dds(pid: int) -> list[str]:
    """Return the names of the threads with a real-time priority that are not of Fast DDS."""
    return [name for name in real_time_threads(pid) if name != 'dds']


def is_permitted() -> bool:
    """Return whether this user may have a real-time priority."""
    return subprocess.run(
        ['chrt', '--rr', str(PRIORITY), 'true'], capture_output=True, check=False).returncode == 0


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('name', NODES)
def test_threads_that_carry_frames(start: Start, tmp_path: Path, name: str) -> None:
    process = start_node(start, tmp_path, name)
    # Receivers have the executor, and the thread that waits for shared frames.
    count = 0 if not is_permitted() else 1 if name == 'img_publisher' else 2
    process.wait_until(lambda _: count == len(without_dds(process.pid)))
    assert (REFUSAL in process.output) == (not is_permitted())
    if is_permitted():
        assert ('main' in without_dds(process.pid)) == (name != 'img_publisher')
        assert real_time_threads(process.pid).count('dds') == 2  # of the topics, and of discovery
    else:
        assert real_time_threads(process.pid) == []


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('name', NODES)
def test_normal_scheduling_without_permission(start: Start, tmp_path: Path, name: str) -> None:
    process = start_node(start, tmp_path, name, *WITHOUT_PERMISSION)
    assert real_time_threads(process.pid) == []
    process.interrupt()
    assert process.finish() == 0, process.output
    (line,) = (line for line in process.output.splitlines() if REFUSAL in line)
    assert '[WARN]' in line
    assert f"'* - rtprio {PRIORITY}'" in line
    assert 'rror]' not in process.output  # of Fast DDS


def test_normal_scheduling_by_default(start: Start) -> None:
    publisher = start('img_publisher', source='pattern')
    publisher.wait_for('Publishing video frame')
    assert real_time_threads(publisher.pid) == []


def test_calling_thread_is_not_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    threads = []
    monkeypatch.setattr(os, 'sched_setscheduler',
                        lambda *wanted: threads.append((get_native_id(), wanted[1])))
    assert explain_refusal(PRIORITY) == ''
    ((thread, policy),) = threads
    assert policy == REAL_TIME
    assert thread != get_native_id()


def test_priority_0_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[object] = []
    monkeypatch.setattr(os, 'sched_setscheduler', lambda *wanted: calls.append(wanted))
    assert explain_refusal(0) == ''
    use_priority(0)
    assert calls == []


@pytest.mark.process
def test_refusal_of_every_thread() -> None:
    script = ('import os\n'
              'from opencv_tools.transport.scheduling import explain_refusal, use_priority\n'
              'use_priority(5)\n'
              'print(os.sched_getscheduler(0), explain_refusal(5))')
    finished = subprocess.run([*WITHOUT_PERMISSION, sys.executable, '-c', script], check=True,
                              capture_output=True, text=True)
    assert finished.stdout.startswith(f'{os.SCHED_OTHER} priority 5 is not permitted')


@pytest.mark.parametrize(('words', 'priority'), [
    ([], 0), (['-p', 'priority:=7'], 7), (['-p', 'mine:priority:=99'], 99),
    (['-p', 'other:priority:=7'], 0), (['-p', 'priority:=100'], 0), (['-p', 'priority:=-1'], 0),
    (['-p', 'priority:=high'], 0), (['-p', 'priority:=['], 0), (['--params-file', '{file}'], 3),
    (['--params-file', '/nowhere'], 0), (['-p', 'priority:=7', '-p', 'depth:=-1'], 7),
    (['-p', 'priority:=7', '-p', 'split_bytes:=5', '-p', 'file_name:=a.png'], 7)])
def test_priority_of_the_command_line(tmp_path: Path, words: list[str], priority: int) -> None:
    file = tmp_path / 'mine.yaml'
    file.write_text('/**/mine:\n  ros__parameters:\n    priority: 3\n')
    args = ['node', '--ros-args', *(word.format(file=file) for word in words)]
    mine = Executable(name='recorder', node='mine', settings=RecorderSettings)
    assert mine.read_start(args) == (priority, 0)


def test_refused_priority(start: Start) -> None:
    publisher = start('img_publisher', source='pattern', priority=100)
    assert publisher.finish() == 2
    assert 'parameter priority is 100: give a whole number from 0 to 99' in publisher.output
