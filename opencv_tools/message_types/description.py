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
The description of a message type, from which ROS computes its hash (REP 2011, REP 2016).

A publisher and a subscriber have the same type if the hashes are equal.
"""

from __future__ import annotations

import hashlib
import json
from typing import Any

from opencv_tools.message_types.definition import Array, Definition, Field, TypeDefinition

# Numbers of type_description_interfaces/msg/FieldType. In a .msg file, char is uint8.
_MESSAGE, _BOUNDED_STRING, _BOUNDED_WSTRING = 1, 21, 22
_NUMBERS = {'int8': 2, 'uint8': 3, 'char': 3, 'int16': 4, 'uint16': 5, 'int32': 6, 'uint32': 7,
            'int64': 8, 'uint64': 9, 'float32': 10, 'float64': 11, 'bool': 15, 'byte': 16,
            'string': 17, 'wstring': 18}
_BOUNDED = {'string': _BOUNDED_STRING, 'wstring': _BOUNDED_WSTRING}
_ARRAYS = {Array.NONE: 0, Array.FIXED: 48, Array.BOUNDED: 96, Array.UNBOUNDED: 144}


def field_type_id(field: Field) -> int:
    """Return the number of the type of a field in type_description_interfaces/msg/FieldType."""
    number = (_MESSAGE if field.is_message else _BOUNDED[field.base] if field.string_size
              else _NUMBERS[field.base])
    return number + _ARRAYS[field.array]


def type_hash(definition: TypeDefinition) -> bytes:
    """Return the SHA-256 of the description of a type, 32 bytes: its hash ``RIHS01``."""
    main = definition.name
    description = {
        'type_description': _describe(main, definition.types[main]),
        'referenced_type_descriptions': [
            _describe(name, each)
            for name, each in sorted(definition.types.items()) if name != main]}
    return hashlib.sha256(json.dumps(description).encode()).digest()


def _describe(name: str, definition: Definition) -> dict[str, Any]:
    return {'type_name': name, 'fields': [
        {'name': field.name, 'type': {
            'type_id': field_type_id(field), 'capacity': field.size,
            'string_capacity': field.string_size,
            'nested_type_name': field.base if field.is_message else ''}}
        for field in definition.fields]}
