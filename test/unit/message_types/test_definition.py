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

from contextlib import redirect_stderr
import io
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

TEXT = 'int32 a'


def test_hash_of_every_compiled_type() -> None:
    names = [*installed_texts()]
    assert len(names) > 150
    wrong = [name for name in names
             if type_hash(installed_type(name)) != hash_of(compiled_class(name))]
    assert wrong == []


def test_types_of_this_package(monkeypatch: pytest.MonkeyPatch) -> None:
    installed = installed_texts()
    shipped = {f'{path.parent.name}/msg/{path.stem}': path.read_text()
               for path in Path(definition.__file__).parent.glob('msg/*/*.msg')}
    packages = {name.partition('/')[0] for name in shipped}
    # All types of a package of ROS are there. The other packages are none of its wheels.
    assert shipped.keys() >= {
        name for name in installed if name.partition('/')[0] in packages}
    assert packages - {name.partition('/')[0] for name in installed} == {
        'ffmpeg_image_transport_msgs', 'foxglove_msgs', 'tf2_msgs', 'vision_msgs'}
    monkeypatch.delenv('AMENT_PREFIX_PATH')
    monkeypatch.setattr(sys, 'prefix', '')
    for name, text in shipped.items():
        assert text.startswith('# From ')
        found = read_definition(name)
        if name in installed:
            assert type_hash(found) == hash_of(compiled_class(name)), name
            assert ros_parsed(name, text) == ros_parsed(name, installed[name])


def ros_parsed(name: str, text: str) -> Any:
    """Return what the parser of ROS reads: fields and constants; an error that it raises."""
    package, _, short = name.split('/')
    with redirect_stderr(io.StringIO()):
        try:
            return parser.parse_message_string(package, short, text)
        except Exception as err:  # noqa: B902 (it raises errors of many classes)
            return err


def ros_fields(name: str, text: str) -> tuple[Field, ...] | None:
    """Return the fields that the parser of ROS reads; None if it refuses the text."""
    parsed = ros_parsed(name, text)
    if isinstance(parsed, Exception):
        return None
    return tuple(Field(
        field.name, field.type.type if field.type.pkg_name is None
        else f'{field.type.pkg_name}/msg/{field.type.type}',
        Array.NONE if not field.type.is_array else Array.UNBOUNDED if not field.type.array_size
        else Array.BOUNDED if field.type.is_upper_bound else Array.FIXED,
        field.type.array_size or 0, field.type.string_upper_bound or 0, field.default_value)
        for field in parsed.fields) or (Field(PLACEHOLDER, 'uint8'),)


def own_fields(name: str, text: str) -> tuple[Field, ...] | None:
    """Return the fields that this package reads; None if it refuses the text."""
    try:
        return definition._parse(name, text)
    except DefinitionError:
        return None


def test_fields_of_every_installed_type_as_ros_reads_them() -> None:
    wrong = [name for name, text in installed_texts().items()
             if own_fields(name, text) != ros_fields(name, text)]
    assert wrong == []


TYPES = strategies.sampled_from([
    *PRIMITIVES, *PRIMITIVES, 'A', 'a_b/A', 'a__b/A', 'a_/A', 'A_B', 'A_Request', 'Sample_A_Goal',
    'Sample_', 'std_msgs/msg/Header', 'string<=3', 'wstring<=2', 'string<=0', 'string<=',
    'string<=3x', 'int32<=3', '', '1A', 'sTring', 'a/int32'])
ARRAYS = strategies.sampled_from([
    '', '', '', '[]', '[1]', '[2]', '[<=2]', '[0]', '[<=]', '[<=0]', '[03]', '[-1]', '[', '[]]',
    '[2][2]', ']', '[ 3]'])
NAMES = strategies.sampled_from([
    'a', 'b1', 'a_b', 'A', 'A_B', 'a__b', '_a', 'a_', 'AB', 'A__B', 'A_', '1a', 'é', '', 'a-b'])
VALUES = strategies.sampled_from([
    '', '', '', '0', '1', '-1', '128', '255', '256', '1.5', 'true', 'FALSE', '0x1f', '0b1', '007',
    '1_0', '+5', '1e3', '1e999', 'nan', '"a"', "'a'", "'", '""', '"a\\"b"', '"a"b"', '[]', '[1]',
    '[1, 2]', '[1,2, 3]', '[true,false]', '["a","b"]', "['a', 'b' ]", '[a, b]', '["a,b"]',
    '["a",]', '["a", ]', '[ ]', '[,]', '[a,,b]', '[" a "]', '["\'x\'"]', '["a\\"b", c]',
    '["\\""]', '[1', '1]', '[1,]', '[0x1]', '["abcd"]', 'abcd', '"abcd"', ' x y ', '\xa0', '\\',
    '"\\"', '# c', '=', '5=6', '"a=b"', '[', '[[]]'])
SPACES = strategies.sampled_from(13 * [' '] + ['', '  ', '\t', '\xa0'])
ANY_LINES = strategies.lists(strategies.one_of(
    strategies.tuples(TYPES, ARRAYS, SPACES, NAMES, SPACES, VALUES).map(''.join),
    strategies.tuples(TYPES, SPACES, NAMES, SPACES, strategies.just('='), VALUES).map(''.join),
    strategies.text('aA1_ []<=",\'\\./#\t', max_size=20)), min_size=1, max_size=2)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [500, 5000])
def test_hostile_lines_are_read_or_refused_as_by_ros(examples: int) -> None:
    @settings(max_examples=examples)
    @given(ANY_LINES.map('\n'.join))
    def check(text: str) -> None:
        assert repr(own_fields('p/msg/A', text)) == repr(ros_fields('p/msg/A', text))

    check()


@pytest.mark.parametrize(('line', 'reason'), [
    ('time a', 'a type of ROS 1, which ROS 2 has not'),
    ('duration[2] a', 'a type of ROS 1'),
    ('int8[4294967296] a', 'the size has four bytes in CDR'),
    ('string<=4294967296 a', 'the size has four bytes in CDR'),
    ('int8[+3] a', 'a size of digits alone'), ('int8[1_0] a', 'a size of digits alone'),
    ('int8[٣] a', 'a size of ASCII'), ('string<=+3 a', 'a size of digits alone'),
    ('string[] a ["a" "b"]', 'a comma is missing'), ('string[] a ["a"b]', 'a comma is missing')])
def test_lines_that_only_ros_reads(line: str, reason: str) -> None:
    assert reason
    assert ros_fields('p/msg/A', line)
    assert own_fields('p/msg/A', line) is None


def test_texts_with_two_escaped_quotes_which_ros_cuts() -> None:
    line = r'string[] a ["\"\"x", b]'
    found = own_fields('p/msg/A', line)
    assert found and found[0].default == ['""x', 'b']
    assert (ros_fields('p/msg/A', line) or found)[0].default != found[0].default


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
    (None, "the definition of a/msg/A is not known; source the workspace of 'a', or add its "
           'folder with share/a to AMENT_PREFIX_PATH'),
    ('B b', 'the definition of a/msg/B is not known'),
    ('A a', 'a/msg/A contains itself'),
    (f'B b{SEPARATOR}a/B\nA[] a', 'a/msg/A contains itself'),
    ('int32', "the definition of a/msg/A is invalid: 'int32' is no field of ROS 2; give a type"),
    ('int32 a\nint8 a', "'int8 a' has the name of a line before; give another"),
    ('int8 a=3', "'int8 a=3' is no constant; give a primitive type, a name in capitals"),
    ('int8 A=128', "'int8 A=128' has a value that is no int8; give another"),
    ('bool a yes', 'has a value that is no bool'), ('string<=2 a "abc"', 'is no string'),
    ('int8[2] a [1]', "'int8[2] a [1]' has a default that is no array of its size"),
    ('B b 3', "'B b 3' has a default, which a message cannot have; give none"),
    ('int32 \x1b[31m', r'\x1b[31m'),
    ('uint8[99999999999999999999] a', 'has a size of 99999999999999999999; give 1 to 4294967295'),
    ('string<=99999999999 a', 'has a size of 99999999999; give 1 to 4294967295'),
    ('time a', 'is no field of ROS 2; give'),
    (f'{TEXT}{SEPARATOR}../x\nint8 a', "'../x' is not a message type"),
    ('int8 a\n' * 2001, 'more than 2000 lines'),
    (f'int8 {"a" * 1000}', 'more than 1000 characters'),
    ('x' * (1 << 20 | 1), '1048577 characters, at most 1048576 are read'),
    (''.join(f'T{i} t{i}\n' for i in range(501))
     + ''.join(f'{SEPARATOR}a/T{i}\n{TEXT}\n' for i in range(501)), '500 types')],
    ids=range(21))
def test_invalid_definitions(text: str | None, message: str) -> None:
    with pytest.raises(DefinitionError) as raised:
        read_definition('a/A', text)
    assert message in str(raised.value)
    assert str(raised.value).isprintable()


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
@example(f'int8 {"A" * 99}a=3')  # the parser of ROS takes longer than the universe exists
@example('\n'.join(1900 * [f'string[] a [{480 * chr(34)}]'.replace('""', '"\\')]))
@example('\n'.join(f'float64[] a{number} [{"1," * 480}1]' for number in range(1000)))
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


def test_installed_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for prefix, text in {'first': 'int8 a', 'second': 'int8 b', 'python': 'int8 c'}.items():
        folder = tmp_path / prefix / 'share/own_msgs/msg'
        folder.mkdir(parents=True)
        (folder / 'A.msg').write_text(text)
    (tmp_path / 'first/share/own_msgs/msg/A.msg').write_bytes(b'# \xff\nint8 a')  # no text

    def name_of_field() -> str:
        return read_definition('own_msgs/A').types['own_msgs/msg/A'].fields[0].name

    monkeypatch.setattr(sys, 'prefix', str(tmp_path / 'python'))
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{tmp_path}/none::{tmp_path}/first:{tmp_path}/second')
    assert name_of_field() == 'b'
    monkeypatch.delenv('AMENT_PREFIX_PATH')
    assert name_of_field() == 'c'
    monkeypatch.chdir(tmp_path / 'first')
    (tmp_path / 'python/share/own_msgs/msg/A.msg').unlink()
    monkeypatch.setenv('AMENT_PREFIX_PATH', '')  # which is not the folder of the process
    with pytest.raises(DefinitionError, match='is not known'):
        name_of_field()


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
