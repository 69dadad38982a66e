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

"""Log of failures: each reason once, also from many threads."""

from __future__ import annotations

from threading import Barrier, Thread
import time

from console import Console
from opencv_tools.recording.errors import FailureLog
import pytest
from switching import switching_in


class Time:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Time:
    time_of_test = Time()
    monkeypatch.setattr(time, 'monotonic', time_of_test)
    return time_of_test


def letters(number: int) -> str:
    return chr(ord('a') + number // 26) + chr(ord('a') + number % 26)


def test_each_reason_is_logged_once(clock: Time) -> None:
    console = Console()
    failure_log = FailureLog(console)
    for number in range(300):
        clock.now += 1
        for _ in range(3):
            failure_log.bad_frame(f'reason {letters(number)}')
    assert console.lines == [f'error: reason {letters(number)}' for number in range(300)]
    failure_log.bad_frame('reason aa')  # the first reason is forgotten
    assert console.lines[-1] == 'error: reason aa'


def test_reasons_that_differ_in_numbers_are_the_same(clock: Time) -> None:
    console = Console()
    failure_log = FailureLog(console)
    for number in range(30):
        clock.now += 1
        failure_log.bad_frame(f'{number}x{number} image with step {2 * number}')
        failure_log.write_failed(f'{number} bytes of {10 * number} were written')
    assert console.lines == [
        'error: 0x0 image with step 0', 'error: 0 bytes of 0 were written']


@pytest.mark.parametrize('name', ['bad_frame', 'write_failed'])
def test_rate_of_lines_is_limited_to_one_per_second(name: str, clock: Time) -> None:
    console = Console()
    failure_log = FailureLog(console)
    for number in range(600):
        clock.now += 1 / 60
        getattr(failure_log, name)(f'reason {letters(number)}')
    assert 18 <= len(console.lines) <= 20  # ten at once, then ten seconds
    counted = sum(int(line.split()[-2]) for line in console.lines if line.endswith(' more)'))
    clock.now += 60
    getattr(failure_log, name)('the last reason')
    last = console.lines[-1]
    assert last.startswith('error: the last reason (and ')
    assert counted + int(last.split()[-2]) + len(console.lines) == 600 + 1


def test_skipped_reason_is_logged_when_it_recurs(clock: Time) -> None:
    console = Console()
    failure_log = FailureLog(console)
    for number in range(11):
        failure_log.bad_frame(f'reason {letters(number)}')
    assert len(console.lines) == 10
    clock.now += 1
    failure_log.bad_frame('reason ak')
    assert console.lines[10:] == ['error: reason ak (and 1 more)']


def test_end_of_an_outage_is_logged_when_the_rate_allows(clock: Time) -> None:
    console = Console()
    failure_log = FailureLog(console)
    for _ in range(20):
        failure_log.write_failed('full')
        failure_log.write_succeeded()
    assert len(console.lines) == 10
    assert sum(line.startswith('info: Writing again') for line in console.lines) == 5
    clock.now += 1
    failure_log.write_succeeded()
    assert console.lines[-1].startswith('info: Writing again; 15 frames were not written')
    failure_log.write_succeeded()
    assert len(console.lines) == 11


def test_library_error_becomes_a_sentence_with_a_remedy() -> None:
    console = Console()
    FailureLog(console).bad_frame(
        'a frame was not written: a 65535x1 frame cannot be encoded as .mp4: [Errno 542398533] '
        'Generic error in an external library: \'avcodec_open2("libx264", {"crf": "23"})\' '
        'returned 542398533; last error log: [libx264] \x1b[31m')
    assert console.lines == [
        'error: a frame was not written: a 65535x1 frame cannot be encoded as .mp4: Generic error '
        'in an external library; set the extension of file_name to .png or .npy, which hold any '
        'size']


def test_damaged_frame_of_a_source_has_no_remedy_for_the_target() -> None:
    console = Console()
    FailureLog(console).bad_frame(
        'a frame was not read: frame 2 of a.mkv cannot be decoded: [Errno 1094995529] Invalid '
        "data found when processing input: 'avcodec_send_packet()'")
    assert console.lines == ['error: a frame was not read: frame 2 of a.mkv cannot be decoded: '
                             'Invalid data found when processing input']


def test_lines_are_printable_and_short() -> None:
    console = Console()
    failure_log = FailureLog(console)
    failure_log.bad_frame('\x1b[2J' + 'a' * 10**6)
    failure_log.write_failed('\x1b[2J' + 'b' * 10**6)
    assert all(line.isprintable() and len(line) <= len('error: ') + 400 for line in console.lines)
    assert len(console.lines) == 2


def test_outage_is_logged_at_its_start_change_and_end() -> None:
    console = Console()
    failure_log = FailureLog(console)
    failure_log.write_succeeded()
    for reason in ('full', 'full', 'gone', 'full'):
        failure_log.write_failed(reason)
    failure_log.write_succeeded()
    failure_log.write_succeeded()
    failure_log.write_failed('full')
    failure_log.write_succeeded()
    assert console.lines == [
        'error: full', 'error: gone', 'error: full',
        'info: Writing again; 4 frames were not written',
        'error: full', 'info: Writing again; 1 frame was not written']


@pytest.mark.parametrize('name', ['bad_frame', 'write_failed'])
def test_threads_log_a_common_failure_once(name: str) -> None:
    console = Console()
    failure_log = FailureLog(console)
    together = Barrier(8)

    def meet() -> None:
        together.wait()
        getattr(failure_log, name)('no space')

    with switching_in(getattr(FailureLog, name)):
        threads = [Thread(target=meet) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert console.lines == ['error: no space']
