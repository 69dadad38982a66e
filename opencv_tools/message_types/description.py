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

from opencv_tools.message_types.definition import (
    Array, Definition, Field, PRIMITIVES, TypeDefinition)

# Numbers of type_description_interfaces/msg/FieldType.
_MESSAGE = 1
_ARRAYS = {Array.NONE: 0, Array.FIXED: 48, Array.BOUNDED: 96, Array.UNBOUNDED: 144}


def field_type_id(field: Field) -> int:
    """Return the number of the type of a field in type_description_interfaces/msg/FieldType."""
    if field.is_message:
        return _MESSAGE + _ARRAYS[field.array]
    found = PRIMITIVES[field.base]
    return (found.bounded_id if field.string_size else found.type_id) + _ARRAYS[field.array]


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
