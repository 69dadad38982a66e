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

"""Processes of Python that do one piece of work, with limits of memory and processor time."""

from __future__ import annotations

import asyncio
from asyncio.subprocess import DEVNULL, PIPE, Process
from contextlib import suppress
import os
import resource
import sys

_NICE = 5  # what the process that waits does is more urgent


def worker_command(module: str, *arguments: str) -> list[str]:
    """
    Return the command of a process that calls ``main`` of a module.

    It imports from the same folders as this process. The working directory, which -m and -c add
    to the path, may have any modules.

    :param arguments: ``sys.argv[1:]`` of the process.
    """
    folders = [*map(str, sys.path)]
    script = f'import sys; sys.path[:] = {folders!r}; from {module} import main; main()'
    return [sys.executable or 'python3', '-c', script, *arguments]


def restrict(limit: int, soft: int, hard: int | None = None) -> None:
    """Lower a limit of `resource` for this process; a lower limit stays as it is."""
    _, maximum = resource.getrlimit(limit)
    hard = soft if hard is None else hard
    if maximum != resource.RLIM_INFINITY:
        soft, hard = min(soft, maximum), min(hard, maximum)
    with suppress(OSError, ValueError):  # some systems do not support every limit
        resource.setrlimit(limit, (soft, hard))


def begin_work(memory: int = 0, seconds: int = 0) -> None:
    """
    Limit this process, and let other processes go first.

    :param memory: bytes of address space, including Python and its modules; 0 for no limit.
    :param seconds: processor time; 0 for no limit.
    """
    os.nice(_NICE)
    if memory:
        restrict(resource.RLIMIT_AS, memory)
    if seconds:
        restrict(resource.RLIMIT_CPU, seconds)


class Worker:
    """A process for a server: it gets bytes, answers with bytes, and can be ended."""

    def __init__(self) -> None:
        self._process: Process | None = None

    async def run(self, command: list[str], data: bytes, seconds: float) -> bytes:
        """
        Return what the process has written when it ends; less, or b'', if it was killed.

        :param command: a result of `worker_command`.
        :param seconds: elapsed time after which it is killed.
        :raises asyncio.TimeoutError: the time was over.
        """
        self._process = await asyncio.create_subprocess_exec(
            *command, stdin=PIPE, stdout=PIPE, stderr=DEVNULL, start_new_session=True)
        try:
            return (await asyncio.wait_for(self._process.communicate(data), seconds))[0]
        finally:
            self.close()

    @property
    def is_running(self) -> bool:
        """Whether there is a process that has not ended."""
        return self._process is not None and self._process.returncode is None

    def close(self) -> None:
        """End the process."""
        if self._process and self.is_running:
            with suppress(ProcessLookupError):
                self._process.kill()
