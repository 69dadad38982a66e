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

"""
Conversion of messages of any type to and from CDR, the serialisation format of ROS 2.

`opencv_tools.image.cdr` does this faster for images. Here a message is a dict of its fields: a
message in a field is a dict, numbers in arrays are a numpy array, other arrays are lists.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from opencv_tools.base.text import printable
from opencv_tools.image.errors import CdrError
from opencv_tools.message_types.definition import (
    Array, Field, PLACEHOLDER, PRIMITIVES, TypeDefinition)


def convert_numbers(value: Any, dtype: np.dtype[Any]) -> np.ndarray[Any, Any] | None:
    """
    Return numbers as an array of a type; None if it cannot represent them.

    Floats are rounded to a type of floats. Integers are never changed.

    :param value: sequence, array or other buffer of one dimension.
    :raises TypeError: the value is no sequence.
    :raises ValueError: a value is no number.
    :raises OverflowError: a number is too large.
    """
    given = np.asarray(value)
    if given.ndim != 1 or (given.size and given.dtype.kind not in 'biuf'):
        raise ValueError('not a number')
    if dtype.kind == 'f':
        with np.errstate(invalid='ignore', over='ignore'):
            converted = given.astype(dtype)
        return converted if np.array_equal(np.isfinite(converted), np.isfinite(given)) else None
    if given.dtype.kind != 'f':
        converted = given.astype(dtype)
        return converted if np.array_equal(converted, given) else None
    if not np.isfinite(given).all():
        return None
    # numpy rounds integers beside floats, and beside integers of another sign.
    exact = given.tolist() if isinstance(value, np.ndarray | memoryview) else [*value]
    numbers = [int(number) for number in exact]
    least, most = (0, 1) if dtype.kind == 'b' else (np.iinfo(dtype).min, np.iinfo(dtype).max)
    fits = numbers == exact and all(least <= number <= most for number in numbers)
    return np.array(numbers, dtype) if fits else None


_HEAD_SIZE = 4  # bytes that identify the encapsulation; fields are aligned from their end
_ORDERS: dict[bytes, Literal['<', '>']] = {b'\0\0': '>', b'\0\1': '<'}
_TYPES = {name: np.dtype(found.dtype) for name, found in PRIMITIVES.items() if found.dtype}
_COUNT = np.dtype('u4')
_MAX_BYTES = 1 << 30  # of a message that is written
_MAX_VALUES = 1 << 19  # messages and strings in a message, each of which takes time and memory
_MAX_SHOWN = 40  # characters of a value in an error


class MessageCodec:
    """
    Convert messages of one type to and from CDR.

    Wide strings are not supported, because their size in CDR differs between ROS releases.
    """

    def __init__(self, definition: TypeDefinition) -> None:
        """
        Prepare the conversion.

        :raises CdrError: the type has wide strings.
        """
        self._type = definition
        for name, each in definition.types.items():
            for field in each.fields:
                if field.base == 'wstring':
                    raise CdrError(f'{name}.{field.name} is a wide string, which is not supported')

    def write(self, message: Mapping[str, Any]) -> bytes:
        """
        Convert a message to CDR.

        :param message: values by name. A field without a value has the default of the definition,
            else 0, ``''`` or no values.
        :returns: little-endian CDR.
        :raises CdrError: a field is unknown, its value does not have its type, or the message has
            more than 1 GiB, or more than 524288 messages and strings.
        """
        writer = _Writer(self._type)
        writer.message(self._type.name, message)
        return writer.finish()

    def read(self, serialized: Any) -> dict[str, Any]:
        """
        Read a message from CDR.

        :param serialized: buffer of CDR, little-endian or big-endian.
        :returns: values by name. Arrays of numbers are views of the buffer, read-only. A buffer
            that is not contiguous is copied.
        :raises CdrError: the bytes are not plain CDR, are too few, have a string that is not
            UTF-8, or have more than 524288 messages and strings.
        """
        return _Reader(self._type, serialized).message(self._type.name)


class _Values:
    """Counts the messages and strings in a message."""

    def __init__(self) -> None:
        self._count = 0

    def count(self, name: str) -> None:
        """
        Count a value.

        :raises CdrError: there are too many.
        """
        self._count += 1
        if self._count > _MAX_VALUES:
            raise CdrError(f'{name} follows {_MAX_VALUES} messages and strings, which are the '
                           'most in a message')


class _Reader:
    """
    Reads fields one after the other.

    Each value takes at least one byte, so the number of values is limited by that of the bytes.
    """

    def __init__(self, definition: TypeDefinition, serialized: Any) -> None:
        data = memoryview(serialized)
        if not data.c_contiguous or not data.nbytes:  # such a view cannot be cast
            data = memoryview(data.tobytes())
        data = data.cast('B').toreadonly()
        order = _ORDERS.get(bytes(data[:2]))
        if order is None or len(data) < _HEAD_SIZE:
            raise CdrError(f'{len(data)} bytes that are not plain CDR')
        self._definitions = definition.types
        self._order = order
        self._data = data[_HEAD_SIZE:]
        self._position = 0
        self._values = _Values()

    def message(self, name: str) -> dict[str, Any]:
        """Read the fields of a message."""
        return {field.name: value for field in self._definitions[name].fields
                for value in (self._field(field),) if field.name != PLACEHOLDER}

    def _field(self, field: Field) -> Any:
        if field.array is Array.NONE:
            return self._value(field)
        count = field.size
        if field.array is not Array.FIXED:
            count = int(self._numbers(_COUNT, 1)[0])
            if field.array is Array.BOUNDED and count > field.size:
                raise CdrError(f'{field.name} has {count} values, at most {field.size} are '
                               'allowed')
        if field.base in _TYPES:
            return self._numbers(_TYPES[field.base], count)
        if count > len(self._data) - self._position:
            raise CdrError(f'{field.name} has {count} values, but only '
                           f'{len(self._data) - self._position} bytes follow')
        return [self._value(field) for _ in range(count)]

    def _value(self, field: Field) -> Any:
        if field.base not in _TYPES:
            self._values.count(field.name)
            return self.message(field.base) if field.is_message else self._string(field)
        return self._numbers(_TYPES[field.base], 1)[0].item()

    def _string(self, field: Field) -> str:
        size = int(self._numbers(_COUNT, 1)[0])
        content = bytes(self._bytes(size)).removesuffix(b'\0')
        try:
            return content.decode()
        except UnicodeDecodeError as err:
            raise CdrError(f'{field.name} is not UTF-8: {err}') from err

    def _numbers(self, dtype: np.dtype[Any], count: int) -> np.ndarray[Any, Any]:
        if count:
            self._bytes(-self._position % dtype.itemsize)
        found = np.frombuffer(self._bytes(count * dtype.itemsize), dtype.newbyteorder(self._order))
        if dtype.kind == 'b':  # any other byte than 0 and 1 would be an invalid bool of numpy
            return found.view(np.uint8) != 0
        return found

    def _bytes(self, size: int) -> memoryview:
        end = self._position + size
        if end > len(self._data):
            raise CdrError(f'{len(self._data)} bytes, but at least {end} belong to the message')
        taken = self._data[self._position:end]
        self._position = end
        return taken


class _Writer:
    """Writes fields one after the other."""

    def __init__(self, definition: TypeDefinition) -> None:
        self._definitions = definition.types
        self._data = bytearray()
        self._values = _Values()

    def finish(self) -> bytes:
        return b'\0\1\0\0' + self._data

    def message(self, name: str, values: Mapping[str, Any]) -> None:
        """Write the fields of a message."""
        if not isinstance(values, Mapping):
            raise CdrError(f'{_shown(values)} is not a mapping of the fields of {name}')
        fields = self._definitions[name].fields
        unknown = [*values.keys() - {field.name for field in fields}]
        if unknown:
            raise CdrError(f"{name} has no field '{printable(unknown[0], _MAX_SHOWN)}'")
        for field in fields:
            value = values.get(field.name)
            self._field(field, field.default if value is None else value)

    def _field(self, field: Field, value: Any) -> None:
        if field.array is Array.NONE:
            self._value(field, value)
            return
        if field.base in _TYPES:
            values: Any = self._array(field, value)
        elif value is None:
            values = range(field.size) if field.array is Array.FIXED else ()
        elif isinstance(value, Sequence) and not isinstance(value, str | bytes):
            values = value
        else:
            raise CdrError(f'{field.name} is an array, not {_shown(value)}')
        count = len(values)
        if (count != field.size if field.array is Array.FIXED
                else field.array is Array.BOUNDED and count > field.size):
            raise CdrError(f'{field.name} has {count} values, {field.size} are '
                           + ('required' if field.array is Array.FIXED else 'the most'))
        if field.array is not Array.FIXED:
            self._numbers(np.array([count], _COUNT))
        if field.base in _TYPES:
            self._numbers(values)
        else:
            for each in values:
                self._value(field, None if value is None else each)

    def _value(self, field: Field, value: Any) -> None:
        if field.base not in _TYPES:
            self._values.count(field.name)
        if field.is_message:
            self.message(field.base, {} if value is None else value)
        elif field.base == 'string':
            self._string(field, '' if value is None else value)
        else:
            self._numbers(self._checked(field, [0 if value is None else value]))

    def _string(self, field: Field, value: Any) -> None:
        if not isinstance(value, str):
            raise CdrError(f'{field.name} is a string, not {_shown(value)}')
        try:
            content = value.encode()
        except UnicodeEncodeError as err:
            raise CdrError(f'{field.name} cannot be written as UTF-8: {err}') from err
        if b'\0' in content:
            raise CdrError(f'{field.name} contains a NUL, which a string cannot have')
        if field.string_size and len(content) > field.string_size:
            raise CdrError(f'{field.name} has {len(content)} bytes, at most {field.string_size} '
                           'are allowed')
        self._check_room(field, len(content))
        self._numbers(np.array([len(content) + 1], _COUNT))
        self._data += content + b'\0'

    def _array(self, field: Field, value: Any) -> np.ndarray[Any, Any]:
        dtype = _TYPES[field.base]
        if value is None:
            count = field.size if field.array is Array.FIXED else 0
            self._check_room(field, count * dtype.itemsize)
            return np.zeros(count, dtype)
        if isinstance(value, bytes | bytearray):
            value = np.frombuffer(value, np.uint8)
        return self._checked(field, value)

    def _checked(self, field: Field, value: Any) -> np.ndarray[Any, Any]:
        """Return values as an array of the type of a field, if it can represent them."""
        try:
            converted = convert_numbers(value, _TYPES[field.base])
        except (BufferError, TypeError, ValueError, OverflowError) as err:
            raise CdrError(f'{field.name} is {field.base}, not {_shown(value)}') from err
        if converted is None:
            raise CdrError(f'{field.name} is {field.base}, which {_shown(value)} does not fit')
        self._check_room(field, converted.nbytes)
        return converted

    def _check_room(self, field: Field, size: int) -> None:
        if len(self._data) + size > _MAX_BYTES:
            raise CdrError(f'{field.name} exceeds {_MAX_BYTES} bytes, which a message may have')

    def _numbers(self, values: np.ndarray[Any, Any]) -> None:
        if values.size:
            self._data += bytes(-len(self._data) % values.itemsize)
            self._data += values.astype(values.dtype.newbyteorder('<'), copy=False).tobytes()


def _shown(value: Any) -> str:
    return printable(f'{value!r}', _MAX_SHOWN)
