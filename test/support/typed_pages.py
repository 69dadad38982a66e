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

"""
The pages of the documentation, each typed into one shell on a terminal from top to bottom.

No library of the tests is necessary, so this is what a user of ``make demo`` can do.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
import os
from pathlib import Path
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile

import cv2
from documentation import (
    add_stand_ins, Block, copy_used, matches, NOTHING_DONE, PAGES, read_blocks, ROOT)
import numpy as np
from opencv_tools.capture.source import open_source
from waiting import status_of, wait_until, work_of

_PROMPT = re.compile(r'<status (\d+)> ')
_CTRL_C = b'\x03'


class Shell:
    """An interactive shell on a terminal; its prompt is the exit status of the last command."""

    def __init__(self, folder: Path, environment: Mapping[str, str]) -> None:
        self._later = ''
        self._master, slave = pty.openpty()
        self._process = subprocess.Popen(
            ['bash', '--norc', '--noediting', '-i'], cwd=folder, stdin=slave, stdout=slave,
            stderr=slave, env={**environment, 'TERM': 'dumb'}, start_new_session=True,
            preexec_fn=lambda: os.close(os.open(os.ttyname(0), os.O_RDWR)))  # its own terminal
        os.close(slave)
        self.enter("stty -echo; PS1='<status $?> ' PS2=''")

    def enter(self, command: str, until: str = '') -> tuple[int, str]:
        """
        Type a command and wait for the prompt.

        :param command: line of the shell.
        :param until: text in the output after which Ctrl-C follows; '' for no Ctrl-C.
        :returns: exit status and output, with that of processes in the background.
        """
        os.write(self._master, f'{command}\n'.encode())
        output, self._later = self._later, ''
        while (prompt := _PROMPT.search(output)) is None:
            wait_until(lambda: select.select([self._master], [], [], 0)[0],
                       f'the end of {command!r} after {output!r}',
                       work=lambda: work_of(self._process.pid))
            output += os.read(self._master, 1 << 16).decode(errors='replace').replace('\r', '')
            if until and until in output:
                os.write(self._master, _CTRL_C)
                until = ''
        self._later = output[prompt.end():]  # of processes in the background
        return int(prompt[1]), output[:prompt.start()]

    def close(self) -> None:
        """End the shell, which ends its processes in the background."""
        self._process.send_signal(signal.SIGHUP)
        status_of(self._process)
        os.close(self._master)


def type_page(page: Path, folder: Path, environment: Mapping[str, str]) -> None:
    """
    Type the blocks of a page into one shell.

    :param page: path of the page in the project.
    :param folder: copy of the project, the working directory.
    :param environment: variables of the shell.
    :raises AssertionError: a command fails, prints other lines than the page shows, or leaves a
        process in the background.
    """
    shell = Shell(folder, environment)
    try:
        for block in read_blocks(page):
            if block.file:
                (folder / block.file).write_text(block.code)
            elif _is_typed(block):
                _type_block(block, shell)
    finally:
        shell.close()


def _is_typed(block: Block) -> bool:
    """Return whether this machine can run a block and would be the same afterwards."""
    return (block.language in ('bash', 'console') and block.is_run
            and 'needs root' not in block.marks
            and ('ros2 launch' not in block.code or shutil.which('ros2') is not None))


def _type_block(block: Block, shell: Shell) -> None:
    """Type the commands of a block, and check what they print and leave behind."""
    for command, shown in block.commands():
        is_long = block.until and not command.endswith('&') and not command.startswith('kill')
        status, output = shell.enter(command, block.until if is_long else '')
        text = f'{block.name}: {command} prints\n{output}'
        assert status == 0 and 'Traceback' not in output, f'{text}\nand ends with {status}'
        assert NOTHING_DONE.search(output) is None, f'{text}\nso there is nothing to see'
        assert block.language != 'console' or matches(shown, output), f'{text}\nnot\n{shown}'
    shell.enter('wait')
    assert shell.enter('jobs')[1] == '', block.name


def check_readme(folder: Path) -> None:
    """Check what the commands of README.md have left behind."""
    with closing(open_source(str(ROOT / 'test' / 'data' / 'big_buck_bunny_720p.mp4'))) as clip:
        for path in sorted(folder.glob('frames/*.png')):
            frame = clip.read()
            assert frame and np.array_equal(cv2.imread(str(path)), frame.image), path
        assert clip.read() is None, 'frames are missing'
    assert len([*folder.glob('mirrored/*.png')]) == 10


def main() -> None:
    """Type the named pages or all, each into a shell and a copy of the project of its own."""
    # The shells inherit that a script in the background ignores Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    outer = {name: value for name, value in os.environ.items() if not name.startswith('MAKE')}
    for page in map(Path, sys.argv[1:]) if sys.argv[1:] else PAGES:
        print(f'Typing {page}', flush=True)
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary, 'opencv_tools')
            copy_used(folder)
            stand_ins = Path(temporary, 'bin')
            stand_ins.mkdir()
            add_stand_ins(stand_ins)
            type_page(page, folder, {
                **outer, 'PATH': f'{stand_ins}:{outer["PATH"]}', 'HOME': temporary,
                'ROS_DISTRO': 'jazzy'})  # so make installs nothing
            if page.name == 'README.md':
                check_readme(folder)


if __name__ == '__main__':
    main()
