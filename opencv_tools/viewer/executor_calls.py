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

from opencv_tools.viewer.errors import RequestError
from rclpy.node import Node

_T = TypeVar('_T')


class ExecutorCalls:
    """Call functions in the executor of a node, from any thread."""

    def __init__(self, node: Node) -> None:
        """
        Create an empty queue.

        :param node: node of the executor.
        """
        self._node = node
        self._queue: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self._guard = node.create_guard_condition(self._run)

    def post(self, call: Callable[[], object]) -> None:
        """Request a call; thread-safe."""
        self._queue.put(call)
        self._guard.trigger()

    def start(self, work: Coroutine[Any, Any, _T],
              on_done: Callable[[_T | RequestError], object]) -> None:
        """
        Run a coroutine of rclpy; thread-safe.

        :param work: coroutine.
        :param on_done: called with the result, or with the refusal, in the executor.
        """
        async def run() -> None:
            try:
                on_done(await work)
            except RequestError as err:
                on_done(err)

        self.post(lambda: self._node.executor.create_task(run()))

    def _run(self) -> None:
        while True:
            try:
                call = self._queue.get_nowait()
            except Empty:
                return
            call()
