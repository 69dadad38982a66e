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

"""End of a process that a library does not let end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import ctypes
import time

_SIGEV_THREAD = 2


class _Notification(ctypes.Structure):
    """``struct sigevent`` of POSIX."""

    _fields_ = [('value', ctypes.c_void_p), ('signal', ctypes.c_int), ('notify', ctypes.c_int),
                ('function', ctypes.c_void_p), ('attributes', ctypes.c_void_p),
                ('reserved', ctypes.c_byte * 32)]


class _Interval(ctypes.Structure):
    """``struct itimerspec`` of POSIX: the period, and the time until the first expiration."""

    _fields_ = [(name, ctypes.c_long) for name in (
        'period_seconds', 'period_nanoseconds', 'seconds', 'nanoseconds')]


@contextmanager
def exit_after(seconds: int, status: int) -> Iterator[None]:
    """
    End the process if the block takes longer, also if no thread can run Python meanwhile.

    A timer of POSIX calls ``_exit`` in a thread of its own. Without such timers there is no limit.

    :param seconds: limit in seconds.
    :param status: exit status of the process at the limit.
    """
    library = ctypes.CDLL(None)
    timer = ctypes.c_void_p()
    try:
        create, start, delete = (getattr(library, f'timer_{name}') for name in (
            'create', 'settime', 'delete'))
    except AttributeError:
        yield
        return
    at_limit = _Notification(value=status, notify=_SIGEV_THREAD, function=ctypes.cast(
        library._exit, ctypes.c_void_p))
    has_timer = create(time.CLOCK_MONOTONIC, ctypes.byref(at_limit), ctypes.byref(timer)) == 0
    if has_timer:
        start(timer, 0, ctypes.byref(_Interval(seconds=seconds)), None)
    try:
        yield
    finally:
        if has_timer:
            delete(timer)
