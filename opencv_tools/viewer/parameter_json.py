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

"""Parameters of other nodes as JSON, and values of JSON as parameters."""

from __future__ import annotations

import re
from typing import Any

from opencv_tools.image.text import printable
from opencv_tools.viewer.errors import MAX_MESSAGE, RequestError
from opencv_tools.viewer.protocol import finite
from rcl_interfaces.msg import ParameterDescriptor, ParameterType, ParameterValue

# Type, field of ParameterValue and type in Python, by the number of the type.
_TYPES: dict[int, tuple[str, str, type]] = {
    ParameterType.PARAMETER_BOOL: ('bool', 'bool_value', bool),
    ParameterType.PARAMETER_INTEGER: ('integer', 'integer_value', int),
    ParameterType.PARAMETER_DOUBLE: ('double', 'double_value', float),
    ParameterType.PARAMETER_STRING: ('string', 'string_value', str),
}
_CHOICES = 'one of: '
# An item of a menu in the description of a camera control: '1 50 Hz'.
_MENU_ITEM = r'(?:: |, ){} ([^,]*)'


def parameter_json(
    descriptor: ParameterDescriptor, value: ParameterValue,
) -> dict[str, Any] | None:
    """
    Return a parameter of the protocol; None for a list or an unset parameter.

    :param descriptor: name, range and description.
    :param value: present value.
    """
    if value.type not in _TYPES:
        return None
    kind, _, _ = _TYPES[value.type]
    shown = value_json(value)
    is_changed = kind == 'string' and shown != value.string_value
    ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
    low, high, step = ((finite(ranges[0].from_value), finite(ranges[0].to_value),
                        finite(ranges[0].step)) if ranges else (None, None, None))
    return {
        'name': printable(descriptor.name), 'type': kind,
        'value': shown, 'minimum': low, 'maximum': high, 'step': step or None,
        'choices': _choices(descriptor, kind),
        'description': printable(descriptor.description, MAX_MESSAGE),
        'read_only': descriptor.read_only or is_changed}


def value_json(value: ParameterValue) -> Any:
    """
    Return a value for JSON; a long text is cut.

    :raises RequestError: the value has a type that is not shown.
    """
    _, field, _ = _type_of(value)
    found = getattr(value, field)
    if isinstance(found, str):
        return printable(found, MAX_MESSAGE)
    return finite(found) if isinstance(found, float) else found


def value_from_json(given: Any, present: ParameterValue) -> ParameterValue:
    """
    Return a value of JSON with the type of the present value.

    :raises RequestError: the value has another type.
    """
    kind, field, python_type = _type_of(present)
    if python_type is float and type(given) is int:
        given = float(given) if abs(given) < 2**53 else given
    if type(given) is not python_type or (
            isinstance(given, int) and not -2**63 <= given < 2**63):
        raise RequestError(f'{str(given)[:40]!r} is not a value of the type {kind}')
    if isinstance(given, str):
        given = encodable(given)
    return ParameterValue(type=present.type, **{field: given})


def encodable(text: str) -> str:
    """Return a text that a message of ROS can hold."""
    return text.encode(errors='replace').decode().replace('\0', '')


def _type_of(value: ParameterValue) -> tuple[str, str, type]:
    """Return the row of ``_TYPES`` of a value."""
    if value.type not in _TYPES:
        raise RequestError('the parameter is not a number, a text or true or false')
    return _TYPES[value.type]


def _choices(descriptor: ParameterDescriptor, kind: str) -> list[tuple[Any, str]]:
    """Return the valid values with their names, as the nodes of this package describe them."""
    constraint = descriptor.additional_constraints
    if not constraint.startswith(_CHOICES) or kind not in ('integer', 'string'):
        return []
    choices: list[tuple[Any, str]] = []
    for text in constraint.removeprefix(_CHOICES)[:MAX_MESSAGE].split(', '):
        if kind == 'string':
            choices.append((text, printable(text)))
        elif re.fullmatch('-?[0-9]{1,18}', text):
            item = re.search(_MENU_ITEM.format(re.escape(text)), descriptor.description)
            choices.append((int(text), printable(item[1]) if item else text))
    return choices
