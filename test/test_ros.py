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
from opencv_tools.ros.parameters import declare_parameters, Parameter, ParameterError
from opencv_tools.ros.progress import Progress
import pytest
import rclpy
from rclpy.node import Node

TABLE = (
    Parameter('name', 'x', 'a text'),
    Parameter('kind', 'a', 'a choice', choices=('a', 'b')),
    Parameter('rate', 1.5, 'a fraction', maximum=10.0),
    Parameter('count', 3, 'a number', minimum=1, maximum=5),
)


@pytest.fixture
def described(domain: int) -> Node:
    """Give a node with the table's parameters, of which some were given."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain, args=[
        '--ros-args', '-p', 'name:=7', '-p', 'rate:=2', '-p', 'count:=5'])
    node = Node('described', context=context,
                automatically_declare_parameters_from_overrides=True)
    node.values = declare_parameters(node, TABLE)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


def test_values_have_the_type_of_their_default(described: Node) -> None:
    assert described.values == {'name': '7', 'kind': 'a', 'rate': 2.0, 'count': 5}
    assert described.get_parameter('rate').value == 2.0
    assert isinstance(described.get_parameter('rate').value, float)


def test_parameters_are_described_with_their_ranges(described: Node) -> None:
    rate = described.describe_parameter('rate')
    assert rate.description == 'a fraction'
    assert rate.read_only
    (bounds,) = rate.floating_point_range
    assert (bounds.from_value, bounds.to_value) == (0.0, 10.0)
    (bounds,) = described.describe_parameter('count').integer_range
    assert (bounds.from_value, bounds.to_value) == (1, 5)
    assert described.describe_parameter('kind').additional_constraints == 'one of: a, b'


def test_a_change_at_run_time_is_refused_with_the_reason(described: Node) -> None:
    (result,) = described.set_parameters([rclpy.Parameter('rate', value=3.0)])
    assert not result.successful
    assert 'read-only' in result.reason


@pytest.mark.parametrize(('index', 'value'), [
    (0, [1]), (0, True), (1, 'c'), (2, 10.1), (2, -0.1), (2, float('nan')), (2, 'x'), (2, True),
    (3, 0), (3, 2.0), (3, None)])
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
        progress.tick(4, 3, 'bgr8', 2)
        now += 0.05
    assert progress.count == 50
    assert progress.average_rate() == pytest.approx(20.0)
    assert lines[0] == 'Doing 1: 4x3 bgr8, 2 dropped'
    assert [bool(re.fullmatch(r'Doing \d+: 4x3 bgr8, 20\.0 Hz, 2 dropped', line))
            for line in lines[1:]] == [True, True]
