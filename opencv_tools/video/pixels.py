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

"""Conversion of images to the planes of an encoder, and of decoded frames to BGR."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.image.encodings import declared_encoding, find_encoding
from opencv_tools.image.errors import VideoError
from opencv_tools.image_codecs import convert_image
from opencv_tools.opencv import cv2

# Conversions of OpenCV, all with BT.601 in limited range.
_TO_I420 = {'bgr8': 'COLOR_BGR2YUV_I420', 'rgb8': 'COLOR_RGB2YUV_I420',
            'bgra8': 'COLOR_BGRA2YUV_I420', 'rgba8': 'COLOR_RGBA2YUV_I420'}
_NAMES = {'8UC1': 'mono8', '8UC3': 'bgr8', '8UC4': 'bgra8'}
_CONVERTED = ('yuv', 'bayer')  # kinds of encodings that are converted to bgr8 first

# Weights of red and blue by AVColorSpace; the others are BT.601.
_WEIGHTS = {1: (0.2126, 0.0722), 4: (0.3, 0.11), 7: (0.212, 0.087), 9: (0.2627, 0.0593),
            10: (0.2627, 0.0593)}
_LIMITED_RANGE, _FULL_RANGE = 1, 2  # AVCOL_RANGE_MPEG and AVCOL_RANGE_JPEG
_PLANAR = frozenset(('yuv420p', 'yuv422p', 'yuv444p', 'yuv440p', 'gray'))


def to_i420(image: NDArray[Any], encoding_name: str) -> NDArray[Any]:
    """
    Convert an image to BT.601 in limited range, with half of the colour resolution.

    :param image: (h, w) or (h, w, c) array of any strides; not modified.
    :param encoding_name: 8-bit encoding of the image.
    :returns: (3 h / 2, w) uint8 array: the planes Y, U and V. An odd height or width is made
        even by a copy of the last row or column.
    :raises EncodingError: the encoding is unknown, or does not fit the array.
    :raises VideoError: the encoding has no video.
    """
    encoding = find_encoding(encoding_name)
    name = _NAMES.get(encoding_name, encoding_name)
    if encoding.dtype != 'uint8' or not (
            name in _TO_I420 or name == 'mono8' or encoding.kind in _CONVERTED):
        raise VideoError(f"'{printable(encoding_name, 80)}' has no video: convert it to mono8, "
                         'or to a colour encoding with 8 bits, such as bgr8')
    declared_encoding(image, encoding_name)
    if not image.size:
        raise VideoError(f'an empty image ({image.shape[1]}x{image.shape[0]}) has no video')
    if encoding.channels == 1:
        image = image.reshape(image.shape[:2])
    if encoding.kind in _CONVERTED:
        image, name = convert_image(image, encoding, find_encoding('bgr8')), 'bgr8'
    image = np.ascontiguousarray(image)
    bottom, right = image.shape[0] % 2, image.shape[1] % 2
    if bottom or right:
        image = cv2.copyMakeBorder(image, 0, bottom, 0, right, cv2.BORDER_REPLICATE)
    if name in _TO_I420:
        return cv2.cvtColor(image, getattr(cv2, _TO_I420[name]))
    height, width = image.shape[:2]
    planes = np.full((height + height // 2, width), 128, np.uint8)
    cv2.convertScaleAbs(image, dst=planes[:height], alpha=219 / 255, beta=16)
    return planes


def to_bgr(frame: Any) -> NDArray[Any]:
    """
    Convert a decoded frame with the matrix and the range that its stream declares.

    A stream without a matrix has BT.601, and without a range the limited one, as for other nodes
    of ROS. Gray without a range has the full one, as in FFmpeg and JPEG. Fractions of 10 and 12
    bits are rounded.

    :param frame: an ``av.VideoFrame``.
    :returns: new (h, w, 3) uint8 array.
    """
    if frame.format.is_rgb:
        return frame.to_ndarray(format='bgr24')
    space, height, width = int(frame.colorspace), frame.height, frame.width
    name = frame.format.name
    is_full = frame.color_range == _FULL_RANGE or name.startswith('yuvj') or (
        name == 'gray' and frame.color_range != _LIMITED_RANGE)
    name = name.replace('yuvj', 'yuv')
    is_even = not (height % 2 or width % 2)
    if name == 'yuv420p' and space not in _WEIGHTS and not is_full and is_even:
        return cv2.cvtColor(frame.to_ndarray(), cv2.COLOR_YUV2BGR_I420)
    if name not in _PLANAR:
        frame = frame.reformat(format='yuv444p')
    luma, *chroma = (_plane(plane) for plane in frame.planes)
    planes = [luma, *(cv2.resize(plane, (width, height)) for plane in chroma)]
    if not chroma:
        planes += [np.full_like(luma, 128)] * 2
    return cv2.transform(cv2.merge(planes), _matrix(space, is_full))


def _plane(plane: Any) -> NDArray[Any]:
    """Return a view of a plane without the padding of its rows."""
    rows = np.frombuffer(plane, np.uint8)
    return rows[:plane.height * plane.line_size].reshape(plane.height, -1)[:, :plane.width]


@lru_cache
def _matrix(space: int, is_full: bool) -> NDArray[np.float64]:
    """Return the (3, 4) matrix from Y, Cb, Cr and 1 to B, G and R (ITU-R BT.601 and BT.709)."""
    red, blue = _WEIGHTS.get(space, (0.299, 0.114))
    green = 1 - red - blue
    offset, y_scale, c_scale = (0, 1.0, 1.0) if is_full else (16, 255 / 219, 255 / 224)
    matrix = np.array([
        [1, 2 * (1 - blue), 0],
        [1, -2 * (1 - blue) * blue / green, -2 * (1 - red) * red / green],
        [1, 0, 2 * (1 - red)]]) * (y_scale, c_scale, c_scale)
    return np.hstack((matrix, -matrix @ [[offset], [128], [128]]))
