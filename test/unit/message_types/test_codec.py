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

"""CDR of messages of any type: that of rclpy, and hostile bytes."""

from __future__ import annotations

from array import array
import tracemalloc
from types import SimpleNamespace
from typing import Any

from hypothesis import given, settings, strategies
from installed_messages import (
    compiled_class, installed_texts, installed_type, random_message, SEPARATOR)
import numpy as np
from opencv_tools.image.errors import CdrError
from opencv_tools.message_types import codec as module
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import read_definition
import pytest
from rclpy.serialization import deserialize_message, serialize_message

HEAD = b'\0\1\0\0'
TEXT = f"""\
int8 small
float64 large 2.5
string<=4 name "ab"
uint16[2] pair
B[] others
int32[<=3] few [7]
bool[] flags
{SEPARATOR}a/B
string[<=2] words
float32 number
"""


@pytest.fixture(scope='module')
def codec() -> MessageCodec:
    return MessageCodec(read_definition('a/A', TEXT))


def plain(value: Any) -> Any:
    """Return a value that was read with lists instead of arrays."""
    if isinstance(value, dict):
        return {name: plain(each) for name, each in value.items()}
    return [plain(each) for each in value] if isinstance(value, list | np.ndarray) else value


def test_every_compiled_type_reads_and_writes_the_same_bytes() -> None:
    random = np.random.default_rng(1)
    for name in installed_texts():
        definition = installed_type(name)
        codec = MessageCodec(definition)
        for message in ({}, *(random_message(definition, name, random) for _ in range(3))):
            written = codec.write(message)
            assert not message or plain(codec.read(written)) == message, name
            passed_on = serialize_message(deserialize_message(written, compiled_class(name)))
            # rclpy leaves arbitrary bytes between the fields, and behind the last one.
            assert len(passed_on) >= len(written), name
            assert plain(codec.read(passed_on)) == plain(codec.read(written)), name
            assert codec.write(codec.read(passed_on)) == written, name
        assert plain(codec.read(serialize_message(compiled_class(name)()))) == plain(
            codec.read(codec.write({}))), name


def test_bytes(codec: MessageCodec) -> None:
    written = codec.write({'small': -2, 'pair': (1, 2), 'others': [
        {'words': ('é', '')}, {'number': 0.5}], 'few': np.array([3]), 'flags': b'\1\0'})
    assert written == HEAD + bytes.fromhex(
        'fe 00000000000000 0000000000000440 03000000 616200 00 0100 0200 02000000'
        '02000000 03000000 c3a900 00 01000000 00 000000 00000000 00000000 0000003f'
        '01000000 03000000 02000000 0100')
    assert plain(codec.read(memoryview(written))) == {
        'small': -2, 'large': 2.5, 'name': 'ab', 'pair': [1, 2],
        'others': [{'words': ['é', ''], 'number': 0.0}, {'words': [], 'number': 0.5}],
        'few': [3], 'flags': [True, False]}


def test_big_endian() -> None:
    codec = MessageCodec(read_definition('a/A', 'uint8 a\nfloat64 b\nuint16[] c\nstring d'))
    found = codec.read(b'\0\0\0\0' + bytes.fromhex(
        '07 00000000000000 4004000000000000 00000002 0001 0002 00000002 4100'))
    assert plain(found) == {'a': 7, 'b': 2.5, 'c': [1, 2], 'd': 'A'}
    assert not found['c'].flags.writeable


def test_arrays_are_views() -> None:
    codec = MessageCodec(read_definition('a/A', 'uint8[] data'))
    written = bytearray(codec.write({'data': np.arange(9, dtype=np.uint8)}))
    found = codec.read(written)['data']
    written[-1] = 99
    assert found.tolist() == [*range(8), 99]


@pytest.mark.parametrize(('message', 'text'), [
    ({'tall': 1}, "a/msg/A has no field 'tall'"), ({1: 1}, "a/msg/A has no field '1'"),
    ([], '[] is not a mapping of the fields of a/msg/A'),
    ({'small': 128}, 'small is int8, which [128] does not fit'),
    ({'small': 1.5}, 'does not fit'), ({'small': float('nan')}, 'does not fit'),
    ({'small': 'x'}, "small is int8, not ['x']"), ({'small': [1]}, 'small is int8'),
    ({'small': {}}, 'small is int8'), ({'large': 10**400}, 'large is float64'),
    ({'pair': [1]}, 'pair has 1 values, 2 are required'), ({'pair': 5}, 'pair is uint16, not 5'),
    ({'pair': [[1, 2]]}, 'pair is uint16'), ({'pair': [-1, 0]}, 'does not fit'),
    ({'few': [1] * 4}, 'few has 4 values, 3 are the most'),
    ({'name': 5}, 'name is a string, not 5'), ({'name': '12345'}, 'at most 4 are'),
    ({'name': 'ééé'}, 'name has 6 bytes, at most 4 are allowed'),
    ({'name': 'a\0'}, 'name contains a NUL, which'),
    ({'name': '\ud800'}, 'cannot be written as UTF-8'),
    ({'others': 'ab'}, "others is an array, not 'ab'"), ({'others': {}}, 'is an array, not {}'),
    ({'others': 5}, 'others is an array, not 5'), ({'others': [5]}, '5 is not a mapping'),
    ({'others': [{'words': ['a'] * 3}]}, 'words has 3 values'),
    ({'others': [{'number': 1e39}]}, 'does not fit')])
def test_wrong_values(codec: MessageCodec, message: Any, text: str) -> None:
    with pytest.raises(CdrError) as raised:
        codec.write(message)
    assert text in str(raised.value)


def test_message_objects_of_every_compiled_type() -> None:
    for name in installed_texts():
        codec, message = MessageCodec(installed_type(name)), compiled_class(name)()
        if name == 'diagnostic_msgs/msg/DiagnosticStatus':
            message.level = b'\7'
        if name == 'std_msgs/msg/ByteMultiArray':
            message.data = [b'\1', b'\xff']
        assert plain(codec.read(codec.write(message))) == plain(
            codec.read(serialize_message(message))), name


def test_header_of_a_frame() -> None:
    codec = MessageCodec(read_definition('vision_msgs/msg/Detection2DArray'))
    header = compiled_class('std_msgs/msg/Header')(frame_id='camera')
    header.stamp.sec = 5
    found = codec.read(codec.write({'header': header, 'detections': [
        {'header': SimpleNamespace(stamp={'sec': 6}, frame_id='b')}]}))
    assert found['header'] == {'stamp': {'sec': 5, 'nanosec': 0}, 'frame_id': 'camera'}
    assert found['detections'][0]['header']['stamp']['sec'] == 6
    for wrong in (SimpleNamespace(frame_id='a'), header.stamp, 'a', 5):
        with pytest.raises(CdrError, match='is not a mapping of the fields of std_msgs/msg/Head'):
            codec.write({'header': wrong})
    empty = MessageCodec(read_definition('std_msgs/Empty'))
    assert empty.write(compiled_class('std_msgs/msg/Empty')()) == empty.write({})
    with pytest.raises(CdrError, match='5 is not a mapping'):
        empty.write(5)


@pytest.mark.parametrize('value', [b'', b'ab', 'a'])
def test_bytes_that_are_not_one_byte(value: Any) -> None:
    codec = MessageCodec(read_definition('a/A', 'byte a\nbyte[] b'))
    for message in ({'a': value}, {'b': [value]}):
        with pytest.raises(CdrError, match='is byte, not'):
            codec.write(message)
    assert codec.read(codec.write({'a': b'\5'}))['a'] == 5


@pytest.mark.parametrize('fields', ['wstring a', 'wstring<=3[] a'])
def test_wide_strings(fields: str) -> None:
    with pytest.raises(CdrError, match=r'a/msg/B\.a is a wide string, which is not supported'):
        MessageCodec(read_definition('a/A', f'B b{SEPARATOR}a/B\n{fields}'))


@pytest.mark.parametrize(('data', 'text'), [
    (b'', '0 bytes that are not plain CDR'), (b'\0\1', '2 bytes that are not'),
    (b'\0\3\0\0', 'not plain CDR'), (HEAD, '0 bytes, but at least 1 belong'),
    (HEAD + b'\xff' * 20, '20 bytes, but at least 4294967315 belong'),
    (HEAD + bytes(16) + b'\2\0\0\0\xff\0', 'is not UTF-8'),
    (HEAD + bytes(20) + bytes(4) + b'\xff\xff\xff\xff' + bytes(50),
     'others has 4294967295 values, but only 50 bytes follow'),
    (HEAD + bytes(20) + bytes(4) + bytes(4) + b'\4\0\0\0' + bytes(50),
     'few has 4 values, at most 3 are allowed')])
def test_wrong_bytes(codec: MessageCodec, data: bytes, text: str) -> None:
    with pytest.raises(CdrError, match=text):
        codec.read(data)


def test_claimed_sizes_cost_no_memory() -> None:
    huge = 'uint8[4294967295] a', 'B[4294967295] a', 'uint64[] a', 'B[] a', 'string[] a'
    tracemalloc.start()
    try:
        for fields in huge:
            codec = MessageCodec(read_definition('a/A', f'{fields}{SEPARATOR}a/B\nint8 a'))
            with pytest.raises(CdrError):
                codec.read(HEAD + b'\xff' * 10_000)
        assert tracemalloc.get_traced_memory()[1] < 3_000_000
    finally:
        tracemalloc.stop()


any_bytes = given(
    strategies.binary(max_size=120),
    strategies.sampled_from([b'', HEAD, b'\0\0\0\0']))


def check_any_bytes_are_read_or_refused(codec: MessageCodec, data: bytes, head: bytes) -> None:
    try:
        found = codec.read(head + data)
    except CdrError:
        return
    assert plain(codec.read(codec.write(found))) == pytest.approx(plain(found), nan_ok=True)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [75, 300])
def test_any_bytes_are_read_or_refused(examples: int, codec: MessageCodec) -> None:
    settings(max_examples=examples)(any_bytes(check_any_bytes_are_read_or_refused))(codec=codec)


def test_arrays_are_read_only() -> None:
    codec = MessageCodec(read_definition('a/A', 'uint8[] data'))
    found = codec.read(bytearray(codec.write({'data': b'abc'})))['data']
    assert not found.flags.writeable


@pytest.mark.parametrize(('fields', 'value', 'expected'), [
    ('uint64[] v', [1, 2**63 + 1], [1, 2**63 + 1]),
    ('int64[] v', [2**53 + 1, 0.0], [2**53 + 1, 0]),
    ('int64[] v', np.array([-2.0**63]), [-2**63]),
    ('bool[] v', [1.0, 0.0], [True, False]),
    ('float32[] v', memoryview(array('f', [1.0, 2.5])), [1.0, 2.5]),
    ('float32[] v', array('f', [1.0, 2.5]), [1.0, 2.5]),
    ('int8[] v', memoryview(array('d', [1.0, 2.0])), [1, 2]),
    ('uint8[] v', memoryview(b'abcdef')[::2], [*b'ace']),
    ('uint8[] v', memoryview(b''), []),
    ('int16[] v', (), []),
    ('int16[] v', np.arange(6)[::2], [0, 2, 4]),
    ('float32[] v', np.arange(6.0)[::2], [0.0, 2.0, 4.0])])
def test_exact_numbers(fields: str, value: Any, expected: list[Any]) -> None:
    codec = MessageCodec(read_definition('a/A', fields))
    assert plain(codec.read(codec.write({'v': value}))) == {'v': expected}


@pytest.mark.parametrize(('fields', 'value'), [
    ('int64[] v', [2.0**63]), ('int64[] v', np.array([2.0**63])), ('uint64[] v', [-1.0]),
    ('uint64[] v', np.array([-1])), ('int64[] v', np.array([2**63 + 1], np.uint64)),
    ('uint64[] v', [2.0**64, 1]), ('int32[] v', [1.5]), ('bool[] v', [2.0]),
    ('int8[] v', [float('inf')]), ('uint8[] v', np.array([255.5]))])
def test_numbers_that_do_not_fit(fields: str, value: Any) -> None:
    codec = MessageCodec(read_definition('a/A', fields))
    with pytest.raises(CdrError, match='does not fit'):
        codec.write({'v': value})


def test_buffer_that_is_not_contiguous() -> None:
    codec = MessageCodec(read_definition('a/A', 'uint8[] data'))
    twice = np.repeat(np.frombuffer(codec.write({'data': b'abc'}), np.uint8), 2)
    assert bytes(codec.read(twice[::2])['data']) == b'abc'
    with pytest.raises(CdrError, match='0 bytes that are not plain CDR'):
        codec.read(np.empty(0, np.uint8))


def test_limits_of_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    levels = ''.join(f'{SEPARATOR}a/B{level}\nB{level + 1}[2] x' for level in range(25))
    levels += f'{SEPARATOR}a/B25\nint8 x'
    monkeypatch.setattr(module, '_MAX_VALUES', 1000)
    with pytest.raises(CdrError, match='follows 1000 messages and strings, which are the most'):
        MessageCodec(read_definition('a/A', f'B0 a{levels}')).write({})
    empty = MessageCodec(read_definition('a/A', f'B[] x{SEPARATOR}a/B\n'))
    assert len(empty.read(empty.write({'x': 1000 * [{}]}))['x']) == 1000
    with pytest.raises(CdrError, match='x follows 1000 messages'):
        empty.read(HEAD + (1001).to_bytes(4, 'little') + bytes(1001))
    texts = MessageCodec(read_definition('a/A', 'string[] x'))
    with pytest.raises(CdrError, match='x follows 1000 messages and strings'):
        texts.write({'x': 1001 * ['']})
    monkeypatch.setattr(module, '_MAX_BYTES', 5000)
    for fields, message in (
            ('uint8[4294967295] x', {}), ('uint8[] x', {'x': bytes(6000)}),
            ('string x', {'x': 'a' * 6000}), ('float64[500] x\nfloat64[500] y', {})):
        with pytest.raises(CdrError, match='exceeds 5000 bytes'):
            MessageCodec(read_definition('a/A', fields)).write(message)
