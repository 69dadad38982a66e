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

"""Signals while an executable starts: no traceback, and the exit status of an orderly end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
import itertools
import os
from pathlib import Path
import signal
import subprocess
import sys

from conftest import executable, NodeProcess
import pytest
from waiting import pause, status_of, wait_until, work_of

pytestmark = pytest.mark.process

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# A background job of a script ignores SIGINT.
HEARING_SIGINT = ('env', '--default-signal=INT')
IGNORING_SIGINT = ('sh', '-c', 'trap "" INT && exec "$0" "$@"')
HANDLED = 'signals are handled'
# Libraries in the order in which the nodes load them.
NODE_STEPS = (HANDLED, 'multiarray_umath', '_rclpy_pybind11', 'librmw_fastrtps', '[INFO]')
ROBOT_STEPS = (HANDLED, 'lxml/etree')
PATTERN = ('--ros-args', '-p', 'source:=pattern')


@dataclass(frozen=True)
class Case:
    """
    An executable that does not end by itself.

    :param words: name and arguments.
    :param status: exit status after a signal; None for 128 plus the number of the signal.
    :param steps: libraries that it loads and texts that it prints, in their order.
    """

    words: Sequence[str]
    status: int | None
    steps: Sequence[str]


CASES = {case.words[0]: case for case in (
    Case(('img_publisher', *PATTERN), 0, NODE_STEPS),
    Case(('img_subscriber',), 0, NODE_STEPS),
    Case(('img_filter', '--ros-args', '-p', 'function:=cv2:Canny'), 0, NODE_STEPS),
    Case(('img_viewer', '--ros-args', '-p', 'port:=0'), 0, NODE_STEPS),
    Case(('img_convert', 'pattern:64x48', '{seq}.png', '--stop', '1000000'), 1,
         (HANDLED, 'multiarray_umath', 'cv2', 'Converting frame')),
    Case(('urdf_to_sdf', '-'), None, ROBOT_STEPS),
    Case(('sdf_to_urdf', '-'), None, ROBOT_STEPS),
    Case(('robot_compare', '-', 'other.urdf'), None, ROBOT_STEPS),
    Case(('robot_frames', '-'), None, ROBOT_STEPS))}
EVERY_CASE = pytest.mark.parametrize('case', CASES.values(), ids=CASES)


@contextmanager
def running(
    case: Case, folder: Path, within: Sequence[str] = HEARING_SIGINT,
) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """Run an executable whose standard input is open, and yield its console."""
    folder.mkdir()
    console = folder / 'console.log'
    with console.open('w') as output, subprocess.Popen(
            [*within, executable(case.words[0]), *case.words[1:]], cwd=folder,
            stdin=subprocess.PIPE, stdout=output, stderr=output) as process:
        try:
            yield process, console
        finally:
            process.kill()


def has_reached(step: str, process: subprocess.Popen[bytes], console: Path) -> bool:
    """Return whether a process handles signals, has loaded a library, or has printed a text."""
    files = Path(f'/proc/{process.pid}')
    if step == HANDLED:
        caught = files.joinpath('status').read_text().partition('SigCgt:')[2].split()[0]
        return bool(int(caught, 16) & 1 << signal.SIGHUP - 1)
    return step in files.joinpath('maps').read_text() or step in console.read_text()


def wait_for_step(step: str, process: subprocess.Popen[bytes], console: Path) -> None:
    def is_met() -> bool:
        met = has_reached(step, process, console)
        assert met or process.poll() is None, console.read_text()
        return met

    wait_until(is_met, step, output=lambda: console.stat().st_size,
               work=lambda: work_of(process.pid))


def check_end(case: Case, process: subprocess.Popen[bytes], console: Path, number: int) -> None:
    """Send a signal and check the end of the process."""
    process.send_signal(number)
    status = status_of(process)
    assert status == (128 + number if case.status is None else case.status), console.read_text()
    assert 'Traceback' not in console.read_text()


@pytest.mark.quick_cases(1)
@EVERY_CASE
def test_signal_at_each_step_of_the_start(case: Case, tmp_path: Path) -> None:
    for index, step in enumerate(case.steps):
        with running(case, tmp_path / f'{index}') as (process, console):
            wait_for_step(step, process, console)
            check_end(case, process, console, SIGNALS[index % len(SIGNALS)])


@pytest.mark.thorough
@EVERY_CASE
def test_signals_in_the_first_two_seconds(case: Case, tmp_path: Path) -> None:
    for moment, number in zip(range(20), itertools.cycle(SIGNALS)):
        with running(case, tmp_path / f'{moment}') as (process, console):
            wait_for_step(HANDLED, process, console)
            pause(moment * 0.1)
            check_end(case, process, console, number)


def test_background_node_of_a_script(tmp_path: Path) -> None:
    # A shell script starts it with SIGINT ignored, and Ctrl-C goes to all of its processes.
    case = CASES['img_publisher']
    with running(case, tmp_path / 'run', IGNORING_SIGINT) as (process, console):
        wait_for_step(HANDLED, process, console)
        check_end(case, process, console, signal.SIGINT)


def test_late_signals_of_an_own_node(tmp_path: Path) -> None:
    script = tmp_path / 'own.py'
    script.write_text("""
import sys
from opencv_tools.frames import FrameNode, main


class Own(FrameNode):
    def __init__(self):
        super().__init__('own')
        self.done.set_result(3)

    def close(self):
        print('closing', flush=True)
        return super().close()


sys.exit(main(Own))
""")
    process = NodeProcess([sys.executable, str(script)], tmp_path / 'own.log', dict(os.environ))
    try:
        process.wait_for('closing')
        while process.is_running():  # its interpreter shuts down
            for number in SIGNALS:
                process.interrupt(number)
            pause(0.001)
        assert process.finish() == 3, process.output
    finally:
        process.kill()
