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
interpreter meanwhile. This module passes the address of the pixels to rcl, and returns the memory
that rcl has filled. If the layout of rcl's structures is not a known one, rclpy is used with its
copies.
"""

from __future__ import annotations

from collections.abc import Sequence
import ctypes
import os
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.cdr import encode_text, image_to_cdr, WireHeader, WireImage
from opencv_tools.transport.rcl_structures import (
    find_image_layout, image_converter, MessageInfo, RclSequence, RclString, RcutilsAllocator,
    RcutilsErrorString, RmwGid, RmwSerializedMessage, serialized_layout_matches, UNNUMBERED,
)
# This import comes first, because it loads the libraries below from their location.
from rclpy.impl.implementation_singleton import rclpy_implementation
from sensor_msgs.msg import Image

# Constants of rcl/types.h and rmw/types.h.
_RCL_RET_OK = 0
_RCL_RET_SUBSCRIPTION_TAKE_FAILED = 401

# Functions that are called, by library.
_FUNCTIONS: dict[str, Sequence[str]] = {
    'librcl.so': ('rcl_publish', 'rcl_publisher_get_rmw_handle', 'rcl_take',
                  'rcl_take_serialized_message', 'rmw_get_gid_for_publisher'),
    'librcutils.so': ('rcutils_error_is_set', 'rcutils_get_default_allocator',
                      'rcutils_get_error_string', 'rcutils_reset_error',
                      'rcutils_uint8_array_init', 'rcutils_uint8_array_fini'),
    'libsensor_msgs__rosidl_generator_c.so': (
        'sensor_msgs__msg__Image__fini', 'sensor_msgs__msg__Image__Sequence__create',
        'sensor_msgs__msg__Image__Sequence__destroy'),
    # Since the release that has it, a rmw_gid_t and a rmw_message_info_t are as below.
    'librosidl_runtime_c.so': ('rosidl_stringify_type_hash',)}

_rcl: Any = None
_rcutils: Any = None
_sensor_msgs: Any = None
_image_layout: Any = None
_free = ctypes.CDLL(None).free
_free.argtypes = [ctypes.c_void_p]
_free.restype = None


#: The serialized message, (n,) uint8, and its metadata.
SerializedMessage = tuple[NDArray[np.uint8], MessageInfo]


class TakenImage(NamedTuple):
    """
    Result of taking an image message.

    :param image: the message, whose data are read-only; None without a message.
    :param unreadable: reason why the middleware has discarded earlier messages; '' if it has
        reported none.
    """

    image: WireImage | None
    info: MessageInfo
    unreadable: str


class _Buffer:
    """Memory of a serialized message, freed with the last view of it."""

    def __init__(self, address: int, size: int) -> None:
        self._address = address
        self.__array_interface__ = {
            'shape': (size,), 'typestr': '|u1', 'data': (address, True), 'version': 3}

    def __del__(self, free: Any = _free) -> None:
        free(self._address)


class _ImageMemory:
    """Memory of an image message that rcl fills, freed with the last view of its data."""

    def __init__(self) -> None:
        self.message = _image_layout()
        self.address = ctypes.addressof(self.message)
        self._free = _sensor_msgs.sensor_msgs__msg__Image__fini

    @property
    def __array_interface__(self) -> dict[str, Any]:
        data = self.message.data  # no rosidl::Buffer, see take_image
        return {'shape': (data.size,), 'typestr': '|u1', 'data': (data.data or self.address, True),
                'version': 3}

    def __del__(self) -> None:
        self._free(self.address)


def use_rcl() -> str:
    """
    Check the layout of rcl's structures and select rcl or rclpy.

    :returns: reason for the use of rclpy; '' if rcl is used.
    """
    global _rcl, _rcutils, _sensor_msgs, _image_layout
    _rcl = _rcutils = _sensor_msgs = None
    if os.environ.get('OPENCV_TOOLS_TRANSPORT') == 'default':
        return 'OPENCV_TOOLS_TRANSPORT is default'
    # This loads the library of sensor_msgs from its location.
    Image.__class__.__import_type_support__()
    try:
        libraries = [ctypes.CDLL(name) for name in _FUNCTIONS]
        for library, names in zip(libraries, _FUNCTIONS.values()):
            for name in names:
                getattr(library, name)
    except (OSError, AttributeError) as err:
        return str(err)
    rcl, rcutils, sensor_msgs, _ = libraries
    rcl.rcl_publish.argtypes = [ctypes.c_void_p] * 3
    rcl.rcl_take.argtypes = rcl.rcl_take_serialized_message.argtypes = [ctypes.c_void_p] * 4
    rcl.rcl_publisher_get_rmw_handle.argtypes = [ctypes.c_void_p]
    rcl.rcl_publisher_get_rmw_handle.restype = ctypes.c_void_p
    rcl.rmw_get_gid_for_publisher.argtypes = [ctypes.c_void_p] * 2
    rcutils.rcutils_error_is_set.restype = ctypes.c_bool
    rcutils.rcutils_get_default_allocator.restype = RcutilsAllocator
    rcutils.rcutils_get_error_string.restype = RcutilsErrorString
    sensor_msgs.sensor_msgs__msg__Image__fini.argtypes = [ctypes.c_void_p]
    sensor_msgs.sensor_msgs__msg__Image__Sequence__create.restype = ctypes.POINTER(RclSequence)
    if not serialized_layout_matches(rcutils):
        return 'rmw_serialized_message_t has another layout'
    _image_layout = find_image_layout(sensor_msgs, image_converter())
    if _image_layout is None:
        return 'sensor_msgs__msg__Image has another layout'
    _rcl, _rcutils, _sensor_msgs = rcl, rcutils, sensor_msgs
    return ''


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
    message = _image_layout(
        header.sec, header.nanosec, _string(header.frame_id), image.height, image.width,
        _string(image.encoding), image.is_bigendian, image.step,
        (data.ctypes.data, data.nbytes, data.nbytes))
    with publisher:
        _check(_rcl.rcl_publish(publisher.pointer, ctypes.byref(message), None))


def publisher_id(publisher: rclpy_implementation.Publisher) -> bytes:
    """
    Return the identifier of a publisher, as in the ``publisher`` of a `MessageInfo`.

    :returns: 16 bytes, or none if rclpy is used.
    """
    if _rcl is None:
        return b''
    gid = RmwGid()
    with publisher:
        _check(_rcl.rmw_get_gid_for_publisher(
            _rcl.rcl_publisher_get_rmw_handle(publisher.pointer), ctypes.byref(gid)))
    return bytes(gid.data)


def take_serialized(subscription: rclpy_implementation.Subscription) -> SerializedMessage | None:
    """
    Take a serialized message.

    :returns: the bytes, (n,) uint8 and read-only, and the metadata; None without a message.
    :raises RuntimeError: the middleware failed.
    """
    if _rcl is None:
        return _take_by_rclpy(subscription)
    message = RmwSerializedMessage(allocator=_rcutils.rcutils_get_default_allocator())
    info = MessageInfo()
    with subscription:
        result = _rcl.rcl_take_serialized_message(
            subscription.pointer, ctypes.byref(message), ctypes.byref(info), None)
    buffer = _Buffer(message.buffer, message.length) if message.buffer else None
    if result == _RCL_RET_SUBSCRIPTION_TAKE_FAILED:
        _rcutils.rcutils_reset_error()
        return None
    _check(result)
    # A message without a byte has no buffer.
    return np.asarray(buffer) if buffer else np.empty(0, np.uint8), info


def take_image(subscription: rclpy_implementation.Subscription) -> TakenImage:
    """
    Take an image message with one copy of its data, which the middleware makes as it reads them.

    The middleware discards messages that it cannot read before the one that it returns. It may
    print a line about them on standard error. It reports neither their number nor, if their data
    are cut off and another message follows, that they were there.

    :param subscription: handle of a subscription to sensor_msgs/Image, whose messages do not pass
        through rclpy.
    :raises RuntimeError: the middleware failed.
    """
    memory, info = _ImageMemory(), MessageInfo()
    message = memory.message
    _rcutils.rcutils_reset_error()
    with subscription:
        result = _rcl.rcl_take(subscription.pointer, memory.address, ctypes.byref(info), None)
    if result not in (_RCL_RET_OK, _RCL_RET_SUBSCRIPTION_TAKE_FAILED):
        _check(result)
    # The text ends with the line of the source.
    unreadable = _pop_error().partition(', at ')[0] if _rcutils.rcutils_error_is_set() else ''
    if result == _RCL_RET_SUBSCRIPTION_TAKE_FAILED:
        if message.frame_id.data is not None and not unreadable:
            unreadable = 'its data are cut off'
        return TakenImage(None, info, unreadable)
    if message.data.is_rosidl_buffer:
        return TakenImage(None, info, 'its data are in a rosidl::Buffer')
    frame_id, encoding = (
        (string.data or b'').decode(errors='replace')
        for string in (message.frame_id, message.encoding))
    return TakenImage(WireImage(
        header=WireHeader(message.sec, message.nanosec, frame_id), height=message.height,
        width=message.width, encoding=encoding, is_bigendian=bool(message.is_bigendian),
        step=message.step, data=np.asarray(memory).data), info, unreadable)


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
        publication_sequence_number=UNNUMBERED)


def _string(text: str) -> RclString:
    encoded = encode_text(text)
    return RclString(encoded, len(encoded), len(encoded) + 1)


def _check(result: int) -> None:
    """
    Check the result of a function of rcl.

    :raises RuntimeError: the function failed.
    """
    if result != _RCL_RET_OK:
        raise RuntimeError(_pop_error())


def _pop_error() -> str:
    """Return the error text of rcl, and reset it."""
    text = _rcutils.rcutils_get_error_string().text.decode(errors='replace')
    _rcutils.rcutils_reset_error()
    return str(text)
