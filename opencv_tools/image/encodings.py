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

"""The sensor_msgs/Image encodings: type, channels and meaning of the pixels of each one."""

from __future__ import annotations

from dataclasses import dataclass, KW_ONLY, replace
from functools import cached_property, lru_cache
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.image.errors import EncodingError

_GENERIC = re.compile(r'(8U|8S|16U|16S|32S|32F|64F)(?:C([0-9]{1,3}))?')
_GENERIC_DESIRED = re.compile(r'(?:8|16|32|64)[USF]C([0-9]{0,9})')
_MAX_CHANNELS = 512  # CV_CN_MAX of OpenCV 4
_MAX_NAME = 80  # characters of an unknown name in an error message


@dataclass(frozen=True)
class Encoding:
    """
    One sensor_msgs/Image encoding.

    :param name: name in the message, such as ``'bgr8'`` or ``'32FC1'``.
    :param dtype: numpy name of the type of a channel, such as ``'uint8'``.
    :param channels: values of a pixel in a row of the message.
    :param kind: ``'color'`` for gray, RGB and BGR; ``'bayer'``; ``'yuv'``; ``'generic'`` for a
        type whose numbers have no defined meaning.
    :param order: order of the values. Colour: the channels, such as ``'bgra'``, and ``'y'`` for
        gray. Bayer: the colours of two rows, such as ``'rggb'``. Packed YUV: the bytes of two
        pixels, ``'uyvy'`` or ``'yuyv'``. YUV with separate chroma rows: the name, as ``'nv12'``.
    :param row_factor: rows of data for a row of the image; above 1 if chroma rows follow the luma
        rows.
    """

    name: str
    dtype: str
    channels: int
    _: KW_ONLY
    kind: str = 'generic'
    order: str = ''
    row_factor: float = 1

    @property
    def is_generic(self) -> bool:
        """Whether this is a generic type, such as ``8UC3``."""
        return self.kind == 'generic'

    @property
    def type_name(self) -> str:
        """Return the type of a pixel in OpenCV, such as ``8UC3``."""
        return f'{_DEPTH_OF_DTYPE[self.dtype]}C{self.channels}'

    @cached_property
    def pixel_bytes(self) -> int:
        """Bytes of a pixel in a row of the message."""
        return self.channels * np.dtype(self.dtype).itemsize

    def rows(self, height: int) -> int:
        """Return the rows of data of an image with some height."""
        return int(height * self.row_factor)

    def height(self, rows: int) -> int:
        """Return the height of an image with some rows of data."""
        return int(rows / self.row_factor)

    def size(self, height: int, width: int) -> int:
        """Return the bytes of an image without padding."""
        return self.rows(height) * width * self.pixel_bytes

    def has_layout_of(self, other: Encoding) -> bool:
        """Return whether two encodings are equal except for their names: yuyv and yuv422_yuy2."""
        return replace(self, name=other.name) == other

    def is_valid_size(self, height: int, width: int) -> bool:
        """Return whether the size is valid for the chroma subsampling of this encoding."""
        return self.row_factor != 1.5 or not (height % 2 or width % 2)


#: All named encodings; ``find_encoding`` also reads generic names (``8UC3``, ``32FC1``).
ENCODINGS = {encoding.name: encoding for encoding in (
    Encoding('rgb8', 'uint8', 3, kind='color', order='rgb'),
    Encoding('rgba8', 'uint8', 4, kind='color', order='rgba'),
    Encoding('rgb16', 'uint16', 3, kind='color', order='rgb'),
    Encoding('rgba16', 'uint16', 4, kind='color', order='rgba'),
    Encoding('bgr8', 'uint8', 3, kind='color', order='bgr'),
    Encoding('bgra8', 'uint8', 4, kind='color', order='bgra'),
    Encoding('bgr16', 'uint16', 3, kind='color', order='bgr'),
    Encoding('bgra16', 'uint16', 4, kind='color', order='bgra'),
    Encoding('mono8', 'uint8', 1, kind='color', order='y'),
    Encoding('mono16', 'uint16', 1, kind='color', order='y'),
    *(Encoding(f'bayer_{pattern}{bits}', f'uint{bits}', 1, kind='bayer', order=pattern)
      for bits in (8, 16) for pattern in ('rggb', 'bggr', 'gbrg', 'grbg')),
    Encoding('yuv422', 'uint8', 2, kind='yuv', order='uyvy'),
    Encoding('uyvy', 'uint8', 2, kind='yuv', order='uyvy'),
    Encoding('yuv422_yuy2', 'uint8', 2, kind='yuv', order='yuyv'),
    Encoding('yuyv', 'uint8', 2, kind='yuv', order='yuyv'),
    Encoding('nv12', 'uint8', 1, kind='yuv', order='nv12', row_factor=1.5),
    Encoding('nv21', 'uint8', 1, kind='yuv', order='nv21', row_factor=1.5),
    Encoding('nv24', 'uint8', 1, kind='yuv', order='nv24', row_factor=3),
)}

#: Names of the encodings with colour channels. All named encodings can be converted to them.
COLOR_ENCODINGS = tuple(
    name for name, encoding in ENCODINGS.items() if encoding.kind == 'color')

#: numpy name of each OpenCV depth, in the order of OpenCV's numbers of depths.
DEPTHS = {'8U': 'uint8', '8S': 'int8', '16U': 'uint16', '16S': 'int16', '32S': 'int32',
          '32F': 'float32', '64F': 'float64'}
_DEPTH_OF_DTYPE = {dtype: depth for depth, dtype in DEPTHS.items()}


def find_encoding(name: str) -> Encoding:
    """
    Return the encoding with a name.

    :param name: a key of ``ENCODINGS``, or a generic name in the form of OpenCV's types (``8UC3``,
        ``16U``).
    :returns: the encoding.
    :raises EncodingError: the name is unknown.
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
    Return the target encoding of a conversion, as cv_bridge does.

    A generic name must contain its number of channels here. A generic name with a type that does
    not exist, such as ``64UC1``, is accepted, and its encoding has an empty dtype. cv_bridge
    compares the channels before the types, so the error texts of ``convert`` need the channels.

    :param name: a key of ``ENCODINGS``, or a generic name such as ``8UC3``.
    :returns: the encoding.
    :raises EncodingError: the name is unknown.
    """
    if name in ENCODINGS:
        return ENCODINGS[name]
    generic = _GENERIC_DESIRED.fullmatch(name)
    if not generic:
        raise EncodingError(f'Unknown encoding {printable(name, _MAX_NAME)}')
    if _GENERIC.fullmatch(name):
        return find_encoding(name)
    return Encoding(name, '', int(generic[1] or 1))


def encodings_between(source: Encoding, desired: str) -> tuple[Encoding, Encoding]:
    """
    Return the source and the target of a conversion to an encoding given by name.

    :param desired: name of the encoding of the result; ``''`` or the name of ``source`` for a
        copy.
    :returns: encodings before and after the conversion.
    :raises EncodingError: the name is unknown, or the name of ``source`` has no number of
        channels (``8U``).
    """
    if desired in ('', source.name):
        return source, source
    return find_desired(source.name), find_desired(desired)


def generic_encoding(image: NDArray[Any]) -> Encoding:
    """
    Return the generic encoding of an array.

    :param image: (h, w) or (h, w, c) array of any byte order.
    :returns: a generic encoding, such as ``8UC3`` for (h, w, 3) uint8.
    :raises EncodingError: OpenCV does not support the type (bool, int64, float16, ...) or the
        shape.
    """
    if image.ndim not in (2, 3):
        raise EncodingError(f'An image must have 2 or 3 dimensions, but its shape is '
                            f'{image.shape}')
    return _generic_encoding(image.dtype, image.shape[2] if image.ndim == 3 else 1)


@lru_cache  # called for each frame
def _generic_encoding(dtype: np.dtype[Any], channels: int) -> Encoding:
    depth = _DEPTH_OF_DTYPE.get(dtype.newbyteorder('=').name)
    if depth is None:
        raise EncodingError(
            f'An image of dtype {dtype} has no encoding; '
            f'convert it to one of {", ".join(_DEPTH_OF_DTYPE)}')
    return find_encoding(f'{depth}C{channels}')


def declared_encoding(image: NDArray[Any], name: str) -> Encoding:
    """
    Return the encoding with a name, and check that an array can have this encoding.

    :param image: (h, w) or (h, w, c) array of any byte order; separate chroma rows follow the
        luma rows.
    :returns: the encoding.
    :raises EncodingError: the name is unknown, or the type or shape of the array does not fit.
    """
    actual, declared = generic_encoding(image), find_encoding(name)
    if (actual.dtype, actual.channels) != (declared.dtype, declared.channels):
        raise EncodingError(f'encoding specified as {name}, '
                            f'but image has incompatible type {actual.name}')
    rows, width = image.shape[:2]
    height = declared.height(rows)
    if declared.rows(height) != rows or not declared.is_valid_size(height, width):
        raise EncodingError(f'encoding specified as {name}, '
                            f'but image has {rows} rows of {width} pixels, which do not fit it')
    return declared


_OPENCV_NAMES = {('uint8', 1): 'mono8', ('uint8', 3): 'bgr8', ('uint8', 4): 'bgra8',
                 ('uint16', 1): 'mono16', ('uint16', 3): 'bgr16', ('uint16', 4): 'bgra16'}


def opencv_encoding(image: NDArray[Any]) -> Encoding:
    """
    Return the encoding of an array with gray, BGR or BGRA channels, as OpenCV decodes it.

    :param image: (h, w) or (h, w, c) array.
    :returns: a colour encoding for uint8 and uint16; a generic encoding for other types and
        numbers of channels.
    :raises EncodingError: OpenCV does not support the type or the shape.
    """
    generic = generic_encoding(image)
    return find_encoding(_OPENCV_NAMES.get((generic.dtype, generic.channels), generic.name))
