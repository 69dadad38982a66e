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

"""Executables of the package on a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
import pty
import select
import subprocess

from conftest import executable
from waiting import status_of, wait_until, work_of


class Terminal:
    """A process whose standard output and error are a terminal of 120 columns."""

    def __init__(self, command: list[str]) -> None:
        self.text = ''
        self._master, slave = pty.openpty()
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=slave, stderr=slave,
            env={**os.environ, 'COLUMNS': '120'})
        os.close(slave)

    def wait_for(self, words: str) -> None:
        """Wait for a text on the terminal."""
        while words not in self.text:
            assert self._read(), f'ended before {words!r}:\n{self.text}'

    def finish(self) -> int:
        """Read all that the process prints, and return its exit status."""
        while self._read():
            pass
        return status_of(self._process)

    def close(self) -> None:
        """End the process by SIGTERM, or by SIGKILL after 5 s."""
        self._process.terminate()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._master)

    def _read(self) -> bool:
        """Read what is printed next; return whether the process may print more."""
        wait_until(lambda: select.select([self._master], [], [], 0)[0], f'text after {self.text}',
                   work=lambda: work_of(self._process.pid))
        try:
            self.text += os.read(self._master, 1 << 16).decode(errors='replace')
        except OSError:  # the other end is closed
            return False
        return True


@contextmanager
def on_terminal(name: str, *words: str, **parameters: object) -> Iterator[Terminal]:
    """Start an executable on a terminal; it ends with the block."""
    given = [word for key, value in parameters.items() for word in ('-p', f'{key}:={value}')]
    terminal = Terminal([executable(name), '--ros-args', *words, *given])
    try:
        yield terminal
    finally:
        terminal.close()
