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
Conversion of image messages to and from CDR, the serialisation format of ROS 2.

The bytes are those of rclpy, except that all padding is zero. Serialising copies the pixels once
instead of three times, and reading does not copy them. A message has a header of four bytes, which
identifies the encapsulation, and its fields in order, with each number aligned to its size::

    00 01 00 00 | sec i32 | nanosec u32 | frame_id | height u32 | width u32 | encoding |
    is_bigendian u8 | step u32 | size of data u32 | data

A string has its size as u32, then its bytes with a final NUL, which is included in the size.
"""

from __future__ import annotations

from dataclasses import dataclass
import struct
from typing import Any

from opencv_tools.base.text import printable
from opencv_tools.base.units import NANO
from opencv_tools.image.errors import CdrError, EncapsulationError

#: Names of the message types.
IMAGE = 'sensor_msgs/msg/Image'
COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'
DISPARITY_IMAGE = 'stereo_msgs/msg/DisparityImage'

_LITTLE_ENDIAN = b'\0\1\0\0'
_HEAD_SIZE = len(_LITTLE_ENDIAN)
_MAX_TEXT = 40  # characters of a text in a description
_ORDERS = {b'\0\0': '>', b'\0\1': '<'}


@dataclass(frozen=True)
class WireHeader:
    """
    A std_msgs/Header as plain values.

    :param sec: seconds of the stamp.
    :param nanosec: nanoseconds of the stamp.
    """

    sec: int
    nanosec: int
    frame_id: str

    @property
    def stamp_ns(self) -> int:
        """Stamp in nanoseconds."""
        return self.sec * NANO + self.nanosec


#: The header of a message that has neither a stamp nor a frame.
NO_HEADER = WireHeader(0, 0, '')


@dataclass(frozen=True, kw_only=True)
class WireImage:
    """
    A sensor_msgs/Image as plain values, which CvBridge accepts instead of the message.

    :param height: height in pixels.
    :param width: width in pixels.
    :param encoding: name of the encoding of the pixels.
    :param is_bigendian: whether numbers in the data are big-endian.
    :param step: bytes from the start of one row to the start of the next.
    :param data: buffer of bytes.
    """

    header: WireHeader
    height: int
    width: int
    encoding: str
    is_bigendian: bool
    step: int
    data: Any

    @property
    def description(self) -> str:
        """Size in pixels and encoding, in printable characters."""
        return f'{self.width}x{self.height} {printable(self.encoding, _MAX_TEXT)}'


@dataclass(frozen=True, kw_only=True)
class WireDisparity(WireImage):
    """
    The image of a stereo_msgs/DisparityImage, in pixels.

    :param min_disparity: smallest disparity; smaller numbers mean that there is none.
    """

    min_disparity: float


@dataclass(frozen=True, kw_only=True)
class WireCompressedImage:
    """
    A sensor_msgs/CompressedImage as plain values, which CvBridge accepts instead of the message.

    :param format: format string, such as ``'jpeg'``.
    :param data: buffer of bytes.
    """

    header: WireHeader
    format: str  # noqa: A003
    data: Any

    @property
    def description(self) -> str:
        """Size in bytes and format string, in printable characters."""
        return f'{len(self.data)} bytes {printable(self.format, _MAX_TEXT)}'


#: An image message of either type.
WireMessage = WireImage | WireCompressedImage


def image_to_cdr(image: WireImage) -> bytes:
    """
    Convert an image message to CDR, copying its data once.

    :param image: the message, with contiguous data.
    :returns: little-endian CDR.
    :raises CdrError: a number is out of range, or a string cannot be serialised.
    """
    return b''.join(message_to_cdr_parts(image))


def compressed_image_to_cdr(image: WireCompressedImage) -> bytes:
    """Convert a compressed image message to CDR, as ``image_to_cdr`` does."""
    return b''.join(message_to_cdr_parts(image))


def message_to_cdr_parts(message: WireMessage) -> tuple[bytes, memoryview]:
    """
    Convert an image message of either type to CDR without a copy of its data.

    :param message: the message, with contiguous data.
    :returns: little-endian CDR in two parts: the bytes before the data, and a view of the data.
    :raises CdrError: a number is out of range, or a string cannot be serialised.
    """
    data = memoryview(message.data).cast('B')
    head = _header(message.header)
    if isinstance(message, WireCompressedImage):
        return _padded(head + _string(message.format)) + _pack('I', data.nbytes), data
    head += _pack('II', message.height, message.width) + _string(message.encoding)
    head = _padded(head + bytes((bool(message.is_bigendian),)))
    return head + _pack('II', message.step, data.nbytes), data


def cdr_to_image(serialized: Any) -> WireImage:
    """
    Read an image message from CDR.

    :param serialized: buffer of CDR, little-endian or big-endian.
    :returns: the message; its data are a view, which keeps the buffer alive.
    :raises EncapsulationError: the buffer has another encapsulation than plain CDR.
    :raises CdrError: the buffer is too short.
    """
    return WireImage(**_Reader(serialized).image())


def cdr_to_disparity(serialized: Any) -> WireDisparity:
    """Read a disparity image message from CDR, as ``cdr_to_image`` does."""
    reader = _Reader(serialized)
    header = reader.header()
    image = reader.image()
    reader.numbers('ffIIII')  # focal length, base line and the part with disparities
    reader.byte()
    return WireDisparity(**image | {'header': header}, min_disparity=reader.numbers('f')[0])


def cdr_to_compressed_image(serialized: Any) -> WireCompressedImage:
    """Read a compressed image message from CDR, as ``cdr_to_image`` does."""
    reader = _Reader(serialized)
    return WireCompressedImage(
        header=reader.header(), format=reader.string(), data=reader.data())


def encode_text(text: str) -> bytes:
    """
    Convert a string of a message to UTF-8.

    :returns: UTF-8 without the final NUL.
    :raises CdrError: the string contains a NUL or a lone surrogate.
    """
    try:
        encoded = text.encode()
    except UnicodeEncodeError as err:
        raise CdrError(f'{text[:80]!r} cannot be encoded: {err.reason}') from err
    if b'\0' in encoded:
        raise CdrError(f'{text[:80]!r} has a NUL character; remove it, because a message cannot '
                       'hold one')
    return encoded


def _header(header: WireHeader) -> bytes:
    """Return the CDR header and the serialised std_msgs/Header, padded to four bytes."""
    stamp = _pack('iI', header.sec, header.nanosec)
    return _padded(_LITTLE_ENDIAN + stamp + _string(header.frame_id))


def _pack(codes: str, *numbers: int) -> bytes:
    try:
        return struct.pack(f'<{codes}', *numbers)
    except struct.error as err:
        raise CdrError(f'a number is out of the range of its field: {err}') from err


def _string(text: str) -> bytes:
    encoded = encode_text(text)
    return _pack('I', len(encoded) + 1) + encoded + b'\0'


def _padded(head: bytes) -> bytes:
    """
    Return bytes with padding for the alignment of a number of four bytes.

    CDR counts the alignment from the end of the CDR header. The header has four bytes, so the
    alignment of the whole is the same.
    """
    return head + bytes(-len(head) % 4)


class _Reader:
    """A reader of the fields of a message in order; its methods raise a CdrError at its end."""

    def __init__(self, serialized: Any) -> None:
        self._bytes = memoryview(serialized).cast('B')
        encapsulation = bytes(self._bytes[:2])
        if self._bytes.nbytes < _HEAD_SIZE:
            raise CdrError(f'{self._bytes.nbytes} bytes are too few for a message')
        if encapsulation not in _ORDERS:
            raise EncapsulationError(f'encapsulation {encapsulation.hex()} is not plain CDR')
        self._order = _ORDERS[encapsulation]
        self._position = _HEAD_SIZE

    def header(self) -> WireHeader:
        """Read a std_msgs/Header."""
        sec, nanosec = self.numbers('iI')
        return WireHeader(sec, nanosec, self.string())

    def image(self) -> dict[str, Any]:
        """Read the fields of a sensor_msgs/Image."""
        header = self.header()
        height, width = self.numbers('II')
        return {'header': header, 'height': height, 'width': width, 'encoding': self.string(),
                'is_bigendian': bool(self.byte()), 'step': self.numbers('I')[0],
                'data': self.data()}

    def numbers(self, codes: str) -> tuple[int, ...]:
        """Read numbers of four bytes by format characters of ``struct``, such as ``'iI'``."""
        self._position += -self._position % 4
        return struct.unpack(self._order + codes, self._take(4 * len(codes)))

    def byte(self) -> int:
        """Read a number of one byte."""
        return self._take(1)[0]

    def string(self) -> str:
        """Read a string, replacing bytes that are not valid UTF-8."""
        text = bytes(self.data())
        return text.removesuffix(b'\0').decode(errors='replace')

    def data(self) -> memoryview:
        """Return a view of a sequence of bytes."""
        return self._take(self.numbers('I')[0])

    def _take(self, size: int) -> memoryview:
        end = self._position + size
        if end > self._bytes.nbytes:
            raise CdrError(
                f'the message ends after {self._bytes.nbytes} bytes, but its next field needs '
                f'{size} bytes from offset {self._position}')
        field = self._bytes[self._position:end]
        self._position = end
        return field
