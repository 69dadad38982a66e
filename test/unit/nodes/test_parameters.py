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

"""Declaration, description and changes of parameters, and the parameters of both nodes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math
from typing import Any

from opencv_tools.base import parameter_fields
from opencv_tools.image_filter import FilterSettings
from opencv_tools.nodes.declaration import (
    declare_parameters, describe_unknown, UnknownParameterError, watch_parameters)
from opencv_tools.nodes.parameters import Parameter, parameter_table, with_values
from opencv_tools.nodes.publisher import parameters as publisher_parameters
from opencv_tools.nodes.publisher.parameters import PublisherSettings
from opencv_tools.nodes.subscriber import parameters as subscriber_parameters
from opencv_tools.nodes.subscriber.parameters import RecorderSettings
from opencv_tools.topics.errors import ParameterError
from opencv_tools.video.settings import VideoSettings
from opencv_tools.viewer.parameters import ViewerSettings
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

TABLE = (
    Parameter('name', 'x', 'a text'),
    Parameter('kind', 'a', 'a choice', choices=('a', 'b'), changeable=True),
    Parameter('rate', 1.5, 'a fraction', bounds=(0, 10), changeable=True),
    Parameter('count', 3, 'a number', bounds=(1, 5), changeable=True),
    Parameter('turn', 0, 'a choice of numbers', choices=(0, 90), changeable=True),
    Parameter('on', False, 'a switch', changeable=True),
    Parameter('even', 2, 'every other number', bounds=(0, 8), step=2, changeable=True),
)


TABLES = {'img_publisher': publisher_parameters.PARAMETERS,
          'img_subscriber': subscriber_parameters.PARAMETERS}
BILLION = 10**9
# Valid values: smallest and largest number, a set of choices, or any text.
VALUES = {
    'img_publisher': {
        'source': str, 'bag_topic': str, 'topics': str, 'width': (0, 65536),
        'height': (0, 65536), 'fps': (0.1, 1000.0), 'fourcc': str,
        'encoding': {'bgr8', 'mono16', 'nv12', ''}, 'publish_rate': (0.1, 1000.0),
        'flip': {'none', 'horizontal', 'vertical', 'both'}, 'rotate': {0, 90, 180, 270},
        'jpeg_quality': (1, 100), 'compressed_format': {'auto', 'jpeg', 'png'},
        'depth_format': {'png', 'rvl'}, 'depth_max': (0.1, 1e4),
        'read_timeout': (0.1, 1e6), 'reconnect': str,
        'on_end': {'stop', 'loop', 'hold'}, 'loop': (0, BILLION), 'start_frame': (0, BILLION),
        'stop_frame': (0, BILLION), 'frame_id': str, 'rectify': {False, True},
        'video_codec': str, 'video_quality': (0, 51), 'video_bit_rate': (0, BILLION),
        'video_key_interval': (0.1, 3600.0), 'video_preset': str,
        'stamp': {'capture', 'publish', 'original'},
        'stamp_offset': (-1e6, 1e6), 'clock': {False, True},
        'camera_info_url': str, 'camera_name': str, 'max_frames': (0, BILLION),
        'wait_for_subscribers': (0, 1000), 'priority': (0, 99)},
    'img_subscriber': {
        'output_dir': str, 'file_name': str, 'topics': str,
        'transport': {'auto', 'raw', 'compressed', 'compressedDepth'}, 'max_pixels': (1, 2**31),
        'mode': {'continuous', 'on_request'}, 'convert': {'auto', 'never'},
        'lossy': {False, True}, 'range_low': (-1e9, 1e9), 'range_high': (-1e9, 1e9),
        'colors': {'gray', 'turbo', 'jet', 'viridis', 'cividis', 'magma', 'inferno', 'plasma'},
        'jpeg_quality': (1, 100), 'png_compression': (0, 9), 'crf': (0, 51),
        'every_n': (1, BILLION), 'max_rate': (0.1, 1e6), 'max_frames': (0, BILLION),
        'max_duration': (0.0, 1e9), 'max_bytes': (0, 10**18), 'ring': {False, True},
        'split_bytes': (0, 10**18), 'split_duration': (0.0, 1e9),
        'queue_size': (1, 100_000), 'writers': (0, 256), 'on_overflow': {'drop', 'block'},
        'on_exists': {'continue', 'error', 'overwrite'}, 'sync': {False, True},
        'timeout': (0.0, 1e9), 'priority': (0, 99)}}
# Rates, which may be 0 as well.
RATES = {'publish_rate', 'fps', 'max_rate'}
# Parameters of the publisher that cannot be changed while it runs; all of the subscriber.
FIXED = {'source', 'bag_topic', 'topics', 'clock', 'camera_info_url', 'camera_name', 'on_end',
         'loop', 'start_frame', 'stop_frame', 'max_frames', 'wait_for_subscribers', 'priority'}


@pytest.fixture
def context(domain: int) -> Iterator[Context]:
    made = Context()
    rclpy.init(context=made, domain_id=domain)
    yield made
    rclpy.shutdown(context=made)


def declare_given(context: Context, table: tuple[Parameter, ...], **given: object) -> Node:
    """Make a node as at the start, with parameters that were given, and without services."""
    node = Node('given', context=context, automatically_declare_parameters_from_overrides=True,
                start_parameter_services=False, enable_rosout=False,
                parameter_overrides=[rclpy.Parameter(name, value=value)
                                     for name, value in given.items()])
    try:
        declare_parameters(node, table)
    except ParameterError:
        node.destroy_node()
        raise
    return node


def test_names_of_all_parameters() -> None:
    assert {name: [parameter.name for parameter in table] for name, table in TABLES.items()} == {
        name: list(allowed) for name, allowed in VALUES.items()}


@pytest.mark.parametrize('executable', VALUES)
def test_descriptors_of_all_parameters(context: Context, executable: str) -> None:
    node = declare_given(context, TABLES[executable])
    found = {name: node.describe_parameter(name) for name in VALUES[executable]}
    node.destroy_node()
    expected, bounds = {}, {}
    for name, allowed in VALUES[executable].items():
        descriptor = found[name]
        is_number = isinstance(allowed, tuple)
        expected[name] = (executable == 'img_subscriber' or name in FIXED, [
            (0.0, allowed[1]) if name in RATES else allowed] if is_number else [])
        bounds[name] = (descriptor.read_only, [(one.from_value, one.to_value) for one in (
            *descriptor.integer_range, *descriptor.floating_point_range)])
        text = descriptor.additional_constraints
        if name in RATES:
            assert text == f'0 or 0.1 to {allowed[1]:.15g}'
        elif isinstance(allowed, set) and allowed != {False, True}:
            listed = {*text.removeprefix('one of: ').split(', ')}
            assert {str(choice) for choice in allowed if choice != ''} <= listed, name
        else:
            assert text == '', name
    assert bounds == expected


@pytest.mark.parametrize('executable', VALUES)
def test_valid_and_invalid_values(context: Context, executable: str) -> None:
    for parameter in TABLES[executable]:
        check_values(context, parameter, VALUES[executable][parameter.name])


def check_values(context: Context, parameter: Parameter, allowed: Any) -> None:
    """Check the values with which a node with one parameter starts, and those it refuses."""
    name, default = parameter.name, parameter.default
    right: list[object] = [default]
    if allowed is str:
        wrong: list[object] = [True, [1]]
    elif isinstance(allowed, set):
        right += allowed
        wrong = [2, 'yes'] if allowed == {False, True} else ['other', 45, -1]
    else:
        right += allowed
        least, most = allowed
        if isinstance(default, float):
            wrong = [math.nextafter(least, -math.inf), math.nextafter(most, math.inf), math.nan]
        else:
            wrong = [least - 1, most + 1, 1.5]
        wrong += ['x', True]
    if name in RATES:
        right.append(0.0)
        wrong += [1e-300, 0.02, -0.0001]
    for value in right:
        node = declare_given(context, (parameter,), **{name: value})
        got = node.get_parameter(name).value
        node.destroy_node()
        assert (name, got, type(got)) == (name, value, type(default))
    for value in wrong:
        with pytest.raises(ParameterError, match=f'parameter {name} is '):
            declare_given(context, (parameter,), **{name: value})


@dataclass(frozen=True, kw_only=True)
class Grouped:
    own: int = parameter_fields.parameter(1, 'a number')
    part: VideoSettings = parameter_fields.parameter_group(
        VideoSettings(quality=30), 'video_')


def test_group_of_parameters() -> None:
    assert [(found.name, found.default) for found in parameter_table(Grouped)][:3] == [
        ('own', 1), ('video_codec', 'h264'), ('video_quality', 30)]
    changed = with_values(Grouped(), {'own': 2, 'video_codec': 'h265'})
    assert changed == Grouped(own=2, part=VideoSettings(codec='h265', quality=30))
    with pytest.raises(ParameterError, match=r'^parameter video_bit_rate is 5: give '):
        with_values(changed, {'video_bit_rate': 5})
    with pytest.raises(TypeError, match='quality'):
        with_values(changed, {'quality': 5})


@pytest.mark.parametrize('settings', [
    PublisherSettings, RecorderSettings, FilterSettings, ViewerSettings])
def test_rates_are_0_or_at_least_0_1(settings: type) -> None:
    rates = [found for found in parameter_table(settings) if 'Hz' in found.description]
    assert rates
    for found in rates:
        for value in (0.02, 1e-300, 5e-324, math.nextafter(0.1, 0.0)):
            with pytest.raises(ParameterError, match=(
                    f'^parameter {found.name} is {value!r}: give (0, or )?a number from 0.1 to ')):
                found.accept(value)
        assert [found.accept(value) for value in (0.1, 1, 240)] == [0.1, 1.0, 240.0]
        if found.or_zero:
            assert str(found.accept(-0.0)) == '0.0'
        assert found.or_zero == (settings is not ViewerSettings)


ENDING = (Parameter('counts', 1, 'a number', bounds=(0, 9)),
          Parameter('limits', 1, 'a limit', bounds=(0, 9), ends=True))


@pytest.mark.parametrize('name', ['limit', 'lmits'])
def test_misspelt_parameter_that_ends_the_node(context: Context, name: str) -> None:
    with pytest.raises(ParameterError, match=f'no parameter {name}: did you mean limits'):
        declare_given(context, ENDING, **{name: 1})


@pytest.mark.parametrize(('name', 'meant'), [
    ('video_device', 'source'), ('filename', 'source'), ('sourc', 'source'),
    ('device_id', 'source'), ('gscam_config', 'source'), ('videofile', 'source'),
    ('VIDEO_DEVICE', 'source'), ('camera_source', 'source'), ('loop_video', 'loop'),
    ('camera_index', 'source'), ('path', 'source')])
def test_name_that_means_a_parameter_that_ends_the_node(
        context: Context, name: str, meant: str) -> None:
    with pytest.raises(ParameterError, match=f'no parameter {name}: did you mean {meant}'):
        declare_given(context, publisher_parameters.PARAMETERS, **{name: '/dev/video2'})


@pytest.mark.parametrize(('name', 'meant'), [
    ('framerate', 'fps'), ('pixel_format', 'fourcc'), ('color_format', 'fourcc'),
    ('image_width', 'width'),
    ('image_height', 'height'), ('camera_frame_id', 'frame_id'), ('output_encoding', 'encoding'),
    ('flip_vertical', 'flip'), ('image_size', 'width and height'), ('FPS', 'fps'),
    ('camera_info_path', 'camera_info_url')])
def test_name_of_another_package(context: Context, name: str, meant: str) -> None:
    declare_given(context, publisher_parameters.PARAMETERS, **{name: 5}).destroy_node()
    assert describe_unknown(name, publisher_parameters.PARAMETERS) == (
        f'unknown parameter {name} is not used; did you mean {meant}?')


@pytest.mark.parametrize(('name', 'value'), [('count', 1), ('use_sim_time', True), ('whole', 1)])
def test_unknown_parameter_beside_one_that_ends_the_node(
        context: Context, name: str, value: object) -> None:
    declare_given(context, ENDING, **{name: value}).destroy_node()


def check_together(changes: dict[str, Any]) -> None:
    if changes.get('count') == 5 and changes.get('turn') == 90:
        raise ParameterError('five turns are too many')


@pytest.fixture
def described(domain: int) -> Node:
    """Create a node with the parameters of the table, some of them set."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain, args=[
        '--ros-args', '-p', 'name:=7', '-p', 'rate:=2', '-p', 'count:=5', '-p', 'on:=1'])
    node = Node('described', context=context,
                automatically_declare_parameters_from_overrides=True)
    node.values = declare_parameters(node, TABLE)
    watch_parameters(node, TABLE, node.values.update, check_together=check_together)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


def test_types_of_declared_values(described: Node) -> None:
    assert described.values == {
        'name': '7', 'kind': 'a', 'rate': 2.0, 'count': 5, 'turn': 0, 'on': True, 'even': 2}
    assert described.get_parameter('rate').value == 2.0
    assert isinstance(described.get_parameter('rate').value, float)


def test_descriptors(described: Node) -> None:
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


def test_changes_at_run_time(described: Node) -> None:
    for name, value in (('rate', 3.0), ('kind', 'b'), ('turn', 90), ('on', False), ('even', 8),
                        ('rate', 4), ('on', 1)):
        (result,) = described.set_parameters([rclpy.Parameter(name, value=value)])
        assert result.successful, result.reason
        assert described.values[name] == described.get_parameter(name).value == value
        expected = {'rate': float, 'on': bool}.get(name, type(value))
        assert type(described.get_parameter(name).value) is expected
    assert described.describe_parameter('rate').type == rclpy.Parameter.Type.DOUBLE.value


def test_changes_of_other_parameters(described: Node) -> None:
    described.declare_parameter('other', 1)
    before = dict(described.values)
    assert described.set_parameters([rclpy.Parameter('other', value=2)])[0].successful
    assert described.values == before
    assert described.set_parameters_atomically(
        [rclpy.Parameter('other', value=3), rclpy.Parameter('rate', value=5)]).successful
    assert described.values == {**before, 'rate': 5.0}
    assert described.get_parameter('other').value == 3


def test_change_of_an_unknown_parameter(described: Node) -> None:
    with pytest.raises(UnknownParameterError, match=r'parameter rat is .*; did you mean rate\?'):
        described.set_parameters([rclpy.Parameter('rat', value=5)])


@pytest.mark.parametrize(('name', 'value', 'reason'), [
    ('name', 'y', 'read-only'), ('rate', 11.0, 'out of range'), ('rate', 11, 'out of range'),
    ('rate', 'x', 'Wrong parameter'), ('rate', True, 'Wrong parameter'),
    ('count', 3.0, 'Wrong parameter'), ('count', None, 'cannot be undeclared'),
    ('kind', 'c', "parameter kind is 'c': give one of 'a', 'b'"),
    ('turn', 45, 'parameter turn is 45: give one of 0, 90'), ('even', 3, 'not a valid step')])
def test_refused_changes_at_run_time(
        described: Node, name: str, value: object, reason: str) -> None:
    before = dict(described.values)
    (result,) = described.set_parameters([rclpy.Parameter(name, value=value)])
    assert not result.successful
    assert reason in result.reason
    assert described.values == before


def test_changes_that_do_not_suit_each_other(described: Node) -> None:
    before = dict(described.values)
    changes = [rclpy.Parameter('count', value=5), rclpy.Parameter('turn', value=90)]
    result = described.set_parameters_atomically(changes)
    assert not result.successful and result.reason == 'five turns are too many'
    assert described.values == before
    assert described.set_parameters_atomically(changes[1:]).successful
    assert described.values == {**before, 'turn': 90}


def test_atomic_changes(described: Node) -> None:
    before = dict(described.values)
    result = described.set_parameters_atomically([
        rclpy.Parameter('rate', value=4.0), rclpy.Parameter('turn', value=45)])
    assert not result.successful
    assert described.values == before


@pytest.mark.parametrize(('index', 'value'), [
    (0, [1]), (0, True), (1, 'c'), (2, 10.1), (2, -0.1), (2, float('nan')), (2, 'x'), (2, True),
    (3, 0), (3, 2.0), (3, None), (4, 45), (4, '90'), (5, 2), (5, 'yes')])
def test_refused_values(index: int, value: object) -> None:
    with pytest.raises(ParameterError, match=f'parameter {TABLE[index].name} is '):
        TABLE[index].accept(value)


@pytest.mark.parametrize(('parameter', 'values', 'noun'), [
    (Parameter('open', 1, 'a number'), (-2**63, 2**63 - 1), 'a whole number'),
    (Parameter('open', 1.0, 'a number'), (-1e300, 1e300), 'a number')])
def test_numbers_without_bounds(
        context: Context, parameter: Parameter, values: tuple[float, ...], noun: str) -> None:
    for value in values:
        node = declare_given(context, (parameter,), open=value)
        assert node.get_parameter('open').value == value
        node.destroy_node()
    for wrong in ('x', math.nan):
        with pytest.raises(ParameterError, match=rf'parameter open is .*: give {noun} \(a number'):
            parameter.accept(wrong)
