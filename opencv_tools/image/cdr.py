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
Image messages in the format of the wire: CDR, to and from plain values.

What rclpy makes of a message, byte for byte but for the padding, which is zero here, with one copy
of the pixels instead of three; and back without a copy. A message is a head of four bytes, which
names the encapsulation, and the fields in their order, numbers aligned to their size::

    00 01 00 00 | sec i32 | nanosec u32 | frame_id | height u32 | width u32 | encoding |
    is_bigendian u8 | step u32 | size of data u32 | data

A string is its size as u32, with the NUL at its end counted, and its bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
import struct
from typing import Any

from opencv_tools.image.errors import ImageError

_LITTLE_ENDIAN = b'\0\1\0\0'
_HEAD_SIZE = len(_LITTLE_ENDIAN)
_STAMP = struct.Struct('<iI')
_SIZE = struct.Struct('<I')
_SIZES = struct.Struct('<II')
_ORDERS = {b'\0\0': '>', b'\0\1': '<'}


class CdrError(ImageError):
    """Bytes that are not a message, or a message that has no such bytes."""


class EncapsulationError(CdrError):
    """A message that is not in plain CDR; the middleware has to read it."""


@dataclass(frozen=True)
class WireHeader:
    """
    A std_msgs/Header as plain values.

    :param sec: seconds of the stamp.
    :param nanosec: nanoseconds of the stamp.
    :param frame_id: frame of the header.
    """

    sec: int
    nanosec: int
    frame_id: str


@dataclass(frozen=True)
class WireImage(WireHeader):
    """
    A sensor_msgs/Image as plain values, which CvBridge reads as it does the message.

    :param height: rows.
    :param width: pixels a row.
    :param encoding: of the pixels.
    :param is_bigendian: whether the most significant byte of a number comes first.
    :param step: bytes from row to row.
    :param data: a buffer of bytes.
    """

    height: int
    width: int
    encoding: str
    is_bigendian: bool
    step: int
    data: Any


@dataclass(frozen=True)
class WireCompressedImage(WireHeader):
    """
    A sensor_msgs/CompressedImage as plain values, which CvBridge reads as it does the message.

    :param format: what the data are, such as ``'jpeg'``.
    :param data: a buffer of bytes.
    """

    format: str  # noqa: A003
    data: Any


def image_to_cdr(image: WireImage) -> bytes:
    """
    Serialise an image message, copying its data once.

    :param image: the message; its data are contiguous.
    :returns: little-endian CDR.
    :raises CdrError: a number or a string that the message cannot hold.
    """
    data = memoryview(image.data).cast('B')
    head = _header(image) + _pack(_SIZES, image.height, image.width)
    head = _padded(head + _string(image.encoding) + bytes((bool(image.is_bigendian),)))
    return b''.join((head, _pack(_SIZES, image.step, data.nbytes), data))


def compressed_image_to_cdr(image: WireCompressedImage) -> bytes:
    """
    Serialise a compressed image message, copying its data once.

    :param image: the message; its data are contiguous.
    :returns: little-endian CDR.
    :raises CdrError: a number or a string that the message cannot hold.
    """
    data = memoryview(image.data).cast('B')
    head = _padded(_header(image) + _string(image.format))
    return b''.join((head, _pack(_SIZE, data.nbytes), data))


def cdr_to_image(serialized: Any) -> WireImage:
    """
    Read a serialised image message.

    :param serialized: a buffer of CDR, little-endian or big-endian.
    :returns: the message, its data a view of the buffer, which stays alive with it.
    :raises EncapsulationError: it is not in plain CDR.
    :raises CdrError: it ends too early.
    """
    reader = _Reader(serialized)
    return WireImage(
        reader.number('i'), reader.number('I'), reader.string(), reader.number('I'),
        reader.number('I'), reader.string(), bool(reader.number('B')), reader.number('I'),
        reader.rest())


def cdr_to_compressed_image(serialized: Any) -> WireCompressedImage:
    """
    Read a serialised compressed image message.

    :param serialized: a buffer of CDR, little-endian or big-endian.
    :returns: the message, its data a view of the buffer, which stays alive with it.
    :raises EncapsulationError: it is not in plain CDR.
    :raises CdrError: it ends too early.
    """
    reader = _Reader(serialized)
    return WireCompressedImage(
        reader.number('i'), reader.number('I'), reader.string(), reader.string(), reader.rest())


def encode_text(text: str) -> bytes:
    """
    Encode a string of a message.

    :returns: UTF-8 without the NUL at its end.
    :raises CdrError: it has a NUL within, or what is no character.
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
    """Serialise what every message with a header begins with."""
    stamp = _pack(_STAMP, header.sec, header.nanosec)
    return _padded(_LITTLE_ENDIAN + stamp + _string(header.frame_id))


def _pack(layout: struct.Struct, *numbers: int) -> bytes:
    try:
        return layout.pack(*numbers)
    except struct.error as err:
        raise CdrError(f'a number is out of the range of its field: {err}') from err


def _string(text: str) -> bytes:
    encoded = encode_text(text)
    return _pack(_SIZE, len(encoded) + 1) + encoded + b'\0'


def _padded(head: bytes) -> bytes:
    """Add what a number of four bytes needs to be aligned; the encapsulation has four as well."""
    return head + bytes(-len(head) % 4)


class _Reader:
    """Read the fields of a message one after another."""

    def __init__(self, serialized: Any) -> None:
        self._bytes = memoryview(serialized).cast('B')
        encapsulation = bytes(self._bytes[:2])
        if self._bytes.nbytes < _HEAD_SIZE:
            raise CdrError(f'{self._bytes.nbytes} bytes are too few for a message')
        if encapsulation not in _ORDERS:
            raise EncapsulationError(f'encapsulation {encapsulation.hex()} is not plain CDR')
        self._order = _ORDERS[encapsulation]
        self._position = _HEAD_SIZE

    def number(self, code: str) -> int:
        """Read a number with its struct format."""
        size = struct.calcsize(f'{self._order}{code}')
        self._position += -self._position % size
        field = self._take(size)
        value: int = struct.unpack(f'{self._order}{code}', field)[0]
        return value

    def string(self) -> str:
        """Read a string; what is not UTF-8 in it is replaced."""
        text = bytes(self._take(self.number('I')))
        return text.removesuffix(b'\0').decode(errors='replace')

    def rest(self) -> memoryview:
        """Read a sequence of bytes, as a view."""
        return self._take(self.number('I'))

    def _take(self, size: int) -> memoryview:
        end = self._position + size
        if end > self._bytes.nbytes:
            raise CdrError(
                f'the message ends after {self._bytes.nbytes} bytes, but its next field needs '
                f'{size} bytes from offset {self._position}')
        field = self._bytes[self._position:end]
        self._position = end
        return field
