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

"""The executor of the nodes: wait sets, wake-ups by other threads, order, errors and the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from threading import Event, Thread, Timer
import time

from opencv_tools.topics.executor import FrameExecutor
from opencv_tools.topics.message_reader import WakeUps
from opencv_tools.topics.timers import create_steady_timer
import pytest
from rclpy.node import Node
from rclpy.task import Future
from waiting import pause, wait_until

#: Most wait sets before the first callback: the node and the waitable were added.
AT_START = 3


@pytest.fixture(params=['itself', 'in a thread'])
def executor(node: Node, request: pytest.FixtureRequest) -> Iterator[FrameExecutor]:
    """Return an executor with the node, which waits for the middleware in one of two ways."""
    created = FrameExecutor(node.context)
    created.add_node(node)
    if request.param != 'itself':
        created.call_soon(bool)
        created.spin_once()
    assert bool(created._waiting) == (request.param != 'itself')
    yield created
    created.remove_node(node)
    created.shutdown()


class Counted(WakeUps):
    """Wake-ups that count the wait sets and the calls."""

    def __init__(self, node: Node, on_wake: Callable[[], object] = lambda: None) -> None:
        self.built = self.calls = 0

        def count() -> None:
            self.calls += 1
            on_wake()

        super().__init__(node, lambda *_: count(), lambda: False)

    def add_to_wait_set(self, wait_set: object) -> None:
        super().add_to_wait_set(wait_set)
        self.built += 1


@pytest.fixture
def wake_ups(node: Node) -> Iterator[Counted]:
    """Return wake-ups of the node."""
    created = Counted(node)
    created.start()
    yield created
    created.destroy()


def test_wait_set_is_built_once_for_each_callback(
    executor: FrameExecutor, wake_ups: Counted,
) -> None:
    executor.spin_once(timeout_sec=0.0)
    for _ in range(30):
        Timer(0.02, wake_ups.wake).start()
        executor.spin_once()
    assert wake_ups.calls == 30
    assert wake_ups.built <= 30 + AT_START


@pytest.mark.parametrize('count', [10, 70, 500])
def test_calls_of_another_thread_build_no_wait_set(
    executor: FrameExecutor, wake_ups: Counted, count: int,
) -> None:
    executor.call_soon(bool)
    executor.spin_once()
    called: list[int] = []
    for number in range(count):
        thread = Thread(target=executor.call_soon, args=[partial(called.append, number)])
        thread.start()
        executor.spin_once()
        thread.join()
    assert called == [*range(count)]
    assert wake_ups.built <= AT_START


def test_function_that_waits_is_called_once_and_in_its_order(executor: FrameExecutor) -> None:
    called: list[str] = []
    first, second = lambda: called.append('first'), lambda: called.append('second')
    for call in (first, second, first):
        executor.call_soon(call)
    executor.spin_once()
    executor.call_soon(first)
    for _ in range(2):
        executor.spin_once()
    assert called == ['first', 'second', 'first']


def test_callback_of_the_middleware_comes_before_calls(
    executor: FrameExecutor, wake_ups: Counted,
) -> None:
    executor.call_soon(bool)
    executor.spin_once()
    called: list[int] = []

    def call_again() -> None:
        called.append(wake_ups.calls)
        executor.call_soon(call_again)

    call_again()
    wake_ups.wake()
    wait_until(lambda: executor._task is not None)
    for _ in range(3):
        executor.spin_once()
    assert called == [0, 1, 1]


def test_all_that_is_ready_in_the_middleware_comes_before_the_next_call(node: Node) -> None:
    called: list[str] = []
    ready = [Counted(node, partial(called.append, name)) for name in ('first', 'second')]
    executor = FrameExecutor(node.context)
    executor.add_node(node)

    def call_again() -> None:
        called.append('call')
        executor.call_soon(call_again)

    for wake_ups in ready:
        wake_ups.start()
        wake_ups.wake()
    executor.call_soon(call_again)
    executor._waiting = Thread(target=executor._wait)
    executor._waiting.start()
    wait_until(lambda: executor._task is not None)
    for _ in range(4):
        executor.spin_once()
    executor.shutdown()
    for wake_ups in ready:
        wake_ups.destroy()
    assert called == ['first', 'second', 'call', 'call']


def test_what_becomes_ready_in_a_call_comes_before_the_next_call(
    executor: FrameExecutor, wake_ups: Counted,
) -> None:
    executor.call_soon(bool)
    executor.spin_once()
    called: list[int] = []

    def call_again() -> None:
        called.append(wake_ups.calls)
        wake_ups.wake()
        pause(0.01)
        executor.call_soon(call_again)

    executor.call_soon(call_again)
    while len(called) < 50:
        executor.spin_once()
    # A wait that began before may have missed one.
    assert max(number - seen for number, seen in enumerate(called)) <= 1


@pytest.mark.parametrize('count', [1, 7, 40])
def test_timer_that_is_due_comes_before_the_next_call(
    executor: FrameExecutor, node: Node, count: int,
) -> None:
    called: list[str] = []

    def call_slowly() -> None:
        called.append('call')
        executor.call_soon(call_slowly)
        wake_ups.wake()  # the middleware has something before the timer is due
        pause(0.02)

    def have_called(*_: object) -> None:
        for _number in range(count):
            executor.call_soon(call_slowly)
        pause(0.02)

    wake_ups, first = Counted(node), Counted(node, have_called)
    for waitable in (wake_ups, first):
        waitable.start()
    create_steady_timer(node, 0.01, lambda: called.append('tick'))
    first.wake()
    while called.count('call') < 10:
        executor.spin_once()
    for waitable in (wake_ups, first):
        waitable.destroy()
    assert 'call call' not in ' '.join(called)


@pytest.mark.parametrize('count', [2, 16, 100])
def test_calls_of_many_cameras_build_few_wait_sets(
    executor: FrameExecutor, wake_ups: Counted, count: int,
) -> None:
    executor.call_soon(bool)
    executor.spin_once()
    for number in range(count):
        executor.call_soon(partial(int, number))
    begin = time.monotonic()
    while executor._calls:
        executor.spin_once()
    periods = (time.monotonic() - begin) / 0.01
    assert wake_ups.built <= AT_START + 2 * (periods + 1)


def test_callback_that_waits_delays_no_call(executor: FrameExecutor, node: Node) -> None:
    answer = Future()
    called: list[str] = []

    async def wait_for_answer() -> None:
        timer.cancel()
        called.append('waits')
        called.append(await answer)

    timer = create_steady_timer(node, 0.001, wait_for_answer)
    while not called:
        executor.spin_once()
    for _ in range(10):
        executor.call_soon(partial(called.append, 'call'))
        calls = called.count('call')
        while called.count('call') == calls:
            executor.spin_once()
    answer.set_result('answer')
    executor.wake()  # rclpy asks then whether a callback waits no longer
    while 'answer' not in called:
        executor.spin_once()
    assert called == ['waits', *['call'] * 10, 'answer']


def test_timer_that_a_call_creates_is_waited_for(
    executor: FrameExecutor, node: Node, wake_ups: Counted,
) -> None:
    fired: list[int] = []
    executor.spin_once(timeout_sec=0.0)
    wait_until(lambda: wake_ups.built > 0)  # it waits for what exists
    executor.call_soon(lambda: create_steady_timer(node, 0.001, lambda: fired.append(1)))
    while not fired:
        executor.spin_once()


@pytest.mark.parametrize('way', ['call', 'callback', 'wait'])
def test_exception_is_raised_where_the_executor_spins_and_it_goes_on(
    executor: FrameExecutor, node: Node, way: str,
) -> None:
    def fail(*_: object) -> None:
        raise LookupError('of the test')

    broken = Counted(node, fail)
    broken.start()
    if way == 'wait':
        broken.get_num_entities = fail  # type: ignore[assignment]
    elif way == 'call':
        executor.call_soon(fail)
    else:
        broken.wake()
    with pytest.raises(LookupError, match='of the test'):
        executor.spin_once()
    broken.destroy()
    called: list[int] = []
    create_steady_timer(node, 0.001, lambda: called.append(1))
    while not called:
        executor.spin_once()


def test_entity_that_is_destroyed_meanwhile_ends_nothing(
    executor: FrameExecutor, node: Node,
) -> None:
    executor._error = LookupError('of an entity that is gone')
    called: list[int] = []
    executor.call_soon(bool)
    create_steady_timer(node, 0.001, lambda: called.append(1))
    while not called:
        executor.spin_once()


def test_spinning_ends_after_its_time(executor: FrameExecutor) -> None:
    begin = time.monotonic()
    executor.spin_once(timeout_sec=0.2)
    assert time.monotonic() - begin >= 0.2


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('where', ['before', 'waiting', 'ready', 'callback', 'call'])
def test_executor_ends_its_thread(node: Node, where: str) -> None:
    executor = FrameExecutor(node.context)
    executor.add_node(node)
    if where != 'before':
        executor.call_soon(bool)
        executor.spin_once()
    ended = Event()

    def end() -> None:
        executor.shutdown()
        ended.set()

    wake_ups, other = Counted(node, end), Counted(node)
    wake_ups.start()
    other.start()
    if where == 'before':
        end()
    elif where == 'waiting':
        wait_until(lambda: wake_ups.built > 0)
        end()
    elif where == 'ready':
        for waitable in (wake_ups, other):
            waitable.wake()
        wait_until(lambda: executor._task)
        end()
        assert executor._tasks
        assert all(task.cancelled() for task, _, _ in executor._tasks)
        assert not executor._has_more
    elif where == 'call':
        executor.call_soon(end)
        executor.spin_once()
    else:
        wake_ups.wake()
        executor.spin_once()
    assert ended.is_set()
    assert executor._waiting is None
    wake_ups.destroy()
    other.destroy()


@pytest.mark.parametrize('way', ['create_task', 'call_soon'])
def test_other_thread_ends_the_wait(executor: FrameExecutor, way: str) -> None:
    executor.spin_once(timeout_sec=0.0)
    other = Timer(0.1, getattr(executor, way), [bool])
    other.start()
    executor.spin_once()
    other.join()
