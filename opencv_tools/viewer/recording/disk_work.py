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


"""Slow work on the disk, for which the executor does not wait."""

from __future__ import annotations

from collections.abc import Callable
from threading import Thread
from typing import TypeVar

from opencv_tools.image.text import MAX_PATH, printable
from opencv_tools.logs import Log
from opencv_tools.recording.errors import RecordingError
from opencv_tools.viewer.errors import MAX_MESSAGE, RequestError
from rclpy.node import Node
from rclpy.task import Future

_T = TypeVar('_T')


async def in_thread(node: Node, log: Log, work: Callable[[], _T]) -> _T:
    """
    Return the result of work in a thread, in a coroutine of the executor.

    :param node: node of the executor.
    :raises RequestError: a folder cannot be used; the reason is logged as well.
    """
    future = Future(executor=node.executor)

    def run() -> None:
        try:
            future.set_result(work())
        except Exception as err:  # noqa: B902 (the coroutine raises it)
            future.set_exception(err)
        executor = node.executor
        if executor:
            executor.wake()

    Thread(target=run, name='recording', daemon=True).start()
    try:
        result: _T = await future
    except (OSError, RecordingError) as err:
        log.error(printable(err, MAX_PATH))
        raise RequestError(printable(err, MAX_MESSAGE)) from err
    return result
