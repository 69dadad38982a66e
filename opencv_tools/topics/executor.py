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

"""Executor that is woken for a frame without the wait set of rclpy."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from threading import Condition, get_ident, Thread
import time
from typing import Any

from rclpy.context import Context
from rclpy.executors import ShutdownException, SingleThreadedExecutor
from rclpy.task import Task

# Timers wait for so long beside the call that runs. With less, the frames of many cameras wait for
# a wait set of all of them after each other.
_SECONDS_OF_CALLS = 0.01


class FrameExecutor(SingleThreadedExecutor):
    """
    Run all callbacks in the thread that spins.

    rclpy builds a wait set of all entities of the node each time it waits, which takes longer than
    all else of a shared frame. From the first ``call_soon`` on another thread waits, and builds it
    only for what the middleware has; meanwhile the thread that spins runs what ``call_soon`` was
    given. After 10 ms of these calls all that the middleware has ready comes before the next one,
    so that slow frames do not delay timers and services.
    """

    def __init__(self, context: Context) -> None:
        """Create an executor without nodes."""
        super().__init__(context=context)
        self._changed = Condition()
        self._calls: dict[Callable[[], object], None] = {}  # oldest first
        self._task: Task | None = None  # what is ready in the middleware
        self._has_more = False  # what is ready comes before the next call
        self._gathered_at = 0.0  # in seconds of the monotonic clock
        self._error: BaseException | None = None
        self._waiting: Thread | None = None
        self._spinning = 0  # the thread that runs what is ready, while it does
        # rclpy wakes itself after each callback, which builds the wait set twice instead of once.
        # It is built after a callback in any case.
        guard: Any = self._guard
        trigger = guard.trigger
        guard.trigger = lambda: None if get_ident() == self._spinning else trigger()

    @property
    def has_thread(self) -> bool:
        """Whether another thread waits for the middleware."""
        return self._waiting is not None

    def call_soon(self, call: Callable[[], object]) -> None:
        """Have a function called in the thread that spins, once if it waits already."""
        with self._changed:
            ends_wait = bool(self._spinning) and self._waiting is None and not self._calls
            self._calls[call] = None
            self._changed.notify_all()
        if ends_wait:
            self.create_task(bool)  # ends the wait of rclpy

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """
        Run one callback.

        :param timeout_sec: seconds to wait for one; None without a limit.
        """
        with self._changed:
            if not (self._waiting or self._calls):
                self._spinning = get_ident()
        if self._spinning:
            self._run(partial(super().spin_once, timeout_sec))
            return
        with self._changed:
            if self._waiting is None:
                self._gather()
                self._waiting = Thread(target=self._wait, name='executor', daemon=True)
                self._waiting.start()
            if not self._changed.wait_for(
                    lambda: self._task or self._error or (self._calls and not self._has_more),
                    timeout_sec):
                return
            failed = self._error is not None
            if failed:  # also by an entity that a callback of this thread has destroyed meanwhile
                self._error = self._waiting = None
            call: Callable[[], object] = self._run_task
            if failed:
                call = partial(self._run, partial(super().spin_once, 0))  # raises what remains
            elif not self._task:
                call = partial(self._call, next(iter(self._calls)))
        call()

    def can_execute(self, entity: Any) -> bool:
        """Return whether to wait for an entity; rclpy asks it when all that was ready has run."""
        if self._has_more:
            with self._changed:
                if self._guard._executor_triggered:
                    self._has_more = False  # calls go on
                    self._changed.notify_all()
                else:
                    self.wake()  # Fast DDS loses a wake-up at the end of a wait
        return bool(super().can_execute(entity))

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """
        End the thread that waits, and all else, as rclpy does.

        :param timeout_sec: seconds to wait for callbacks of other threads; None without a limit.
        """
        with self._changed:
            self._is_shutdown = True
            self._changed.notify_all()
        if self._waiting:
            self.wake()
            self._waiting.join()
            self._waiting, self._has_more = None, False
        for task, _, _ in self._tasks:
            if not task.executing():  # nobody will run it
                task.cancel()
        return bool(super().shutdown(timeout_sec))

    def _call(self, call: Callable[[], object]) -> None:
        """Call a function; after 10 ms of them, what is ready comes before the next one."""
        del self._calls[call]
        call()
        with self._changed:
            # What is known to be ready was gathered before the call.
            if (self._calls or self._task or self._has_more) and (
                    time.monotonic() - self._gathered_at >= _SECONDS_OF_CALLS):
                self._gather()

    def _run_task(self) -> None:
        """Run what is ready in the middleware, and have the other thread wait for more."""
        assert self._task
        try:
            self._run(self._task)
            self._task.result()  # raises its exception
        finally:
            with self._changed:
                self._task = None
                self._changed.notify_all()

    def _run(self, call: Callable[[], object]) -> None:
        """Call a function of rclpy in this thread, which does not wake itself."""
        self._spinning = get_ident()
        try:
            call()
        finally:
            self._spinning = 0

    def _wait(self) -> None:
        """Wait for the middleware, until the end of the executor."""
        try:
            while True:
                ready: Any = self.wait_for_ready_callbacks()  # task, entity, node
                with self._changed:
                    self._task = ready[0]
                    self._has_more |= ready[1] is not None
                    self._changed.notify_all()
                    self._changed.wait_for(lambda: not self._task or self._is_shutdown)
        except ShutdownException:
            pass
        except BaseException as err:  # noqa: B902 (raised in the thread that spins)
            with self._changed:
                self._error = err
                self._changed.notify_all()

    def _gather(self) -> None:
        """Have all run that is ready now before the next call."""
        self._has_more, self._gathered_at = True, time.monotonic()
        self._guard._executor_triggered = False  # rclpy sets it when it gathers after the wake-up
        self.wake()
