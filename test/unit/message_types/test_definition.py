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

"""Definitions of message types: all of ROS, and hostile texts."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
import sys
import time
from typing import Any

from hypothesis import example, given, settings, strategies
from installed_messages import compiled_class, installed_texts, installed_type, SEPARATOR
from opencv_tools.message_types import definition
from opencv_tools.message_types.definition import (
    Array, DefinitionError, Field, full_name, PLACEHOLDER, PRIMITIVES, read_definition)
from opencv_tools.message_types.description import type_hash
from opencv_tools.transport.type_support import hash_of
import pytest
from rosidl_adapter import parser
from type_description_interfaces.msg import FieldType
from waiting import pause

TEXT = 'int32 a'


def test_hash_of_every_compiled_type() -> None:
    names = [*installed_texts()]
    assert len(names) > 150
    wrong = [name for name in names
             if type_hash(installed_type(name)) != hash_of(compiled_class(name))]
    assert wrong == []


@pytest.mark.parametrize('name', [
    'foxglove_msgs/msg/CompressedVideo', 'ffmpeg_image_transport_msgs/msg/FFMPEGPacket',
    'tf2_msgs/msg/TFMessage', 'vision_msgs/msg/Detection2DArray'])
def test_types_of_this_package(name: str) -> None:
    found = read_definition(name)
    assert found.types[name].fields
    compiled = found.types.keys() & installed_texts().keys()
    assert 'builtin_interfaces/msg/Time' in compiled
    shipped = {f'{path.parent.name}/msg/{path.stem}': path.read_text()
               for path in Path(definition.__file__).parent.glob('msg/*/*.msg')}
    for inner in compiled & shipped.keys():
        assert type_hash(read_definition(inner, shipped[inner])) == hash_of(
            compiled_class(inner)), inner
    assert found.types.keys() - compiled <= shipped.keys()
    assert all(text.startswith('# From ') for text in shipped.values())


def test_fields() -> None:
    found = read_definition('a_msgs/A', f"""\
# first comment
uint8 LIMIT=3 # a constant
bool flag true
string<=5 short "a'b"
float32[3] fixed [1, 2, 3]
B[<=4] bounded  # a comment = 3

std_msgs/Header[] unbounded
{SEPARATOR}a_msgs/B
string[<=2] texts
""")
    assert found.name == 'a_msgs/msg/A'
    assert found.types['a_msgs/msg/A'].fields == (
        Field('flag', 'bool', default=True),
        Field('short', 'string', string_size=5, default="a'b"),
        Field('fixed', 'float32', Array.FIXED, 3, default=[1, 2, 3]),
        Field('bounded', 'a_msgs/msg/B', Array.BOUNDED, 4),
        Field('unbounded', 'std_msgs/msg/Header', Array.UNBOUNDED))
    assert [*found.types] == [
        'a_msgs/msg/A', 'a_msgs/msg/B', 'std_msgs/msg/Header', 'builtin_interfaces/msg/Time']
    assert read_definition('a_msgs/A', '# empty').types['a_msgs/msg/A'].fields == (
        Field(PLACEHOLDER, 'uint8'),)


def nested(levels: int) -> str:
    return 'T1 next\n' + ''.join(
        f'{SEPARATOR}a/T{level}\n' + (f'T{level + 1}[2] next\n' if level < levels else TEXT)
        for level in range(1, levels + 1))


def test_levels() -> None:
    assert len(read_definition('a/A', nested(29)).types) == 30
    with pytest.raises(DefinitionError, match='more than 30 levels'):
        read_definition('a/A', nested(30))


@pytest.mark.parametrize(('text', 'message'), [
    (None, 'the definition of a/msg/A is not known; give the text of its .msg file'),
    ('B b', 'the definition of a/msg/B is not known'),
    ('A a', 'a/msg/A contains itself'),
    (f'B b{SEPARATOR}a/B\nA[] a', 'a/msg/A contains itself'),
    ('int32', 'the definition of a/msg/A is invalid: InvalidFieldDefinition: int32'),
    ('int32 a\nint8 a', 'duplicate names'),
    ('int32 \x1b[31m', r'\x1b[31m'),
    ('uint8[99999999999999999999] a', 'a/msg/A.a has a size of 99999999999999999999'),
    ('string<=99999999999 a', 'at most 4294967295 are possible'),
    ('time a', "the type 'time' of ROS 1"),
    (f'{TEXT}{SEPARATOR}../x\nint8 a', "'../x' is not a message type"),
    ('int8 a\n' * 2001, 'more than 2000 lines'),
    (f'int8 {"a" * 1000}', 'more than 1000 characters'),
    ('x' * (1 << 20 | 1), '1048577 characters, at most 1048576 are read'),
    (''.join(f'T{i} t{i}\n' for i in range(501))
     + ''.join(f'{SEPARATOR}a/T{i}\n{TEXT}\n' for i in range(501)), '500 types')],
    ids=range(15))
def test_invalid_definitions(
        text: str | None, message: str, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(DefinitionError) as raised:
        read_definition('a/A', text)
    assert message in str(raised.value)
    assert str(raised.value).isprintable()
    assert capfd.readouterr() == ('', '')  # where the parser of ROS prints


@pytest.mark.parametrize('name', [
    '', 'A', 'a/b', 'a/srv/A', 'a/msg/A/B', '../a/msg/A', 'a/msg/A\n', 'a/msg/../../A', 'A/msg/A',
    'é/msg/A', 'a/A' * 99, None, 5, b'a/msg/A'])
def test_invalid_names(name: Any) -> None:
    with pytest.raises(DefinitionError, match='is not a message type; give package/msg/Name'):
        full_name(name)
    with pytest.raises(DefinitionError, match='is not a message type'):
        read_definition(name)


LINES = strategies.sampled_from([
    'int32 a', 'A a', 'B[] b', 'string<=', 'string<=3[<=2] c', 'uint8[', 'uint8[<=0] d', '=' * 80,
    'MSG: a/B', 'MSG: a/A', 'float64 e 1e999', 'bool[] f [true', 'int8 G=300', '#', '\t', '\0',
    'wstring w "', 'x' * 500, '\ud800', 'string s "' + '\\' * 99])


any_text = given(
    strategies.one_of(
        strategies.text(max_size=200), strategies.lists(LINES, max_size=12).map('\n'.join)))


@example('string s ' + '"\\' * 480)
@example('int32[] a [' + ',' * 900)
def check_any_text_is_read_or_refused(text: str) -> None:
    began = time.process_time()
    try:
        found = read_definition('a/A', text)
    except DefinitionError as err:
        assert str(err).isprintable()
    else:
        assert len(type_hash(found)) == 32
    assert time.process_time() - began < 5


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [75, 300])
def test_any_text_is_read_or_refused(examples: int) -> None:
    settings(max_examples=examples)(any_text(check_any_text_is_read_or_refused))()


def test_lines_of_windows() -> None:
    text = f'B b\r\nint8 a\r\n{SEPARATOR}a/B\nstring s\r\n'.replace('=\nMSG', '=\r\nMSG').replace(
        'a/B\n', 'a/B\r\n')
    found = read_definition('a/A', text)
    assert [*found.types] == ['a/msg/A', 'a/msg/B']
    assert found.types['a/msg/B'].fields == (Field('s', 'string'),)


@pytest.mark.parametrize(('name', 'text'), [('std_msgs/Header', None), ('a/A', TEXT)])
def test_without_ros(monkeypatch: pytest.MonkeyPatch, name: str, text: str | None) -> None:
    for module in ('ament_index_python', 'rosidl_adapter', 'rosidl_adapter.parser'):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DefinitionError, match=r'is not known|rosidl_adapter, a part of ROS'):
        read_definition(name, text)


def test_one_thread_at_a_time_silences_the_parser(monkeypatch: pytest.MonkeyPatch) -> None:
    parse, running, most = parser.parse_message_string, [], []

    def parse_slowly(*arguments: Any) -> Any:
        running.append(arguments)
        pause(0.01)
        most.append(len(running))
        running.pop()
        return parse(*arguments)

    monkeypatch.setattr(parser, 'parse_message_string', parse_slowly)
    before = sys.stderr
    with ThreadPoolExecutor(4) as threads:
        [*threads.map(lambda number: read_definition(f'a/A{number}', TEXT), range(8))]
    assert most == 8 * [1]
    assert sys.stderr is before


def test_numbers_of_the_primitive_types() -> None:
    for name, primitive in PRIMITIVES.items():
        known = {'char': 'UINT8', 'float32': 'FLOAT', 'float64': 'DOUBLE', 'bool': 'BOOLEAN'}.get(
            name, name.upper())
        assert primitive.type_id == getattr(FieldType, f'FIELD_TYPE_{known}'), name
        assert primitive.bounded_id == getattr(FieldType, f'FIELD_TYPE_BOUNDED_{known}', 0), name


def test_hash_of_bounded_strings() -> None:
    definition = read_definition('a/A', 'wstring<=3 a\nstring<=3[<=2] b')
    assert type_hash(definition).hex() == (
        'da992b11c8b45e896acfc0086753ad2d72f8c4785aa0208ad660eb2ac7685a79')
