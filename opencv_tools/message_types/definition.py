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

"""Message types, read from the text of their definitions (``.msg``), and primitive types."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from importlib.resources import files
import os
from pathlib import Path
import re
import sys
from typing import Any, NamedTuple

from opencv_tools.base.text import printable


class Primitive(NamedTuple):
    """
    A primitive type.

    :param dtype: type of numpy; '' for strings.
    :param type_id: number in type_description_interfaces/msg/FieldType.
    :param introspection: number in rosidl_typesupport_introspection_c/field_types.h.
    :param bounded_id: like ``type_id``, of a string with a largest size.
    """

    dtype: str
    type_id: int
    introspection: int
    bounded_id: int = 0


#: The primitive types by name. In a .msg file, char is uint8.
PRIMITIVES = {
    'bool': Primitive('?', 15, 6),
    'byte': Primitive('u1', 16, 7),
    'char': Primitive('u1', 3, 8),
    'int8': Primitive('i1', 2, 9),
    'uint8': Primitive('u1', 3, 8),
    'int16': Primitive('i2', 4, 11),
    'uint16': Primitive('u2', 5, 10),
    'int32': Primitive('i4', 6, 13),
    'uint32': Primitive('u4', 7, 12),
    'int64': Primitive('i8', 8, 15),
    'uint64': Primitive('u8', 9, 14),
    'float32': Primitive('f4', 10, 1),
    'float64': Primitive('f8', 11, 2),
    'string': Primitive('', 17, 16, 21),
    'wstring': Primitive('', 18, 17, 22),
}


_MAX_TEXT = 1 << 20  # characters of a type with all types that it contains
_MAX_LINES = 2000  # of one type
_MAX_LINE = 1000  # characters
_MAX_TYPES = 500
_MAX_DEPTH = 30  # of types inside of types
_MAX_SHOWN = 80  # characters of a text in an error
_MAX_SIZE = 2**32 - 1  # of an array or a string in CDR
# Names as ROS allows them. A pattern takes a time linear in the line.
_WORD = '[a-z][a-z0-9]*(?:_[a-z0-9]+)*'  # a package or field
_SHORT = ('(?:Sample_)?[A-Z][A-Za-z0-9]*(?:_Feedback)?(?:_Result)?(?:_Goal)?(?:_Response)?'
          '(?:_Request)?')
_SIZE = '0*[1-9][0-9]*'
_NAME = re.compile(f'{_WORD}/msg/{_SHORT}')
_FIELD_NAME = re.compile(_WORD)
_CONSTANT_NAME = re.compile('[A-Z][A-Z0-9]*(?:_[A-Z0-9]+)*')
_TYPE = re.compile(
    rf'(?:(?P<base>{"|".join(PRIMITIVES)})(?:(?<=string)<=(?P<limit>{_SIZE}))?'
    rf'|(?:(?P<package>{_WORD})/)?(?P<short>{_SHORT}))'
    rf'(?P<array>\[(?:(?P<bound><=)?(?P<size>{_SIZE}))?\])?')
# A text in an array of texts: between quotes, which a backslash escapes, or up to a comma.
_TEXT = re.compile(
    r""" *(?:(["'])((?:(?!\1|\\).|\\\1(?!\1)|\\(?!\1))*)\1|([^,"' ][^,]*)) *(?:,|\Z)""")
_BOOLS = {'true': True, '1': True, 'false': False, '0': False}
_SEPARATOR = re.compile(r'^={40,}\s*^MSG: *(\S+)[ \r]*$', re.MULTILINE)
#: The field of a type without fields, of which C and IDL know none.
PLACEHOLDER = 'structure_needs_at_least_one_member'


class DefinitionError(ValueError):
    """The definition of a message type is missing or invalid. The message contains the reason."""


class Array(Enum):
    """How many values a field has."""

    NONE = 'one'
    FIXED = 'fixed'
    BOUNDED = 'bounded'
    UNBOUNDED = 'unbounded'


class Field(NamedTuple):
    """
    A field of a message.

    :param base: type of one value: a primitive type such as ``'uint8'``, or the full name of a
        message type.
    :param size: number of values of a fixed array, largest number of a bounded one; else 0.
    :param string_size: largest number of characters of a bounded string; else 0.
    :param default: default value; None without one.
    """

    name: str
    base: str
    array: Array = Array.NONE
    size: int = 0
    string_size: int = 0
    default: Any = None

    @property
    def is_message(self) -> bool:
        """Whether the values are messages."""
        return '/' in self.base


class Definition(NamedTuple):
    """
    The definition of a message type.

    :param fields: its fields, in order.
    :param text: text of its ``.msg`` file.
    """

    fields: tuple[Field, ...]
    text: str


@dataclass(frozen=True)
class TypeDefinition:
    """
    A message type and all types that it contains.

    :param name: full name, such as ``'std_msgs/msg/Header'``.
    :param types: its own fields and those of the types that it contains, by full name.
    """

    name: str
    types: Mapping[str, Definition]

    @property
    def text(self) -> str:
        """Text of the type, then of those that it contains, as in a bag."""
        first, *others = self.types.items()
        return ''.join([first[1].text, *(
            f'\n{"=" * 80}\nMSG: {name.replace("/msg/", "/")}\n{found.text}'
            for name, found in others)])


def full_name(text: str) -> str:
    """
    Return the full name of a message type.

    :param text: ``package/msg/Name`` or ``package/Name``.
    :raises DefinitionError: the text is no such name.
    """
    package, _, rest = text.partition('/') if isinstance(text, str) else 3 * ('',)
    name = text if '/' in rest else f'{package}/msg/{rest}'
    if not _NAME.fullmatch(name):
        raise DefinitionError(f"'{printable(text, _MAX_SHOWN)}' is not a message type; give "
                              'package/msg/Name')
    return name


def read_definition(name: str, text: str | None = None) -> TypeDefinition:
    """
    Read the definition of a message type.

    :param text: text of its ``.msg`` file; then, each after a line of ``=`` and a line
        ``MSG: package/Name``, the text of types that it contains, as in a bag. Types that are not
        there, and all without a text, are those that this package contains, such as all of
        common_interfaces, else those of packages in ``AMENT_PREFIX_PATH`` or beside Python.
    :returns: the type and all types that it contains.
    :raises DefinitionError: a definition is missing, invalid, too large or contains itself.
    """
    name = full_name(name)
    texts: dict[str, str] = {}
    if text is not None:
        if len(text) > _MAX_TEXT:
            raise DefinitionError(f'the definition of {name} has {len(text)} characters, at most '
                                  f'{_MAX_TEXT} are read')
        first, *others = _SEPARATOR.split(text)
        texts = {full_name(other): body for other, body in zip(others[::2], others[1::2])}
        texts[name] = first
    found: dict[str, Definition] = {}
    depths: dict[str, int] = {}

    def add(current: str, path: tuple[str, ...]) -> int:
        """Add a type with those that it contains, and return how many levels it has."""
        if current in path:
            raise DefinitionError(f'{current} contains itself')
        if len(path) > _MAX_DEPTH or len(found) >= _MAX_TYPES:
            raise DefinitionError(f'{name} contains more than {_MAX_DEPTH} levels or {_MAX_TYPES} '
                                  'types')
        if current not in depths:
            body = texts[current] if current in texts else _known_text(current)
            found[current] = Definition(_parse(current, body), body)
            inner = dict.fromkeys(
                field.base for field in found[current].fields if field.is_message)
            depths[current] = 1 + max(
                (add(base, (*path, current)) for base in inner), default=0)
        if len(path) + depths[current] > _MAX_DEPTH:
            raise DefinitionError(f'{name} contains more than {_MAX_DEPTH} levels')
        return depths[current]

    add(name, ())
    return TypeDefinition(name, found)


def _known_text(name: str) -> str:
    """Return the text of a definition that this package contains, or that is installed."""
    package, _, short = name.split('/')
    own = files(__package__) / 'msg' / package / f'{short}.msg'
    if own.is_file():
        return own.read_text('utf-8')
    for prefix in (*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix):
        path = Path(prefix, 'share', package, 'msg', f'{short}.msg')
        with suppress(OSError, ValueError):  # not there, or no text
            if prefix and path.is_file() and path.stat().st_size <= _MAX_TEXT:
                return path.read_text('utf-8')
    raise DefinitionError(f"the definition of {name} is not known; source the workspace of '"
                          f"{package}', or add its folder with share/{package} to "
                          'AMENT_PREFIX_PATH')


def _parse(name: str, text: str) -> tuple[Field, ...]:
    """Return the fields of a type, as the parser of ROS reads them."""
    # Comments may be of any size. As in the parser of ROS, # begins one in a text, too.
    lines = [line.partition('#')[0].replace('\t', ' ').rstrip() for line in text.splitlines()]
    if len(lines) > _MAX_LINES or any(len(line) > _MAX_LINE for line in lines):
        raise DefinitionError(f'the definition of {name} has more than {_MAX_LINES} lines, or a '
                              f'line with more than {_MAX_LINE} characters')
    found: dict[str, Field | None] = {}  # None for a constant
    for line in filter(None, lines):
        try:
            key, field = _read_line(name.partition('/')[0], line)
            if key in found:
                raise ValueError('has the name of a line before; give another')
        except ValueError as err:
            raise DefinitionError(f"the definition of {name} is invalid: '"
                                  f"{printable(line, _MAX_SHOWN)}' {printable(err)}") from err
        found[key] = field
    return tuple(filter(None, found.values())) or (Field(PLACEHOLDER, 'uint8'),)


def _read_line(package: str, line: str) -> tuple[str, Field | None]:
    """
    Return the name in a line, and its field; None for a constant.

    :raises ValueError: the line is invalid; the message follows the line.
    """
    kind, _, rest = line.partition(' ')
    name, is_constant, value = (part.strip() for part in rest.partition('='))
    if is_constant:
        if kind not in PRIMITIVES or not _CONSTANT_NAME.fullmatch(name):
            raise ValueError('is no constant; give a primitive type, a name in capitals, = and a '
                             'value')
        _read_value(Field(name, kind), value)
        return name, None
    name, _, value = name.partition(' ')
    match = _TYPE.fullmatch(kind)
    if not match or not _FIELD_NAME.fullmatch(name):
        raise ValueError('is no field of ROS 2; give a type and a name in small letters, such as '
                         'float64[3] position or builtin_interfaces/Time stamp')
    limit, size = (int(match[group] or 0) for group in ('limit', 'size'))
    if max(limit, size) > _MAX_SIZE:
        raise ValueError(f'has a size of {max(limit, size)}; give 1 to {_MAX_SIZE}')
    array = (Array.NONE if not match['array'] else Array.UNBOUNDED if not size
             else Array.BOUNDED if match['bound'] else Array.FIXED)
    base = match['base'] or f"{match['package'] or package}/msg/{match['short']}"
    field = Field(name, base, array, size, limit)
    return name, field._replace(default=_read_default(field, value.strip())) if value else field


def _read_default(field: Field, value: str) -> Any:
    if field.is_message:
        raise ValueError('has a default, which a message cannot have; give none')
    if field.array is Array.NONE:
        return _read_value(field, value)
    inner = value[1:-1]
    parts = inner.split(',') if inner else []
    if not PRIMITIVES[field.base].dtype:
        parts, end = [], 0
        while match := _TEXT.match(inner, end):
            quote, quoted, plain = match.groups()
            parts.append(quoted.replace('\\' + quote, quote) if quote else plain)
            end = match.end()
        inner = inner[:end]  # the rest is no text
    if (value != f'[{inner}]' or (len(parts) > field.size and field.array is Array.BOUNDED)
            or (len(parts) != field.size and field.array is Array.FIXED)):
        raise ValueError('has a default that is no array of its size; give values with commas '
                         'between [ and ]')
    return [_read_value(field, part.strip()) for part in parts]


def _read_value(field: Field, value: str) -> Any:
    """Return a value of the type of a field, without regard to its array."""
    dtype = PRIMITIVES[field.base].dtype
    with suppress(LookupError, ValueError):
        if field.base == 'bool':
            return _BOOLS[value.lower()]
        if not dtype:
            quote, size = value[:1], field.string_size or _MAX_SIZE
            if quote in ('"', "'") and value.endswith(quote):
                escaped = value[1:-1].count('\\' + quote)
                value = value[1:-1].replace('\\' + quote, quote)
                size = size if value.count(quote) == escaped else -1
            if len(value) <= size:
                return value
        elif dtype.startswith('f'):
            return float(value)
        else:
            number = int(value, 0 if {*value} & {*'xXoObB'} else 10)
            count = 1 << 8 * int(dtype[1])  # of the values of the type
            if 0 <= number + (count // 2 if dtype.startswith('i') else 0) < count:
                return number
    raise ValueError(f'has a value that is no {field.base}; give another')
