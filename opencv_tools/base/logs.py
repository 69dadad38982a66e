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

"""Log of printable lines that can leave out repetitions, and a line about slow work."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import math
import sys
from threading import Lock, Timer
import time
from typing import Protocol

from opencv_tools.base.text import without_password

_MAX_LINE = 10_000  # characters; a sentence may name two of the longest paths of Linux
_MAX_KEYS = 256
_SLOW_SECONDS = 1.0


class Throttle:
    """Limit how often something happens, by key; thread-safe. The 256 last used keys are kept."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._ends: dict[str, float] = {}  # of periods, the last used key at the end

    def passes(self, key: str, seconds: float = math.inf) -> bool:
        """
        Return whether an action may happen now; if so, a new period begins.

        :param seconds: period in seconds; by default it ends only with ``forget``.
        """
        now = time.monotonic()
        with self._lock:
            end = self._ends.pop(key, now)
            self._ends[key] = now + seconds if end <= now else end
            if len(self._ends) > _MAX_KEYS:
                del self._ends[next(iter(self._ends))]
        return end <= now

    def forget(self, key: str) -> None:
        """Allow the next action of a key."""
        with self._lock:
            self._ends.pop(key, None)


class LineWriter(Protocol):
    """Destination of lines: the logger of a node, a progress bar or the console."""

    def debug(self, message: str, /) -> object:
        """Write a detail for developers."""

    def info(self, message: str, /) -> object:
        """Write normal progress."""

    def warning(self, message: str, /) -> object:
        """Write a possible problem."""

    def error(self, message: str, /) -> object:
        """Write a failure."""


class ConsoleWriter:
    """Writer of whole lines on standard error, without details for developers; thread-safe."""

    def __init__(self, command: str) -> None:
        """
        Create the writer.

        :param command: name of the command, with which each line begins.
        """
        self._command = command
        self._lock = Lock()

    def debug(self, message: str, /) -> None:
        """Discard a detail for developers."""

    def info(self, message: str, /) -> None:
        """Write normal progress."""
        with self._lock:
            print(f'{self._command}: {message}\n', end='', file=sys.stderr, flush=True)

    def warning(self, message: str, /) -> None:
        """Write a possible problem."""
        self.info(f'warning: {message}')

    def error(self, message: str, /) -> None:
        """Write a failure."""
        self.info(f'error: {message}')


class Log:
    """
    Write printable lines; thread-safe.

    With ``once``, only the first line of this key is written, until ``forget``. With ``every``,
    one line of ``key`` is written in this number of seconds; the default key is the line itself.
    All methods return whether the line was written.
    """

    def __init__(self, writer: LineWriter) -> None:
        """
        Create a log.

        :param writer: destination of the lines.
        """
        self._writer = writer
        self._throttle = Throttle()

    # Each method has its own call, because rclpy refuses two severities from one line of code.

    def debug(self, text: str, *, once: str = '', every: float = 0.0, key: str = '') -> bool:
        """Log a detail for developers."""
        if line := self._line(text, once, every, key):
            self._writer.debug(line)
        return bool(line)

    def info(self, text: str, *, once: str = '', every: float = 0.0, key: str = '') -> bool:
        """Log normal progress."""
        if line := self._line(text, once, every, key):
            self._writer.info(line)
        return bool(line)

    def warning(self, text: str, *, once: str = '', every: float = 0.0, key: str = '') -> bool:
        """Log a possible problem."""
        if line := self._line(text, once, every, key):
            self._writer.warning(line)
        return bool(line)

    def error(self, text: str, *, once: str = '', every: float = 0.0, key: str = '') -> bool:
        """Log a failure."""
        if line := self._line(text, once, every, key):
            self._writer.error(line)
        return bool(line)

    def forget(self, key: str) -> None:
        """Write the next line of a key."""
        self._throttle.forget(key)

    def _line(self, text: str, once: str, every: float, key: str) -> str:
        """Return the printable line without passwords, '' if it is left out."""
        line = without_password(text, _MAX_LINE)
        if once:
            return line if self._throttle.passes(once) else ''
        return line if not every or self._throttle.passes(key or line, every) else ''


@contextmanager
def log_if_slow(log: Log, text: str, seconds: float = _SLOW_SECONDS) -> Iterator[None]:
    """
    Log a line from another thread if the work within the context takes long.

    :param text: what takes long; '' for no line.
    :param seconds: time until the line.
    """
    timer = Timer(seconds, log.info, [text])
    timer.daemon = True
    if text:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
