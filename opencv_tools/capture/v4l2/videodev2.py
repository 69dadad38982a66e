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
from ctypes import c_char, c_int32, c_int64, c_long, c_uint32, c_uint64, c_uint8, c_ulong, c_void_p
import errno
from fcntl import ioctl
from typing import Any

VIDEO_MAJOR = 81

V4L2_BUF_TYPE_VIDEO_CAPTURE = 1
V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE = 9
V4L2_MEMORY_MMAP = 1
V4L2_FIELD_ANY = 0

V4L2_CAP_VIDEO_CAPTURE = 0x00000001
V4L2_CAP_VIDEO_CAPTURE_MPLANE = 0x00001000
V4L2_CAP_STREAMING = 0x04000000
V4L2_CAP_DEVICE_CAPS = 0x80000000
V4L2_CAP_TIMEPERFRAME = 0x1000

V4L2_BUF_FLAG_ERROR = 0x00000040
V4L2_BUF_FLAG_TIMESTAMP_MASK = 0x0000e000
V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC = 0x00002000

V4L2_FRMSIZE_TYPE_DISCRETE = 1
V4L2_FRMIVAL_TYPE_DISCRETE = 1

V4L2_CTRL_FLAG_NEXT_CTRL = 0x80000000
V4L2_CTRL_FLAG_DISABLED = 0x0001
V4L2_CTRL_FLAG_READ_ONLY = 0x0004
V4L2_CTRL_FLAG_INACTIVE = 0x0010
V4L2_CTRL_FLAG_WRITE_ONLY = 0x0040

V4L2_EVENT_CTRL = 3
V4L2_EVENT_SUB_FL_ALLOW_FEEDBACK = 0x0002


def _union(**members: Any) -> type[ctypes.Union]:
    return type('union', (ctypes.Union,), {'_fields_': [*members.items()]})


class v4l2_capability(ctypes.Structure):
    _fields_ = [
        ('driver', c_char * 16), ('card', c_char * 32), ('bus_info', c_char * 32),
        ('version', c_uint32), ('capabilities', c_uint32), ('device_caps', c_uint32),
        ('reserved', c_uint32 * 3)]


class v4l2_fmtdesc(ctypes.Structure):
    _fields_ = [
        ('index', c_uint32), ('type', c_uint32), ('flags', c_uint32),
        ('description', c_char * 32), ('pixelformat', c_uint32), ('mbus_code', c_uint32),
        ('reserved', c_uint32 * 3)]


class v4l2_fract(ctypes.Structure):
    _fields_ = [('numerator', c_uint32), ('denominator', c_uint32)]


class v4l2_frmsize_stepwise(ctypes.Structure):
    _fields_ = [
        ('min_width', c_uint32), ('max_width', c_uint32), ('step_width', c_uint32),
        ('min_height', c_uint32), ('max_height', c_uint32), ('step_height', c_uint32)]


class v4l2_frmsize_discrete(ctypes.Structure):
    _fields_ = [('width', c_uint32), ('height', c_uint32)]


class v4l2_frmsizeenum(ctypes.Structure):
    _anonymous_ = ('union',)
    _fields_ = [
        ('index', c_uint32), ('pixel_format', c_uint32), ('type', c_uint32),
        ('union', _union(discrete=v4l2_frmsize_discrete, stepwise=v4l2_frmsize_stepwise)),
        ('reserved', c_uint32 * 2)]


class v4l2_frmival_stepwise(ctypes.Structure):
    _fields_ = [('min', v4l2_fract), ('max', v4l2_fract), ('step', v4l2_fract)]


class v4l2_frmivalenum(ctypes.Structure):
    _anonymous_ = ('union',)
    _fields_ = [
        ('index', c_uint32), ('pixel_format', c_uint32), ('width', c_uint32),
        ('height', c_uint32), ('type', c_uint32),
        ('union', _union(discrete=v4l2_fract, stepwise=v4l2_frmival_stepwise)),
        ('reserved', c_uint32 * 2)]


class v4l2_pix_format(ctypes.Structure):
    """``struct v4l2_pix_format``, without its last fields."""

    _fields_ = [
        ('width', c_uint32), ('height', c_uint32), ('pixelformat', c_uint32),
        ('field', c_uint32), ('bytesperline', c_uint32), ('sizeimage', c_uint32)]


class v4l2_plane_pix_format(ctypes.Structure):
    _fields_ = [('sizeimage', c_uint32), ('bytesperline', c_uint32), ('reserved', c_uint32 * 3)]


class v4l2_pix_format_mplane(ctypes.Structure):
    """``struct v4l2_pix_format_mplane``, without its last fields."""

    _fields_ = [
        ('width', c_uint32), ('height', c_uint32), ('pixelformat', c_uint32),
        ('field', c_uint32), ('colorspace', c_uint32), ('plane_fmt', v4l2_plane_pix_format * 8),
        ('num_planes', c_uint8)]


class v4l2_format(ctypes.Structure):
    # Other members contain pointers, which determine the alignment of the union.
    _fields_ = [('type', c_uint32), ('fmt', _union(
        pix=v4l2_pix_format, pix_mp=v4l2_pix_format_mplane, pointer=c_void_p,
        raw_data=c_uint8 * 200))]


class v4l2_captureparm(ctypes.Structure):
    _fields_ = [
        ('capability', c_uint32), ('capturemode', c_uint32), ('timeperframe', v4l2_fract),
        ('extendedmode', c_uint32), ('readbuffers', c_uint32), ('reserved', c_uint32 * 4)]


class v4l2_streamparm(ctypes.Structure):
    _fields_ = [
        ('type', c_uint32), ('parm', _union(capture=v4l2_captureparm, raw_data=c_uint8 * 200))]


class v4l2_requestbuffers(ctypes.Structure):
    _fields_ = [
        ('count', c_uint32), ('type', c_uint32), ('memory', c_uint32),
        ('capabilities', c_uint32), ('flags', c_uint8), ('reserved', c_uint8 * 3)]


class v4l2_plane(ctypes.Structure):
    _fields_ = [
        ('bytesused', c_uint32), ('length', c_uint32),
        ('m', _union(mem_offset=c_uint32, userptr=c_ulong)), ('data_offset', c_uint32),
        ('reserved', c_uint32 * 11)]


class v4l2_buffer(ctypes.Structure):
    """``struct v4l2_buffer``; ``timestamp`` has seconds and microseconds."""

    _fields_ = [
        ('index', c_uint32), ('type', c_uint32), ('bytesused', c_uint32), ('flags', c_uint32),
        ('field', c_uint32), ('timestamp', c_long * 2), ('timecode', c_uint32 * 4),
        ('sequence', c_uint32), ('memory', c_uint32),
        ('m', _union(offset=c_uint32, planes=ctypes.POINTER(v4l2_plane))), ('length', c_uint32),
        ('reserved2', c_uint32), ('request_fd', c_int32)]


class v4l2_query_ext_ctrl(ctypes.Structure):
    _fields_ = [
        ('id', c_uint32), ('type', c_uint32), ('name', c_char * 32), ('minimum', c_int64),
        ('maximum', c_int64), ('step', c_uint64), ('default_value', c_int64),
        ('flags', c_uint32), ('elem_size', c_uint32), ('elems', c_uint32),
        ('nr_of_dims', c_uint32), ('dims', c_uint32 * 4), ('reserved', c_uint32 * 32)]


class v4l2_querymenu(ctypes.Structure):
    """``struct v4l2_querymenu``; for an integer menu ``name`` holds the value of the entry."""

    _fields_ = [
        ('id', c_uint32), ('index', c_uint32), ('name', c_char * 32), ('reserved', c_uint32)]


class v4l2_control(ctypes.Structure):
    _fields_ = [('id', c_uint32), ('value', c_int32)]


class v4l2_event_subscription(ctypes.Structure):
    _fields_ = [
        ('type', c_uint32), ('id', c_uint32), ('flags', c_uint32), ('reserved', c_uint32 * 5)]


class v4l2_event(ctypes.Structure):
    """``struct v4l2_event``; ``id`` is the ID of the control that has changed."""

    _fields_ = [
        ('type', c_uint32), ('u', c_int64 * 8), ('pending', c_uint32), ('sequence', c_uint32),
        ('timestamp', c_long * 2), ('id', c_uint32), ('reserved', c_uint32 * 8)]


_WRITE, _READ = 1, 2


def _ioc(number: int, argument: type[ctypes.Structure] | type[ctypes._SimpleCData[int]],
         direction: int = _WRITE | _READ) -> int:
    """Return the number of a request of V4L2, as ``_IOC`` of ``<asm-generic/ioctl.h>`` does."""
    return direction << 30 | ctypes.sizeof(argument) << 16 | ord('V') << 8 | number


VIDIOC_QUERYCAP = _ioc(0, v4l2_capability, _READ)
VIDIOC_ENUM_FMT = _ioc(2, v4l2_fmtdesc)
VIDIOC_S_FMT = _ioc(5, v4l2_format)
VIDIOC_REQBUFS = _ioc(8, v4l2_requestbuffers)
VIDIOC_QUERYBUF = _ioc(9, v4l2_buffer)
VIDIOC_QBUF = _ioc(15, v4l2_buffer)
VIDIOC_DQBUF = _ioc(17, v4l2_buffer)
VIDIOC_STREAMON = _ioc(18, c_int32, _WRITE)
VIDIOC_STREAMOFF = _ioc(19, c_int32, _WRITE)
VIDIOC_G_PARM = _ioc(21, v4l2_streamparm)
VIDIOC_S_PARM = _ioc(22, v4l2_streamparm)
VIDIOC_G_CTRL = _ioc(27, v4l2_control)
VIDIOC_S_CTRL = _ioc(28, v4l2_control)
VIDIOC_QUERYMENU = _ioc(37, v4l2_querymenu)
VIDIOC_ENUM_FRAMESIZES = _ioc(74, v4l2_frmsizeenum)
VIDIOC_ENUM_FRAMEINTERVALS = _ioc(75, v4l2_frmivalenum)
VIDIOC_DQEVENT = _ioc(89, v4l2_event, _READ)
VIDIOC_SUBSCRIBE_EVENT = _ioc(90, v4l2_event_subscription, _WRITE)
VIDIOC_QUERY_EXT_CTRL = _ioc(103, v4l2_query_ext_ctrl)


def try_ioctl(fd: int, request: int, argument: ctypes.Structure) -> bool:
    """
    Send a request that a device may not support, such as for one entry of a list.

    :param argument: argument of the request; the kernel writes the answer to it.
    :returns: False when the device has no such entry, or does not support the request.
    :raises OSError: the device rejects the request for another reason.
    """
    try:
        ioctl(fd, request, argument)
    except OSError as err:
        if err.errno in (errno.EINVAL, errno.ENOTTY):
            return False
        raise
    return True
