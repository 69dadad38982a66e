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

"""Repair of standard input, output and error that are closed or broken."""

from __future__ import annotations

import os
import sys

_STREAMS = (('stdin', 'r'), ('stdout', 'w'), ('stderr', 'w'))


def open_standard_streams() -> None:
    """
    Open ``/dev/null`` for each standard stream that is closed at the start of the process.

    Otherwise the next opened file would get the descriptor of the stream, and printed text would
    be written to this file.
    """
    for number, (name, mode) in enumerate(_STREAMS):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)  # gets the lowest free descriptor
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
        if getattr(sys, name) is None:  # the stream was closed when Python started
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))


def discard_broken_streams() -> None:
    """
    Discard buffered output to a terminal or pipe that no longer exists.

    Python writes buffered output when it exits. If the stream is broken, Python exits with
    status 120.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, stream.fileno())
            os.close(null)
