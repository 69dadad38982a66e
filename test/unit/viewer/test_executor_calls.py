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

"""Calls into the executor of a node, and calls that fail."""

from __future__ import annotations

from functools import partial
from inspect import CORO_CLOSED, getcoroutinestate
from typing import Any

from conftest import spin_until
from opencv_tools.base.logs import Log
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.executor_calls import ExecutorCalls
import pytest
from rclpy.node import Node
from rclpy.task import Future


class Lines(list):
    """Lines of a log."""

    def add(self, line: str) -> None:
        self.append(line)

    debug = info = warning = error = add


def answers_of(node: Node, log: Log, *functions: Any) -> list[tuple[Any, Any]]:
    """Return the answers to each function, called and as a coroutine."""
    calls = ExecutorCalls(node, log)
    answers: dict[tuple[int, str], Any] = {}

    async def run(function: Any) -> Any:
        return function()

    for number, function in enumerate(functions):
        calls.call(function, partial(answers.__setitem__, (number, 'called')))
        calls.start(run(function), partial(answers.__setitem__, (number, 'started')))
    spin_until(node, lambda: len(answers) == 2 * len(functions))
    return [(answers[number, 'called'], answers[number, 'started'])
            for number in range(len(functions))]


def surrogate() -> bytes:
    return '\ud800'.encode()


def refuse() -> None:
    raise RequestError('not now', 503)


def test_result_of_a_call(node: Node) -> None:
    assert answers_of(node, Log(Lines()), lambda: 5) == [(5, 5)]


@pytest.mark.parametrize(('function', 'status', 'sentence'), [
    (refuse, 503, 'not now'),
    (surrogate, 500, 'the request has failed: UnicodeEncodeError: '),
    ({}.popitem, 500, 'the request has failed: KeyError: ')])
def test_call_that_fails_for_its_caller_only(
        node: Node, function: Any, status: int, sentence: str) -> None:
    lines = Lines()
    refused, good = answers_of(node, Log(lines), function, lambda: 5)
    assert good == (5, 5)
    for err in refused:
        assert isinstance(err, RequestError)
        assert (err.status, str(err)[:len(sentence)]) == (status, sentence)
    assert [line[:len(sentence)] for line in lines] == [sentence] * (status == 500)


def test_call_without_an_answer(node: Node) -> None:
    lines = Lines()
    calls = ExecutorCalls(node, Log(lines))
    calls.call(surrogate)
    spin_until(node, lambda: len(lines) == 1)


@pytest.mark.parametrize('count', [1, 4, 30])
def test_coroutines_that_have_not_returned_at_the_end(node: Node, count: int) -> None:
    calls, begun, ended, answers = ExecutorCalls(node, Log(Lines())), [], [], list[Any]()

    async def wait() -> None:
        begun.append(None)
        try:
            await Future()
        finally:
            ended.append(None)

    works = [wait() for _ in range(count)]
    for work in works:
        calls.start(work, answers.append)
    spin_until(node, lambda: len(begun) == count)
    works += [wait() for _ in range(count)]
    for work in works[count:]:
        calls.start(work, answers.append)
    calls.close()
    assert {getcoroutinestate(work) for work in works} == {CORO_CLOSED}
    assert (len(begun), len(ended), answers) == (count, count, [])
