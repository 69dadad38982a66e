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

"""Signals that ask a node to end."""

from __future__ import annotations

from collections.abc import Callable
import signal
import socket
from threading import Thread
import time
from types import FrameType

from opencv_tools.signals import handle_signals, ignore_signals

_FORCE_QUIT_SECONDS = 1.0


class NodeSignals:
    """
    Record SIGINT, SIGTERM and SIGHUP; SIGHUP stays ignored under nohup.

    rclpy's handlers shut down the context immediately, even while the node is starting or
    flushing frames. These handlers only record the time of the first signal, from the moment that
    something has to be finished. A signal before raises KeyboardInterrupt.
    """

    def __init__(self) -> None:
        self._first_at = 0.0
        self._has_ended = False
        #: Whether signals are only recorded.
        self.are_recorded = False
        #: Called by the handler of a much later signal; None to raise KeyboardInterrupt.
        self.force: Callable[[], object] | None = None
        # Signals that arrive before the executor waits are kept in this socket.
        self._reader, self._writer = socket.socketpair()
        self._writer.setblocking(False)
        self._waker: Thread | None = None
        self._previous = signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)
        handle_signals(self._receive, ignorable=(signal.SIGHUP,))

    @property
    def received(self) -> bool:
        """Return whether the node was asked to end."""
        return self._first_at > 0.0

    def wake(self, end_spin: Callable[[], object]) -> None:
        """End the spinning at each signal, because Python's handlers run only then."""
        def wake() -> None:
            while self._reader.recv(1):
                end_spin()

        self._waker = Thread(target=wake, name='signals', daemon=True)
        self._waker.start()

    def end(self) -> None:
        """Ignore signals from now on."""
        self._has_ended = True
        ignore_signals()
        if self._writer.fileno() < 0:
            return
        signal.set_wakeup_fd(self._previous)
        self._writer.close()
        if self._waker:
            self._waker.join()
        self._reader.close()

    def _receive(self, _number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        self._first_at = self._first_at or now
        if not self.are_recorded:
            raise KeyboardInterrupt
        # ros2 launch repeats the SIGINT of the terminal. A much later signal forces an exit.
        if now - self._first_at > _FORCE_QUIT_SECONDS and not self._has_ended:
            if self.force is None:
                raise KeyboardInterrupt
            self.force()
