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

"""Real-time priority of the threads that carry frames."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
import os

_REFUSAL = (
    'priority {priority} is not permitted ({reason}): normal scheduling is used; write '
    "'* - rtprio {priority}' to /etc/security/limits.d/opencv_tools.conf and log in again, or "
    'start Docker with --ulimit rtprio={priority}')


def explain_refusal(priority: int) -> str:
    """Return why a priority is not permitted and a remedy, '' if it is."""
    try:
        with ThreadPoolExecutor(1) as thread:  # the calling thread is not changed
            thread.submit(_set_priority, priority).result()
    except OSError as err:
        return _REFUSAL.format(priority=priority, reason=err.strerror)
    return ''


def current_priority() -> int:
    """Return the real-time priority of the calling thread, 0 for normal scheduling."""
    return os.sched_getparam(0).sched_priority


def use_priority(priority: int) -> None:
    """
    Change the scheduling of the calling thread to SCHED_RR, if that is permitted.

    Threads that it starts later have normal scheduling.

    :param priority: 1 to 99; 0 to change nothing.
    """
    with suppress(OSError):
        _set_priority(priority)


def _set_priority(priority: int) -> None:
    if priority:
        os.sched_setscheduler(
            0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
