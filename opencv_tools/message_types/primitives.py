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

"""Primitive types of message definitions, and their numbers in the parts of ROS."""

from __future__ import annotations

from typing import NamedTuple


class Primitive(NamedTuple):
    """
    A primitive type.

    :param dtype: type of numpy; '' for strings.
    :param type_id: number in type_description_interfaces/msg/FieldType.
    :param introspection: number in rosidl_typesupport_introspection_c/field_types.h.
    :param bounded_id: like ``type_id``, of a string with a largest size.
    """

    dtype: str
    type_id: int
    introspection: int
    bounded_id: int = 0


#: The primitive types by name. In a .msg file, char is uint8.
PRIMITIVES = {
    'bool': Primitive('?', 15, 6),
    'byte': Primitive('u1', 16, 7),
    'char': Primitive('u1', 3, 8),
    'int8': Primitive('i1', 2, 9),
    'uint8': Primitive('u1', 3, 8),
    'int16': Primitive('i2', 4, 11),
    'uint16': Primitive('u2', 5, 10),
    'int32': Primitive('i4', 6, 13),
    'uint32': Primitive('u4', 7, 12),
    'int64': Primitive('i8', 8, 15),
    'uint64': Primitive('u8', 9, 14),
    'float32': Primitive('f4', 10, 1),
    'float64': Primitive('f8', 11, 2),
    'string': Primitive('', 17, 16, 21),
    'wstring': Primitive('', 18, 17, 22),
}
