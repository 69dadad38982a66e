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

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import repeat
from operator import itemgetter
import struct
from typing import Any, Literal

import numpy as np
from opencv_tools.base.text import printable
from opencv_tools.image.errors import CdrError
from opencv_tools.message_types.definition import Array, Field, PLACEHOLDER, TypeDefinition
from opencv_tools.message_types.plan import ALIGNMENT, is_number, Steps, structs, TypePlan, TYPES

_HEAD_SIZE = 4  # bytes that identify the encapsulation; fields are aligned from their end
_ORDERS: dict[bytes, Literal['<', '>']] = {b'\0\0': '>', b'\0\1': '<'}
_COUNT_BYTES = 4
# Functions that pack a number of values or bytes, by the alignment of its begin.
_PACK_COUNT = [struct.Struct(f'<{-begin % 4}xI').pack for begin in range(_COUNT_BYTES)]
_MAX_BYTES = 1 << 30  # of a message that is written
_MAX_VALUES = 1 << 19  # messages and strings in a message, each of which takes time and memory
_MAX_SHOWN = 40  # characters of a value in an error


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
        self._readers: dict[bytes, _Read] = {}
        for name, each in definition.types.items():
            for field in each.fields:
                if field.base == 'wstring':
                    raise CdrError(f'{name}.{field.name} is a wide string, which is not supported')

    def write(self, message: Any) -> bytes:
        """
        Convert a message to CDR.

        :param message: values by name, or an object with all fields as attributes, such as
            ``frame.header``. A message in a field is one of both, too. A field without a value
            has the default of the definition, else 0, ``''`` or no values.
        :returns: little-endian CDR.
        :raises CdrError: a field is unknown, its value does not have its type, or the message has
            more than 1 GiB, or more than 524288 messages and strings.
        """
        data = bytearray()
        self._write(data, message, _Values())
        return b'\0\1\0\0' + data

    def read(self, serialized: Any) -> dict[str, Any]:
        """
        Read a message from CDR.

        :param serialized: buffer of CDR, little-endian or big-endian.
        :returns: values by name. Arrays of numbers are views of the buffer, read-only. A buffer
            that is not contiguous is copied.
        :raises CdrError: the bytes are not plain CDR, are too few, have a string that is not
            UTF-8, or have more than 524288 messages and strings.
        """
        data = memoryview(serialized)
        if not data.c_contiguous or not data.nbytes:  # such a view cannot be cast
            data = memoryview(data.tobytes())
        data = data.cast('B').toreadonly()
        head = bytes(data[:2])
        if head not in _ORDERS or len(data) < _HEAD_SIZE:
            raise CdrError(f'{len(data)} bytes that are not plain CDR')
        if head not in self._readers:
            self._readers[head] = _ReadPlan(self._type, _ORDERS[head]).message(self._type.name)
        message: dict[str, Any] = self._readers[head](data[_HEAD_SIZE:], 0, _Values())[0]
        return message

    @cached_property
    def _write(self) -> _Write:
        return _WritePlan(self._type).message(self._type.name)


class _Values:
    """Number of messages and strings that a message may still have."""

    def __init__(self) -> None:
        self.left = _MAX_VALUES


# Reads a value from an offset of the data; returns it and the offset of its end.
_Read = Callable[[memoryview, int, _Values], tuple[Any, int]]
# Appends a value to the data.
_Write = Callable[[bytearray, Any, _Values], None]


class _ReadPlan(TypePlan[_Read]):
    """
    Reading of fields one after the other.

    Each value takes at least one byte, so the number of values is limited by that of the bytes.
    """

    def __init__(self, definition: TypeDefinition, order: Literal['<', '>']) -> None:
        super().__init__(definition)
        self._order = order
        self._count = struct.Struct(f'{order}I').unpack_from

    def _message(self, name: str, field: str, steps: Steps[_Read]) -> _Read:
        named = [('' if is_number(run[0]) else run[0].name, step) for step, run in steps]
        is_empty = any(each.name == PLACEHOLDER for _, run in steps for each in run)

        def read(data: memoryview, position: int, values: _Values) -> tuple[Any, int]:
            if field:
                values.left -= 1
                if values.left < 0:
                    raise _too_many(field)
            message: dict[str, Any] = {}
            for name, step in named:
                if name:
                    message[name], position = step(data, position, values)
                else:
                    numbers, position = step(data, position, values)
                    message.update(numbers)
            if is_empty:
                del message[PLACEHOLDER]
            return message, position
        return read

    def _run(self, fields: Sequence[Field]) -> _Read:
        """Return the function for consecutive numbers, which returns them by name."""
        names = [field.name for field in fields]
        ways = [(found.unpack_from, found.size) for found in structs(fields, self._order)]

        def read(data: memoryview, position: int, values: _Values) -> tuple[Any, int]:
            unpack, size = ways[position % ALIGNMENT]
            if position + size > len(data):
                for field in fields:  # one of them is cut off
                    width = TYPES[field.base].itemsize
                    position = _checked_begin(data, position, width, width) + width
            return zip(names, unpack(data, position)), position + size
        return read

    def _string(self, field: Field) -> _Read:
        unpack = self._count

        def read(data: memoryview, position: int, values: _Values) -> tuple[Any, int]:
            values.left -= 1
            if values.left < 0:
                raise _too_many(field.name)
            begin = _checked_begin(data, position, _COUNT_BYTES, _COUNT_BYTES) + _COUNT_BYTES
            end = begin + unpack(data, begin - _COUNT_BYTES)[0]
            if end > len(data):
                raise _too_few(data, end)
            try:
                return bytes(data[begin:end]).removesuffix(b'\0').decode(), end
            except UnicodeDecodeError as err:
                raise CdrError(f'{field.name} is not UTF-8: {err}') from err
        return read

    def _numbers(self, field: Field) -> _Read:
        dtype = TYPES[field.base].newbyteorder(self._order)
        alignment, is_bool = dtype.itemsize, dtype.kind == 'b'
        read_count = self._counted(field)

        def read(data: memoryview, position: int, values: _Values) -> tuple[Any, int]:
            count, position = read_count(data, position, values)
            size = count * alignment
            if size:
                position = _checked_begin(data, position, alignment, size)
            found = np.frombuffer(data[position:position + size], dtype)
            if is_bool:  # any other byte than 0 and 1 would be an invalid bool of numpy
                found = found.view(np.uint8) != 0
            return found, position + size
        return read

    def _values(self, field: Field, one: _Read) -> _Read:
        read_count = self._counted(field)

        def read(data: memoryview, position: int, values: _Values) -> tuple[Any, int]:
            count, position = read_count(data, position, values)
            if count > len(data) - position:
                raise CdrError(f'{field.name} has {count} values, but only '
                               f'{len(data) - position} bytes follow')
            found = []
            for _ in range(count):
                value, position = one(data, position, values)
                found.append(value)
            return found, position
        return read

    def _counted(self, field: Field) -> _Read:
        """Return the function for the number of values of an array."""
        unpack = self._count
        most = field.size if field.array is Array.BOUNDED else 2**32

        def read(data: memoryview, position: int, values: _Values) -> tuple[Any, int]:
            begin = _checked_begin(data, position, _COUNT_BYTES, _COUNT_BYTES)
            count = unpack(data, begin)[0]
            if count > most:
                raise CdrError(f'{field.name} has {count} values, at most {most} are allowed')
            return count, begin + _COUNT_BYTES

        if field.array is Array.FIXED:
            return lambda data, position, values: (field.size, position)
        return read


def _too_many(name: str) -> CdrError:
    return CdrError(f'{name} follows {_MAX_VALUES} messages and strings, which are the most in a '
                    'message')


def _checked_begin(data: memoryview, position: int, alignment: int, size: int) -> int:
    """Return the aligned offset of some bytes that the data have."""
    begin = position + -position % alignment
    if begin + size > len(data):
        raise _too_few(data, begin if begin > len(data) else begin + size)
    return begin


def _too_few(data: memoryview, end: int) -> CdrError:
    return CdrError(f'{len(data)} bytes, but at least {end} belong to the message')


class _WritePlan(TypePlan[_Write]):
    """Writing of fields one after the other."""

    def _message(self, name: str, field: str, steps: Steps[_Write]) -> _Write:
        names = frozenset(each.name for _, run in steps for each in run)
        named = [('', None, step) if is_number(run[0]) else (run[0].name, run[0].default, step)
                 for step, run in steps]
        # A message object of a type without fields has slots, which numbers and texts do not have.
        attributes = names - {PLACEHOLDER} or {'__slots__'}

        def write(data: bytearray, message: Any, values: _Values) -> None:
            if field:
                values.left -= 1
                if values.left < 0:
                    raise _too_many(field)
                message = {} if message is None else message
            if type(message) is not dict and not isinstance(message, Mapping):
                if not all(hasattr(message, each) for each in attributes):
                    raise CdrError(f'{_shown(message)} is not a mapping of the fields of {name}')
                message = {each: getattr(message, each) for each in names - {PLACEHOLDER}}
            if not message.keys() <= names:
                unknown = next(iter(message.keys() - names))
                raise CdrError(f"{name} has no field '{printable(unknown, _MAX_SHOWN)}'")
            for key, default, step in named:
                value = message.get(key) if key else message
                step(data, default if value is None else value, values)
        return write

    def _run(self, fields: Sequence[Field]) -> _Write:
        """Return the function for consecutive numbers of a message, which it receives."""
        ways = [(found.pack, found.size) for found in structs(fields, '<')]
        kinds = [type(TYPES[field.base].type().item()) for field in fields]
        names = [field.name for field in fields]
        get = itemgetter(*names) if len(names) > 1 else lambda message: (message[names[0]],)

        def write(data: bytearray, message: Any, values: _Values) -> None:
            pack, size = ways[len(data) % ALIGNMENT]
            try:
                found = get(message) if type(message) is dict else ()
                if [*map(type, found)] == kinds and len(data) + size <= _MAX_BYTES:
                    data += pack(*found)
                    return
            except (KeyError, OverflowError, struct.error):
                pass  # a default follows, or the error of a number
            for field in fields:
                value = message.get(field.name)
                default = 0 if field.default is None else field.default
                number = _checked(field, data, [default if value is None else value])
                data += bytes(-len(data) % number.itemsize)
                data += number.tobytes()
        return write

    def _string(self, field: Field) -> _Write:
        limit = field.string_size or 2**32

        def write(data: bytearray, value: Any, values: _Values) -> None:
            values.left -= 1
            if values.left < 0:
                raise _too_many(field.name)
            if value is None:
                value = ''
            if not isinstance(value, str):
                raise CdrError(f'{field.name} is a string, not {_shown(value)}')
            try:
                content = value.encode()
            except UnicodeEncodeError as err:
                raise CdrError(f'{field.name} cannot be written as UTF-8: {err}') from err
            if b'\0' in content:
                raise CdrError(f'{field.name} contains a NUL, which a string cannot have')
            size = len(content)
            if size > limit:
                raise CdrError(f'{field.name} has {size} bytes, at most {limit} are allowed')
            if len(data) + size > _MAX_BYTES:
                raise _too_long(field)
            data += _PACK_COUNT[len(data) % _COUNT_BYTES](size + 1)
            data += content
            data += b'\0'
        return write

    def _numbers(self, field: Field) -> _Write:
        dtype, write_count = TYPES[field.base], self._counted(field)

        def write(data: bytearray, value: Any, values: _Values) -> None:
            if type(value) is not np.ndarray or value.dtype != dtype or value.ndim != 1:
                value = _array(field, data, value)
            size = value.nbytes
            if len(data) + size > _MAX_BYTES:
                raise _too_long(field)
            write_count(data, len(value), values)
            if size:
                data += bytes(-len(data) % dtype.itemsize)
                data += value.tobytes()
        return write

    def _values(self, field: Field, one: _Write) -> _Write:
        write_count = self._counted(field)
        default_count = field.size if field.array is Array.FIXED else 0

        def write(data: bytearray, value: Any, values: _Values) -> None:
            if value is not None and (
                    not isinstance(value, Sequence) or isinstance(value, str | bytes)):
                raise CdrError(f'{field.name} is an array, not {_shown(value)}')
            write_count(data, default_count if value is None else len(value), values)
            for each in repeat(None, default_count) if value is None else value:
                one(data, each, values)
        return write

    def _counted(self, field: Field) -> _Write:
        """Return the function for the number of values of an array."""
        is_fixed = field.array is Array.FIXED
        least = field.size if is_fixed else 0
        most = 2**32 if field.array is Array.UNBOUNDED else field.size

        def write(data: bytearray, count: Any, values: _Values) -> None:
            if not least <= count <= most:
                raise CdrError(f'{field.name} has {count} values, {field.size} are '
                               + ('required' if is_fixed else 'the most'))
            if not is_fixed:
                data += _PACK_COUNT[len(data) % _COUNT_BYTES](count)
        return write


def _array(field: Field, data: bytearray, value: Any) -> np.ndarray[Any, Any]:
    """Return the numbers of an array, zeros without a value."""
    if value is None:
        count = field.size if field.array is Array.FIXED else 0
        _check_room(field, data, count * TYPES[field.base].itemsize)
        return np.zeros(count, TYPES[field.base])
    if isinstance(value, bytes | bytearray):
        value = np.frombuffer(value, np.uint8)
    return _checked(field, data, value)


def _checked(field: Field, data: bytearray, value: Any) -> np.ndarray[Any, Any]:
    """Return values as an array of the type of a field, if it can represent them."""
    try:
        if field.base == 'byte' and isinstance(value, list):  # rclpy has bytes of one byte
            value = [each[0] if isinstance(each, bytes) and len(each) == 1 else each
                     for each in value]
        converted = convert_numbers(value, TYPES[field.base])
    except (BufferError, TypeError, ValueError, OverflowError) as err:
        raise CdrError(f'{field.name} is {field.base}, not {_shown(value)}') from err
    if converted is None:
        raise CdrError(f'{field.name} is {field.base}, which {_shown(value)} does not fit')
    _check_room(field, data, converted.nbytes)
    return converted


def _check_room(field: Field, data: bytearray, size: int) -> None:
    if len(data) + size > _MAX_BYTES:
        raise _too_long(field)


def _too_long(field: Field) -> CdrError:
    return CdrError(f'{field.name} exceeds {_MAX_BYTES} bytes, which a message may have')


def _shown(value: Any) -> str:
    return printable(f'{value!r}', _MAX_SHOWN)
