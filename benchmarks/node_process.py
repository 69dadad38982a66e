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

"""A node in its own process."""

from __future__ import annotations

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

START_SECONDS = 30.0
_POLL_SECONDS = 0.02
_MODULES = {'filter': 'image_filter', 'publisher': 'basic_image_publisher',
            'subscriber': 'basic_image_subscriber', 'viewer': 'image_viewer'}

# Each test has a domain from 1 to 100; the namespace keeps one benchmark from another.
_DOMAIN = {'ROS_DOMAIN_ID': '101', 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
NAMESPACE = f'/benchmark_{os.getpid()}'


def enter_domain() -> None:
    """Isolate this process and its nodes in a ROS domain; SIGTERM ends them like Ctrl-C."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    os.environ.update(_DOMAIN)


class NodeProcess:
    """One of the package's nodes, its console, and the CPU it takes."""

    def __init__(self, name: str, folder: Path, **parameters: object) -> None:
        """
        Start it, with its console in a file.

        :param name: ``publisher``, ``subscriber``, ``viewer`` or ``filter``.
        :param folder: where the file is.
        :param parameters: of the node.
        """
        command = [sys.executable, '-m', f'opencv_tools.{_MODULES[name]}', '--ros-args',
                   '-r', f'__ns:={NAMESPACE}']
        for parameter, value in parameters.items():
            command += ['-p', f'{parameter}:={value}']
        self.name = name
        self._console = folder / f'{name}.log'
        with self._console.open('w') as lines:
            self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=lines)

    def console(self) -> str:
        """Console output so far."""
        return self._console.read_text()

    def wait_for(self, phrase: str) -> None:
        """Wait until it says something."""
        deadline = time.monotonic() + START_SECONDS
        while phrase not in self.console():
            if self.process.poll() is not None or time.monotonic() > deadline:
                raise SystemExit(f'the {self.name} did not say {phrase!r}:\n{self.console()}')
            time.sleep(_POLL_SECONDS)

    def cpu(self) -> float:
        """Return the CPU time in s, user and system, of all threads of the running process."""
        # The clock that clock_getcpuclockid(3) gives; /proc/PID/stat has the same in 10 ms steps.
        return time.clock_gettime((~self.process.pid << 3) | 2)

    def end(self) -> int:
        """End it in any case; the exit status."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(START_SECONDS)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()
