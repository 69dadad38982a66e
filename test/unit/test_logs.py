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

"""Log: printable lines, which repetitions are left out, and lines about slow work."""

from __future__ import annotations

from io import StringIO
from threading import Barrier, Thread

from console import Console
from opencv_tools.base.logs import ConsoleWriter, Log, log_if_slow, Throttle
import pytest
from rclpy.logging import LoggingSeverity
from rclpy.node import Node
from switching import switching_in
from waiting import LONGEST_SECONDS, pause, wait_until


class Time:
    """A clock that a test sets."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Time:
    time = Time()
    monkeypatch.setattr('time.monotonic', time)
    return time


def test_all_levels() -> None:
    log = Console()
    assert log.debug('a') and log.info('b') and log.warning('c') and log.error('d')
    assert log.lines == ['debug: a', 'info: b', 'warning: c', 'error: d']


def test_all_levels_of_a_node(node: Node, capfd: pytest.CaptureFixture[str]) -> None:
    node.get_logger().set_level(LoggingSeverity.DEBUG)
    log = Log(node.get_logger())
    assert log.debug('a') and log.info('b') and log.warning('c') and log.error('d')
    shown = ''.join(capfd.readouterr())
    for level, text in (('DEBUG', 'a'), ('INFO', 'b'), ('WARN', 'c'), ('ERROR', 'd')):
        assert f'[plain]: {text}' in next(line for line in shown.split('\n') if level in line)


@pytest.mark.parametrize(('text', 'line'), [
    ('\x1b[2Jbad\nname', 'info: \\x1b[2Jbad\\nname'),
    ('/' + 8192 * 'a', 'info: /' + 8192 * 'a'),
    (10**6 * 'a', 'info: ' + 9997 * 'a' + '...'),
])
def test_lines_are_printable_and_bounded(text: str, line: str) -> None:
    log = Console()
    assert log.info(text)
    assert log.lines == [line]


def test_once_until_forgotten(clock: Time) -> None:
    log = Console()
    assert log.warning('first', once='key')
    clock.now += 1e9
    assert not log.error('second', once='key')
    assert log.error('third', once='another key')
    log.forget('key')
    assert log.error('fourth', once='key')
    assert log.lines == ['warning: first', 'error: third', 'error: fourth']


def test_one_line_a_second(clock: Time) -> None:
    log = Console()
    written = []
    for clock.now in (0.0, 0.5, 0.75, 1.0, 1.5, 2.0, 9.0, 9.5):
        written.append(log.info(f'{clock.now} s', every=1.0, key='key'))
    assert written == [True, False, False, True, False, True, True, False]
    assert log.lines == ['info: 0.0 s', 'info: 1.0 s', 'info: 2.0 s', 'info: 9.0 s']


def test_line_is_the_key_by_default(clock: Time) -> None:
    log = Console()
    assert [log.info(text, every=1.0) for text in 'aabba'] == [True, False, True, False, False]
    clock.now += 1
    assert log.info('a', every=1.0)


def test_number_of_keys_is_bounded() -> None:
    throttle = Throttle()
    assert throttle.passes('used often')
    for number in range(10_000):
        assert throttle.passes(str(number))
        assert not throttle.passes('used often')
    assert len(throttle._ends) == 256
    assert throttle.passes('0') and not throttle.passes('9999')


def test_threads_write_a_line_once() -> None:
    log = Console()
    together = Barrier(8)

    def meet() -> None:
        together.wait()
        log.error('no space', once='key')

    with switching_in(Throttle.passes):
        threads = [Thread(target=meet) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert log.lines == ['error: no space']


class SlowStream(StringIO):
    """A stream during whose writes other threads run."""

    def write(self, text: str) -> int:
        pause(0.001)
        return super().write(text)


def test_console_lines_of_threads_do_not_mix(monkeypatch: pytest.MonkeyPatch) -> None:
    stream, console = SlowStream(), ConsoleWriter('command')
    monkeypatch.setattr('sys.stderr', stream)
    words = [letter * length for letter, length in (('a', 1), ('b', 90), ('c', 9000))]
    threads = [Thread(target=lambda word=word: [console.info(word) for _ in range(9)])
               for word in words]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    lines = stream.getvalue().splitlines()
    assert sorted(lines) == [f'command: {word}' for word in words for _ in range(9)]


def test_line_about_slow_work() -> None:
    console = Console()
    with log_if_slow(Log(console), 'slow', 0.0):
        wait_until(lambda: console.lines, 'the line')
    with log_if_slow(Log(console), 'fast', LONGEST_SECONDS):
        pass
    assert console.lines == ['info: slow']
