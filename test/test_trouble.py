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

"""What is told of trouble: once each, though many threads meet it."""

from __future__ import annotations

from threading import Barrier, Thread
import time

from opencv_tools.recording.trouble import Throttle, Troubles
import pytest
from switching import switching_in


class Console:
    """Keep what is said."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def info(self, message: str) -> None:
        self.lines.append(message)

    warning = error = info


def test_a_reason_is_told_once_and_no_more_than_twenty() -> None:
    console = Console()
    troubles = Troubles(console)
    for number in (0, 0, *range(30), 0):
        troubles.failed(f'reason {number}')
    assert console.lines == [f'reason {number}' for number in range(20)]


def test_an_outage_is_told_when_it_begins_changes_and_ends() -> None:
    console = Console()
    troubles = Troubles(console)
    troubles.written()
    for reason in ('full', 'full', 'gone', 'full'):
        troubles.outage(reason)
    troubles.written()
    troubles.written()
    troubles.outage('full')
    troubles.written()
    assert console.lines == ['full', 'gone', 'full', 'Writing again; 4 frames were not written',
                             'full', 'Writing again; 1 frames were not written']


@pytest.mark.parametrize('name', ['failed', 'outage'])
def test_threads_with_one_trouble_tell_it_once(name: str) -> None:
    console = Console()
    troubles = Troubles(console)
    together = Barrier(8)

    def meet() -> None:
        together.wait()
        getattr(troubles, name)('no space')

    with switching_in(getattr(Troubles, name)):
        threads = [Thread(target=meet) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert console.lines == ['no space']


def test_a_throttle_lets_one_pass_each_second(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([0.0, 0.5, 0.75, 1.0, 1.5, 2.0, 9.0, 9.5])
    monkeypatch.setattr(time, 'monotonic', lambda: next(times))
    throttle = Throttle()
    assert [throttle.passes() for _ in range(8)] == [
        True, False, False, True, False, True, True, False]
