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

from dataclasses import dataclass, replace
from functools import lru_cache
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.errors import EncodingError
from opencv_tools.image.text import printable

_GENERIC = re.compile(r'(8U|8S|16U|16S|32S|32F|64F)(?:C([0-9]{1,3}))?')
_GENERIC_DESIRED = re.compile(r'(?:8|16|32|64)[USF]C([0-9]{0,9})')
_MAX_CHANNELS = 512  # CV_CN_MAX of OpenCV 4
_MAX_NAME = 80  # of a name that is not known, in an error


@dataclass(frozen=True)
class Encoding:
    """
    One sensor_msgs/Image encoding.

    :param name: as it stands in the message, such as ``'bgr8'`` or ``'32FC1'``.
    :param dtype: numpy name of one channel's type, such as ``'uint8'``.
    :param channels: values a pixel takes in a row of the message.
    :param kind: ``'color'`` for gray, RGB and BGR; ``'bayer'``; ``'yuv'``; ``''`` for a generic
        type, whose numbers can mean anything.
    :param order: of a color its channels, such as ``'bgra'``, or ``'y'`` for gray; of a bayer
        pattern its colours row by row, such as ``'rggb'``; of yuv the bytes of a pair of pixels,
        ``'uyvy'`` or ``'yuyv'``, or the name of the format with the chroma in rows of its own.
    :param planes: rows in the data for a row of the picture: more than 1 where rows of chroma
        follow the rows of luma.
    """

    name: str
    dtype: str
    channels: int
    kind: str = ''
    order: str = ''
    planes: float = 1

    @property
    def pixel_bytes(self) -> int:
        """Bytes of one pixel in a row of the message."""
        return self.channels * np.dtype(self.dtype).itemsize

    def rows(self, height: int) -> int:
        """Give the rows in the data of a picture of a height."""
        return int(height * self.planes)

    def height(self, rows: int) -> int:
        """Give the height of the picture that takes so many rows of data."""
        return int(rows / self.planes)

    def has_layout_of(self, other: Encoding) -> bool:
        """Return whether two encodings differ in their names at most, as yuyv and yuv422_yuy2."""
        return replace(self, name=other.name) == other

    def is_possible(self, height: int, width: int) -> bool:
        """Tell whether a size leaves no pixel without the chroma that four of them share."""
        return self.planes != 1.5 or not (height % 2 or width % 2)


_BAYER = tuple(
    Encoding(f'bayer_{pattern}{bits}', f'uint{bits}', 1, 'bayer', pattern)
    for bits in (8, 16) for pattern in ('rggb', 'bggr', 'gbrg', 'grbg')
)

#: Every named encoding; the generic ones (``8UC3``, ``32FC1``) are read by their pattern.
ENCODINGS = {encoding.name: encoding for encoding in (
    Encoding('rgb8', 'uint8', 3, 'color', 'rgb'),
    Encoding('rgba8', 'uint8', 4, 'color', 'rgba'),
    Encoding('rgb16', 'uint16', 3, 'color', 'rgb'),
    Encoding('rgba16', 'uint16', 4, 'color', 'rgba'),
    Encoding('bgr8', 'uint8', 3, 'color', 'bgr'),
    Encoding('bgra8', 'uint8', 4, 'color', 'bgra'),
    Encoding('bgr16', 'uint16', 3, 'color', 'bgr'),
    Encoding('bgra16', 'uint16', 4, 'color', 'bgra'),
    Encoding('mono8', 'uint8', 1, 'color', 'y'),
    Encoding('mono16', 'uint16', 1, 'color', 'y'),
    *_BAYER,
    Encoding('yuv422', 'uint8', 2, 'yuv', 'uyvy'),
    Encoding('uyvy', 'uint8', 2, 'yuv', 'uyvy'),
    Encoding('yuv422_yuy2', 'uint8', 2, 'yuv', 'yuyv'),
    Encoding('yuyv', 'uint8', 2, 'yuv', 'yuyv'),
    Encoding('nv12', 'uint8', 1, 'yuv', 'nv12', 1.5),
    Encoding('nv21', 'uint8', 1, 'yuv', 'nv21', 1.5),
    Encoding('nv24', 'uint8', 1, 'yuv', 'nv24', 3),
)}

#: The encodings whose channels are colours, which any of them can be converted to.
COLOR_ENCODINGS = tuple(
    name for name, encoding in ENCODINGS.items() if encoding.kind == 'color')

#: numpy's name of each depth, in the order of OpenCV's numbers for them.
DEPTHS = {'8U': 'uint8', '8S': 'int8', '16U': 'uint16', '16S': 'int16', '32S': 'int32',
          '32F': 'float32', '64F': 'float64'}
_DEPTH_OF_DTYPE = {dtype: depth for depth, dtype in DEPTHS.items()}


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
        raise EncodingError(f'Unrecognized image encoding [{printable(name, _MAX_NAME)}]')
    return Encoding(name, DEPTHS[generic[1]], channels)


def find_desired(name: str) -> Encoding:
    """
    Look up the encoding that an image is to be converted to, as cv_bridge does.

    A generic name must tell its number of channels here. One whose type there is not, such as
    ``64UC1``, is found with no type, for the channels are compared before the types.

    :param name: a named encoding, or a generic one.
    :returns: the encoding.
    :raises EncodingError: the name is neither.
    """
    if name in ENCODINGS:
        return ENCODINGS[name]
    generic = _GENERIC_DESIRED.fullmatch(name)
    if not generic:
        raise EncodingError(f'Unknown encoding {printable(name, _MAX_NAME)}')
    if _GENERIC.fullmatch(name):
        return find_encoding(name)
    return Encoding(name, '', int(generic[1] or 1))


def generic_encoding(image: NDArray[Any]) -> Encoding:
    """
    Name the type of an array as OpenCV does.

    :param image: array of shape (h, w) or (h, w, c), of any byte order.
    :returns: a generic encoding, such as ``8UC3`` for (h, w, 3) uint8.
    :raises EncodingError: OpenCV has no such type (bool, int64, float16, ...), or no such shape.
    """
    if image.ndim not in (2, 3):
        raise EncodingError(f'An image must have 2 or 3 dimensions, but its shape is '
                            f'{image.shape}')
    return _generic_encoding(image.dtype, image.shape[2] if image.ndim == 3 else 1)


@lru_cache  # it is asked for every frame
def _generic_encoding(dtype: np.dtype[Any], channels: int) -> Encoding:
    depth = _DEPTH_OF_DTYPE.get(dtype.newbyteorder('=').name)
    if depth is None:
        raise EncodingError(
            f'An image of dtype {dtype} has no encoding; '
            f'convert it to one of {", ".join(_DEPTH_OF_DTYPE)}')
    return find_encoding(f'{depth}C{channels}')


def declared_encoding(image: NDArray[Any], name: str) -> Encoding:
    """
    Look up the encoding that an array is said to have, and check that it can have it.

    :param image: array of shape (h, w) or (h, w, c), of any byte order; where chroma has rows of
        its own, they stand below those of the luma.
    :param name: name of the encoding.
    :returns: the encoding.
    :raises EncodingError: it is not known, or its pixels or rows are not those of the array.
    """
    actual, declared = generic_encoding(image), find_encoding(name)
    if (actual.dtype, actual.channels) != (declared.dtype, declared.channels):
        raise EncodingError(f'encoding specified as {name}, '
                            f'but image has incompatible type {actual.name}')
    rows, width = image.shape[:2]
    height = declared.height(rows)
    if declared.rows(height) != rows or not declared.is_possible(height, width):
        raise EncodingError(f'encoding specified as {name}, '
                            f'but image has {rows} rows of {width} pixels, which do not fit it')
    return declared


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
