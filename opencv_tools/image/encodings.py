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

"""Image encodings: what a pixel of each sensor_msgs/Image encoding is made of."""

from __future__ import annotations

from dataclasses import dataclass
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

_GENERIC = re.compile(r'(8U|8S|16U|16S|32S|32F|64F)(?:C([0-9]{1,3}))?')
_MAX_CHANNELS = 512  # CV_CN_MAX of OpenCV 4


class EncodingError(ValueError):
    """An encoding that is not known."""


@dataclass(frozen=True)
class Encoding:
    """
    One sensor_msgs/Image encoding.

    :param name: as it stands in the message, such as ``'bgr8'`` or ``'32FC1'``.
    :param dtype: numpy name of one channel's type, such as ``'uint8'``.
    :param channels: values a pixel takes in a row of the message.
    :param order: the channels in order, such as ``'bgr'``, or ``'y'`` for gray; ``''`` when a
        pixel's values are not colours that can be reordered (bayer, yuv, depth, generic types).
    """

    name: str
    dtype: str
    channels: int
    order: str = ''

    @property
    def pixel_bytes(self) -> int:
        """Bytes of one pixel in a row of the message."""
        return self.channels * np.dtype(self.dtype).itemsize


_BAYER = tuple(
    Encoding(f'bayer_{pattern}{bits}', f'uint{bits}', 1)
    for bits in (8, 16) for pattern in ('rggb', 'bggr', 'gbrg', 'grbg')
)

#: Every named encoding; the generic ones (``8UC3``, ``32FC1``) are read by their pattern.
ENCODINGS = {encoding.name: encoding for encoding in (
    Encoding('rgb8', 'uint8', 3, 'rgb'),
    Encoding('rgba8', 'uint8', 4, 'rgba'),
    Encoding('rgb16', 'uint16', 3, 'rgb'),
    Encoding('rgba16', 'uint16', 4, 'rgba'),
    Encoding('bgr8', 'uint8', 3, 'bgr'),
    Encoding('bgra8', 'uint8', 4, 'bgra'),
    Encoding('bgr16', 'uint16', 3, 'bgr'),
    Encoding('bgra16', 'uint16', 4, 'bgra'),
    Encoding('mono8', 'uint8', 1, 'y'),
    Encoding('mono16', 'uint16', 1, 'y'),
    *_BAYER,
    Encoding('yuv422', 'uint8', 2),
    Encoding('yuv422_yuy2', 'uint8', 2),
)}

#: The encodings whose channels are colours, which any of them can be converted to.
COLOR_ENCODINGS = tuple(name for name, encoding in ENCODINGS.items() if encoding.order)

_DEPTHS = {'8U': 'uint8', '8S': 'int8', '16U': 'uint16', '16S': 'int16', '32S': 'int32',
           '32F': 'float32', '64F': 'float64'}
_DEPTH_OF_DTYPE = {dtype: depth for depth, dtype in _DEPTHS.items()}


def find_encoding(name: str) -> Encoding:
    """
    Look an encoding up by its name.

    :param name: a named encoding, or a generic one as OpenCV writes its types (``8UC3``, ``16U``).
    :returns: the encoding.
    :raises EncodingError: the name is neither.
    """
    if name in ENCODINGS:
        return ENCODINGS[name]
    generic = _GENERIC.fullmatch(name)
    channels = int(generic[2] or 1) if generic else 0
    if not generic or not 1 <= channels <= _MAX_CHANNELS:
        raise EncodingError(f'Unrecognized image encoding [{name[:80]}]')
    return Encoding(name, _DEPTHS[generic[1]], channels)


def generic_encoding(image: NDArray[Any]) -> Encoding:
    """
    Name the type of an array as OpenCV does.

    :param image: array of shape (h, w) or (h, w, c), of any byte order.
    :returns: a generic encoding, such as ``8UC3`` for (h, w, 3) uint8.
    :raises EncodingError: OpenCV has no such type (bool, int64, float16, ...).
    """
    channels = image.shape[2] if image.ndim == 3 else 1
    depth = _DEPTH_OF_DTYPE.get(image.dtype.newbyteorder('=').name)
    if depth is None:
        raise EncodingError(
            f'An image of dtype {image.dtype} has no encoding; '
            f'convert it to one of {", ".join(_DEPTH_OF_DTYPE)}')
    return find_encoding(f'{depth}C{channels}')


_PICTURE_NAMES = {('uint8', 1): 'mono8', ('uint8', 3): 'bgr8', ('uint8', 4): 'bgra8',
                  ('uint16', 1): 'mono16', ('uint16', 3): 'bgr16', ('uint16', 4): 'bgra16'}


def picture_encoding(image: NDArray[Any]) -> Encoding:
    """
    Name what OpenCV read from a picture file, whose channels are gray, BGR or BGRA.

    :param image: array of shape (h, w) or (h, w, c).
    :returns: a colour encoding for uint8 and uint16, a generic one for other types.
    :raises EncodingError: OpenCV has no such type.
    """
    generic = generic_encoding(image)
    return find_encoding(_PICTURE_NAMES.get((generic.dtype, generic.channels), generic.name))
