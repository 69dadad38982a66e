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

"""A process with a journal, and a console that is a file or a terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
import os
from pathlib import Path
import pty
import re
import signal
import subprocess
from threading import Thread

from conftest import created_segments, is_fastdds
from prepared import programs
from waiting import wait_until, work_of

_COLOUR = re.compile('\x1b\\[[0-9;]*m')
_SHARED_FILE = re.compile(r'/dev/shm/\S*(?:fast(?:rtps|dds)_[0-9a-f]{16}|opencv_tools_\S+)')


def shared_files(process: Path) -> set[Path]:
    """Return the files in /dev/shm that a process uses; it is a folder of /proc."""
    with suppress(OSError):
        opened = [str(link.readlink()) for link in process.joinpath('fd').iterdir()]
        used = '\n'.join([process.joinpath('maps').read_text(), *opened])
        return {Path(name) for name in _SHARED_FILE.findall(used)}
    return set()


@dataclass(frozen=True)
class Event:
    """A line of a journal."""

    time: float
    name: str
    words: tuple[str, ...]


class Child:
    """A process with a console, which is a file or a terminal, and a journal."""

    def __init__(self, name: str, command: Sequence[str], folder: Path, *,
                 on_terminal: bool = False) -> None:
        self.journal = folder / f'{name}.journal'
        #: Files in /dev/shm that the process has used.
        self.shared_files: set[Path] = set()
        self._console = folder / f'{name}.log'
        self._console.touch()
        self._terminal = -1
        if on_terminal:
            self._terminal, slave = pty.openpty()
            self._process = programs().start(
                command, folder, stdin=slave, output=slave, is_terminal=True,
            ) or subprocess.Popen(
                ['setsid', '--ctty', *command], stdin=slave, stdout=slave, stderr=slave,
                cwd=folder)
            os.close(slave)
            self._copier = Thread(target=self._copy_terminal)
            self._copier.start()
        else:
            with self._console.open('w') as console:
                self._process = programs().start(
                    command, folder, stdin=subprocess.PIPE, output=console.fileno(),
                ) or subprocess.Popen(
                    command, stdin=subprocess.PIPE, stdout=console, stderr=subprocess.STDOUT,
                    cwd=folder)

    def _copy_terminal(self) -> None:
        """Copy the console until the process ends, because a full terminal blocks the process."""
        with self._console.open('wb', buffering=0) as file, suppress(OSError):
            while data := os.read(self._terminal, 1 << 16):
                file.write(data)

    @property
    def output(self) -> str:
        return _COLOUR.sub('', self._console.read_text(errors='replace'))

    def events(self, name: str = '') -> list[Event]:
        """Return the whole lines of the journal, or those with a name."""
        with suppress(FileNotFoundError):
            text = self.journal.read_text()
            lines = (line.split(' ') for line in text[:text.rfind('\n') + 1].splitlines())
            return [Event(float(at), found, tuple(words)) for at, found, *words in lines
                    if name in ('', found)]
        return []

    def wait_for(self, condition: Callable[[], bool], name: str) -> None:
        """Wait for a condition while the process runs."""
        def is_met() -> bool:
            met = condition()
            assert met or self.is_running(), f'ended before {name}:\n{self.output}'
            return met

        wait_until(is_met, name, **self._counters())

    def _counters(self) -> dict[str, Callable[[], object]]:
        """Return what grows while the process makes progress."""
        return {'journal': lambda: len(self.events()),
                'output': lambda: self._console.stat().st_size,
                'work': lambda: work_of(self._process.pid)}

    def is_running(self) -> bool:
        """Return whether the process is running."""
        return self._process.poll() is None

    def signal(self, number: int) -> None:
        """Send a signal."""
        self.find_shared_files()
        self._process.send_signal(number)

    def press_ctrl_c(self) -> None:
        """Interrupt the process: on a terminal by the key."""
        self.find_shared_files()
        if self._terminal < 0:
            self._process.send_signal(signal.SIGINT)
        else:
            os.write(self._terminal, b'\x03')

    def finish(self) -> int:
        """Return the exit status, -N after signal N."""
        self.find_shared_files()
        wait_until(lambda: not self.is_running(), f'the end of {self.journal.stem}',
                   **self._counters())
        self._close()
        return self._process.returncode

    def kill(self) -> None:
        """End the process if it is running."""
        self.find_shared_files()
        self._process.kill()
        self._process.wait()
        self._close()

    def find_shared_files(self) -> None:
        """Add the files in /dev/shm that the process uses now, of Fast DDS those it created."""
        created = created_segments(self._process.pid)
        self.shared_files |= {path for path in shared_files(Path(f'/proc/{self._process.pid}'))
                              if path in created or not is_fastdds(path)}

    def _close(self) -> None:
        if self._process.stdin:
            with suppress(BrokenPipeError):
                self._process.stdin.close()
        if self._terminal >= 0:
            self._copier.join()
            os.close(self._terminal)
            self._terminal = -1

    def order(self, line: str) -> None:
        """Write a line to the standard input."""
        assert self._process.stdin
        self._process.stdin.write(f'{line}\n'.encode())
        self._process.stdin.flush()
