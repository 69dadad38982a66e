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

"""The messages of a topic of a bag as samples, and their numbers with names."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.bags.compression import decompressed_message
from opencv_tools.bags.reading import BagMessage, BagTopic, Damage
from opencv_tools.base.text import enumerated, printable
from opencv_tools.base.units import NANO
from opencv_tools.datasets.clocks import Clocks, LOG_REMEDY
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.plan import NumbersSource
from opencv_tools.image.errors import CdrError, ImageError
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import Array, DefinitionError, read_definition

# Fields with the names of the numbers in the arrays beside them, as in JointState.
_NAME_FIELDS = ('name', 'names', 'joint_names')
_HEADERS = ('header', 'layout')  # what is not data
_MOST = 4096  # numbers of a source


class NumbersReader:
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


def numbers_of(message: dict[str, Any], source: NumbersSource,
               ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """
    Return the numbers of a message, and whether it has each of them.

    :param message: message as `NumbersReader.read` returns it.
    :param source: path of the numbers. If it has names, the numbers have their order.
    :returns: two (n,) arrays; a number that the message does not have is 0.
    :raises DatasetError: the numbers are missing, or one is there twice.
    """
    names, values = _named(message, source)
    if not source.names or names == source.names:
        return values, np.ones(len(values), np.bool_)
    places = {name: place for place, name in enumerate(names)}
    if len(places) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise DatasetError(f"'{twice}' is there twice")
    is_known = np.array([name in places for name in source.names])
    found = np.zeros(len(source.names))
    found[is_known] = values[[places[name] for name in source.names if name in places]]
    return found, is_known


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
    for key in _NAME_FIELDS if isinstance(parent, dict) else ():
        names = parent.get(key)
        if isinstance(names, list) and names and len(value) and all(
                isinstance(name, str) for name in names):
            if len(names) != len(value):
                raise DatasetError(f"'{key}' has {len(names)} names for {len(value)} numbers")
            return names
    return []


_FILE_BITS = 40  # of a place in a file; the bits above have the number of the file
_STAMP_AT = 4  # offset in CDR of a stamp at the begin of a message


@dataclass
class Samples:
    """
    Messages of a topic that are read one after the other.

    :param source: numbers of the messages; None for images.
    :param reader: reader of the messages; None for images.
    :param logs: time of the recording of each message, in nanoseconds.
    :param stamps: stamp of each message, 0 without one.
    :param places: number of each message among all of the topic.
    :param written: place of each message in the files of the bag.
    :param values: numbers of all messages.
    :param known: whether the message has each of these numbers.
    :param events: values that begin or end episodes; None if the numbers are used.
    :param can_begin: returns whether a message can be decoded without those before it.
    :param is_video: returns whether a message has video; the first one tells.
    :param left_out: number of messages before the first one that can.
    :param damaged: number of those that cannot be read.
    """

    topic: BagTopic
    source: NumbersSource | None = None
    reader: NumbersReader | None = field(default=None, init=False)
    logs: array[int] = field(default_factory=lambda: array('q'))
    stamps: array[int] = field(default_factory=lambda: array('q'))
    places: array[int] = field(default_factory=lambda: array('q'))
    written: array[int] = field(default_factory=lambda: array('q'))
    values: array[float] = field(default_factory=lambda: array('d'))
    known: array[int] = field(default_factory=lambda: array('b'))
    events: list[Any] | None = None
    can_begin: Callable[[Any], bool] | None = None
    is_video: Callable[[Any], bool] | None = None
    has_video: bool = False
    left_out: int = 0
    count: int = 0
    damaged: int = 0

    def __post_init__(self) -> None:
        """Read the definition of the messages; see `NumbersReader`."""
        if self.source:
            self.reader = NumbersReader(self.topic)

    def add(self, item: BagMessage, file: int = 0) -> None:
        """
        Add a message; one that cannot be read counts as lost.

        :param file: number of its file in the bag, from 0.
        :raises DatasetError: it does not have the numbers.
        """
        place, self.count = self.count, self.count + 1
        try:
            serialized = decompressed_message(item.load())
            message = self.reader.read(serialized) if self.reader else {}
            if self.can_begin and not self.logs and not self.can_begin(serialized):
                self.left_out += 1
                return
            if self.is_video and not self.logs:
                self.has_video = self.is_video(serialized)
            stamp = _stamp(serialized) if not self.reader or self.reader.has_stamp else 0
            self.logs.append(item.log_ns)
        except (ImageError, OSError, OverflowError, struct.error):
            self.damaged += 1
            return
        if self.events is not None and self.source:
            self.events.append(_event(message, self.source))
        elif self.source:
            values, is_known = numbers_of(message, self.source)
            self.values.extend(values)
            self.known.extend(is_known.tolist())
        self.stamps.append(stamp)
        self.places.append(place)
        self.written.append((file << _FILE_BITS) + min(item.place, (1 << _FILE_BITS) - 1))

    def leave_out_zero(self) -> bool:
        """
        Leave out a first message with the stamp 0, as simulators begin; return whether it was.

        Several stamps of 0 are an error of `times`.
        """
        has_zero = len(self.stamps) > 1 and not self.stamps[0] and self.stamps[1] != 0
        if has_zero:
            width = len(self.values) // len(self.logs)
            del self.logs[0], self.stamps[0], self.places[0], self.written[0]
            del self.values[:width], self.known[:width]
            self.left_out += 1
        return has_zero

    @property
    def clocks(self) -> Clocks:
        """Return the times of the messages in the order of the files."""
        order = self._file_order()
        return Clocks(integers(self.logs)[order], integers(self.stamps)[order])

    def _file_order(self) -> NDArray[np.intp]:
        return np.argsort(integers(self.written), kind='stable')

    def doubled(self, clock: str) -> tuple[NDArray[np.bool_], str]:
        """
        Return which messages are in a time that is there twice; see `Clocks.doubled`.

        Video after the step cannot be decoded in this order.
        """
        clocks = self.clocks
        found, step = clocks.doubled(clock, is_video=self.has_video)
        found = found[np.argsort(self._file_order())]
        is_lost = self.has_video and clocks.log_is_doubled
        return np.maximum.accumulate(found) if is_lost else found, step

    def times(self, clock: str, name: str) -> NDArray[np.int64]:
        """
        Return the times of all messages in nanoseconds.

        :param clock: 'stamp' or 'log'.
        :raises DatasetError: there is none, or the times cannot be used.
        """
        shown = f'{name} ({printable(self.topic.name)})'
        if not self.logs:
            raise DatasetError(f'{shown} has no message that can be read')
        if clock == 'log':
            self.clocks.check_logs(shown)
            return integers(self.logs)
        if self.reader and not self.reader.has_stamp:
            raise DatasetError(f'the messages of {shown} have no stamp; {LOG_REMEDY}')
        self.clocks.check_stamps(shown)
        return integers(self.stamps)


def first_names(messages: Iterable[BagMessage | Damage], topic: BagTopic, source: NumbersSource,
                ) -> tuple[str, ...]:
    """
    Return the names of the numbers in the first message that can be read.

    Several publishers may send different joints. Names of messages that have none of those before
    follow them.

    :raises DatasetError: there is none, or it has no such numbers.
    """
    reader = NumbersReader(topic)
    reason = 'has no messages'
    found: tuple[str, ...] = ()
    try:
        for item in messages:
            if isinstance(item, Damage):
                continue
            try:
                message = reader.read(decompressed_message(item.load()))
            except (ImageError, OSError) as err:
                reason = f'has no message that can be read: {err}'
                continue
            if not found or {*_joints(message, source)}.isdisjoint(found):
                found += names_of(message, source)
            if not _joints(message, source):
                break
    except (ImageError, OSError) as err:
        raise DatasetError(f'{printable(source.topic)}: {err}') from err
    except DatasetError as err:
        raise DatasetError(f'{printable(source.topic)}: {err}') from err
    if not found:
        raise DatasetError(f'{printable(source.topic)} {reason}')
    return found


def _joints(message: dict[str, Any], source: NumbersSource) -> list[str]:
    """Return the names beside the numbers of a message; [] if its numbers have none."""
    value, parent = find_value(message, source.path)
    return _array_names(value, parent) if isinstance(value, np.ndarray) else []


def _event(message: dict[str, Any], source: NumbersSource) -> Any:
    """Return a value that begins or ends an episode: a number, a bool or a text."""
    path = source.path or (('data',) if 'data' in message else ())
    value, _ = find_value(message, path)
    if not isinstance(value, bool | int | float | str):
        raise DatasetError(f'{source} is not one number or text; name a field')
    return value


def _stamp(serialized: Any) -> int:
    """Return the stamp at the begin of a message in nanoseconds."""
    seconds, nanoseconds = struct.unpack_from(
        '<iI' if serialized[1:2] == b'\1' else '>iI', serialized, _STAMP_AT)
    return int(seconds) * NANO + int(nanoseconds)


def integers(values: array[int]) -> NDArray[np.int64]:
    """Return a view of integers."""
    return np.frombuffer(values, np.int64)
