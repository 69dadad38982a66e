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

"""
Images of depth as compressed_depth_image_transport of ROS stores them, without their PNG codec.

A message has a header of 12 bytes, and then a PNG of 16 bits, or width, height and RVL. The format
string is ``'16UC1; compressedDepth png'``, where ``rvl`` or nothing may be in place of ``png``.
Floats in metres (``32FC1``) are quantised to 16 bits as inverse depth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.image.errors import CodecError, SizeError
from opencv_tools.image.image_size import check_size, image_size
from opencv_tools.image.rvl import decode_rvl, encode_rvl

COMPRESSED_DEPTH = 'compressedDepth'
#: Codecs of depth; the first one is the default of compressed_depth_image_transport.
DEPTH_CODECS = ('png', 'rvl')
#: Least and largest depth in metres up to which floats may be stored.
FARTHEST = (0.1, 1e4)
#: Encodings that have a compressed form.
DEPTH_ENCODINGS = ('16UC1', 'mono16', '32FC1')

_HEAD, _SIZE = struct.Struct('<iff'), struct.Struct('<II')
_PNG = b'\x89PNG'
_MAX_STORED = 2**16 - 1


@dataclass(frozen=True)
class Quantisation:
    """
    How a float is stored as the number ``numerator / depth + offset`` of 16 bits.

    The number 0 means that there is no depth.
    """

    numerator: float
    offset: float

    @classmethod
    def up_to(cls, farthest: float = 10.0, quantum: float = 100.0) -> Quantisation:
        """
        Return the quantisation of compressed_depth_image_transport.

        :param farthest: depth in metres that is no longer stored, its parameter ``depth_max``.
        :param quantum: its parameter ``depth_quantization``; a larger one has finer steps, and
            stores less of what is near.
        """
        numerator = np.float32(quantum) * (np.float32(quantum) + np.float32(1))
        return cls(float(numerator), float(np.float32(1) - numerator / np.float32(farthest)))

    def depth_of(self, stored: NDArray[Any]) -> NDArray[np.float32]:
        """Return the depth of stored numbers in metres, with NaN for none."""
        depth = stored.astype(np.float32)
        with np.errstate(all='ignore'):
            depth -= np.float32(self.offset)
            np.divide(np.float32(self.numerator), depth, out=depth)
        depth[(stored == 0) | ~np.isfinite(depth)] = np.nan
        return depth

    def stored(self, depth: NDArray[np.float32]) -> NDArray[np.uint16]:
        """
        Return the numbers of depths in metres.

        :returns: 0 for NaN, zero, negative and too far depths; 65535 for those that are too near.
        """
        with np.errstate(all='ignore'):
            numbers = np.float32(self.numerator) / depth + np.float32(self.offset)
            farthest = np.float32(self.numerator) / np.float32(1 - self.offset)
        numbers[~((depth > 0) & (depth < farthest))] = 0
        return np.minimum(numbers, _MAX_STORED, out=numbers).astype(np.uint16)


@dataclass(frozen=True)
class DepthSettings:
    """
    How a publisher stores images of depth on ``<topic>/compressedDepth``.

    :param codec: ``'png'``, which more readers know, or ``'rvl'``, which is faster.
    :param farthest: depth in metres from which ``32FC1`` images have NaN.
    :raises ValueError: a value is invalid.
    """

    codec: str = 'png'
    farthest: float = 10.0

    def __post_init__(self) -> None:
        if self.codec not in DEPTH_CODECS:
            raise ValueError(
                f'the codec of depth is {self.codec!r}: give one of {", ".join(DEPTH_CODECS)}')
        low, high = FARTHEST
        is_number = isinstance(self.farthest, Real) and not isinstance(self.farthest, bool)
        if not is_number or not low <= self.farthest <= high:
            raise ValueError(
                f'the largest depth is {self.farthest!r}: give {low:g} to {high:g} metres')


#: The settings of compressed_depth_image_transport.
DEFAULT_DEPTH = DepthSettings()


def why_no_depth(encoding: str) -> str:
    """Return why images of an encoding are not stored as depth; '' if they are."""
    return '' if encoding in DEPTH_ENCODINGS else f'an image of {encoding} has no depth'


def quantisation_loss(image: NDArray[Any], farthest: float) -> str:
    """
    Return what an image of floats loses, except for precision; '' for nothing.

    :param farthest: as for `Quantisation.up_to`.
    """
    used = Quantisation.up_to(farthest)
    nearest = used.numerator / (_MAX_STORED - used.offset)
    is_float = image.dtype.kind == 'f'
    return ' and '.join(filter(None, (
        f'depths of {farthest:g} m and more are lost' if is_float and (
            (image >= farthest) & (image < np.inf)).any() else '',
        f'those below {nearest:.2g} m become {nearest:.2g} m' if is_float and (
            (image > 0) & (image < nearest)).any() else '')))


def is_compressed_depth(format_text: str) -> bool:
    """Return whether a message is an image of depth, given its format string."""
    return COMPRESSED_DEPTH in format_text


def depth_encoding(format_text: str) -> str:
    """Return the encoding of the images of messages, given their format string."""
    name = format_text.partition(';')[0].strip()
    return name if name in DEPTH_ENCODINGS else '16UC1'


def depth_size(content: bytes, format_text: str) -> tuple[int, int]:
    """
    Return width and height of an image of depth, without decoding it.

    :raises SizeError: the content has no size.
    :raises CodecError: the codec is unknown.
    """
    if _check_codec(content, format_text) == 'png':
        return image_size(content[_HEAD.size:])
    width, height = _SIZE.unpack_from(content, _HEAD.size)
    return width, height


def compressed_size(content: bytes, format_text: str) -> tuple[int, int]:
    """
    Return width and height of any compressed image, without decoding it.

    :raises CodecError: the content has no size.
    """
    return (depth_size(content, format_text) if is_compressed_depth(format_text) else
            image_size(content))


def read_depth(
    content: bytes, format_text: str, max_pixels: int,
    decode_png: Callable[[bytes], NDArray[Any]],
) -> tuple[NDArray[np.uint16], Quantisation | None]:
    """
    Decode an image of depth.

    :param max_pixels: largest allowed number of pixels; it is checked before decoding.
    :param decode_png: decodes a PNG, see ``opencv_tools.image_codecs.decode_image``.
    :returns: (h, w) array, and how it stores floats; None for the numbers of the image, which are
        millimetres mostly.
    :raises CodecError: the content is no image of depth, is incomplete, or has too many pixels.
    """
    width, height = depth_size(content, format_text)
    check_size(width, height, max_pixels)
    if not width * height:
        raise SizeError(f'an image of depth has {width}x{height} pixels')
    if depth_codec(format_text) == 'png':
        image = decode_png(content[_HEAD.size:])
        if image.dtype != np.uint16 or image.ndim != 2:
            raise CodecError(f'a PNG of depth has 16 bits and one channel, not {image.dtype} '
                             f'and {image.ndim} dimensions')
    else:
        image = decode_rvl(content[_HEAD.size + _SIZE.size:], width * height)
    if depth_encoding(format_text) != '32FC1':
        return image.reshape(height, width), None
    _, numerator, offset = _HEAD.unpack_from(content)
    # The least number of a depth is 1.
    if not (0 < numerator < np.inf and -np.inf < offset < 1):
        raise CodecError(f'an image of depth has the quantisation {numerator:g} and {offset:g}, '
                         'which gives no depths in metres: the camera has to send other ones')
    return image.reshape(height, width), Quantisation(numerator, offset)


def write_depth(
    image: NDArray[Any], encoding: str, codec: str, encode_png: Callable[[NDArray[Any]], bytes],
    quantisation: Quantisation | None = None,
) -> tuple[bytes, str]:
    """
    Encode an image of depth.

    :param image: (h, w) array in native byte order, of float32 for ``32FC1``, else of uint16.
    :param encoding: one of ``DEPTH_ENCODINGS``.
    :param codec: one of ``DEPTH_CODECS``.
    :param quantisation: of floats; None for that of compressed_depth_image_transport.
    :returns: content and format string of the message.
    :raises CodecError: the encoding or codec is another one, or the image is empty.
    """
    if encoding not in DEPTH_ENCODINGS or codec not in DEPTH_CODECS or not image.size:
        raise CodecError(
            f'a {image.shape[1]}x{image.shape[0]} image of {encoding} cannot be stored as depth '
            f'with {printable(codec, 20)!r}: give 16UC1, mono16 or 32FC1, and png or rvl')
    used = Quantisation(0, 0)
    if encoding == '32FC1':
        used = quantisation or Quantisation.up_to()
        image = used.stored(image)
    height, width = image.shape[:2]
    body = (encode_png(image) if codec == 'png' else
            _SIZE.pack(width, height) + encode_rvl(np.ascontiguousarray(image)))
    return (_HEAD.pack(0, used.numerator, used.offset) + body,
            f'{encoding}; {COMPRESSED_DEPTH} {codec}')


def depth_codec(format_text: str) -> str:
    """Return the codec of messages; PNG where an old format string names none."""
    return format_text.partition(COMPRESSED_DEPTH)[2].strip() or 'png'


def _check_codec(content: bytes, format_text: str) -> str:
    """Return the codec of a message that begins as one with this codec."""
    codec = depth_codec(format_text)
    if (codec == 'png' and content.startswith(_PNG, _HEAD.size)) or (
            codec == 'rvl' and len(content) > _HEAD.size + _SIZE.size):
        return codec
    reason = ('it is damaged or incomplete' if codec in DEPTH_CODECS else
              'the camera has to use png or rvl')
    raise CodecError(f'{printable(format_text, 40)!r} of {len(content)} bytes is not an image of '
                     f'depth: {reason}')
