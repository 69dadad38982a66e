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
Structures of rcl that image messages need, and checks of their layout.

They are those of rmw/types.h, rcutils/error_handling.h, rcutils/types/uint8_array.h, and of the
header that rosidl_generator_c generates for sensor_msgs/Image.
"""

from __future__ import annotations

import ctypes
from typing import Any

from sensor_msgs.msg import Image

#: Sequence number of a message whose publisher is unknown (rmw/types.h).
UNNUMBERED = 2**64 - 1
_GID_BYTES = 16
_CHECKED_BYTES = 17


class RclString(ctypes.Structure):
    """A rosidl_runtime_c__String."""

    _fields_ = (('data', ctypes.c_char_p), ('size', ctypes.c_size_t),
                ('capacity', ctypes.c_size_t))


class RclBytes(ctypes.Structure):
    """A rosidl_runtime_c__uint8__Sequence of Jazzy and Kilted."""

    #: Whether ``data`` points to a rosidl::Buffer, whose memory may be that of a GPU.
    is_rosidl_buffer: bool = False

    _fields_ = (('data', ctypes.c_void_p), ('size', ctypes.c_size_t),
                ('capacity', ctypes.c_size_t))


class RclBuffer(ctypes.Structure):
    """A rosidl_runtime_c__uint8__Sequence since Lyrical."""

    _fields_ = (*RclBytes._fields_, ('is_rosidl_buffer', ctypes.c_bool),
                ('owns_rosidl_buffer', ctypes.c_bool))


# The fields before the data; those of the header come first.
_IMAGE_FIELDS = (
    ('sec', ctypes.c_int32), ('nanosec', ctypes.c_uint32), ('frame_id', RclString),
    ('height', ctypes.c_uint32), ('width', ctypes.c_uint32), ('encoding', RclString),
    ('is_bigendian', ctypes.c_uint8), ('step', ctypes.c_uint32))


class RclImage(ctypes.Structure):
    """A sensor_msgs__msg__Image of Jazzy and Kilted."""

    _fields_ = (*_IMAGE_FIELDS, ('data', RclBytes))


class RclBufferImage(ctypes.Structure):
    """A sensor_msgs__msg__Image since Lyrical."""

    _fields_ = (*_IMAGE_FIELDS, ('data', RclBuffer))


#: The known layouts of an image message.
IMAGE_LAYOUTS: tuple[type[ctypes.Structure], ...] = (RclImage, RclBufferImage)


class RclSequence(ctypes.Structure):
    """A sequence of rosidl_runtime_c, such as a sensor_msgs__msg__Image__Sequence."""

    _fields_ = (('data', ctypes.c_void_p), ('size', ctypes.c_size_t),
                ('capacity', ctypes.c_size_t))


class RcutilsAllocator(ctypes.Structure):
    """A rcutils_allocator_t."""

    _fields_ = tuple((name, ctypes.c_void_p) for name in (
        'allocate', 'deallocate', 'reallocate', 'zero_allocate', 'state'))


class RmwSerializedMessage(ctypes.Structure):
    """A rmw_serialized_message_t."""

    _fields_ = (('buffer', ctypes.c_void_p), ('length', ctypes.c_size_t),
                ('capacity', ctypes.c_size_t), ('allocator', RcutilsAllocator))


class RmwGid(ctypes.Structure):
    """A rmw_gid_t."""

    _fields_ = (('implementation_identifier', ctypes.c_char_p),
                ('data', ctypes.c_uint8 * _GID_BYTES))


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
        ('publisher', ctypes.c_uint8 * _GID_BYTES),
        ('from_intra_process', ctypes.c_bool))

    @property
    def number(self) -> int:
        """Return the sequence number of the publisher, from 1; 0 if unknown."""
        number = int(self.publication_sequence_number)
        return 0 if number == UNNUMBERED else number


class RcutilsErrorString(ctypes.Structure):
    """A rcutils_error_string_t."""

    _fields_ = (('text', ctypes.c_char * 1024),)


def serialized_layout_matches(rcutils: Any) -> bool:
    """Return whether rcl's serialized message, an array of bytes, has the expected fields."""
    allocator = rcutils.rcutils_get_default_allocator()
    # The buffer has twice the size, in case the structure of rcl is larger.
    buffer = ctypes.create_string_buffer(2 * ctypes.sizeof(RmwSerializedMessage))
    if rcutils.rcutils_uint8_array_init(
            buffer, ctypes.c_size_t(_CHECKED_BYTES), ctypes.byref(allocator)):
        return False
    message = RmwSerializedMessage.from_buffer(buffer)
    found = (bool(message.buffer), message.length, message.capacity, bytes(message.allocator),
             buffer.raw[ctypes.sizeof(RmwSerializedMessage):].strip(b'\0'))
    rcutils.rcutils_uint8_array_fini(buffer)
    return found == (True, 0, _CHECKED_BYTES, bytes(allocator), b'')


def find_image_layout(sensor_msgs: Any, convert: Any) -> Any:
    """
    Return the layout of an image message of rclpy.

    :param sensor_msgs: library with the C functions of sensor_msgs.
    :param convert: function that converts an Image of rclpy to one of C, at an address.
    :returns: one of ``IMAGE_LAYOUTS``; None if none matches.
    """
    return next((layout for layout in IMAGE_LAYOUTS
                 if _image_layout_matches(layout, sensor_msgs, convert)), None)


def image_converter() -> Any:
    """Return the function of rclpy that converts an Image to one of C."""
    return ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p)(
        _pointer(Image._CONVERT_FROM_PY, None))


def _image_layout_matches(layout: Any, sensor_msgs: Any, convert: Any) -> bool:
    """Return whether an image message has the fields and the size of a layout."""
    message = Image(height=3, width=4, encoding='mono8', is_bigendian=5, step=6, data=bytes(7))
    message.header.stamp.sec, message.header.stamp.nanosec = -1, 2
    message.header.frame_id = 'camera'
    images = sensor_msgs.sensor_msgs__msg__Image__Sequence__create(ctypes.c_size_t(2))
    try:
        if not (images and convert(message, images.contents.data)):
            return False
        # The second image is where it is expected only if the first has the expected size.
        image, empty = (layout.from_address(images.contents.data + offset)
                        for offset in (0, ctypes.sizeof(layout)))
        # The numbers are compared first, because pointers of another layout may be invalid.
        return (image.sec, image.nanosec, image.height, image.width, image.is_bigendian,
                image.step, image.frame_id.size, image.encoding.size, image.data.size,
                empty.frame_id.size, empty.frame_id.capacity, empty.encoding.capacity) == (
                    -1, 2, 3, 4, 5, 6, 6, 5, 7, 0, 1, 1) and (
            image.frame_id.data, image.encoding.data, image.data.is_rosidl_buffer) == (
                b'camera', b'mono8', False)
    finally:
        sensor_msgs.sensor_msgs__msg__Image__Sequence__destroy(images)


_pointer = ctypes.pythonapi.PyCapsule_GetPointer
_pointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
_pointer.restype = ctypes.c_void_p
