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

"""Parameters and progress: the rooms between the nodes and ROS."""

from __future__ import annotations

import re

from opencv_tools.ros.parameters import (
    declare_parameters, Parameter, ParameterError, watch_parameters,
)
from opencv_tools.ros.progress import Progress
import pytest
import rclpy
from rclpy.node import Node

TABLE = (
    Parameter('name', 'x', 'a text', fixed=True),
    Parameter('kind', 'a', 'a choice', choices=('a', 'b')),
    Parameter('rate', 1.5, 'a fraction', maximum=10.0),
    Parameter('count', 3, 'a number', minimum=1, maximum=5),
    Parameter('turn', 0, 'a choice of numbers', choices=(0, 90)),
    Parameter('on', False, 'a switch'),
    Parameter('even', 2, 'every other number', minimum=0, maximum=8, step=2),
)


@pytest.fixture
def described(domain: int) -> Node:
    """Give a node with the table's parameters, of which some were given."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain, args=[
        '--ros-args', '-p', 'name:=7', '-p', 'rate:=2', '-p', 'count:=5', '-p', 'on:=1'])
    node = Node('described', context=context,
                automatically_declare_parameters_from_overrides=True)
    node.values = declare_parameters(node, TABLE)
    watch_parameters(node, TABLE, node.values.update)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


def test_values_have_the_type_of_their_default(described: Node) -> None:
    assert described.values == {
        'name': '7', 'kind': 'a', 'rate': 2.0, 'count': 5, 'turn': 0, 'on': True, 'even': 2}
    assert described.get_parameter('rate').value == 2.0
    assert isinstance(described.get_parameter('rate').value, float)


def test_parameters_are_described_with_their_ranges(described: Node) -> None:
    rate = described.describe_parameter('rate')
    assert rate.description == 'a fraction'
    assert not rate.read_only
    assert described.describe_parameter('name').read_only
    (bounds,) = rate.floating_point_range
    assert (bounds.from_value, bounds.to_value) == (0.0, 10.0)
    (bounds,) = described.describe_parameter('count').integer_range
    assert (bounds.from_value, bounds.to_value) == (1, 5)
    assert described.describe_parameter('kind').additional_constraints == 'one of: a, b'
    assert described.describe_parameter('turn').additional_constraints == 'one of: 0, 90'
    (bounds,) = described.describe_parameter('even').integer_range
    assert (bounds.from_value, bounds.to_value, bounds.step) == (0, 8, 2)


def test_a_change_at_run_time_is_taken(described: Node) -> None:
    for name, value in (('rate', 3.0), ('kind', 'b'), ('turn', 90), ('on', False), ('even', 8)):
        (result,) = described.set_parameters([rclpy.Parameter(name, value=value)])
        assert result.successful, result.reason
        assert described.values[name] == value


@pytest.mark.parametrize(('name', 'value', 'reason'), [
    ('name', 'y', 'read-only'), ('rate', 11.0, 'out of range'), ('rate', 'x', 'Wrong parameter'),
    ('kind', 'c', "parameter kind is 'c': give one of 'a', 'b'"),
    ('turn', 45, 'parameter turn is 45: give one of 0, 90'), ('even', 3, 'not a valid step')])
def test_a_change_at_run_time_is_refused_with_the_reason(
        described: Node, name: str, value: object, reason: str) -> None:
    before = dict(described.values)
    (result,) = described.set_parameters([rclpy.Parameter(name, value=value)])
    assert not result.successful
    assert reason in result.reason
    assert described.values == before


def test_changes_that_go_together_are_taken_together_or_not_at_all(described: Node) -> None:
    before = dict(described.values)
    result = described.set_parameters_atomically([
        rclpy.Parameter('rate', value=4.0), rclpy.Parameter('turn', value=45)])
    assert not result.successful
    assert described.values == before


@pytest.mark.parametrize(('index', 'value'), [
    (0, [1]), (0, True), (1, 'c'), (2, 10.1), (2, -0.1), (2, float('nan')), (2, 'x'), (2, True),
    (3, 0), (3, 2.0), (3, None), (4, 45), (4, '90'), (5, 2), (5, 'yes')])
def test_values_that_are_refused(index: int, value: object) -> None:
    with pytest.raises(ParameterError, match=f'parameter {TABLE[index].name} is '):
        TABLE[index].accept(value)


def test_progress_is_said_at_most_once_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr('time.monotonic', lambda: now)
    lines: list[str] = []
    progress = Progress(lines.append, 'Doing')
    for _ in range(50):
        progress.tick('4x3 bgr8', 2)
        now += 0.05
    assert progress.count == 50
    assert progress.average_rate() == pytest.approx(20.0)
    assert lines[0] == 'Doing 1: 4x3 bgr8, 2 dropped'
    assert [bool(re.fullmatch(r'Doing \d+: 4x3 bgr8, 20\.0 Hz, 2 dropped', line))
            for line in lines[1:]] == [True, True]
