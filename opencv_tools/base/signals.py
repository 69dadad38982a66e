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

"""Signals that end a process: SIGINT (Ctrl-C), SIGTERM and SIGHUP."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager
import os
import signal
from types import FrameType

END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Handler = Callable[[int, FrameType | None], object]


def handle_signals(handler: Handler, ignorable: Container[int] = END_SIGNALS) -> None:
    """
    Set the handler of the signals that end a process.

    :param handler: called with the number of the signal and the current frame.
    :param ignorable: signals that stay ignored if they are ignored now, as SIGHUP under nohup.
    """
    for number in END_SIGNALS:
        if number not in ignorable or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


def ignore_signals() -> None:
    """
    Ignore the signals until the process has ended, because they would change the exit status.

    Python removes its own handlers while the interpreter shuts down, which takes half a second.
    """
    for number in END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def recorded_signals() -> Iterator[Callable[[], bool]]:
    """
    Only record the signals for a while, so that none interrupts what is being written.

    Signals that are ignored stay ignored.

    :returns: a function that returns whether there was a signal.
    """
    received: list[int] = []
    previous = {number: signal.getsignal(number) for number in END_SIGNALS}
    handle_signals(lambda number, frame: received.append(number))
    try:
        yield lambda: bool(received)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def end_at_signals(
    command: Callable[[], int], status: int | None = None,
    ignorable: Container[int] = END_SIGNALS,
) -> int:
    """
    Run a command that a signal ends without a traceback.

    A signal raises KeyboardInterrupt in the command. While a module is imported, it ends the
    process at once, because importlib and some modules discard exceptions.

    :param status: exit status after a signal; None for 128 plus the number of the signal.
    :param ignorable: as for ``handle_signals``.
    :returns: the exit status.
    """
    has_ended = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        if has_ended:
            return
        if _is_importing(frame):
            os._exit(128 + number if status is None else status)
        raise KeyboardInterrupt(number)

    def end() -> None:
        nonlocal has_ended
        has_ended = True
        ignore_signals()

    try:
        try:
            handle_signals(interrupt, ignorable)
            return command()
        finally:
            end()
    except KeyboardInterrupt as err:  # also one just before or just after the command
        end()
        return 128 + err.args[0] if status is None else status


def _is_importing(frame: FrameType | None) -> bool:
    while frame and not frame.f_code.co_filename.startswith('<frozen importlib'):
        frame = frame.f_back
    return frame is not None
