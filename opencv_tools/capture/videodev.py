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

"""The kernel's camera interface V4L2: structures and requests of ``<linux/videodev2.h>``."""

from __future__ import annotations

import ctypes
from ctypes import c_char, c_int32, c_int64, c_long, c_uint32, c_uint64, c_uint8
import enum
import errno
import fcntl

MAJOR = 81  # Documentation/admin-guide/devices.txt: video4linux

CAPTURE = 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE
CAPTURE_PLANES = 9  # V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE
MMAP = 1  # V4L2_MEMORY_MMAP
FIELD_ANY = 0

CAN_CAPTURE = 0x00000001  # V4L2_CAP_VIDEO_CAPTURE
CAN_CAPTURE_PLANES = 0x00001000  # V4L2_CAP_VIDEO_CAPTURE_MPLANE
CAN_STREAM = 0x04000000
HAS_DEVICE_CAPS = 0x80000000
HAS_TIME_PER_FRAME = 0x1000

BUFFER_IS_BROKEN = 0x0040  # V4L2_BUF_FLAG_ERROR
BUFFER_CLOCK = 0xe000
BUFFER_CLOCK_MONOTONIC = 0x2000

DISCRETE = 1  # V4L2_FRMSIZE_TYPE_DISCRETE, V4L2_FRMIVAL_TYPE_DISCRETE

NEXT_CONTROL = 0x80000000
CONTROL_IS_DISABLED = 0x0001
CONTROL_IS_READ_ONLY = 0x0004
CONTROL_IS_INACTIVE = 0x0010
CONTROL_IS_WRITE_ONLY = 0x0040

CONTROL_EVENT = 3  # V4L2_EVENT_CTRL
OWN_CHANGES_TOO = 0x0002  # V4L2_EVENT_SUB_FL_ALLOW_FEEDBACK


class ControlType(enum.IntEnum):
    """The values of ``enum v4l2_ctrl_type`` for controls with a single number."""

    INTEGER = 1
    BOOLEAN = 2
    MENU = 3
    INTEGER_MENU = 9


class Capability(ctypes.Structure):
    """``struct v4l2_capability``."""

    _fields_ = [
        ('driver', c_char * 16), ('card', c_char * 32), ('bus_info', c_char * 32),
        ('version', c_uint32), ('capabilities', c_uint32), ('device_caps', c_uint32),
        ('reserved', c_uint32 * 3)]


class FormatDescription(ctypes.Structure):
    """``struct v4l2_fmtdesc``."""

    _fields_ = [
        ('index', c_uint32), ('type', c_uint32), ('flags', c_uint32),
        ('description', c_char * 32), ('pixelformat', c_uint32), ('mbus_code', c_uint32),
        ('reserved', c_uint32 * 3)]


class Fraction(ctypes.Structure):
    """``struct v4l2_fract``."""

    _fields_ = [('numerator', c_uint32), ('denominator', c_uint32)]


class FrameSize(ctypes.Structure):
    """``struct v4l2_frmsizeenum``; a discrete size uses the first two numbers only."""

    _fields_ = [
        ('index', c_uint32), ('pixelformat', c_uint32), ('type', c_uint32),
        ('numbers', c_uint32 * 6), ('reserved', c_uint32 * 2)]


class FrameInterval(ctypes.Structure):
    """``struct v4l2_frmivalenum``; a discrete interval uses the first fraction only."""

    _fields_ = [
        ('index', c_uint32), ('pixelformat', c_uint32), ('width', c_uint32),
        ('height', c_uint32), ('type', c_uint32), ('fractions', Fraction * 3),
        ('reserved', c_uint32 * 2)]


class Format(ctypes.Structure):
    """``struct v4l2_format`` of a single-planar capture device."""

    _fields_ = [
        ('type', c_uint32), ('align', c_uint32 * (ctypes.sizeof(ctypes.c_void_p) // 8)),
        ('width', c_uint32), ('height', c_uint32), ('pixelformat', c_uint32),
        ('field', c_uint32), ('bytesperline', c_uint32), ('sizeimage', c_uint32),
        ('rest', c_uint8 * (200 - 24))]


class PlaneFormat(ctypes.Structure):
    """``struct v4l2_plane_pix_format``."""

    _fields_ = [('sizeimage', c_uint32), ('bytesperline', c_uint32), ('reserved', c_uint32 * 3)]


class PlanarFormat(ctypes.Structure):
    """``struct v4l2_format`` of a multi-planar capture device."""

    _fields_ = [
        ('type', c_uint32), ('align', c_uint32 * (ctypes.sizeof(ctypes.c_void_p) // 8)),
        ('width', c_uint32), ('height', c_uint32), ('pixelformat', c_uint32),
        ('field', c_uint32), ('colorspace', c_uint32), ('planes', PlaneFormat * 8),
        ('num_planes', c_uint8), ('rest', c_uint8 * (200 - 20 - 8 * 20 - 1))]


class StreamParameters(ctypes.Structure):
    """``struct v4l2_streamparm`` of a capture device."""

    _fields_ = [
        ('type', c_uint32), ('capability', c_uint32), ('capturemode', c_uint32),
        ('timeperframe', Fraction), ('rest', c_uint8 * (200 - 16))]


class BufferRequest(ctypes.Structure):
    """``struct v4l2_requestbuffers``."""

    _fields_ = [
        ('count', c_uint32), ('type', c_uint32), ('memory', c_uint32),
        ('capabilities', c_uint32), ('reserved', c_uint32)]


class Plane(ctypes.Structure):
    """``struct v4l2_plane``."""

    _fields_ = [
        ('bytesused', c_uint32), ('length', c_uint32), ('offset', c_uint64),
        ('data_offset', c_uint32), ('reserved', c_uint32 * 11)]


class Buffer(ctypes.Structure):
    """``struct v4l2_buffer``; for multi-planar devices ``offset`` points to ``length`` planes."""

    _fields_ = [
        ('index', c_uint32), ('type', c_uint32), ('bytesused', c_uint32), ('flags', c_uint32),
        ('field', c_uint32), ('seconds', c_long), ('microseconds', c_long),
        ('timecode', c_uint32 * 4), ('sequence', c_uint32), ('memory', c_uint32),
        ('offset', c_uint64), ('length', c_uint32), ('reserved', c_uint32 * 2)]


class ControlQuery(ctypes.Structure):
    """``struct v4l2_query_ext_ctrl``."""

    _fields_ = [
        ('id', c_uint32), ('type', c_uint32), ('name', c_char * 32), ('minimum', c_int64),
        ('maximum', c_int64), ('step', c_uint64), ('default_value', c_int64),
        ('flags', c_uint32), ('elem_size', c_uint32), ('elems', c_uint32),
        ('nr_of_dims', c_uint32), ('dims', c_uint32 * 4), ('reserved', c_uint32 * 32)]


class MenuQuery(ctypes.Structure):
    """``struct v4l2_querymenu``; for an integer menu ``name`` holds the value of the entry."""

    _fields_ = [
        ('id', c_uint32), ('index', c_uint32), ('name', c_char * 32), ('reserved', c_uint32)]


class ControlValue(ctypes.Structure):
    """``struct v4l2_control``."""

    _fields_ = [('id', c_uint32), ('value', c_int32)]


class EventSubscription(ctypes.Structure):
    """``struct v4l2_event_subscription``."""

    _fields_ = [
        ('type', c_uint32), ('id', c_uint32), ('flags', c_uint32), ('reserved', c_uint32 * 5)]


class Event(ctypes.Structure):
    """``struct v4l2_event``; ``id`` is the ID of the control that has changed."""

    _fields_ = [
        ('type', c_uint32), ('data', c_int64 * 8), ('pending', c_uint32), ('sequence', c_uint32),
        ('seconds', c_long), ('nanoseconds', c_long), ('id', c_uint32),
        ('reserved', c_uint32 * 8)]


_WRITE, _READ = 1, 2


def _request(number: int, argument: type[ctypes.Structure] | type[ctypes._SimpleCData[int]],
             direction: int = _WRITE | _READ) -> int:
    """
    Return the number of an ioctl request, as ``_IOC`` of ``<asm-generic/ioctl.h>`` does.

    :param number: number of the request within V4L2.
    :param argument: type of the argument.
    :param direction: ``_WRITE``, ``_READ`` or both.
    """
    return direction << 30 | ctypes.sizeof(argument) << 16 | ord('V') << 8 | number


QUERYCAP = _request(0, Capability, _READ)
ENUM_FMT = _request(2, FormatDescription)
G_FMT = _request(4, Format)
S_FMT = _request(5, Format)
REQBUFS = _request(8, BufferRequest)
QUERYBUF = _request(9, Buffer)
QBUF = _request(15, Buffer)
DQBUF = _request(17, Buffer)
STREAMON = _request(18, c_int32, _WRITE)
STREAMOFF = _request(19, c_int32, _WRITE)
G_PARM = _request(21, StreamParameters)
S_PARM = _request(22, StreamParameters)
G_CTRL = _request(27, ControlValue)
S_CTRL = _request(28, ControlValue)
QUERYMENU = _request(37, MenuQuery)
ENUM_FRAMESIZES = _request(74, FrameSize)
ENUM_FRAMEINTERVALS = _request(75, FrameInterval)
DQEVENT = _request(89, Event, _READ)
SUBSCRIBE_EVENT = _request(90, EventSubscription, _WRITE)
QUERY_EXT_CTRL = _request(103, ControlQuery)


def ask(fd: int, request: int, argument: ctypes.Structure | ctypes._SimpleCData[int]) -> None:
    """
    Send a request to a device.

    :param fd: descriptor of the device.
    :param request: number of the request.
    :param argument: argument of the request; the kernel writes the answer to it.
    :raises OSError: the device rejects the request.
    """
    fcntl.ioctl(fd, request, argument)


def ask_about(fd: int, request: int, argument: ctypes.Structure) -> bool:
    """
    Send a request that a device may not support, such as for one entry of a list.

    :param fd: descriptor of the device.
    :param request: number of the request.
    :param argument: argument of the request; the kernel writes the answer to it.
    :returns: False when the device has no such entry, or does not support the request.
    :raises OSError: the device rejects the request for another reason.
    """
    try:
        ask(fd, request, argument)
    except OSError as err:
        if err.errno in (errno.EINVAL, errno.ENOTTY):
            return False
        raise
    return True


# Flag in the number of a pixel format with big-endian words: v4l2_fourcc_be().
_BIG_ENDIAN = 1 << 31
_BIG_ENDIAN_SUFFIX = '-BE'


def pack_fourcc(text: str) -> int:
    """Return the V4L2 number of a pixel format from its text, as ``unpack_fourcc`` writes it."""
    letters = text.removesuffix(_BIG_ENDIAN_SUFFIX)
    number = int.from_bytes(letters.ljust(4).encode('latin-1'), 'little')
    return number if letters == text else number | _BIG_ENDIAN


def unpack_fourcc(number: int) -> str:
    """Return a pixel format as text without trailing blanks, with ``-BE`` if big-endian."""
    letters = (number & ~_BIG_ENDIAN).to_bytes(4, 'little').decode('latin-1').rstrip()
    return letters + _BIG_ENDIAN_SUFFIX if number & _BIG_ENDIAN else letters
