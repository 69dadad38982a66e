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
Message types for rclpy without compiled code.

rclpy knows a message type by a capsule with a rosidl_message_type_support_t, which a compiled
package has. Here this structure and those to which it points are made from the definition of the
type. The middleware then has the name, the hash and the fields of the type. It publishes and takes
messages as CDR. It cannot convert them, and is refused where it tries.

rmw_fastrtps calls the functions of the structures while it creates a publisher or subscription. It
holds a lock then, for which other threads wait with the GIL. So these functions run no Python,
which could pass the GIL to such a thread: they are built-in, with all answers known before.

The structures are those of rosidl_runtime_c (message_type_support_struct.h, type_description),
rosidl_typesupport_fastrtps_cpp (message_type_support.h) and rosidl_typesupport_introspection_c
(message_introspection.h).
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from ctypes import addressof, c_bool, c_char_p, c_size_t, c_uint32, c_uint64, c_uint8, c_void_p
from functools import cache
from operator import methodcaller
from typing import Any

from opencv_tools.message_types.definition import Array, PRIMITIVES, TypeDefinition
from opencv_tools.message_types.description import field_type_id, type_hash
from opencv_tools.transport.rcl_structures import RclSequence, RclString

_FASTRTPS, _INTROSPECTION = _C = (
    b'rosidl_typesupport_fastrtps_c', b'rosidl_typesupport_introspection_c')
_CPP = (b'rosidl_typesupport_fastrtps_cpp', b'rosidl_typesupport_introspection_cpp')
_MESSAGE = 18  # in rosidl_typesupport_introspection_c/field_types.h
_HASH_VERSION = 1
_HASH_BYTES = 32
_UNBOUNDED = b'\0'


class _TypeSupport(ctypes.Structure):
    """A rosidl_message_type_support_t."""

    _fields_ = tuple((name, c_void_p) for name in (
        'typesupport_identifier', 'data', 'func', 'get_type_hash_func',
        'get_type_description_func', 'get_type_description_sources_func'))


class _Callbacks(ctypes.Structure):
    """A message_type_support_callbacks_t."""

    _fields_ = tuple((name, c_void_p) for name in (
        'message_namespace', 'message_name', 'cdr_serialize', 'cdr_deserialize',
        'get_serialized_size', 'max_serialized_size', 'key_callbacks'))


class _Member(ctypes.Structure):
    """A rosidl_typesupport_introspection_c__MessageMember."""

    _fields_ = (
        ('name', c_char_p), ('type_id', c_uint8), ('string_upper_bound', c_size_t),
        ('members', c_void_p), ('is_key', c_bool), ('is_array', c_bool), ('array_size', c_size_t),
        ('is_upper_bound', c_bool), ('offset', c_uint32), ('default_value', c_void_p),
        *((name, c_void_p) for name in ('size_function', 'get_const_function', 'get_function',
                                        'fetch_function', 'assign_function', 'resize_function')))


class _Members(ctypes.Structure):
    """A rosidl_typesupport_introspection_c__MessageMembers."""

    _fields_ = (
        ('message_namespace', c_char_p), ('message_name', c_char_p), ('member_count', c_uint32),
        ('size_of', c_size_t), ('has_any_key_member', c_bool), ('members', c_void_p),
        ('init_function', c_void_p), ('fini_function', c_void_p))


class _TypeHash(ctypes.Structure):
    """A rosidl_type_hash_t."""

    _fields_ = (('version', c_uint8), ('value', c_uint8 * _HASH_BYTES))


class _FieldType(ctypes.Structure):
    """A rosidl_runtime_c__type_description__FieldType."""

    _fields_ = (('type_id', c_uint8), ('capacity', c_uint64), ('string_capacity', c_uint64),
                ('nested_type_name', RclString))


class _Field(ctypes.Structure):
    """A rosidl_runtime_c__type_description__Field."""

    _fields_ = (('name', RclString), ('type', _FieldType), ('default_value', RclString))


class _Individual(ctypes.Structure):
    """A rosidl_runtime_c__type_description__IndividualTypeDescription."""

    _fields_ = (('type_name', RclString), ('fields', RclSequence))


class _Description(ctypes.Structure):
    """A rosidl_runtime_c__type_description__TypeDescription."""

    _fields_ = (('type_description', _Individual), ('referenced_type_descriptions', RclSequence))


class _Source(ctypes.Structure):
    """A rosidl_runtime_c__type_description__TypeSource."""

    _fields_ = tuple((name, RclString) for name in (
        'type_name', 'encoding', 'raw_file_contents'))


_Pointer = ctypes.CFUNCTYPE(c_void_p, c_void_p)
_Handle = ctypes.CFUNCTYPE(c_void_p, c_void_p, c_char_p)
_Convert = ctypes.CFUNCTYPE(c_bool, c_void_p, c_void_p)
_Size = ctypes.CFUNCTYPE(c_uint32, c_void_p)
_MaxSize = ctypes.CFUNCTYPE(c_void_p, ctypes.POINTER(ctypes.c_char))  # None is 0 as a c_void_p
_Create = ctypes.CFUNCTYPE(c_void_p)
_Destroy = ctypes.CFUNCTYPE(None, c_void_p)
_new_capsule = ctypes.pythonapi.PyCapsule_New
_new_capsule.restype = ctypes.py_object
_new_capsule.argtypes = [c_void_p, c_char_p, c_void_p]
_pointer = ctypes.pythonapi.PyCapsule_GetPointer
_pointer.restype = c_void_p
_pointer.argtypes = [ctypes.py_object, c_char_p]


class TypeSupport:
    """The structures of one message type. They must outlive the nodes that use the type."""

    def __init__(self, definition: TypeDefinition) -> None:
        self._name = definition.name
        self._definitions = definition.types
        #: Hash of the type, 32 bytes.
        self.type_hash = type_hash(definition)
        self._kept: list[Any] = []  # what the structures point to
        self._introspections: dict[str, int] = {}
        name = definition.name
        package, _, short = name.split('/')
        callbacks = self._keep(_Callbacks(
            self._text(f'{package}::msg'), self._text(short), *map(self._function, (
                _Convert(lambda message, cdr: False), _Convert(lambda cdr, message: False),
                _Size(lambda message: 0),
                _MaxSize(methodcaller('__setitem__', 0, _UNBOUNDED)))), None))
        supports = {_INTROSPECTION: self._introspection(name)}
        others = sorted(definition.types.keys() - {name})
        description = self._keep(_Description(
            self._individual(name), self._sequence(_Individual, map(self._individual, others))))
        sources = self._keep(self._sequence(_Source, map(self._source, (name, *others))))
        hashed = self._keep(_TypeHash(
            _HASH_VERSION, (c_uint8 * _HASH_BYTES)(*self.type_hash)))
        support = self._keep(_TypeSupport(self._text(_FASTRTPS.decode()), addressof(callbacks)))
        #: Address of the rosidl_message_type_support_t.
        self.address = supports[_FASTRTPS] = addressof(support)
        support.func = self._handle(self.address, supports)
        for name, structure in (('get_type_hash_func', hashed),
                                ('get_type_description_func', description),
                                ('get_type_description_sources_func', sources)):
            setattr(support, name, self._function(
                _Pointer({self.address: addressof(structure)}.get)))

    def python_class(self) -> type:
        """
        Create the class for ``create_publisher`` and ``create_subscription`` of rclpy.

        It has no instances: messages are published and received as bytes. The class refers to
        this object, and so keeps the structures.
        """
        def refuse(cls: type) -> None:
            raise TypeError(f'{self._name} has no messages in Python; publish bytes of CDR, and '
                            'subscribe with raw=True')

        create = self._keep(_Create(lambda: None))  # rclpy raises MemoryError
        convert = self._keep(_Convert(lambda message, other: False))
        destroy = self._keep(_Destroy(lambda message: None))
        capsules = {
            attribute: _new_capsule(ctypes.cast(function, c_void_p), None, None)
            for attribute, function in {
                '_CREATE_ROS_MESSAGE': create, '_CONVERT_FROM_PY': convert,
                '_CONVERT_TO_PY': convert, '_DESTROY_ROS_MESSAGE': destroy}.items()}
        metaclass = type('Metaclass', (type,), {
            '_TYPE_SUPPORT': _new_capsule(self.address, None, None), **capsules,
            '__import_type_support__': classmethod(lambda cls: None)})
        created: type = metaclass(self._name.rpartition('/')[2], (), {
            '__slots__': (), '__new__': refuse, '__doc__': f'The message type {self._name}.'})
        return created

    def _keep(self, kept: Any) -> Any:
        self._kept.append(kept)
        return kept

    def _text(self, text: str) -> int | None:
        return ctypes.cast(self._keep(ctypes.create_string_buffer(text.encode())), c_void_p).value

    def _function(self, function: Any) -> int | None:
        return ctypes.cast(self._keep(function), c_void_p).value

    def _handle(self, address: int, supports: dict[bytes, int]) -> int | None:
        """Return the function that finds the structures of a type support by its identifier."""
        return self._function(_Handle(_known(
            lambda _, identifier: supports.get(identifier),
            *((address, identifier) for identifier in _C + _CPP))))

    def _string(self, text: str) -> RclString:
        encoded = text.encode(errors='replace')
        return RclString(self._keep(encoded), len(encoded), len(encoded) + 1)

    def _sequence(self, kind: Any, items: Any) -> RclSequence:
        values = [*items]
        array = self._keep((kind * len(values))(*values))
        return RclSequence(addressof(array) if values else None, len(values), len(values))

    def _individual(self, name: str) -> _Individual:
        return _Individual(self._string(name), self._sequence(_Field, (
            _Field(self._string(field.name), _FieldType(
                field_type_id(field), field.size, field.string_size,
                self._string(field.base if field.is_message else '')), self._string(''))
            for field in self._definitions[name].fields)))

    def _source(self, name: str) -> _Source:
        return _Source(self._string(name), self._string('msg'),
                       self._string(self._definitions[name].text))

    def _introspection(self, name: str) -> int:
        """Return the address of the structures with the members of a type."""
        if name not in self._introspections:
            package, _, short = name.split('/')
            fields = self._definitions[name].fields
            members = self._keep((_Member * len(fields))(*(
                _Member(name=self._keep(field.name.encode()),
                        type_id=(_MESSAGE if field.is_message
                                 else PRIMITIVES[field.base].introspection),
                        string_upper_bound=field.string_size,
                        members=self._introspection(field.base) if field.is_message else None,
                        is_array=field.array is not Array.NONE, array_size=field.size,
                        is_upper_bound=field.array is Array.BOUNDED)
                for field in fields)))
            data = self._keep(_Members(
                f'{package}__msg'.encode(), short.encode(), len(fields), 0, False,
                addressof(members), None, None))
            support = self._keep(_TypeSupport(
                self._text(_INTROSPECTION.decode()), addressof(data)))
            address = self._introspections[name] = addressof(support)
            support.func = self._handle(address, {_INTROSPECTION: address})
        return self._introspections[name]


def hash_of(message_class: Any) -> bytes:
    """Return the hash of a message class of rclpy, compiled or made here: 32 bytes."""
    address = _pointer(type(message_class)._TYPE_SUPPORT, None)
    get_hash = _Pointer(_TypeSupport.from_address(address).get_type_hash_func)
    return bytes(_TypeHash.from_address(get_hash(address)).value)


def _known(answer: Callable[..., int | None], *questions: tuple[int, bytes]) -> Any:
    """Return a built-in function that knows its answers to some questions without Python."""
    known = cache(answer)
    for question in questions:
        known(*question)
    return known
