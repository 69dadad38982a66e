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

"""Closed and broken standard streams of a process."""

from __future__ import annotations

import itertools
import os
from pathlib import Path
import subprocess
import sys

from closed_streams import CLOSED, closing
import pytest
from waiting import LONGEST_SECONDS


@pytest.mark.process
@pytest.mark.parametrize('closed', [
    chosen for count in range(1, 4) for chosen in itertools.combinations(CLOSED, count)])
def test_closed_stream_is_opened_as_dev_null(closed: tuple[str, ...], tmp_path: Path) -> None:
    script = ('import os, sys\n'
              'links = [f"/proc/self/fd/{number}" for number in range(3)]\n'
              'before = {link for link in links if os.path.exists(link)}\n'
              'from opencv_tools.base.standard_streams import open_standard_streams\n'
              'open_standard_streams()\n'
              'for link in links:\n'
              '    told = os.readlink(link)\n'
              '    assert (told == "/dev/null") is (link not in before), (link, told)\n'
              'file = open(sys.argv[1], "w")\n'
              'assert file.fileno() > 2\n'
              'print("lost"); print("lost", file=sys.stderr); assert sys.stdin.read() == ""\n'
              'assert not sys.stderr.isatty()\n'
              'file.write("done"); file.close()\n')
    path = tmp_path / 'file'
    subprocess.run([*closing(*closed), sys.executable, '-c', script, str(path)], input='',
                   capture_output=True, text=True, timeout=LONGEST_SECONDS, check=True)
    assert path.read_text() == 'done'


@pytest.mark.process
@pytest.mark.parametrize('stream', ['stdout', 'stderr'])
def test_lost_terminal_does_not_change_the_exit_status(
        stream: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv('PYTHONUNBUFFERED', raising=False)
    code = ('import sys\n'
            'from opencv_tools.base.standard_streams import discard_broken_streams\n'
            'sys.stdin.readline()\n'
            f'sys.{stream}.write("no line")\n'
            'discard_broken_streams()\n')
    read, write = os.pipe()
    with subprocess.Popen([sys.executable, '-c', code], stdin=subprocess.PIPE, stdout=write,
                          stderr=write) as process:
        os.close(write)
        os.close(read)
        process.communicate(b'\n', timeout=LONGEST_SECONDS)
    assert process.returncode == 0
