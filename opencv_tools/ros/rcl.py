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
Image messages given to rcl and taken from it as they lie in memory, without rclpy's copies.

rclpy copies a serialised message once before it publishes it and once after it has taken it, and
holds the interpreter meanwhile. Here rcl gets the address of the pixels, and hands over the bytes
that it took. The structures are those of rcl/publisher.h, rcl/subscription.h, rmw/types.h,
rcutils/types/uint8_array.h and, for the message, of the header that rosidl_generator_c makes of
sensor_msgs/Image.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.cdr import encode_text, WireImage
# Imported first, it loads the libraries below from where they are.
from rclpy.impl.implementation_singleton import rclpy_implementation

_OK = 0
_NOTHING_TAKEN = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED
_UNKNOWN_NUMBER = 2**64 - 1  # RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED
_GID_SIZE = 16

_rcl = ctypes.CDLL('librcl.so')
_rcutils = ctypes.CDLL('librcutils.so')
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
    """A sensor_msgs__msg__Image; its header lies in it as its fields do."""

    _fields_ = (
        ('sec', ctypes.c_int32), ('nanosec', ctypes.c_uint32), ('frame_id', _String),
        ('height', ctypes.c_uint32), ('width', ctypes.c_uint32), ('encoding', _String),
        ('is_bigendian', ctypes.c_uint8), ('step', ctypes.c_uint32), ('data', _Bytes))


class _Allocator(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_void_p) for name in (
        'allocate', 'deallocate', 'reallocate', 'zero_allocate', 'state'))


class _SerializedMessage(ctypes.Structure):
    _fields_ = (('buffer', ctypes.c_void_p), ('length', ctypes.c_size_t),
                ('capacity', ctypes.c_size_t), ('allocator', _Allocator))


class MessageInfo(ctypes.Structure):
    """
    What the middleware tells of a message.

    ``source_timestamp`` and ``received_timestamp`` are nanoseconds of the system clock, 0 where
    they are not known.
    """

    source_timestamp: int
    received_timestamp: int

    _fields_ = (
        ('source_timestamp', ctypes.c_int64), ('received_timestamp', ctypes.c_int64),
        ('publication_sequence_number', ctypes.c_uint64),
        ('reception_sequence_number', ctypes.c_uint64),
        ('implementation', ctypes.c_char_p), ('publisher', ctypes.c_uint8 * _GID_SIZE),
        ('from_intra_process', ctypes.c_bool))

    @property
    def number(self) -> int:
        """Give the publisher's count of its messages, from 1 on; 0 where it is not known."""
        number = int(self.publication_sequence_number)
        return 0 if number == _UNKNOWN_NUMBER else number


#: The bytes of a message, (n,) uint8, and what is known of it.
Taken = tuple[NDArray[np.uint8], MessageInfo]


class _ErrorText(ctypes.Structure):
    _fields_ = (('text', ctypes.c_char * 1024),)


class _Buffer:
    """A message's bytes, which go away with the last view of them."""

    def __init__(self, address: int, size: int) -> None:
        self._address = address
        self.__array_interface__ = {
            'shape': (size,), 'typestr': '|u1', 'data': (address, True), 'version': 3}

    def __del__(self, free: Any = _free) -> None:
        free(self._address)


_rcl.rcl_publish.argtypes = [ctypes.c_void_p] * 3
_rcl.rcl_take_serialized_message.argtypes = [ctypes.c_void_p] * 4
_rcutils.rcutils_get_default_allocator.restype = _Allocator
_rcutils.rcutils_get_error_string.restype = _ErrorText


def publish_image(publisher: rclpy_implementation.Publisher, image: WireImage) -> None:
    """
    Publish an image message; the middleware copies its data once, to keep them.

    :param publisher: the handle of a publisher of sensor_msgs/Image.
    :param image: the message; its numbers fit their fields, its data are contiguous and are not
        written to meanwhile.
    :raises CdrError: a string that the message cannot hold.
    :raises RuntimeError: the middleware could not publish it.
    """
    data = np.frombuffer(image.data, np.uint8)
    message = _Image(
        image.sec, image.nanosec, _string(image.frame_id), image.height, image.width,
        _string(image.encoding), image.is_bigendian, image.step,
        _Bytes(data.ctypes.data, data.nbytes, data.nbytes))
    with publisher:
        _check(_rcl.rcl_publish(publisher.pointer, ctypes.byref(message), None))


def take_serialized(subscription: rclpy_implementation.Subscription) -> Taken | None:
    """
    Take a message as it came over the wire.

    :param subscription: the handle of a subscription of any type.
    :returns: its bytes, (n,) uint8 and read-only, and what is known of it; None if there is none.
    :raises RuntimeError: the middleware could not give it.
    """
    message = _SerializedMessage(allocator=_rcutils.rcutils_get_default_allocator())
    info = MessageInfo()
    with subscription:
        result = _rcl.rcl_take_serialized_message(
            subscription.pointer, ctypes.byref(message), ctypes.byref(info), None)
    taken = _Buffer(message.buffer, message.length) if message.buffer else None
    if result == _NOTHING_TAKEN:
        _rcutils.rcutils_reset_error()
        return None
    _check(result)
    return np.asarray(taken), info


def _string(text: str) -> _String:
    encoded = encode_text(text)
    return _String(encoded, len(encoded), len(encoded) + 1)


def _check(result: int) -> None:
    """
    Look at what a function of rcl returned.

    :raises RuntimeError: it failed.
    """
    if result != _OK:
        text = _rcutils.rcutils_get_error_string().text.decode(errors='replace')
        _rcutils.rcutils_reset_error()
        raise RuntimeError(text)
