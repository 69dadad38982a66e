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
The plan of a message type: functions for its fields, compiled once and without generated code.

The function of a message calls one function for each field. Consecutive single numbers are one
struct.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
import struct
from typing import Any, Generic, TypeVar

import numpy as np
from opencv_tools.message_types.definition import Array, Field, PRIMITIVES, TypeDefinition

#: Types of numpy of the numbers by name, little-endian.
TYPES = {name: np.dtype(f'<{found.dtype}') for name, found in PRIMITIVES.items() if found.dtype}
#: Largest alignment of a number in bytes.
ALIGNMENT = 8
_CODES = {'?': '?', 'i1': 'b', 'u1': 'B', 'i2': 'h', 'u2': 'H', 'i4': 'i', 'u4': 'I', 'i8': 'q',
          'u8': 'Q', 'f4': 'f', 'f8': 'd'}  # of struct

Step = TypeVar('Step', bound=Callable[..., Any])
# The functions of a message with their fields: consecutive numbers, or one other field.
Steps = list[tuple[Step, list[Field]]]


class TypePlan(ABC, Generic[Step]):
    """The functions for the types that a type contains, each of which is compiled once."""

    def __init__(self, definition: TypeDefinition) -> None:
        self._definitions = definition.types
        self._steps: dict[str, Steps[Step]] = {}

    def message(self, name: str, field: str = '') -> Step:
        """
        Return the function for a message.

        :param name: type, such as ``std_msgs/msg/Header``.
        :param field: name of its field; '' for the message itself, which is not counted.
        """
        if name not in self._steps:
            self._steps[name] = [
                (self._run(run) if is_number(run[0]) else self._step(run[0]), run)
                for run in runs(self._definitions[name].fields)]
        return self._message(name, field, self._steps[name])

    def _step(self, field: Field) -> Step:
        """Return the function for a field that is not a single number."""
        if field.base in TYPES:
            return self._numbers(field)
        one = (self.message(field.base, field.name) if field.is_message
               else self._string(field))
        return one if field.array is Array.NONE else self._values(field, one)

    @abstractmethod
    def _message(self, name: str, field: str, steps: Steps[Step]) -> Step: ...

    @abstractmethod
    def _run(self, fields: Sequence[Field]) -> Step:
        """Return the function for consecutive numbers."""

    @abstractmethod
    def _string(self, field: Field) -> Step: ...

    @abstractmethod
    def _numbers(self, field: Field) -> Step:
        """Return the function for an array of numbers."""

    @abstractmethod
    def _values(self, field: Field, one: Step) -> Step:
        """Return the function for an array of messages or strings."""


def is_number(field: Field) -> bool:
    return field.array is Array.NONE and field.base in TYPES


def runs(fields: Sequence[Field]) -> Iterator[list[Field]]:
    """Yield consecutive single numbers together, and every other field alone."""
    for are_numbers, group in groupby(fields, is_number):
        if are_numbers:
            yield [*group]
        else:
            yield from ([field] for field in group)


def structs(fields: Sequence[Field], order: str) -> list[struct.Struct]:
    """Return a struct of consecutive numbers for each alignment of their begin."""
    found = []
    for begin in range(ALIGNMENT):
        position, text = begin, order
        for field in fields:
            size = TYPES[field.base].itemsize
            text += -position % size * 'x' + _CODES[PRIMITIVES[field.base].dtype]
            position += -position % size + size
        found.append(struct.Struct(text))
    return found
