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

"""Numbers in messages of any type, with their names."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.bags.reading import BagTopic
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.plan import NumbersSource
from opencv_tools.image.errors import CdrError
from opencv_tools.image.text import enumerated, printable
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import Array, DefinitionError, read_definition

# Fields with the names of the numbers in the arrays beside them, as in JointState.
_NAME_FIELDS = ('name', 'names', 'joint_names')
_HEADERS = ('header', 'layout')  # what is not data
_MOST = 4096  # numbers of a source


class MessageReader:
    """Reader of the messages of a topic."""

    def __init__(self, topic: BagTopic) -> None:
        """
        Read the definition of the type.

        :raises DatasetError: the definition is missing or invalid.
        """
        try:
            found = read_definition(topic.type_name, topic.definition or None)
            self._codec = MessageCodec(found)
        except (DefinitionError, CdrError) as err:
            raise DatasetError(f'{printable(topic.name)} cannot be read: {err}') from err
        fields = found.types[found.name].fields
        #: Whether a message begins with a time, that of a header or its own.
        self.has_stamp = bool(fields) and fields[0].array is Array.NONE and fields[0].base in (
            'std_msgs/msg/Header', 'builtin_interfaces/msg/Time')

    def read(self, serialized: Any) -> dict[str, Any]:
        """
        Read a message.

        :raises CdrError: the message cannot be read.
        """
        return self._codec.read(serialized)


def find_value(message: dict[str, Any], path: tuple[str, ...]) -> tuple[Any, Any]:
    """
    Return a value of a message, and the message or list that contains it.

    :raises DatasetError: a field or an element is missing.
    """
    parent: Any = None
    value: Any = message
    for name in path:
        parent = value
        if isinstance(value, dict) and name in value:
            value = value[name]
        elif isinstance(value, list | np.ndarray) and name.isdecimal() and int(name) < len(value):
            value = value[int(name)]
        else:
            known = [*value] if isinstance(value, dict) else (
                [f'0 to {len(value) - 1}'] if isinstance(value, list | np.ndarray) and len(value)
                else [])
            raise DatasetError(f"there is no field '{printable(name)}'; there is "
                               f'{enumerated(known, 20) or "no other"}')
    return value, parent


def numbers_of(message: dict[str, Any], source: NumbersSource) -> NDArray[np.float64]:
    """
    Return the numbers of a message.

    :param message: message as `MessageReader.read` returns it.
    :param source: path of the numbers. If it has names, the numbers have their order.
    :returns: (n,) array.
    :raises DatasetError: the numbers, or one of the names, are missing.
    """
    names, values = _named(message, source)
    if not source.names or names == source.names:
        return values
    places = {name: place for place, name in enumerate(names)}
    if len(places) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise DatasetError(f"'{twice}' is there twice")
    missing = [name for name in source.names if name not in places]
    if missing:
        raise DatasetError(f'{enumerated(missing)} of {len(source.names)} is missing; there is '
                           f'{enumerated(names, 20) or "nothing"}')
    return values[[places[name] for name in source.names]]


def names_of(message: dict[str, Any], source: NumbersSource) -> tuple[str, ...]:
    """
    Return the names of the numbers of a message, in its order.

    :raises DatasetError: the numbers are missing, or two have the same name.
    """
    names, _ = _named(message, source)
    if not names or len(names) > _MOST:
        raise DatasetError(f'{source} has {len(names)} numbers; 1 to {_MOST} can be a feature')
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise DatasetError(f"{source} has '{twice}' twice")
    return names


def _named(message: dict[str, Any], source: NumbersSource,
           ) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    value, parent = find_value(message, source.path)
    label = source.path[-1] if source.path else ''
    pairs = list(_leaves(value, parent, label, nested=False))
    return tuple(name for name, _ in pairs), np.array([number for _, number in pairs], np.float64)


def _leaves(value: Any, parent: Any, label: str, nested: bool) -> Iterator[tuple[str, float]]:
    """Yield the numbers in a value, with a name for each."""
    if isinstance(value, dict):
        for name, inner in value.items():
            if name not in _HEADERS:
                yield from _leaves(inner, value, f'{label}.{name}' if nested else name, True)
    elif isinstance(value, np.ndarray):
        names = _array_names(value, parent)
        for place, number in enumerate(value.tolist()):
            name = printable(names[place]) if names else f'{label}_{place}'
            yield f'{label}.{name}' if names and nested else name, float(number)
    elif isinstance(value, bool | int | float):
        yield label, float(value)
    else:
        kind = 'a text' if isinstance(value, str) else 'a list of messages or texts'
        raise DatasetError(f"'{printable(label)}' is {kind}, not a number; name another field, or "
                           'an element of a list by its number')


def _array_names(value: NDArray[Any], parent: Any) -> list[str]:
    """Return the names beside an array, as those of the joints in JointState; [] without them."""
    for field in _NAME_FIELDS if isinstance(parent, dict) else ():
        names = parent.get(field)
        if isinstance(names, list) and len(names) == len(value) and all(
                isinstance(name, str) for name in names):
            return names
    return []
