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

"""Declaration of the parameters of a node, and their changes while the node runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
import difflib
from typing import Any, TypeVar

from opencv_tools.base.logs import Log
from opencv_tools.base.text import printable
from opencv_tools.nodes.parameters import Parameter, parameter_table, with_values
from opencv_tools.topics.errors import ParameterError
from rcl_interfaces.msg import SetParametersResult
import rclpy
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.node import Node

S = TypeVar('S')

# Names and prefixes of parameters that ROS itself reads.
_ROS_PARAMETERS = ('use_sim_time', 'start_type_description_service', 'qos_overrides.')


class UnknownParameterError(ParameterNotDeclaredException):
    """A change of an undeclared parameter; rclpy replies with the message."""

    def __init__(self, message: str) -> None:
        Exception.__init__(self, message)


def declare_settings(node: Node, settings: type[S]) -> S:
    """Declare the parameters of a settings class, as `declare_parameters`; return the values."""
    return with_values(settings(), declare_parameters(node, parameter_table(settings)))


def declare_parameters(node: Node, table: Sequence[Parameter]) -> dict[str, Any]:
    """
    Declare a table of parameters and return their values by name.

    :param node: node created with ``automatically_declare_parameters_from_overrides``, so that
        given values can be read and checked before their descriptors apply.
    :raises ParameterError: a given value is invalid, or the name of a parameter that ends the
        node is misspelt.
    """
    values = {parameter.name: declare_parameter(node, parameter) for parameter in table}
    ending = {parameter.name for parameter in table if parameter.ends}
    for name in unknown_parameters(node, table):
        similar = closest_name(name, table)
        if similar in ending:
            raise ParameterError(
                f'there is no parameter {printable(name)}: did you mean {similar}?')
    return values


def declare_parameter(node: Node, parameter: Parameter) -> Any:
    """
    Declare one parameter and return its value.

    :param node: node, as for `declare_parameters`.
    :raises ParameterError: the given value is invalid.
    """
    value = parameter.default
    if node.has_parameter(parameter.name):
        value = parameter.accept(node.get_parameter(parameter.name).value)
        node.undeclare_parameter(parameter.name)
    node.declare_parameter(
        parameter.name, parameter.shown(value), parameter.descriptor(), ignore_override=True)
    return value


def unknown_parameters(node: Node, table: Sequence[Parameter]) -> dict[str, Any]:
    """Return the given parameters that are not in a table, as values by name."""
    names = {parameter.name for parameter in table}
    given: dict[str, Any] = node.get_parameters_by_prefix('')  # rclpy's own type is wrong
    return {name: parameter.value for name, parameter in given.items()
            if name not in names and not name.startswith(_ROS_PARAMETERS)}


def warn_unknown_parameters(node: Node, table: Sequence[Parameter], log: Log) -> None:
    """Log the given parameters that are not in a table."""
    for name in unknown_parameters(node, table):
        log.warning(describe_unknown(name, table))


def closest_name(name: str, table: Sequence[Parameter]) -> str:
    """Return what a misspelt name, or one of another package, stands for; '' if unknown."""
    lower = name.lower()
    meant = [parameter.name for parameter in table if lower in parameter.other_names]
    if meant:
        return ' and '.join(meant)
    names = [parameter.name for parameter in table]
    parts = [one for one in lower.split('_') if one in names]  # as in loop_video
    return next(iter(parts or difflib.get_close_matches(lower, names, 1)), '')


def describe_unknown(name: str, table: Sequence[Parameter]) -> str:
    """Return a message about an unknown parameter, with the name that it resembles."""
    names = [parameter.name for parameter in table]
    close = closest_name(name, table)
    hint = f'did you mean {close}?' if close else f'the parameters are {", ".join(names)}'
    return f'unknown parameter {printable(name)} is not used; {hint}'


def watch_parameters(
    node: Node, table: Sequence[Parameter], apply: Callable[[dict[str, Any]], object],
    more: Callable[[], Sequence[Parameter]] = tuple,
    check_together: Callable[[dict[str, Any]], object] | None = None,
) -> None:
    """
    Apply changes of parameters while the node runs; refuse invalid ones with the reason.

    Values are converted as at startup, for example 5 to 5.0.

    :param table: parameters that can be changed.
    :param apply: called with the changed values by name.
    :param more: returns further parameters, which other callbacks apply.
    :param check_together: called before ``apply`` with the same values; raises ``ParameterError``
        for values that do not suit each other or the values of other parameters.
    """
    by_name = {parameter.name: parameter for parameter in table}

    def convert(changes: list[rclpy.Parameter]) -> list[rclpy.Parameter]:
        parameters = {**by_name, **{parameter.name: parameter for parameter in more()}}
        for change in changes:
            if not node.has_parameter(change.name):
                raise UnknownParameterError(
                    describe_unknown(change.name, tuple(parameters.values())))
        return [_converted(change, parameters.get(change.name)) for change in changes]

    def own(changes: list[rclpy.Parameter]) -> dict[str, Any]:
        return {change.name: change.value for change in changes if change.name in by_name}

    def check(changes: list[rclpy.Parameter]) -> SetParametersResult:
        try:
            for name, value in own(changes).items():
                by_name[name].accept(value)
            if check_together:
                check_together(own(changes))
        except ParameterError as err:
            return SetParametersResult(successful=False, reason=str(err))
        return SetParametersResult(successful=True)

    def apply_changes(changes: list[rclpy.Parameter]) -> None:
        if own(changes):
            apply(own(changes))

    node.add_pre_set_parameters_callback(convert)
    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(apply_changes)


def _converted(change: rclpy.Parameter, parameter: Parameter | None) -> rclpy.Parameter:
    """Convert a change to the type of its parameter; return an invalid change unmodified."""
    if parameter is None:
        return change
    value = change.value
    if isinstance(parameter.default, float) and type(value) is int:
        value = float(value)  # even if out of range, which is the better reason for a refusal
    with suppress(ParameterError):
        value = parameter.accept(value)
    return rclpy.Parameter(change.name, value=value)
