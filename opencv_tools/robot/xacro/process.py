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
Files of xacro, expanded in a process of their own.

The expressions in a file are Python, which nothing in the same process can end for certain. This
process has limits for its memory and its time.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
import json
import os
import resource
import signal
import subprocess
import sys
from types import FrameType

from opencv_tools.robot.xacro.errors import TOO_LARGE, XacroProblem
from opencv_tools.robot.xacro.expand import expand
from opencv_tools.robot.xml.document import DescriptionError, display_name, MAX_BYTES
from opencv_tools.robot.xml.report import Note, Report

# The modules are those of this process, wherever it has them from.
_START = ('import sys; sys.path[:] = sys.argv[1:]; '
          'from opencv_tools.robot.xacro.process import main; main()')
_REPLY = b'\0'  # after what else may have been written, by sitecustomize for example


@dataclass(frozen=True)
class Limits:
    """
    What the process may use.

    :param memory: bytes, those of Python and its modules too.
    :param seconds: of processor time.
    :param wait: seconds until it has to be done, also where it waits for something.
    :param grace: seconds beyond each, in which it can say where it was.
    """

    memory: int = 1_500_000_000
    seconds: int = 20
    wait: float = 30.0
    grace: int = 5

    def impose(self) -> None:
        """Limit this process. Reaching a limit raises an `XacroProblem`."""
        signal.signal(signal.SIGXCPU, self._end)
        signal.signal(signal.SIGALRM, self._end)
        _restrict(resource.RLIMIT_CORE, 0)
        _restrict(resource.RLIMIT_AS, self.memory)
        _restrict(resource.RLIMIT_CPU, self.seconds, self.seconds + self.grace)
        # Again and again: xacro goes on after some errors.
        signal.setitimer(signal.ITIMER_REAL, self.wait, 1.0)

    def _end(self, number: int, _: FrameType | None) -> None:
        raise XacroProblem(self.too_slow if number == signal.SIGXCPU else self.too_late)

    @property
    def too_slow(self) -> str:
        """Return the message for too much processor time."""
        return (f'takes more than {self.seconds} s of processor time to expand; look for an '
                'expression that does not end')

    @property
    def too_late(self) -> str:
        """Return the message for too long a wait."""
        return (f'is not expanded after {self.wait:g} s; look for an expression that does not end '
                'or a file that cannot be read')


LIMITS = Limits()


def expand_apart(path: str, data: bytes, arguments: Mapping[str, str], report: Report,
                 limits: Limits = LIMITS) -> bytes:
    """
    Expand a file of xacro as `expand` does, in a process of its own.

    :param limits: of that process.
    :raises DescriptionError: it cannot be expanded, or not within the limits.
    """
    source = display_name(path)
    request = json.dumps({'path': path, 'arguments': dict(arguments), 'source': report.source,
                          'limits': asdict(limits)})
    try:
        done = subprocess.run(
            [sys.executable or 'python3', '-c', _START, *map(str, sys.path)],
            input=request.encode() + b'\n' + data, capture_output=True,
            timeout=limits.wait + limits.grace, check=False)
    except subprocess.TimeoutExpired as err:
        raise DescriptionError(limits.too_late, source=source) from err
    except OSError as err:
        raise DescriptionError(f'cannot be expanded, no process can be started: {err.strerror}',
                               source=source) from err
    _, begun, answer = done.stdout.partition(_REPLY)
    if done.returncode or not begun:
        raise DescriptionError(_why_ended(done, limits), source=source)
    head, _, expanded = answer.partition(b'\n')
    reply = json.loads(head)
    report.notes.extend(Note(**note) for note in reply['notes'])
    if reply['error']:
        raise DescriptionError(reply['error'])
    return expanded


def _why_ended(done: subprocess.CompletedProcess[bytes], limits: Limits) -> str:
    """Return why the process ended without a reply."""
    last = done.stderr.decode(errors='replace').strip().rpartition('\n')[2]
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return limits.too_slow
    if last.startswith('MemoryError'):
        return TOO_LARGE
    return f'cannot be expanded: {last[:200] or f"the process ended with {done.returncode}"}'


def _restrict(what: int, soft: int, hard: int | None = None) -> None:
    """Lower a limit of this process; one that is lower already stays."""
    _, most = resource.getrlimit(what)
    hard = soft if hard is None else hard
    if most != resource.RLIM_INFINITY:
        soft, hard = min(soft, most), min(hard, most)
    with suppress(OSError, ValueError):  # not every system has every limit
        resource.setrlimit(what, (soft, hard))


def main() -> None:
    """Expand what standard input has, and write that, or what is wrong, to standard output."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # the parent says what there is to say
    # Text that others print goes before the reply, or to standard error.
    sys.stdout.flush()
    output = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    request = json.loads(sys.stdin.buffer.readline())
    report = Report(request['source'])
    expanded, error = b'', ''
    try:
        Limits(**request['limits']).impose()
        expanded = expand(request['path'], sys.stdin.buffer.read(), request['arguments'], report)
        if len(expanded) > MAX_BYTES:
            raise XacroProblem(TOO_LARGE)
    except DescriptionError as err:
        error = str(err)
    except (XacroProblem, MemoryError) as err:
        expanded = b''
        error = str(DescriptionError(str(err) or TOO_LARGE, source=display_name(request['path'])))
    signal.setitimer(signal.ITIMER_REAL, 0)
    reply = {'error': error, 'notes': [asdict(note) for note in report.notes]}
    with os.fdopen(output, 'wb') as stream:
        stream.write(_REPLY + json.dumps(reply).encode() + b'\n' + expanded)
