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

"""Conversion of frames for the video encoder: YCbCr planes in 4:2:0 or 4:4:4."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.encodings import declared_encoding, find_encoding
from opencv_tools.image_codecs import convert_image
from opencv_tools.recording.errors import VideoError
from opencv_tools.recording.recorder import Prepared

# PyAV is imported in functions, because the import is slow and most recordings are image files.

# Order of the colour channels by encoding. OpenCV treats generic types as gray and BGR.
_ORDERS = {'mono8': 'y', '8UC1': 'y', '8U': 'y', 'rgb8': 'rgb', 'bgr8': 'bgr', '8UC3': 'bgr'}

# Matrix from R, G, B and 1 to Y, Cb, Cr: ITU-R BT.601-7, 2.5. OpenCV assumes this matrix for every
# video, and most players for a video that does not name its matrix.
_LUMA = np.array([0.299, 0.587, 0.114])
_RGB = np.array([219 * _LUMA, 224 / 1.772 * ([0, 0, 1] - _LUMA), 224 / 1.402 * ([1, 0, 0] - _LUMA)
                 ]) / 255
_OFFSETS = np.array([[16], [128], [128]])
_MATRICES = {'rgb': np.hstack([_RGB, _OFFSETS]), 'bgr': np.hstack([_RGB[:, ::-1], _OFFSETS])}


@dataclass(frozen=True)
class VideoFrame(Prepared):
    """A frame for the encoder, as an ``av.VideoFrame``."""

    frame: Any

    @property
    def stream_format(self) -> tuple[int, int, str]:
        """Properties that all frames of a file share: width, height and pixel format."""
        return self.frame.width, self.frame.height, self.frame.format.name

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.frame.width, self.frame.height


def to_video_frame(
    image: NDArray[Any], encoding_name: str, suffix: str, to_color: bool = False,
) -> VideoFrame:
    """
    Convert an image for the encoder; thread-safe.

    :param image: (h, w) or (h, w, c) array of any strides; not modified.
    :param encoding_name: sensor_msgs/Image encoding of the image.
    :param suffix: extension of the video, one of ``VIDEO_FORMATS``, for error messages.
    :param to_color: whether 8-bit Bayer and YUV images are converted; otherwise they are refused.
    :returns: a copy in 4:2:0 if both sizes are even, else in 4:4:4, which keeps every pixel.
    :raises VideoError: no video can hold the image.
    """
    import av
    encoding = find_encoding(encoding_name)
    is_converted = to_color and encoding.dtype == 'uint8' and encoding.kind in ('bayer', 'yuv')
    if encoding_name not in _ORDERS and not is_converted:
        raise VideoError(f'a {encoding_name} frame cannot be stored as {suffix}')
    declared_encoding(image, encoding_name)
    if not image.size:
        raise VideoError(f'an empty frame ({image.shape[1]}x{image.shape[0]}) cannot be stored '
                         f'as {suffix}')
    if is_converted:
        image = convert_image(image, encoding, find_encoding('bgr8'))
    height, width = image.shape[:2]
    is_even = not (height % 2 or width % 2)
    frame = av.VideoFrame(width, height, 'yuv420p' if is_even else 'yuv444p')
    planes = _planes(image, _ORDERS.get(encoding_name, 'bgr'), is_even)
    for plane, values in zip(frame.planes, planes):
        rows = np.frombuffer(plane, np.uint8)  # type: ignore[call-overload]
        rows.reshape(-1, plane.line_size)[:, :plane.width] = values
    return VideoFrame(frame)


def _planes(image: NDArray[Any], order: str, is_even: bool) -> tuple[Any, Any, Any]:
    """
    Return the planes Y, Cb and Cr; a number stands for a constant plane.

    OpenCV needs a third of the time of FFmpeg, whose matrix depends on the version of PyAV.
    """
    if order == 'y':
        gray = image.reshape(image.shape[:2])
        return cv2.convertScaleAbs(gray, alpha=219 / 255, beta=16), 128, 128
    yuv = chroma = cv2.transform(image, _MATRICES[order])
    if is_even:
        size = image.shape[1] // 2, image.shape[0] // 2
        chroma = cv2.resize(yuv, size, interpolation=cv2.INTER_AREA)
    return cv2.extractChannel(yuv, 0), cv2.extractChannel(chroma, 1), cv2.extractChannel(chroma, 2)
