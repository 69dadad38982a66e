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

"""Parameters, transport and progress: the rooms between the nodes and ROS."""

from __future__ import annotations

import os
from pathlib import Path
import re
import xml.etree.ElementTree as ElementTree

from opencv_tools.ros import transport
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


@pytest.fixture
def untouched(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Take away what a user may have configured."""
    for variable in ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE',
                     'FASTDDS_BUILTIN_TRANSPORTS', 'RMW_IMPLEMENTATION', 'OPENCV_TOOLS_TRANSPORT'):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.chdir(tmp_path)


def segment_in_use() -> int | None:
    """Read the segment's size from the profile in force, None when there is none."""
    path = os.environ.get('FASTRTPS_DEFAULT_PROFILES_FILE')
    if path is None:
        return None
    namespace = '{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}'
    return int(ElementTree.parse(path).find(f'.//{namespace}segment_size').text)


@pytest.mark.usefixtures('untouched')
def test_the_segment_holds_several_frames_and_the_profile_goes_away() -> None:
    with transport.transport_for_frames():
        path = Path(os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'])
        assert segment_in_use() == 64 << 20
    assert not path.exists()
    assert segment_in_use() is None


@pytest.mark.usefixtures('untouched')
@pytest.mark.parametrize(('variable', 'value'), [
    ('OPENCV_TOOLS_TRANSPORT', 'default'), ('RMW_IMPLEMENTATION', 'rmw_cyclonedds_cpp'),
    ('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4'), ('FASTDDS_DEFAULT_PROFILES_FILE', '/mine.xml')])
def test_what_the_user_configured_is_left_alone(
        monkeypatch: pytest.MonkeyPatch, variable: str, value: str) -> None:
    monkeypatch.setenv(variable, value)
    with transport.transport_for_frames():
        assert segment_in_use() is None


@pytest.mark.usefixtures('untouched')
def test_a_profile_in_the_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / 'DEFAULT_FASTRTPS_PROFILES.xml').touch()
    with transport.transport_for_frames():
        assert segment_in_use() is None


@pytest.mark.usefixtures('untouched')
@pytest.mark.parametrize(('free', 'segment'), [
    (64 << 20, 32 << 20), (40 << 20, 20 << 20), (8 << 20, None)])
def test_a_small_dev_shm_is_not_filled(
        monkeypatch: pytest.MonkeyPatch, free: int, segment: int | None) -> None:
    values = list(os.statvfs('/'))
    values[1], values[4] = 4096, free // 4096  # f_frsize, f_bavail
    monkeypatch.setattr(os, 'statvfs', lambda path: os.statvfs_result(values))
    with transport.transport_for_frames():
        assert segment_in_use() == segment


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
