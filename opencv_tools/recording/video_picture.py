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

"""Frames as an encoder of videos takes them: luma and chroma, of even sizes or in full."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.encodings import declared_encoding, find_encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.pictures import convert_picture

# PyAV is imported where it is used: it takes a while, and most recordings are no videos.

# The order of a frame's colours. OpenCV takes generic types for gray and BGR.
_ORDERS = {'mono8': 'y', '8UC1': 'y', '8U': 'y', 'rgb8': 'rgb', 'bgr8': 'bgr', '8UC3': 'bgr'}

# Y, Cb, Cr of R, G, B and 1: ITU-R BT.601-7, 2.5. OpenCV takes this matrix for that of any video,
# and most players for that of one that does not tell.
_LUMA = np.array([0.299, 0.587, 0.114])
_RGB = np.array([219 * _LUMA, 224 / 1.772 * ([0, 0, 1] - _LUMA), 224 / 1.402 * ([1, 0, 0] - _LUMA)
                 ]) / 255
_OFFSETS = np.array([[16], [128], [128]])
_MATRICES = {'rgb': np.hstack([_RGB, _OFFSETS]), 'bgr': np.hstack([_RGB[:, ::-1], _OFFSETS])}


class VideoError(ImageError):
    """A frame or a machine that cannot make a video; the message says why."""


@dataclass(frozen=True)
class VideoPicture:
    """A picture as the encoder takes it, an ``av.VideoFrame``."""

    frame: Any

    @property
    def form(self) -> tuple[int, int, str]:
        """Give what all pictures of a file have in common: width, height and pixel format."""
        return self.frame.width, self.frame.height, self.frame.format.name


def video_picture(
    image: NDArray[Any], encoding_name: str, suffix: str, to_color: bool = False,
) -> VideoPicture:
    """
    Prepare a frame for the encoder; any thread may do it.

    :param image: (h, w) or (h, w, c) array of any strides; it is not changed.
    :param encoding_name: its sensor_msgs/Image encoding.
    :param suffix: the format, one of ``FORMATS``.
    :param to_color: convert bayer and yuv frames of 8 bits, which else are refused.
    :returns: a fresh picture: 4:2:0 if its size is even, else 4:4:4, which keeps every pixel.
    :raises VideoError: no video can hold the frame; the caller knows what can.
    """
    import av
    encoding = find_encoding(encoding_name)
    is_converted = to_color and encoding.dtype == 'uint8' and encoding.kind in ('bayer', 'yuv')
    if encoding_name not in _ORDERS and not is_converted:
        raise VideoError(f'a {encoding_name} frame cannot be kept as {suffix}')
    declared_encoding(image, encoding_name)
    if not image.size:
        raise VideoError(f'an empty frame, {image.shape[1]}x{image.shape[0]}, '
                         f'cannot be kept as {suffix}')
    if is_converted:
        image = convert_picture(image, encoding, find_encoding('bgr8'))
    height, width = image.shape[:2]
    is_even = not (height % 2 or width % 2)
    frame = av.VideoFrame(width, height, 'yuv420p' if is_even else 'yuv444p')
    planes = _planes(image, _ORDERS.get(encoding_name, 'bgr'), is_even)
    for plane, values in zip(frame.planes, planes):
        rows = np.frombuffer(plane, np.uint8)  # type: ignore[call-overload]
        rows.reshape(-1, plane.line_size)[:, :plane.width] = values
    return VideoPicture(frame)


def _planes(image: NDArray[Any], order: str, is_even: bool) -> tuple[Any, Any, Any]:
    """
    Make the planes of Y, Cb and Cr; a number is a plane of one value.

    OpenCV does it in a third of the time of FFmpeg, whose matrix depends on PyAV's version.
    """
    if order == 'y':
        gray = image.reshape(image.shape[:2])
        return cv2.convertScaleAbs(gray, alpha=219 / 255, beta=16), 128, 128
    yuv = chroma = cv2.transform(image, _MATRICES[order])
    if is_even:
        size = image.shape[1] // 2, image.shape[0] // 2
        chroma = cv2.resize(yuv, size, interpolation=cv2.INTER_AREA)
    return cv2.extractChannel(yuv, 0), cv2.extractChannel(chroma, 1), cv2.extractChannel(chroma, 2)
