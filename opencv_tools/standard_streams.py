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

"""Standard input, output and error, as every program here expects them: open."""

from __future__ import annotations

import os
import sys

_STREAMS = (('stdin', 'r'), ('stdout', 'w'), ('stderr', 'w'))


def open_standard_streams() -> None:
    """
    Open ``/dev/null`` where the process was started with a standard stream that is closed.

    A file that is opened later would get its number otherwise, and what is printed would go
    there.
    """
    for number, (name, mode) in enumerate(_STREAMS):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
        if getattr(sys, name) is None:  # it was closed when Python began
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))


def let_go_of_broken_streams() -> None:
    """
    Write what is left for a terminal or pipe that is gone to ``/dev/null``.

    Python tries to write it at its end, and ends with status 120 where it cannot.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, stream.fileno())
            os.close(null)
