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

"""Parameters as tables: declared with descriptions and ranges, refused with a sentence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import difflib
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

# Parameters that ROS itself looks for under these names or prefixes.
_ROS_PARAMETERS = ('use_sim_time', 'start_type_description_service', 'qos_overrides.')


class ParameterError(ValueError):
    """A parameter's value that cannot be used; the message quotes it and says what can."""


@dataclass(frozen=True)
class Parameter:
    """
    One parameter of a node.

    :param name: as in ``-p name:=value``.
    :param default: its value when none is given; its type is the parameter's type.
    :param description: what it does, in a few words.
    :param minimum: lowest number allowed.
    :param maximum: highest number allowed.
    :param choices: the texts allowed; empty when any is.
    :param check: raises ValueError, with the remedy, for a value that is wrong in another way.
    """

    name: str
    default: str | int | float
    description: str
    minimum: float = 0
    maximum: float = 0
    choices: tuple[str, ...] = ()
    check: Callable[[Any], None] | None = None

    def descriptor(self) -> ParameterDescriptor:
        """Describe the parameter to ``ros2 param describe``."""
        descriptor = ParameterDescriptor(
            name=self.name, description=self.description, read_only=True,
            additional_constraints=f'one of: {", ".join(self.choices)}' if self.choices else '')
        if isinstance(self.default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=self.minimum, to_value=self.maximum)]
        elif isinstance(self.default, int):
            descriptor.integer_range = [
                IntegerRange(from_value=int(self.minimum), to_value=int(self.maximum), step=1)]
        return descriptor

    def accept(self, value: object) -> str | int | float:
        """
        Turn a value as the command line gives it into one of the parameter's type.

        ``source:=0`` arrives as an integer and ``publish_rate:=10`` too, which is what was meant.

        :raises ParameterError: the value cannot be used.
        """
        if isinstance(self.default, str):
            return self._accept_text(value)
        kind = float if isinstance(self.default, float) else int
        numeric = isinstance(value, (int, kind)) and not isinstance(value, bool)
        if not numeric or not self.minimum <= value <= self.maximum:
            noun = 'a number' if kind is float else 'a whole number'
            raise ParameterError(
                f'parameter {self.name} is {value!r}: give {noun} '
                f'from {self.minimum:.15g} to {self.maximum:.15g} ({self.description})')
        return kind(value)

    def _accept_text(self, value: object) -> str:
        if not isinstance(value, (str, int, float)) or isinstance(value, bool):
            raise ParameterError(f'parameter {self.name} is {value!r}: give a text '
                                 f'({self.description})')
        text = str(value)
        if self.choices and text not in self.choices:
            raise ParameterError(f'parameter {self.name} is {text!r}: give one of '
                                 f'{", ".join(repr(choice) for choice in self.choices)}')
        if self.check:
            try:
                self.check(text)
            except ValueError as err:
                raise ParameterError(f'parameter {self.name} is {text!r}: {err}') from err
        return text


def declare_parameters(node: Node, table: Sequence[Parameter]) -> dict[str, Any]:
    """
    Declare a table of parameters and give their values.

    :param node: made with ``automatically_declare_parameters_from_overrides``, so that what was
        given can be read, and checked, before it meets its descriptor.
    :param table: the parameters of the node.
    :returns: name to value.
    :raises ParameterError: a value that was given cannot be used.
    """
    overrides = node.get_parameters_by_prefix('')
    given = {name: parameter.value for name, parameter in overrides.items()}
    names = [parameter.name for parameter in table]
    for name in given:
        if name not in names and not name.startswith(_ROS_PARAMETERS):
            close = difflib.get_close_matches(name, names, 1)
            hint = f'did you mean {close[0]}?' if close else f'there are {", ".join(names)}'
            node.get_logger().warning(f'unknown parameter {name} is not used; {hint}')
    values = {}
    for parameter in table:
        value = parameter.default
        if parameter.name in given:
            value = parameter.accept(given[parameter.name])
            node.undeclare_parameter(parameter.name)
        node.declare_parameter(parameter.name, value, parameter.descriptor(), ignore_override=True)
        values[parameter.name] = value
    return values


def describe_parameters(table: Sequence[Parameter]) -> str:
    """Write a table of parameters for ``--help``: name, default and description a line."""
    width = max(len(parameter.name) for parameter in table)
    lines = []
    for parameter in table:
        choices = ': ' + ', '.join(filter(None, parameter.choices)) if parameter.choices else ''
        lines.append(f'  {parameter.name:{width}}  {parameter.description}{choices} '
                     f'[{parameter.default!r}]')
    return '\n'.join(lines)
