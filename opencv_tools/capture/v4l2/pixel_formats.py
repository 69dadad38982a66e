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

"""The supported V4L2 pixel formats, and their conversion to arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.capture.errors import BrokenFrameError
from opencv_tools.capture.frame import JPEG, VIDEO
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import LayoutError
from opencv_tools.image.layout import view_pixels
from opencv_tools.opencv import cv2

# Flag in the number of a pixel format with big-endian words: v4l2_fourcc_be().
_BIG_ENDIAN = 1 << 31
_BIG_ENDIAN_SUFFIX = '-BE'

Buffer = bytes | memoryview
#: Function that converts a buffer to an array: data, height and width in pixels, bytes a line.
Reader = Callable[[Buffer, int, int, int], NDArray[Any]]


@dataclass(frozen=True)
class PixelFormat:
    """
    One V4L2 pixel format.

    :param fourcc: four-character code without trailing blanks.
    :param encoding: sensor_msgs/Image encoding of the arrays that ``read`` returns, ``JPEG`` or
        ``VIDEO``.
    :param read: function that converts a buffer to an array.
    """

    fourcc: str
    encoding: str
    read: Reader


def _read_pixels(
    encoding: str, data: Buffer, height: int, width: int, step: int,
) -> NDArray[Any]:
    """Return a view of pixels that have an encoding of ROS."""
    return view_pixels(data, height, width, step, find_encoding(encoding))


def _read_planes(
    conversion: str, data: Buffer, height: int, width: int, step: int,
) -> NDArray[Any]:
    """
    Convert a luma plane and two chroma planes to BGR, because ROS has no such encoding.

    :param conversion: name of the code of ``cv2.cvtColor``.
    """
    lines = np.frombuffer(data, np.uint8, height * step * 3 // 2)
    luma = lines[:height * step].reshape(height, step)[:, :width]
    chroma = lines[height * step:].reshape(height, step // 2)[:, :width // 2]
    planes = np.concatenate([luma, chroma.reshape(height // 2, width)])
    return cv2.cvtColor(planes, getattr(cv2, conversion))


def _read_bytes(data: Buffer, _height: int, _width: int, _step: int) -> NDArray[Any]:
    return np.frombuffer(bytes(data), np.uint8)  # small, and read more than once


def _raw(fourcc: str, encoding: str) -> PixelFormat:
    return PixelFormat(fourcc, encoding, partial(_read_pixels, encoding))


#: All supported pixel formats by their code, the preferred ones first.
PIXEL_FORMATS = {known.fourcc: known for known in (
    _raw('BGR3', 'bgr8'), _raw('RGB3', 'rgb8'), _raw('XR24', 'bgra8'), _raw('AR24', 'bgra8'),
    _raw('YUYV', 'yuv422_yuy2'), _raw('UYVY', 'yuv422'),
    _raw('NV12', 'nv12'), _raw('NV21', 'nv21'), _raw('NV24', 'nv24'),
    PixelFormat('YU12', 'bgr8', partial(_read_planes, 'COLOR_YUV2BGR_I420')),
    PixelFormat('YV12', 'bgr8', partial(_read_planes, 'COLOR_YUV2BGR_YV12')),
    PixelFormat('MJPG', JPEG, _read_bytes), PixelFormat('JPEG', JPEG, _read_bytes),
    _raw('RGGB', 'bayer_rggb8'), _raw('BA81', 'bayer_bggr8'),
    _raw('GBRG', 'bayer_gbrg8'), _raw('GRBG', 'bayer_grbg8'),
    _raw('RG16', 'bayer_rggb16'), _raw('BYR2', 'bayer_bggr16'),
    _raw('GB16', 'bayer_gbrg16'), _raw('GR16', 'bayer_grbg16'),
    _raw('GREY', 'mono8'), _raw('Y16', 'mono16'), _raw('Y12', 'mono16'), _raw('Y10', 'mono16'),
    _raw('Z16', '16UC1'),
    PixelFormat('H264', VIDEO, _read_bytes),
)}


def check_fourcc(text: str) -> None:
    """
    Check that a pixel format is supported.

    :param text: four-character code; '' is valid too.
    :raises ValueError: the code is not in ``PIXEL_FORMATS``.
    """
    if text and text not in PIXEL_FORMATS:
        raise ValueError(f'give a supported pixel format: {", ".join(PIXEL_FORMATS)}')


def pack_fourcc(text: str) -> int:
    """Return the V4L2 number of a pixel format from its text, as ``unpack_fourcc`` writes it."""
    letters = text.removesuffix(_BIG_ENDIAN_SUFFIX)
    number = int.from_bytes(letters.ljust(4).encode('latin-1'), 'little')
    return number if letters == text else number | _BIG_ENDIAN


def unpack_fourcc(number: int) -> str:
    """Return a pixel format as text without trailing blanks, with ``-BE`` if big-endian."""
    letters = (number & ~_BIG_ENDIAN).to_bytes(4, 'little').decode('latin-1').rstrip()
    return letters + _BIG_ENDIAN_SUFFIX if number & _BIG_ENDIAN else letters


def read_pixels(
    pixel_format: PixelFormat, data: Buffer, height: int, width: int, step: int,
) -> NDArray[Any]:
    """
    Convert the data of a camera buffer to an array.

    :param pixel_format: pixel format of the data.
    :param data: the bytes that the camera has written.
    :param height: height of the image in pixels.
    :param width: width of the image in pixels.
    :param step: bytes from the start of one line to the start of the next.
    :returns: array with the encoding of the format: for ``JPEG`` and ``VIDEO`` a copy of the
        bytes, (n,) uint8; a converted copy for YU12 and YV12; otherwise a view of the data, copied
        only where padding splits the chroma.
    :raises BrokenFrameError: the data are shorter than an image.
    """
    try:
        return pixel_format.read(data, height, width, step)
    except (LayoutError, ValueError) as err:
        raise BrokenFrameError(f'the camera sent an incomplete frame: {err}') from err
