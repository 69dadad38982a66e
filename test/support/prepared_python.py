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
Python that has imported the modules of a program, and runs the program in copies of itself.

The import takes most of the processor time of a node that runs for a second. Standard input is a
socket. A request has the program and the descriptors of a process.
"""

from __future__ import annotations

import ctypes
import fcntl
import gc
from importlib import import_module
import io
import json
import os
from pathlib import Path
import re
import runpy
import selectors
import signal
import socket
import sys
import termios
from typing import Any

_LARGEST_REQUEST = 1 << 20
_TRACING = re.compile(r'/liblttng-ust(-[0-9a-f]{8})?\.so')


def fork() -> int:
    """
    Create a copy of this process: return 0 there, and its process id here.

    A copy has only the thread that creates it. LTTng of ROS has two more, and begins them again.
    """
    tracing = {line.split()[-1] for line in Path('/proc/self/maps').read_text().splitlines()
               if _TRACING.search(line)}
    assert len(list(Path('/proc/self/task').iterdir())) <= 1 + 2 * len(tracing)
    libraries = [ctypes.CDLL(path) for path in tracing]
    signals = ctypes.create_string_buffer(128)  # sigset_t

    def call(moment: str) -> None:
        for library in libraries:  # LTTng 2.13 has other names than 2.12
            name = f'ust_{moment}' if hasattr(library, f'ust_{moment}') else f'lttng_ust_{moment}'
            function = getattr(library, name)
            function.restype = None
            function(signals)

    call('before_fork')
    pid = os.fork()
    call('after_fork_parent' if pid else 'after_fork_child')
    return pid


def serve(requests: socket.socket) -> dict[str, Any] | None:
    """
    Start a copy for each request until the end of the socket.

    :returns: the request in the copy, None in this process.
    """
    selector = selectors.DefaultSelector()
    selector.register(requests, selectors.EVENT_READ)
    results: dict[int, tuple[int, int]] = {}  # by the descriptor of the process
    while True:
        for key, _ in selector.select():
            if key.fd != requests.fileno():
                selector.unregister(key.fd)
                pid, result = results.pop(key.fd)
                os.close(key.fd)
                os.write(result, b'%d' % os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
                os.close(result)
                continue
            content, descriptors, _, _ = socket.recv_fds(requests, _LARGEST_REQUEST, 4)
            if not content:
                return None
            pid = fork()
            if not pid:
                selector.close()
                for opened, (_, result) in results.items():
                    os.close(opened)
                    os.close(result)
                requests.close()
                become(json.loads(content), descriptors)
                return json.loads(content)
            for descriptor in descriptors[:3]:
                os.close(descriptor)
            process = os.pidfd_open(pid)
            results[process] = pid, descriptors[3]
            selector.register(process, selectors.EVENT_READ)
            requests.send(b'%d' % pid)


def become(request: dict[str, Any], descriptors: list[int]) -> None:
    """Take the environment and the standard streams of a request, as a new process has them."""
    for number, descriptor in enumerate(descriptors[:3]):
        os.dup2(descriptor, number)
    for descriptor in descriptors:
        os.close(descriptor)
    if request['is_terminal']:
        os.setsid()
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    Path('/proc/self/comm').write_text(Path(request['command'][0]).name)  # first 15 characters
    os.chdir(request['folder'])
    os.environ.clear()
    os.environ.update(request['environment'])
    sys.argv = request['command']
    sys.stdin = sys.__stdin__ = open(0, closefd=False)  # noqa: SIM115
    is_line_buffered = os.environ.get('PYTHONUNBUFFERED') or os.isatty(1)
    sys.stdout = sys.__stdout__ = open(  # noqa: SIM115
        1, 'w', buffering=1 if is_line_buffered else -1, closefd=False)
    sys.stderr = sys.__stderr__ = io.TextIOWrapper(
        open(2, 'wb', closefd=False), errors='backslashreplace',  # noqa: SIM115
        line_buffering=True)


def main() -> None:
    for module in sys.argv[1:]:
        import_module(module)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the tests end this process
    gc.freeze()  # else each copy looks through all modules several times, 0.1 s
    request = serve(socket.socket(fileno=os.dup(0)))
    if request:
        script = Path(request['command'][0])
        sys.path[0] = str(script.parent)
        runpy.run_path(str(script), run_name='__main__')


if __name__ == '__main__':
    main()
