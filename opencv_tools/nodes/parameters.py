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

"""Tables of ROS parameters, with descriptions, ranges and checks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, KW_ONLY, replace
import json
import math
from textwrap import TextWrapper
from typing import Any, TypeVar

from opencv_tools.base.parameter_fields import (
    LOWEST_RATE, parameter, parameter_group, rate_parameter)
from opencv_tools.base.text import HIDDEN, hide_passwords, without_password
from opencv_tools.topics.errors import ParameterError
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

__all__ = (
    'describe_parameters', 'literal', 'LOWEST_RATE', 'Parameter', 'parameter', 'parameter_group',
    'parameter_table', 'rate_parameter', 'with_values')

_TYPES = {bool: 'bool', float: 'double', int: 'integer', str: 'string'}
_HELP_COLUMNS = 99

S = TypeVar('S', bound=Any)


@dataclass(frozen=True)
class Parameter:
    """
    A parameter of a node.

    :param name: name of the parameter, as in ``-p name:=value``.
    :param default: default value; its type is the type of the parameter.
    :param description: noun phrase that stands alone in ``ros2 param describe``, with unit, range
        and the meaning of special values.
    :param bounds: smallest and largest valid number; None for no bounds.
    :param or_zero: whether 0, which is below the bounds, is valid as well.
    :param step: distance between valid numbers, counted from the smallest.
    :param choices: valid values; empty if all values are valid.
    :param check: raises ValueError with the remedy for an invalid text.
    :param changeable: whether the parameter can be changed while the node runs.
    :param secret: whether other nodes cannot read the given value.
    :param words: whether the text is a list of words, which can be given as an array of texts too.
    :param ends: whether the parameter decides what the node does, or when it ends. The node does
        not start with a misspelt name of such a parameter.
    :param other_names: names of parameters of other packages that mean the same.
    """

    name: str
    default: str | int | float
    description: str
    _: KW_ONLY
    bounds: tuple[float, float] | None = None
    or_zero: bool = False
    step: int = 1
    choices: tuple[str | int, ...] = ()
    check: Callable[[Any], None] | None = None
    changeable: bool = False
    secret: bool = False
    words: bool = False
    ends: bool = False
    other_names: tuple[str, ...] = ()

    def shown(self, value: Any) -> Any:
        """Return what other nodes can read of a value."""
        if self.secret and value not in ('', self.default):
            return HIDDEN
        return hide_passwords(value) if isinstance(value, str) else value

    def descriptor(self) -> ParameterDescriptor:
        """Return the descriptor for ``ros2 param describe``."""
        descriptor = ParameterDescriptor(
            name=self.name, description=self.description, read_only=not self.changeable,
            additional_constraints=f'one of: {_listed(self.choices)}' if self.choices
            else self.values() if self.or_zero else '')
        if self.bounds and isinstance(self.default, float):
            low, high = map(float, (0 if self.or_zero else self.bounds[0], self.bounds[1]))
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        elif self.bounds:
            low, high = map(int, self.bounds)
            descriptor.integer_range = [
                IntegerRange(from_value=low, to_value=high, step=self.step)]
        return descriptor

    @property
    def type_name(self) -> str:
        """Name of the type in ROS."""
        return _TYPES[type(self.default)]

    def values(self, quote: Callable[[str], str] = str) -> str:
        """Return a list of the valid values, each quoted; '' without choices and bounds."""
        choices = (False, True) if isinstance(self.default, bool) else self.choices
        if choices or not self.bounds:
            return ', '.join(quote(literal(choice)) for choice in choices)
        low, high = (quote(str(bound) if isinstance(bound, int) else f'{bound:.15g}')
                     for bound in self.bounds)
        steps = '' if self.step == 1 else f', in steps of {quote(str(self.step))}'
        zero = f'{quote("0")} or ' if self.or_zero else ''
        return f'{zero}{low} to {high}{steps}'

    def accept(self, value: Any) -> str | int | float:
        """
        Convert a value of the command line to the type of the parameter.

        ``source:=0`` and ``publish_rate:=10`` arrive as integers, but mean a text and a float.

        :raises ParameterError: the value is invalid.
        """
        if isinstance(self.default, str):
            return self._accept_text(value)
        if isinstance(self.default, bool):
            if value in (False, True):  # or 0 or 1
                return bool(value)
            raise self._error(value, f'give true or false ({self.description})')
        if self.choices:
            return self._accept_choice(value)
        number = float if isinstance(self.default, float) else int
        is_number = isinstance(value, (int, number)) and not isinstance(value, bool)
        low, high = self.bounds or (-math.inf, math.inf)
        if not is_number or not (low <= value <= high or (self.or_zero and value == 0)):
            noun = ('0, or ' if self.or_zero else '') + (
                'a number' if number is float else 'a whole number')
            span = f' from {low:.15g} to {high:.15g}' if self.bounds else ''
            raise self._error(value, f'give {noun}{span} ({self.description})')
        return number(value) or number(0)  # which is not negative

    def _accept_text(self, value: object) -> str:
        if self.words and isinstance(value, (list, tuple)):
            value = ' '.join(map(str, value))
        if not isinstance(value, (str, int, float)) or isinstance(value, bool):
            raise self._error(value, f'give a text ({self.description})')
        text: str = self._accept_choice(str(value))
        if self.check:
            try:
                self.check(text)
            except ValueError as err:
                raise self._error(text, str(err)) from err
        return text

    def _accept_choice(self, value: Any) -> Any:
        if self.choices and value not in self.choices:
            raise self._error(value, f'give one of {", ".join(map(repr, self.choices))}')
        return value

    def _error(self, value: object, remedy: str) -> ParameterError:
        """Return an error that quotes a value without passwords."""
        return ParameterError(
            f'parameter {self.name} is {without_password(repr(value))}: {remedy}')


def parameter_table(settings: type) -> tuple[Parameter, ...]:
    """Return the parameters of a settings class, whose fields ``parameter`` has created."""
    return tuple(_parameters_of(settings))


def _parameters_of(settings: Any, prefix: str = '') -> Iterator[Parameter]:
    """Yield the parameters of a settings class, or of an object with other default values."""
    for found in fields(settings):
        default = getattr(settings, found.name)
        if 'prefix' in found.metadata:
            yield from _parameters_of(default, found.metadata['prefix'])
        elif found.metadata:
            yield Parameter(prefix + found.name, default, **found.metadata)


def with_values(settings: S, values: Mapping[str, Any]) -> S:
    """
    Return settings with other values of some parameters.

    :param values: values by the names of the parameters, also of those in groups.
    :raises ParameterError: the values of a group do not suit each other.
    """
    given = dict(values)
    for found in fields(settings):
        if 'prefix' not in found.metadata:
            continue
        prefix, group = found.metadata['prefix'], getattr(settings, found.name)
        own = {one.name: given.pop(prefix + one.name) for one in fields(group)
               if prefix + one.name in given}
        try:
            given[found.name] = replace(group, **own)
        except ValueError as err:
            raise ParameterError(f'parameter {prefix}{err}') from err
    return replace(settings, **given)


def describe_parameters(table: Sequence[Parameter]) -> str:
    """Return the lines of ``--help`` for a table: descriptions, types, values and defaults."""
    width = max(len(found.name) for found in table)
    lines = ['parameters, with type: values [default]; at run time if changeable while the node '
             'runs:']
    for found in table:
        wrapper = TextWrapper(
            _HELP_COLUMNS, f'  {found.name:{width}}  ', ' ' * (width + 4),
            break_long_words=False, break_on_hyphens=False)
        lines += wrapper.wrap(found.description)
        wrapper.initial_indent = wrapper.subsequent_indent
        values = f': {found.values()}' if found.values() else ''
        changes = '; at run time' if found.changeable else ''
        lines += wrapper.wrap(
            f'{found.type_name}{values} [{literal(found.default)}]{changes}')
    return '\n'.join(lines)


def literal(value: str | int | float) -> str:
    """Return a value as a parameter file has it."""
    return (value or "''") if isinstance(value, str) else json.dumps(value)


def _listed(choices: Sequence[str | int]) -> str:
    return ', '.join(str(choice) for choice in choices if choice != '')
