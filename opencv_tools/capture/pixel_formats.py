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

"""What the pixels of a V4L2 pixel format are, and how they become an array."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.capture.frame import BrokenFrameError, JPEG
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import LayoutError
from opencv_tools.image.layout import view_pixels

#: Makes an array of a buffer's bytes, the picture's height and width, and the bytes a line.
Reader = Callable[[bytes, int, int, int], NDArray[Any]]


@dataclass(frozen=True)
class PixelFormat:
    """
    One pixel format of a camera.

    :param fourcc: its four letters, without blanks behind them.
    :param encoding: what the arrays made of it are: a sensor_msgs/Image encoding, or ``JPEG``.
    :param read: makes such an array.
    """

    fourcc: str
    encoding: str
    read: Reader


def _read_pixels(
    encoding: str, data: bytes, height: int, width: int, step: int,
) -> NDArray[Any]:
    """View pixels that an encoding of ROS describes."""
    return view_pixels(data, height, width, step, find_encoding(encoding))


def _read_planes(
    conversion: int, data: bytes, height: int, width: int, step: int,
) -> NDArray[Any]:
    """Convert luma with two planes of chroma behind it, for which ROS has no encoding, to BGR."""
    lines = np.frombuffer(data, np.uint8, height * step * 3 // 2)
    luma = lines[:height * step].reshape(height, step)[:, :width]
    chroma = lines[height * step:].reshape(height, step // 2)[:, :width // 2]
    planes = np.concatenate([luma, chroma.reshape(height // 2, width)])
    image: NDArray[Any] = cv2.cvtColor(planes, conversion)
    return image


def _read_jpeg(data: bytes, _height: int, _width: int, _step: int) -> NDArray[Any]:
    return np.frombuffer(data, np.uint8)


def _raw(fourcc: str, encoding: str) -> PixelFormat:
    return PixelFormat(fourcc, encoding, partial(_read_pixels, encoding))


#: Every format that can be read, by its letters, in the order in which they are preferred.
PIXEL_FORMATS = {known.fourcc: known for known in (
    _raw('BGR3', 'bgr8'), _raw('RGB3', 'rgb8'), _raw('XR24', 'bgra8'), _raw('AR24', 'bgra8'),
    _raw('YUYV', 'yuv422_yuy2'), _raw('UYVY', 'yuv422'),
    _raw('NV12', 'nv12'), _raw('NV21', 'nv21'), _raw('NV24', 'nv24'),
    PixelFormat('YU12', 'bgr8', partial(_read_planes, cv2.COLOR_YUV2BGR_I420)),
    PixelFormat('YV12', 'bgr8', partial(_read_planes, cv2.COLOR_YUV2BGR_YV12)),
    PixelFormat('MJPG', JPEG, _read_jpeg), PixelFormat('JPEG', JPEG, _read_jpeg),
    _raw('RGGB', 'bayer_rggb8'), _raw('BA81', 'bayer_bggr8'),
    _raw('GBRG', 'bayer_gbrg8'), _raw('GRBG', 'bayer_grbg8'),
    _raw('RG16', 'bayer_rggb16'), _raw('BYR2', 'bayer_bggr16'),
    _raw('GB16', 'bayer_gbrg16'), _raw('GR16', 'bayer_grbg16'),
    _raw('GREY', 'mono8'), _raw('Y16', 'mono16'), _raw('Y12', 'mono16'), _raw('Y10', 'mono16'),
    _raw('Z16', '16UC1'),
)}


def check_fourcc(text: str) -> None:
    """
    Refuse letters that are no known pixel format.

    :raises ValueError: it is none of ``PIXEL_FORMATS`` and not empty.
    """
    if text and text not in PIXEL_FORMATS:
        raise ValueError(f'give a supported pixel format: {", ".join(PIXEL_FORMATS)}')


def read_pixels(
    pixel_format: PixelFormat, data: bytes, height: int, width: int, step: int,
) -> NDArray[Any]:
    """
    Make an array of a camera's buffer.

    :param pixel_format: of the camera.
    :param data: the bytes that the camera filled, copied.
    :param height: of the picture, in pixels.
    :param width: of the picture, in pixels.
    :param step: bytes from one line to the next.
    :returns: an array of the format's encoding, for the most part a view of the bytes; of ``JPEG``
        those themselves, (n,) uint8.
    :raises BrokenFrameError: the buffer holds less than a picture.
    """
    try:
        return pixel_format.read(data, height, width, step)
    except (LayoutError, ValueError) as err:
        raise BrokenFrameError(f'the camera sent an incomplete frame: {err}') from err
