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

"""Ends at signals: exit status, signals during imports, ignored signals."""

from __future__ import annotations

from pathlib import Path
import signal
import subprocess
import sys

import pytest
from waiting import LONGEST_SECONDS

pytestmark = pytest.mark.process

END = """
import os, signal, sys, time
from opencv_tools.base.signals import end_at_signals

def send(name):
    os.kill(os.getpid(), getattr(signal, name))
    time.sleep(0)  # the handler runs at a call, at the latest

def command():
    {body}

status = end_at_signals(command, {arguments})
send('SIGINT')  # ignored
sys.exit(status)
"""


def run(body: str, arguments: str = '', within: tuple[str, ...] = (),
        folder: Path | None = None) -> int:
    """Return the exit status of a command, which must not print anything."""
    finished = subprocess.run(
        [*within, sys.executable, '-c', END.format(body=body, arguments=arguments)],
        capture_output=True, text=True, cwd=folder, timeout=LONGEST_SECONDS, check=False)
    assert not finished.stdout + finished.stderr
    return finished.returncode


def test_status_of_the_command() -> None:
    assert run('return 7') == 7


@pytest.mark.parametrize('name', ['SIGINT', 'SIGTERM', 'SIGHUP'])
@pytest.mark.parametrize(('arguments', 'status'), [('', None), ('status=0', 0)])
def test_status_after_a_signal(name: str, arguments: str, status: int | None) -> None:
    expected = 128 + getattr(signal, name) if status is None else status
    assert run(f"send('{name}'); return 7", arguments) == expected


def test_signal_before_the_command() -> None:
    script = """
import os, signal, sys
from opencv_tools.base.signals import end_at_signals


def handle(number, handler, handle=signal.signal):
    handle(number, handler)
    os.kill(os.getpid(), number)

signal.signal = handle
sys.exit(end_at_signals(lambda: 7))
"""
    finished = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                              timeout=LONGEST_SECONDS, check=False)
    assert (finished.returncode, finished.stderr) == (130, '')


def test_signal_after_the_command() -> None:
    # The handler runs at the call that would end the handling of signals.
    assert run('sys.settrace(lambda frame, event, _: '
               "send('SIGINT') if frame.f_code.co_name == 'end' else None); return 7") == 130


@pytest.mark.parametrize(('arguments', 'status'), [('', 130), ('status=0', 0)])
def test_import_that_discards_exceptions(arguments: str, status: int, tmp_path: Path) -> None:
    (tmp_path / 'discarding.py').write_text(
        "import __main__\ntry: __main__.send('SIGINT')\nexcept: pass\n")
    assert run('import discarding; return 7', arguments, folder=tmp_path) == status


@pytest.mark.parametrize(('arguments', 'status'), [('', 7), ('ignorable=()', 129)])
def test_ignored_hangup(arguments: str, status: int) -> None:
    within = ('sh', '-c', 'trap "" HUP && exec "$0" "$@"')
    assert run("send('SIGHUP'); return 7", arguments, within) == status
