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

"""Processes whose modules are imported once for all tests of a worker, see `prepared_python`."""

from __future__ import annotations

import atexit
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
import json
import os
from pathlib import Path
import select
import signal
import socket
import subprocess
import sys
from typing import IO

#: Programs, and the modules that each one imports in every case.
_MODULES = {
    'img_filter': ('opencv_tools.image_filter',),
    'img_publisher': ('opencv_tools.basic_image_publisher',),
    'img_subscriber': ('opencv_tools.basic_image_subscriber',),
    'img_viewer': ('opencv_tools.image_viewer', 'opencv_tools.viewer.server'),
    'numbered_nodes.py': ('numbered_nodes',)}
#: Beginnings of variables that have an effect before or during the imports.
_EARLY = ('OPENCV_TOOLS_TRANSPORT', 'PYTHON', 'LD_', 'OPENBLAS', 'MALLOC_', 'LANG', 'LC_', 'OMP_')


class PreparedProcess:
    """A process of `PreparedPython`, with the interface of `subprocess.Popen`."""

    def __init__(self, pid: int, result: int, stdin: IO[bytes] | None) -> None:
        self.pid = pid
        self.stdin = stdin
        self.returncode: int | None = None
        self._result = result

    def poll(self) -> int | None:
        """Return the exit status, -N after signal N; None while the process runs."""
        with suppress(subprocess.TimeoutExpired):
            self.wait(0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end and return the exit status."""
        if self.returncode is None:
            if not select.select([self._result], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
            self.returncode = int(os.read(self._result, 16))
            os.close(self._result)
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send a signal to a process that runs."""
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)


class PreparedPython:
    """A process that has imported the modules of a program, and starts the program."""

    def __init__(self, modules: Sequence[str]) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, str(Path(__file__).with_name('prepared_python.py')), *modules],
                stdin=theirs, stdout=subprocess.DEVNULL, start_new_session=True)

    def start(self, command: Sequence[str], folder: Path, environment: Mapping[str, str],
              streams: Sequence[int], is_terminal: bool) -> tuple[int, int]:
        """Return the process id, and the descriptor from which its exit status can be read."""
        result, theirs = os.pipe()
        request = {'command': list(command), 'folder': str(folder),
                   'environment': dict(environment), 'is_terminal': is_terminal}
        socket.send_fds(self._socket, [json.dumps(request).encode()], [*streams, theirs])
        os.close(theirs)
        answer = self._socket.recv(16)
        assert answer, 'the prepared Python has ended, see its error above'
        return int(answer), result

    def close(self) -> None:
        """End the process."""
        self._socket.close()
        self._process.wait()


class PreparedPrograms:
    """The prepared processes of a worker, each created for the first start of its program."""

    def __init__(self) -> None:
        self._early = _early(os.environ)
        self._pythons: dict[str, PreparedPython] = {}
        atexit.register(self._close)

    def start(self, command: Sequence[str], folder: Path, *, stdin: int, output: int,
              environment: Mapping[str, str] | None = None, is_terminal: bool = False,
              ) -> PreparedProcess | None:
        """
        Start a program.

        :param stdin: standard input, or `subprocess.PIPE`.
        :param output: standard output and standard error.
        :param environment: None for that of this process.
        :param is_terminal: whether ``stdin`` is a terminal, which shall control the process.
        :returns: None for another program, or if the environment differs in what affects imports.
        """
        if command[0] == sys.executable:
            command = command[1:]
        name = Path(command[0]).name
        environment = os.environ if environment is None else environment
        if name not in _MODULES or _early(environment) != self._early:
            return None
        if name not in self._pythons:
            self._pythons[name] = PreparedPython(_MODULES[name])
        writer: IO[bytes] | None = None
        if stdin == subprocess.PIPE:
            stdin, writing = os.pipe()
            writer = os.fdopen(writing, 'wb')
        try:
            started = self._pythons[name].start(
                command, folder, environment, (stdin, output, output), is_terminal)
        finally:
            if writer:
                os.close(stdin)
        return PreparedProcess(*started, writer)

    def _close(self) -> None:
        """End the prepared processes, whose programs have ended before."""
        for python in self._pythons.values():
            python.close()


@cache
def programs() -> PreparedPrograms:
    """Return the prepared processes of this worker, which end with it."""
    return PreparedPrograms()


def _early(environment: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if name.startswith(_EARLY)}
