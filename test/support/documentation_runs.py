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

"""Runs of the blocks of the documentation, each in a copy of the project with a home of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
import time

from conftest import DEADLINE, executable
from documentation import ROOT
from documented_commands import PARAMETERS, ROBOT_COMMANDS

#: Time of the copied files. No stamp of make is older, so that make installs nothing.
LONG_AGO = 1_000_000_000
#: Line of a node that has published or received a frame.
FRAME = re.compile(r'video frame \d')

# PyPI has no ros2 command, and a container often has no sudo.
_ROS2 = """#!/bin/bash
[ "$1 $2" = 'run opencv_tools' ] && exec "${@:3}"
echo "ros2 $1 is not on PyPI: mark the block with 'needs ros'" >&2
exit 1
"""
_SUDO = '#!/bin/bash\nexec "$@"\n'


def copy_project(folder: Path) -> Path:
    """
    Copy the files of the project, without those that git ignores, and lend it the environment.

    :param folder: a new folder for the copy, for the home and for stand-ins of commands.
    :returns: the root of the copy.
    """
    ignored = (line.strip('/\n') for line in (ROOT / '.gitignore').open())
    root = folder / 'opencv_tools'
    shutil.copytree(ROOT, root, copy_function=_copy_file, symlinks=True,
                    ignore=shutil.ignore_patterns('.git', *ignored))
    (root / '.venv').mkdir()
    for path in Path(sys.prefix).iterdir() if sys.prefix != sys.base_prefix else ():
        (root / '.venv' / path.name).symlink_to(path)
    for stamp in ('ready', 'installed', 'dev', 'docs'):
        if not (root / '.venv' / stamp).exists():
            (root / '.venv' / stamp).touch()
    (folder / 'bin').mkdir()
    for name in (*PARAMETERS, *ROBOT_COMMANDS):
        (folder / 'bin' / name).symlink_to(executable(name))
    for name, text in (('ros2', _ROS2), ('sudo', _SUDO)):
        if shutil.which(name) is None:
            (folder / 'bin' / name).write_text(text)
            (folder / 'bin' / name).chmod(0o755)
    (folder / 'home').mkdir()
    return root


def _copy_file(source: str, target: str) -> str:
    shutil.copy(source, target)
    os.utime(target, (LONG_AGO, LONG_AGO))
    return target


def environment(root: Path) -> Mapping[str, str]:
    """Return the variables of the blocks in a copy of the project."""
    folders = (str(root.parent / 'bin'), str(Path(sys.executable).parent), os.environ['PATH'])
    return {**os.environ, 'PATH': os.pathsep.join(folders), 'HOME': str(root.parent / 'home'),
            'PYTHONPATH': os.pathsep.join((str(ROOT), os.environ.get('PYTHONPATH', ''))),
            'PYTHONUNBUFFERED': '1', 'PIP_NO_INDEX': '1'}


def run(command: Sequence[str], root: Path, seconds: float = 0,
        is_ready: Callable[[str], bool] = lambda output: bool(FRAME.search(output)),
        ) -> tuple[int, str]:
    """
    Run a command in a copy of the project, and end everything that it has started.

    :param command: the command.
    :param root: the copy.
    :param seconds: time after which Ctrl-C follows; 0 to wait for the end.
    :param is_ready: whether Ctrl-C may come earlier, by the output.
    :returns: exit status, and the output of the command and of what it started.
    """
    log = root.parent / 'output.log'
    with log.open('w') as console:
        process = subprocess.Popen(
            command, cwd=root, env=environment(root), stdin=subprocess.DEVNULL, stdout=console,
            stderr=subprocess.STDOUT, start_new_session=True)
    try:
        _wait(process, log, seconds, is_ready)
    finally:
        _end_session(process)
    return process.returncode, log.read_text()


def _wait(process: subprocess.Popen[bytes], log: Path, seconds: float,
          is_ready: Callable[[str], bool]) -> None:
    """Wait for the end of a process, and interrupt its group when that is due."""
    begin = interrupted = time.monotonic()
    seen = 0
    while process.poll() is None:
        now = time.monotonic()
        if now > begin + DEADLINE:
            raise AssertionError(f'did not end:\n{log.read_text()}')
        if seconds and (now > interrupted + seconds or is_ready(log.read_text()[seen:])):
            os.killpg(process.pid, signal.SIGINT)
            interrupted, seen = now, len(log.read_text())
        time.sleep(0.02)


def _end_session(process: subprocess.Popen[bytes]) -> None:
    """End the processes in the session of a process, those in the background too."""
    begin = time.monotonic()
    while members := _members(process.pid):
        number = signal.SIGTERM if time.monotonic() < begin + 10 else signal.SIGKILL
        for pid in members:
            with suppress(ProcessLookupError):
                os.kill(pid, number)
        time.sleep(0.1)
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


def matches(expected: str, output: str) -> bool:
    """Return whether an output has the expected lines; ``...`` stands for any text or lines."""
    pattern = ''.join(
        r'(?:.*\n)*?' if line.strip() == '...'
        else re.escape(line.rstrip()).replace(re.escape('...'), '.*') + r'[ \t]*\n'
        for line in expected.splitlines())
    return re.fullmatch(pattern, output if output.endswith('\n') or not output else f'{output}\n'
                        ) is not None
