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

"""The scheduling of threads beside libraries that change it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import os
from pathlib import Path

_TASKS = Path('/proc/self/task')  # the threads of this process, see proc(5)


@contextmanager
def kept_scheduling() -> Iterator[None]:
    """
    Restore the scheduling of this thread, and give it to the threads that begin meanwhile.

    SVT-AV1 makes the thread that opens an encoder a real-time one, if that is permitted. All
    threads that begin later would inherit that.
    """
    if not hasattr(os, 'sched_getscheduler') or not _TASKS.exists():  # not Linux
        yield
        return
    before = {task.name for task in _TASKS.iterdir()}
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        yield
    finally:
        if (os.sched_getscheduler(0), os.sched_getparam(0)) != (policy, parameters):
            for name in ({task.name for task in _TASKS.iterdir()} - before) | {'0'}:
                with suppress(OSError):  # it has ended
                    os.sched_setscheduler(int(name), policy, parameters)
