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

"""The consumer of the frames of a subscription."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from threading import current_thread, RLock, Thread

from opencv_tools.image.errors import CdrError
from opencv_tools.topics.executor import FrameExecutor
from opencv_tools.topics.queue import FrameQueue, QueuedFrame, ReceivedMessage
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node


class Consumer:
    """Call the callbacks of a subscription with the frames of its queue, one call at a time."""

    def __init__(
        self, node: Node, queue: FrameQueue, on_frame: Callable[[ReceivedMessage], object],
        on_broken: Callable[[CdrError], object], wake: Callable[[], object],
    ) -> None:
        """
        Create a consumer in the executor.

        :param node: node whose timers are not delayed by frames that wait.
        :param on_frame: called with each frame.
        :param on_broken: called with the error of a message that cannot be read.
        :param wake: wakes an executor of rclpy; thread-safe.
        """
        self._node = node
        self._queue = queue
        self._on_frame = on_frame
        self._on_broken = on_broken
        self._wake = wake
        self._error: BaseException | None = None  # raised by a callback in its thread
        self._has_yielded = False
        #: Held during each call. A callback may take it again.
        self.calling = RLock()
        self._thread: Thread | None = None
        self._has_call = False  # the executor will call _pass_on_next

    @property
    def has_thread(self) -> bool:
        """Whether a thread calls the callbacks."""
        return self._thread is not None

    @property
    def is_pending(self) -> bool:
        """Whether frames wait for the executor that it does not know of."""
        return not (self._thread or self._has_call) and self._queue.has_frames

    @property
    def is_current_thread(self) -> bool:
        """Whether the caller is in a callback of the thread."""
        return self._thread is current_thread()

    def start_thread(self, name: str, on_end: Callable[[bool], object]) -> None:
        """
        Pass on the frames in a thread, until the queue is closed or a callback fails.

        :param on_end: called in the thread at its end; True if a callback has failed.
        """
        def run() -> None:
            try:
                while frame := self._queue.wait():
                    self.pass_on(frame)
                    del frame  # release the message before the next wait
            except BaseException as err:  # noqa: B902 (`raise_error` raises it)
                self._error = err
                on_end(True)
            else:
                on_end(False)

        self._thread = Thread(target=run, name=name, daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Have a frame passed on that was put into the queue; thread-safe."""
        if self._thread:  # waits for the queue
            return
        executor = self._node.executor
        if isinstance(executor, FrameExecutor):
            self._has_call = True
            executor.call_soon(self._pass_on_next)
        else:
            self._wake()

    def next_in_executor(self) -> QueuedFrame | None:
        """Return the oldest frame; None if it has to wait for other callbacks."""
        executor = self._node.executor
        if isinstance(executor, FrameExecutor) and executor.has_thread:
            self.wake()  # the executor knows of it from now on
            return None
        return None if self._yields_to_timers() else self._queue.pop()

    def pass_on(self, frame: QueuedFrame) -> None:
        """Call the callback of a frame."""
        with self.calling:
            if isinstance(frame, CdrError):
                self._on_broken(frame)
            else:
                self._on_frame(frame)

    def raise_error(self) -> None:
        """Raise the exception that has ended the thread, once."""
        error, self._error = self._error, None
        if error is not None:
            raise error

    def join(self) -> None:
        """Wait for the end of a running call, and of the thread."""
        with self.calling:
            pass
        if self._thread:
            self._thread.join()

    def _pass_on_next(self) -> None:
        """Pass on a frame in the executor; those that follow it come after other callbacks."""
        self._has_call = False
        with self.calling:
            frame = self._queue.pop()
            if frame:
                self.pass_on(frame)
        if self._queue.has_frames:
            self.wake()

    def _yields_to_timers(self) -> bool:
        """
        Return whether the next frame waits once for timers that are due.

        The executor runs waitables first, so that a slow callback would delay them twice.
        """
        with suppress(InvalidHandle):  # a timer that another thread destroys
            self._has_yielded = not self._has_yielded and self._queue.has_frames and any(
                timer.is_ready() for timer in self._node.timers)
        return self._has_yielded
