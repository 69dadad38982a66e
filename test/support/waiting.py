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

"""Waits that end by what they wait for, and never by the speed of the machine."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
import os
from pathlib import Path
import queue
import subprocess
import threading
import time
from typing import Any, Protocol, TypeVar

STILL_SECONDS = 60.0  # that the counters of a wait may stand still
LONGEST_SECONDS = 600.0  # that any wait may last
_POLL_SECONDS = 0.01
_LOOK_SECONDS = 1.0  # between looks at the counters
_TICK = os.sysconf('SC_CLK_TCK')
_COUNTED_TICKS = _TICK  # idle threads of Fast DDS take a tick now and then, a second in minutes
_T = TypeVar('_T')


class _Alive(Protocol):
    """A thread or a process of `multiprocessing`."""

    name: str

    def is_alive(self) -> bool: ...


class _Process(Protocol):
    """A process of `subprocess` or `prepared`."""

    @property
    def pid(self) -> int: ...

    @property
    def returncode(self) -> Any: ...

    def poll(self) -> int | None: ...


def _ticks(stat: Path) -> int:
    """Return the processor time of a thread or process by its file ``stat``, 0 after its end."""
    with suppress(OSError):
        words = stat.read_text().rpartition(')')[2].split()
        return int(words[11]) + int(words[12])
    return 0


def _tree(process: int) -> list[int]:
    """Return the numbers of a process and of its descendants."""
    found = [process]
    for children in Path(f'/proc/{process}/task').glob('*/children'):
        with suppress(OSError):
            for child in map(int, children.read_text().split()):
                found += _tree(child)
    return found


def _ticks_of(processes: list[int]) -> int:
    return sum(_ticks(Path(f'/proc/{process}/stat')) for process in processes)


def work_of(process: int) -> int:
    """Return the whole seconds of work of a process and of its descendants."""
    return _ticks_of(_tree(process)) // _COUNTED_TICKS


def work() -> int:
    """Return the whole seconds of work of other threads and of child processes, ended or not."""
    ended = os.times()
    return (sum(_ticks(task / 'stat') for task in Path('/proc/self/task').iterdir()
                if task.name != str(threading.get_native_id()))
            + round((ended.children_user + ended.children_system) * _TICK)
            + _ticks_of(_tree(os.getpid())[1:])) // _COUNTED_TICKS


class Watch:
    """
    A watch over a wait: `check` is called in each round of it.

    :param name: what is waited for.
    :param counters: by their names, what grows while the wait makes progress: frames, lines,
        bytes, or steps; without one, `work`. A counter may return any value with ``==``.
    """

    def __init__(self, name: str, counters: dict[str, Callable[[], object]]) -> None:
        self._name = name
        self._counters = counters or {'work': work}
        self._counts: dict[str, object] = {}
        self._began = self._moved = self._looked = time.monotonic()

    def check(self) -> None:
        """
        Look at the counters, at most once a second.

        :raises AssertionError: if all stood still for ``STILL_SECONDS``, or the wait is longer
            than ``LONGEST_SECONDS``.
        """
        now = time.monotonic()
        if now < self._looked + _LOOK_SECONDS:
            return
        self._looked = now
        counts = {name: counter() for name, counter in self._counters.items()}
        if self._counts and counts != self._counts:
            self._moved = now
        self._counts = counts
        still, lasted = now - self._moved, now - self._began
        shown = ', '.join(f'{name} = {count!r}' for name, count in counts.items())
        assert still < STILL_SECONDS and lasted < LONGEST_SECONDS, (
            f'{self._name} did not come in {lasted:.0f} s; nothing has moved for {still:.0f} s: '
            f'{shown}')


def _sleep() -> None:
    time.sleep(_POLL_SECONDS)


def wait_until(condition: Callable[[], _T], name: str = 'the condition',
               step: Callable[[], object] = _sleep,
               **counters: Callable[[], object]) -> _T:
    """Wait until a condition is true, and return its value; take a step before each new look."""
    watch = Watch(name, counters)
    while not (value := condition()):
        watch.check()
        step()
    return value


async def until(condition: Callable[[], _T], name: str = 'the condition',
                **counters: Callable[[], object]) -> _T:
    """Wait in an event loop until a condition is true, and return its value; see `Watch`."""
    watch = Watch(name, counters)
    while not (value := condition()):
        watch.check()
        await asyncio.sleep(_POLL_SECONDS)
    return value


async def result_of(awaited: Awaitable[_T], name: str = 'the result',
                    **counters: Callable[[], object]) -> _T:
    """Wait in an event loop for a result; see `Watch`."""
    watch = Watch(name, counters)
    task = asyncio.ensure_future(awaited)
    try:
        while not (await asyncio.wait([task], timeout=_LOOK_SECONDS))[0]:
            watch.check()
    except asyncio.CancelledError:
        if not task.done():  # else its result would be lost
            raise
    finally:
        task.cancel()
    return await task


def join(ending: _Alive, **counters: Callable[[], object]) -> None:
    """Wait for the end of a thread, or of a process of `multiprocessing`; see `Watch`."""
    wait_until(lambda: not ending.is_alive(), f'the end of {ending.name}', **counters)


def status_of(process: _Process, **counters: Callable[[], object]) -> int:
    """Wait for the end of a process, and return its exit status; see `Watch`."""
    wait_until(lambda: process.poll() is not None, f'the end of process {process.pid}',
               work=lambda: work_of(process.pid), **counters)
    return int(process.returncode)


def communicate(process: subprocess.Popen[Any], given: Any = None) -> tuple[Any, Any]:
    """Write to a process, read all it prints, and wait for its end; see `Watch`."""
    watch = Watch(f'the end of process {process.pid}', {'work': lambda: work_of(process.pid)})
    while True:
        with suppress(subprocess.TimeoutExpired):
            return process.communicate(given, timeout=_LOOK_SECONDS)
        watch.check()


def item_of(items: queue.Queue[_T] | queue.SimpleQueue[_T],
            **counters: Callable[[], object]) -> _T:
    """Wait for the next item of a queue; see `Watch`."""
    watch = Watch('the next item', counters)
    while True:
        with suppress(queue.Empty):
            return items.get(timeout=_LOOK_SECONDS)
        watch.check()


def pause(seconds: float) -> None:
    """
    Sleep between the steps of a load, such as messages at a rate or signals at random moments.

    Nothing may depend on what happens meanwhile; a wait for something is `wait_until`.
    """
    time.sleep(seconds)


async def pause_loop(seconds: float = 0.0) -> None:
    """Sleep in an event loop between the steps of a load, or let its other tasks run."""
    await asyncio.sleep(seconds)


async def due() -> None:
    """Wait in an event loop until it has made the calls that are due now."""
    made = asyncio.get_running_loop().create_future()
    asyncio.get_running_loop().call_later(0.0, made.set_result, None)
    await made
