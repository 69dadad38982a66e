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

"""The messages of a topic of a bag, collected while the bag is read."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.bags.compression import decompressed_message
from opencv_tools.bags.reading import BagMessage, BagTopic, Damage
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.numbers import (
    find_value, MessageReader, names_of, numbers_of)
from opencv_tools.datasets.plan import NumbersSource
from opencv_tools.image.errors import ImageError
from opencv_tools.image.text import printable
from opencv_tools.units import NANO

# A stamp that is further from the one before than the times of the recording is a jump.
_JUMP_NS = NANO // 2
_STAMP_AT = 4  # offset in CDR of a stamp at the begin of a message
LOG_REMEDY = 'use --clock log for the times of the recording'


@dataclass
class Samples:
    """
    Messages of a topic that are read one after the other.

    :param topic: the topic.
    :param source: numbers of the messages; None for images.
    :param reader: reader of the messages; None for images.
    :param logs: time of the recording of each message, in nanoseconds.
    :param stamps: stamp of each message, 0 without one.
    :param places: number of each message among all of the topic.
    :param values: numbers of all messages.
    :param events: values that begin or end episodes; None if the numbers are used.
    :param count: number of messages so far.
    :param damaged: number of those that cannot be read.
    """

    topic: BagTopic
    source: NumbersSource | None = None
    reader: MessageReader | None = field(default=None, init=False)
    logs: array[int] = field(default_factory=lambda: array('q'))
    stamps: array[int] = field(default_factory=lambda: array('q'))
    places: array[int] = field(default_factory=lambda: array('q'))
    values: array[float] = field(default_factory=lambda: array('d'))
    events: list[Any] | None = None
    count: int = 0
    damaged: int = 0

    def __post_init__(self) -> None:
        """Read the definition of the messages; see `MessageReader`."""
        if self.source:
            self.reader = MessageReader(self.topic)

    def add(self, item: BagMessage) -> None:
        """
        Add a message; one that cannot be read counts as lost.

        :raises DatasetError: it does not have the numbers.
        """
        place, self.count = self.count, self.count + 1
        try:
            serialized = decompressed_message(item.load())
            message = self.reader.read(serialized) if self.reader else {}
            stamp = _stamp(serialized) if not self.reader or self.reader.has_stamp else 0
            self.logs.append(item.log_ns)
        except (ImageError, OSError, OverflowError, struct.error):
            self.damaged += 1
            return
        if self.events is not None and self.source:
            self.events.append(_event(message, self.source))
        elif self.source:
            self.values.extend(numbers_of(message, self.source))
        self.stamps.append(stamp)
        self.places.append(place)

    def times(self, clock: str, name: str) -> NDArray[np.int64]:
        """
        Return the times of all messages in nanoseconds.

        :param clock: 'stamp' or 'log'.
        :param name: name of the messages in an error.
        :raises DatasetError: there is none, or the stamps cannot be used.
        """
        logs, stamps = integers(self.logs), integers(self.stamps)
        if not len(logs):
            raise DatasetError(f'{name} ({printable(self.topic.name)}) has no message that can be '
                               'read')
        if clock == 'log':
            return logs
        shown = f'{name} ({printable(self.topic.name)})'
        if self.reader and not self.reader.has_stamp:
            raise DatasetError(f'the messages of {shown} have no stamp; {LOG_REMEDY}')
        if not stamps.all():
            raise DatasetError(f'{np.count_nonzero(stamps == 0)} stamps of {shown} are zero; '
                               f'{LOG_REMEDY}')
        steps, log_steps = np.diff(stamps), np.diff(logs)
        jumps = (steps < -_JUMP_NS) | (steps > np.maximum(log_steps, 0) + _JUMP_NS)
        if jumps.any():
            at = int(np.argmax(jumps))
            raise DatasetError(f'the stamps of {shown} jump by {steps[at] / NANO:.3f} s after '
                               f'message {at}; {LOG_REMEDY}')
        return stamps


def first_names(messages: Iterable[BagMessage | Damage], topic: BagTopic, source: NumbersSource,
                ) -> tuple[str, ...]:
    """
    Return the names of the numbers in the first message that can be read.

    :raises DatasetError: there is none, or it has no such numbers.
    """
    reader = MessageReader(topic)
    reason = 'has no messages'
    try:
        for item in messages:
            if isinstance(item, Damage):
                continue
            try:
                message = reader.read(decompressed_message(item.load()))
            except (ImageError, OSError) as err:
                reason = f'has no message that can be read: {err}'
                continue
            return names_of(message, source)
    except (ImageError, OSError) as err:
        raise DatasetError(f'{printable(source.topic)}: {err}') from err
    except DatasetError as err:
        raise DatasetError(f'{printable(source.topic)}: {err}') from err
    raise DatasetError(f'{printable(source.topic)} {reason}')


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
