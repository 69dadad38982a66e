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

from collections.abc import Iterator, Mapping
from contextlib import redirect_stderr, suppress
from dataclasses import dataclass
from enum import Enum
from importlib.resources import files
import io
from pathlib import Path
import re
from threading import Lock
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
_NAME = re.compile(r'[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9_]*')
_SEPARATOR = re.compile(r'^={40,}\s*^MSG: *(\S+)[ \r]*$', re.MULTILINE)
#: The field of a type without fields, of which C and IDL know none.
PLACEHOLDER = 'structure_needs_at_least_one_member'
# The parser of ROS writes on standard error, which belongs to the process.
_parser_lock = Lock()


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
    if not isinstance(text, str):
        raise DefinitionError(f"'{printable(text, _MAX_SHOWN)}' is not a message type; give "
                              'package/msg/Name')
    package, _, rest = text.partition('/')
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
        there, and all without a text, are those that are installed, else those that this
        package contains.
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
            found[current] = Definition(tuple(_parse(current, body)), body)
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
    """Return the text of a definition that is installed, or that this package contains."""
    package, _, short = name.split('/')
    own = files(__package__) / 'msg' / package / f'{short}.msg'
    with suppress(ImportError, LookupError, OSError, ValueError):  # not installed, or no text
        from ament_index_python import get_package_share_directory
        path = Path(get_package_share_directory(package), 'msg', f'{short}.msg')
        if path.stat().st_size <= _MAX_TEXT:
            return path.read_text()
    if not own.is_file():
        raise DefinitionError(f'the definition of {name} is not known; give the text of its .msg '
                              'file')
    return own.read_text()


def _parse(name: str, text: str) -> Iterator[Field]:
    """Yield the fields of a type, as the parser of ROS reads them."""
    try:
        from rosidl_adapter.parser import parse_message_string
    except ImportError as err:
        raise DefinitionError(f'{name} cannot be read, because rosidl_adapter, a part of ROS, '
                              f'cannot be imported: {err}') from err
    # Comments may be of any size and take time. As in the parser, # begins one everywhere.
    lines = [line.partition('#')[0] for line in text.splitlines()]
    if len(lines) > _MAX_LINES or any(len(line) > _MAX_LINE for line in lines):
        raise DefinitionError(f'the definition of {name} has more than {_MAX_LINES} lines, or a '
                              f'line with more than {_MAX_LINE} characters')
    package, _, short = name.split('/')
    try:
        with _parser_lock, redirect_stderr(io.StringIO()):
            parsed = parse_message_string(package, short, '\n'.join(lines))
    except Exception as err:  # noqa: B902 (the parser raises errors of many classes)
        raise DefinitionError(f'the definition of {name} is invalid: '
                              f'{type(err).__name__}: {printable(err)}') from err
    if not parsed.fields:
        yield Field(PLACEHOLDER, 'uint8')
    for field in parsed.fields:
        found = field.type
        size, string_size = found.array_size or 0, found.string_upper_bound or 0
        if found.type in ('duration', 'time') and found.pkg_name is None:
            raise DefinitionError(f"the definition of {name} has the type '{found.type}' of ROS 1")
        if max(size, string_size) > _MAX_SIZE:
            raise DefinitionError(f'{name}.{field.name} has a size of '
                                  f'{max(size, string_size)}, at most {_MAX_SIZE} are possible')
        array = (Array.NONE if not found.is_array else Array.UNBOUNDED if not size
                 else Array.BOUNDED if found.is_upper_bound else Array.FIXED)
        yield Field(field.name, found.type if found.pkg_name is None
                    else f'{found.pkg_name}/msg/{found.type}', array, size, string_size,
                    field.default_value)
