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
Publish and take image messages through rcl directly, without rclpy's copies.

rclpy copies a serialised message once before publishing and once after taking it, and blocks the
interpreter meanwhile. This module passes the address of the pixels to rcl, and returns the bytes
that rcl has taken. The structures are those of rcl/publisher.h, rcl/subscription.h, rmw/types.h,
rcutils/types/uint8_array.h, and of the header that rosidl_generator_c generates for
sensor_msgs/Image. If their layout differs from ROS 2 Jazzy, rclpy is used with its copies.
"""

from __future__ import annotations

from collections.abc import Sequence
import ctypes
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.cdr import encode_text, image_to_cdr, WireImage
# This import comes first, because it loads the libraries below from their location.
from rclpy.impl.implementation_singleton import rclpy_implementation
from sensor_msgs.msg import Image

# Constants of rcl/types.h and rmw/types.h.
_RCL_RET_OK = 0
_RCL_RET_SUBSCRIPTION_TAKE_FAILED = 401
_RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED = 2**64 - 1
_RMW_GID_STORAGE_SIZE = 16

# Functions that are called, by library.
_FUNCTIONS: dict[str, Sequence[str]] = {
    'librcl.so': ('rcl_publish', 'rcl_publisher_get_rmw_handle', 'rcl_take_serialized_message',
                  'rmw_get_gid_for_publisher'),
    'librcutils.so': ('rcutils_get_default_allocator', 'rcutils_get_error_string',
                      'rcutils_reset_error', 'rcutils_uint8_array_init',
                      'rcutils_uint8_array_fini')}
_CHECKED_BYTES = 17

_rcl: Any = None
_rcutils: Any = None
_free = ctypes.CDLL(None).free
_free.argtypes = [ctypes.c_void_p]
_free.restype = None


class _String(ctypes.Structure):
    _fields_ = (('data', ctypes.c_char_p), ('size', ctypes.c_size_t),
                ('capacity', ctypes.c_size_t))


class _Bytes(ctypes.Structure):
    _fields_ = (('data', ctypes.c_void_p), ('size', ctypes.c_size_t),
                ('capacity', ctypes.c_size_t))


class _Image(ctypes.Structure):
    """A sensor_msgs__msg__Image; the fields of its header come first."""

    _fields_ = (
        ('sec', ctypes.c_int32), ('nanosec', ctypes.c_uint32), ('frame_id', _String),
        ('height', ctypes.c_uint32), ('width', ctypes.c_uint32), ('encoding', _String),
        ('is_bigendian', ctypes.c_uint8), ('step', ctypes.c_uint32), ('data', _Bytes))


class _Allocator(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_void_p) for name in (
        'allocate', 'deallocate', 'reallocate', 'zero_allocate', 'state'))


class _RmwSerializedMessage(ctypes.Structure):
    _fields_ = (('buffer', ctypes.c_void_p), ('length', ctypes.c_size_t),
                ('capacity', ctypes.c_size_t), ('allocator', _Allocator))


class MessageInfo(ctypes.Structure):
    """
    Metadata of a message from the middleware.

    ``source_timestamp`` and ``received_timestamp`` are nanoseconds of the system clock, 0 if
    unknown.
    """

    source_timestamp: int
    received_timestamp: int

    _fields_ = (
        ('source_timestamp', ctypes.c_int64), ('received_timestamp', ctypes.c_int64),
        ('publication_sequence_number', ctypes.c_uint64),
        ('reception_sequence_number', ctypes.c_uint64),
        ('implementation', ctypes.c_char_p),
        ('publisher', ctypes.c_uint8 * _RMW_GID_STORAGE_SIZE),
        ('from_intra_process', ctypes.c_bool))

    @property
    def number(self) -> int:
        """Return the sequence number of the publisher, from 1; 0 if unknown."""
        number = int(self.publication_sequence_number)
        return 0 if number == _RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED else number


#: The serialized message, (n,) uint8, and its metadata.
SerializedMessage = tuple[NDArray[np.uint8], MessageInfo]


class _Gid(ctypes.Structure):
    _fields_ = (('implementation', ctypes.c_char_p),
                ('data', ctypes.c_uint8 * _RMW_GID_STORAGE_SIZE))


class _ErrorText(ctypes.Structure):
    _fields_ = (('text', ctypes.c_char * 1024),)


class _Buffer:
    """Memory of a message, freed with the last view of it."""

    def __init__(self, address: int, size: int) -> None:
        self._address = address
        self.__array_interface__ = {
            'shape': (size,), 'typestr': '|u1', 'data': (address, True), 'version': 3}

    def __del__(self, free: Any = _free) -> None:
        free(self._address)


def use_rcl() -> str:
    """
    Check the layout of rcl's structures and select rcl or rclpy.

    :returns: reason for the use of rclpy; '' if rcl is used.
    """
    global _rcl, _rcutils
    _rcl = _rcutils = None
    if os.environ.get('OPENCV_TOOLS_TRANSPORT') == 'default':
        return 'OPENCV_TOOLS_TRANSPORT is default'
    if os.environ.get('ROS_DISTRO', 'jazzy') != 'jazzy':
        return f'ROS_DISTRO is {os.environ["ROS_DISTRO"]}'
    try:
        rcl, rcutils = (ctypes.CDLL(name) for name in _FUNCTIONS)
        for library, names in zip((rcl, rcutils), _FUNCTIONS.values()):
            for name in names:
                getattr(library, name)
    except (OSError, AttributeError) as err:
        return str(err)
    rcl.rcl_publish.argtypes = [ctypes.c_void_p] * 3
    rcl.rcl_take_serialized_message.argtypes = [ctypes.c_void_p] * 4
    rcl.rcl_publisher_get_rmw_handle.argtypes = [ctypes.c_void_p]
    rcl.rcl_publisher_get_rmw_handle.restype = ctypes.c_void_p
    rcl.rmw_get_gid_for_publisher.argtypes = [ctypes.c_void_p] * 2
    rcutils.rcutils_get_default_allocator.restype = _Allocator
    rcutils.rcutils_get_error_string.restype = _ErrorText
    if not _array_layout_matches(rcutils):
        return 'rmw_serialized_message_t has another layout'
    if not _image_layout_matches():
        return 'sensor_msgs__msg__Image has another layout'
    _rcl, _rcutils = rcl, rcutils
    return ''


def _array_layout_matches(rcutils: Any) -> bool:
    """Return whether rcl's serialized message, an array of bytes, has the expected fields."""
    allocator = rcutils.rcutils_get_default_allocator()
    # The buffer has twice the size, in case the structure of rcl is larger.
    buffer = ctypes.create_string_buffer(2 * ctypes.sizeof(_RmwSerializedMessage))
    if rcutils.rcutils_uint8_array_init(
            buffer, ctypes.c_size_t(_CHECKED_BYTES), ctypes.byref(allocator)) != _RCL_RET_OK:
        return False
    message = _RmwSerializedMessage.from_buffer(buffer)
    found = (bool(message.buffer), message.length, message.capacity, bytes(message.allocator),
             buffer.raw[ctypes.sizeof(_RmwSerializedMessage):].strip(b'\0'))
    rcutils.rcutils_uint8_array_fini(buffer)
    return found == (True, 0, _CHECKED_BYTES, bytes(allocator), b'')


def _image_layout_matches() -> bool:
    """Return whether an image message of rclpy has the expected fields."""
    message = Image(height=3, width=4, encoding='mono8', is_bigendian=5, step=6, data=bytes(7))
    message.header.stamp.sec, message.header.stamp.nanosec = -1, 2
    message.header.frame_id = 'camera'
    Image.__class__.__import_type_support__()  # type: ignore[attr-defined]
    create, convert, destroy = (
        prototype(_pointer(capsule, None)) for prototype, capsule in (
            (ctypes.PYFUNCTYPE(ctypes.c_void_p), Image._CREATE_ROS_MESSAGE),
            (ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p),
             Image._CONVERT_FROM_PY),
            (ctypes.PYFUNCTYPE(None, ctypes.c_void_p), Image._DESTROY_ROS_MESSAGE)))
    address = create()
    try:
        if not (address and convert(message, address)):
            return False
        image = _Image.from_address(address)
        # The numbers are compared first, because pointers of another layout may be invalid.
        return (image.sec, image.nanosec, image.height, image.width, image.is_bigendian,
                image.step, image.frame_id.size, image.encoding.size, image.data.size) == (
                    -1, 2, 3, 4, 5, 6, 6, 5, 7) and (
            image.frame_id.data, image.encoding.data) == (b'camera', b'mono8')
    finally:
        destroy(address)


_pointer = ctypes.pythonapi.PyCapsule_GetPointer
_pointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
_pointer.restype = ctypes.c_void_p

#: Reason why messages pass through rclpy; '' if they do not.
reason_for_rclpy = use_rcl()


def publish_image(publisher: rclpy_implementation.Publisher, image: WireImage) -> None:
    """
    Publish an image message; the middleware makes the only copy of its data.

    :param publisher: handle of a publisher of sensor_msgs/Image.
    :param image: message with numbers in the range of their fields and contiguous data, which
        must not change during the call.
    :raises CdrError: a string cannot be part of a message.
    :raises RuntimeError: the middleware did not publish the message.
    """
    if _rcl is None:
        with publisher:
            publisher.publish_raw(image_to_cdr(image))
        return
    header, data = image.header, np.frombuffer(image.data, np.uint8)
    message = _Image(
        header.sec, header.nanosec, _string(header.frame_id), image.height, image.width,
        _string(image.encoding), image.is_bigendian, image.step,
        _Bytes(data.ctypes.data, data.nbytes, data.nbytes))
    with publisher:
        _check(_rcl.rcl_publish(publisher.pointer, ctypes.byref(message), None))


def publisher_id(publisher: rclpy_implementation.Publisher) -> bytes:
    """
    Return the identifier of a publisher, as in the ``publisher`` of a `MessageInfo`.

    :param publisher: handle of the publisher.
    :returns: 16 bytes, or none if rclpy is used.
    """
    if _rcl is None:
        return b''
    gid = _Gid()
    with publisher:
        _check(_rcl.rmw_get_gid_for_publisher(
            _rcl.rcl_publisher_get_rmw_handle(publisher.pointer), ctypes.byref(gid)))
    return bytes(gid.data)


def take_serialized(subscription: rclpy_implementation.Subscription) -> SerializedMessage | None:
    """
    Take a serialized message.

    :param subscription: handle of a subscription of any type.
    :returns: the bytes, (n,) uint8 and read-only, and the metadata; None without a message.
    :raises RuntimeError: the middleware failed.
    """
    if _rcl is None:
        return _take_by_rclpy(subscription)
    message = _RmwSerializedMessage(allocator=_rcutils.rcutils_get_default_allocator())
    info = MessageInfo()
    with subscription:
        result = _rcl.rcl_take_serialized_message(
            subscription.pointer, ctypes.byref(message), ctypes.byref(info), None)
    buffer = _Buffer(message.buffer, message.length) if message.buffer else None
    if result == _RCL_RET_SUBSCRIPTION_TAKE_FAILED:
        _rcutils.rcutils_reset_error()
        return None
    _check(result)
    return np.asarray(buffer), info


def _take_by_rclpy(subscription: rclpy_implementation.Subscription) -> SerializedMessage | None:
    """Take a message through rclpy, which does not report its publisher."""
    with subscription:
        taken = subscription.take_message(Image, True)
    if taken is None:
        return None
    data, info = taken
    return np.frombuffer(data, np.uint8), MessageInfo(
        source_timestamp=info['source_timestamp'],
        received_timestamp=info['received_timestamp'],
        publication_sequence_number=_RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED)


def _string(text: str) -> _String:
    encoded = encode_text(text)
    return _String(encoded, len(encoded), len(encoded) + 1)


def _check(result: int) -> None:
    """
    Check the result of a function of rcl.

    :raises RuntimeError: the function failed.
    """
    if result != _RCL_RET_OK:
        text = _rcutils.rcutils_get_error_string().text.decode(errors='replace')
        _rcutils.rcutils_reset_error()
        raise RuntimeError(text)
