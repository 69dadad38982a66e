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

"""Waits of the tests, and a lint that there are no others."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from queue import Queue
import subprocess
import sys
from threading import Event, Thread

from conftest import spin_until
import pytest
from rclpy.node import Node
from stepped_clock import BEGAN, SteppedClock
import waiting
from waiting import wait_until, work, work_of

TESTS = Path(__file__).parents[1]
#: Python that starts a process, which computes for each line of its input.
GRANDPARENT = """
import subprocess, sys
child = '''
import sys, time
print(flush=True)
for line in sys.stdin:
    end = time.process_time() + 0.1
    while time.process_time() < end:
        pass
    print(flush=True)
'''
sys.exit(subprocess.run([sys.executable, '-c', child]).returncode)
"""


def test_bare_sleeps_and_fixed_deadlines() -> None:
    texts = {path: path.read_text() for path in TESTS.rglob('*.py') if path.name != 'waiting.py'}
    assert len(texts) > 300
    found = [f'{path.relative_to(TESTS)}:{node.lineno}' for path, text in texts.items()
             if 'DEADLINE' in text or 'sleep' in text for node in ast.walk(ast.parse(text))
             if getattr(node, 'id', '') == 'DEADLINE' or (
                 isinstance(node, ast.Call) and 'sleep' in (
                     getattr(node.func, 'id', ''), getattr(node.func, 'attr', '')))]
    assert found == []  # a wait is one of support/waiting.py


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SteppedClock:
    """Replace the clock of the waits; each step of a wait lasts a second."""
    stepped = SteppedClock()
    monkeypatch.setattr(waiting, 'time', stepped)
    return stepped


def wait_for_ever(clock: SteppedClock, **counters: Callable[[], object]) -> str:
    """Return how a wait failed whose condition does not come."""
    with pytest.raises(AssertionError) as raised:
        wait_until(lambda: False, 'the frame', lambda: clock.step_to(clock.now + 1), **counters)
    return str(raised.value)


def test_counter_that_stands_still(clock: SteppedClock) -> None:
    assert wait_for_ever(clock, frames=lambda: 7) == (
        'the frame did not come in 60 s; nothing has moved for 60 s: frames = 7')


def test_counter_that_stops(clock: SteppedClock) -> None:
    assert wait_for_ever(clock, frames=lambda: min(clock.now - BEGAN, 200), bytes=lambda: 3) == (
        'the frame did not come in 260 s; nothing has moved for 60 s: frames = 200, bytes = 3')


@pytest.mark.parametrize('period', [2, 31, 59])
def test_slow_counter_has_nine_minutes(clock: SteppedClock, period: int) -> None:
    assert wait_until(lambda: clock.now - BEGAN if clock.now >= BEGAN + 540 else 0, 'the frame',
                      lambda: clock.step_to(clock.now + 1),
                      frames=lambda: (clock.now - BEGAN) // period) == 540


def test_no_counter_has_more_than_ten_minutes(clock: SteppedClock) -> None:
    assert wait_for_ever(clock, frames=lambda: clock.now) == (
        f'the frame did not come in 600 s; nothing has moved for 0 s: frames = {BEGAN + 600}')


def test_met_condition_needs_no_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, 'time', SteppedClock())
    assert wait_until(lambda: 'at once') == 'at once'


def test_item_that_does_not_come(
        clock: SteppedClock, monkeypatch: pytest.MonkeyPatch) -> None:
    class Silent(Queue):

        def get(self, block: bool = True, timeout: float | None = None) -> object:
            assert timeout is not None
            clock.step_to(clock.now + timeout)
            return super().get(block=False)

    with pytest.raises(AssertionError, match=r'next item did not come in 60 s.*: puts = 0'):
        waiting.item_of(Silent(), puts=lambda: 0)


def test_result_that_does_not_come(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, 'STILL_SECONDS', 0.0)
    monkeypatch.setattr(waiting, '_LOOK_SECONDS', 0.01)
    with pytest.raises(AssertionError, match=r'an answer did not come .*: bytes = 3'):
        waiting.asyncio.run(waiting.result_of(
            waiting.asyncio.Event().wait(), 'an answer', bytes=lambda: 3))


@pytest.fixture
def computing_thread() -> Iterator[Callable[[], None]]:
    """Return a function that lets another thread compute until its ticks grow."""
    orders: Queue[Event | None] = Queue()

    def compute() -> None:
        while (computed := orders.get()) is not None:
            while not computed.is_set():
                sum(range(1000))

    def _order() -> None:
        computed, before = Event(), work()
        orders.put(computed)
        wait_until(lambda: work() > before, 'work of the thread')
        computed.set()

    thread = Thread(target=compute)
    thread.start()
    yield _order
    orders.put(None)
    thread.join()


def stands_still(counter: Callable[[], int]) -> bool:
    """Return whether a counter is the same at two of a hundred looks in a row."""
    counts = [counter() for _ in range(100)]
    return any(first == second for first, second in pairwise(counts))


def test_work_of_another_thread(
        computing_thread: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, '_COUNTED_TICKS', 1)
    computing_thread()
    assert stands_still(work)
    computing_thread()


@pytest.mark.process
def test_work_of_a_grandchild(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, '_COUNTED_TICKS', 1)
    with subprocess.Popen([sys.executable, '-c', GRANDPARENT], text=True,
                          stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin and process.stdout and process.stdout.readline()
        for _ in range(2):
            before, all_before = work_of(process.pid), work()
            process.stdin.write('\n')
            process.stdin.flush()
            assert process.stdout.readline()
            assert work_of(process.pid) >= before + 9
            assert work() >= all_before + 9
        wait_until(lambda: stands_still(lambda: work_of(process.pid)), 'its sleep')
        _, ended = waiting.communicate(process, '')
        assert ended is None and process.returncode == 0
    assert work() >= all_before + 9  # the work of an ended process counts still


def test_node_that_receives_nothing(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, timers = SteppedClock(), list[float]()
    node.create_timer(0.001, lambda: timers.append(clock.now))
    with monkeypatch.context() as patched:
        patched.setattr(waiting, 'time', clock)
        with pytest.raises(AssertionError, match=r'did not come in 60 s;.*received = 0$'):
            spin_until(node, lambda: clock.step_to(clock.now + 0.5), 'the image')
    assert len(timers) > 10
