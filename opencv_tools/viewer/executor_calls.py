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

"""Calls from other threads into the executor of a node."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from opencv_tools.base.logs import Log
from opencv_tools.base.text import printable
from opencv_tools.viewer.errors import MAX_MESSAGE, RequestError
from rclpy.node import Node

_T = TypeVar('_T')


class ExecutorCalls:
    """
    Call functions in the executor of a node, from any thread.

    A call that fails is logged, and fails only for its caller.
    """

    def __init__(self, node: Node, log: Log) -> None:
        self._node = node
        self._log = log
        self._queue: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self._started: dict[Coroutine[Any, Any, None], Coroutine[Any, Any, Any]] = {}
        self._guard = node.create_guard_condition(self._run)

    def call(self, function: Callable[[], _T],
             on_done: Callable[[_T | RequestError], object] = lambda _: None) -> None:
        """
        Call a function; thread-safe.

        :param function: function without arguments.
        :param on_done: called with the result, or with the refusal, in the executor.
        """
        def run() -> None:
            try:
                result: _T | RequestError = function()
            except Exception as err:  # noqa: B902 (one request must not end the node)
                result = self._refusal(err)
            on_done(result)

        self._request(run)

    def start(self, work: Coroutine[Any, Any, _T],
              on_done: Callable[[_T | RequestError], object]) -> None:
        """
        Run a coroutine of rclpy; thread-safe.

        :param on_done: called with the result, or with the refusal, in the executor.
        """
        async def run() -> None:
            try:
                result: _T | RequestError = await work
            except Exception as err:  # noqa: B902 (one request must not end the node)
                result = self._refusal(err)
            del self._started[running]
            on_done(result)

        def create_task() -> None:
            executor = self._node.executor
            if executor:  # always, because it calls this function
                executor.create_task(running)

        running = run()
        self._started[running] = work
        self._request(create_task)

    def close(self) -> None:
        """End the coroutines that have not returned, after the end of the executor's spin."""
        while self._started:
            for coroutine in self._started.popitem():
                coroutine.close()

    def _request(self, call: Callable[[], object]) -> None:
        self._queue.put(call)
        self._guard.trigger()

    def _run(self) -> None:
        while True:
            try:
                call = self._queue.get_nowait()
            except Empty:
                return
            call()

    def _refusal(self, err: Exception) -> RequestError:
        """Return an error for the caller; log one that is not a refusal."""
        if isinstance(err, RequestError):
            return err
        message = f'the request has failed: {type(err).__name__}: {err}'
        self._log.error(message, every=1.0, key='request')
        return RequestError(printable(message, MAX_MESSAGE), 500)
