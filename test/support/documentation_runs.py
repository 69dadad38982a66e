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

"""Runs of blocks of the documentation, each in a copy of the project with its own home."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from conftest import executable
from documentation import add_stand_ins, copy_used, ROOT
from documented_commands import COMMANDS, PARAMETERS
from waiting import pause, wait_until, work_of


def copy_project(folder: Path) -> Path:
    """
    Copy the files of the project that the pages use.

    :param folder: a new folder for the copy, for the home and for commands.
    :returns: the root of the copy.
    """
    root = folder / 'opencv_tools'
    copy_used(root)
    (folder / 'bin').mkdir()
    for name in (*PARAMETERS, *COMMANDS):
        (folder / 'bin' / name).symlink_to(executable(name))
    add_stand_ins(folder / 'bin')
    (folder / 'home').mkdir()
    return root


def environment(root: Path) -> dict[str, str]:
    """Return the variables of the blocks in a copy of the project."""
    folders = (str(root.parent / 'bin'), str(Path(sys.executable).parent), os.environ['PATH'])
    outer = {name: value for name, value in os.environ.items() if not name.startswith('MAKE')}
    return {**outer, 'PATH': os.pathsep.join(folders), 'HOME': str(root.parent / 'home'),
            'PYTHONPATH': os.pathsep.join((str(ROOT), os.environ.get('PYTHONPATH', ''))),
            'PYTHONUNBUFFERED': '1', 'PIP_NO_INDEX': '1',
            'ROS_DISTRO': 'jazzy'}  # so make installs nothing


def run(command: Sequence[str], root: Path, until: str = '') -> tuple[int, str]:
    """
    Run a command in a copy of the project, and end everything that it has started.

    :param command: the command and its arguments.
    :param root: the copy, which is its working directory.
    :param until: text in the output after which Ctrl-C follows; '' for no Ctrl-C.
    :returns: exit status, and the output of the command and of what it started.
    """
    log = root.parent / 'output.log'
    with log.open('w') as console:
        process = subprocess.Popen(
            command, cwd=root, env=environment(root), stdin=subprocess.DEVNULL, stdout=console,
            stderr=subprocess.STDOUT, start_new_session=True)
    try:
        _wait(process, log, until)
    finally:
        _end_session(process)
    return process.returncode, log.read_text()


def _wait(process: subprocess.Popen[bytes], log: Path, until: str) -> None:
    """Wait for the end of a process, and interrupt its group after each line with a text."""
    seen = 0

    def has_ended() -> bool:
        nonlocal seen
        output = log.read_text()
        if until and until in output[seen:] and process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)
            seen = len(output)
        return process.poll() is not None

    wait_until(has_ended, f'the end of {process.args!r}', output=lambda: log.stat().st_size,
               work=lambda: work_of(process.pid))


def _end_session(process: subprocess.Popen[bytes]) -> None:
    """End the processes in the session of a process, those in the background too."""
    begin = time.monotonic()
    asked: set[int] = set()
    while members := set(_members(process.pid)):
        is_late = time.monotonic() > begin + 10
        for pid in members if is_late else members - asked:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL if is_late else signal.SIGTERM)
        asked |= members
        pause(0.05)
        process.poll()


def _members(session: int) -> list[int]:
    """Return the running processes of a session."""
    found = []
    for path in Path('/proc').glob('[0-9]*/stat'):
        with suppress(OSError):
            state, _, _, number = path.read_text().rpartition(')')[2].split()[:4]
            if int(number) == session and state != 'Z':
                found.append(int(path.parent.name))
    return found
