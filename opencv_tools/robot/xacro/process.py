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
Recognition of xacro files, and their expansion in a separate process.

The Python expressions in a file cannot be stopped reliably in the same process. The separate
process has limits of memory and time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
import json
import os
import re
import resource
import signal
import subprocess
import sys
from types import FrameType

from lxml import etree
from opencv_tools.base.worker import restrict, worker_command
from opencv_tools.robot.xacro.errors import TOO_LARGE, XacroProblem
from opencv_tools.robot.xacro.expand import expand
from opencv_tools.robot.xml.document import DescriptionError, Element
from opencv_tools.robot.xml.input import display_name, MAX_BYTES
from opencv_tools.robot.xml.report import Note, Report

_NAMESPACE = re.compile(r'https?://(?:www\.|wiki\.)?ros\.org/(?:wiki/)?xacro/?')
_REPLY = b'\0'  # begins the reply; other output, for example of sitecustomize, is before it


@dataclass(frozen=True)
class XacroLimits:
    """
    Limits of the process.

    :param memory: address space in bytes, including Python and its modules.
    :param wait: elapsed time in seconds.
    :param grace: seconds beyond both times in which the process can report its location.
    """

    memory: int = 1_500_000_000
    seconds: int = 20
    wait: float = 30.0
    grace: int = 5

    def impose(self) -> None:
        """Limit this process. It raises an `XacroProblem` when it reaches a limit of time."""
        signal.signal(signal.SIGXCPU, self._end)
        signal.signal(signal.SIGALRM, self._end)
        restrict(resource.RLIMIT_CORE, 0)
        restrict(resource.RLIMIT_AS, self.memory)
        restrict(resource.RLIMIT_CPU, self.seconds, self.seconds + self.grace)
        # The alarm repeats, because xacro continues after some errors.
        signal.setitimer(signal.ITIMER_REAL, self.wait, 1.0)

    def _end(self, number: int, _: FrameType | None) -> None:
        raise XacroProblem(self.too_slow if number == signal.SIGXCPU else self.timeout)

    @property
    def too_slow(self) -> str:
        """Message for too much processor time."""
        return (f'expansion needs more than {self.seconds} s of processor time; look for an '
                'expression that does not end')

    @property
    def timeout(self) -> str:
        """Message for too much elapsed time."""
        return (f'expansion timed out after {self.wait:g} s; look for an expression that does not '
                'end, or a file that cannot be read')


LIMITS = XacroLimits()


def is_xacro(root: Element) -> bool:
    """Return whether a document declares the namespace of xacro anywhere."""
    return any(namespace and _NAMESPACE.fullmatch(namespace[1])
               for _, namespace in etree.iterwalk(root, events=('start-ns',)))


def is_xacro_name(element: Element) -> bool:
    """Return whether the tag of an element is one of xacro."""
    return bool(_NAMESPACE.fullmatch(etree.QName(element).namespace or ''))


def expand_apart(path: str, data: bytes, arguments: Mapping[str, str], report: Report,
                 limits: XacroLimits = LIMITS, find: str = 'path') -> bytes:
    """
    Expand a xacro file as `expand` does, in a separate process.

    :raises DescriptionError: the file cannot be expanded within the limits.
    """
    source = display_name(path)
    request = json.dumps({'path': path, 'arguments': dict(arguments), 'source': report.source,
                          'find': find, 'limits': asdict(limits)})
    try:
        process = subprocess.run(
            worker_command(__name__), input=request.encode() + b'\n' + data, capture_output=True,
            timeout=limits.wait + limits.grace, check=False)
    except subprocess.TimeoutExpired as err:
        raise DescriptionError(limits.timeout, source=source) from err
    except OSError as err:
        raise DescriptionError(f'cannot be expanded: no process can be started: {err.strerror}',
                               source=source) from err
    _, marker, answer = process.stdout.partition(_REPLY)
    if process.returncode or not marker:
        raise DescriptionError(_exit_reason(process, limits), source=source)
    head, _, expanded = answer.partition(b'\n')
    reply = json.loads(head)
    report.notes.extend(Note(**note) for note in reply['notes'])
    report.files.extend(reply['files'])
    if reply['error']:
        raise DescriptionError(reply['error'])
    return expanded


def _exit_reason(process: subprocess.CompletedProcess[bytes], limits: XacroLimits) -> str:
    """Return why the process ended without a reply."""
    message = process.stderr.decode(errors='replace').strip().rpartition('\n')[2]
    if process.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return limits.too_slow
    if message.startswith('MemoryError'):
        return TOO_LARGE
    return 'cannot be expanded: ' + (
        message[:200] or f'the process ended with exit status {process.returncode}')


def main() -> None:
    """Expand the request on standard input, and write the reply to standard output."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # the parent process reports Ctrl-C
    # Text that others print goes before the reply, or to standard error.
    sys.stdout.flush()
    output = os.dup(sys.stdout.fileno())
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    request = json.loads(sys.stdin.buffer.readline())
    report = Report(request['source'])
    expanded, error = b'', ''
    try:
        XacroLimits(**request['limits']).impose()
        expanded = expand(request['path'], sys.stdin.buffer.read(), request['arguments'], report,
                          request['find'])
        if len(expanded) > MAX_BYTES:
            raise XacroProblem(TOO_LARGE)
    except DescriptionError as err:
        error = str(err)
    except (XacroProblem, MemoryError) as err:
        expanded = b''
        error = str(DescriptionError(str(err) or TOO_LARGE, source=display_name(request['path'])))
    signal.setitimer(signal.ITIMER_REAL, 0)
    reply = {'error': error, 'notes': [asdict(note) for note in report.notes],
             'files': report.files}
    with os.fdopen(output, 'wb') as stream:
        stream.write(_REPLY + json.dumps(reply).encode() + b'\n' + expanded)
