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

"""Bits, NAL units and OBUs of compressed video."""

from __future__ import annotations

from collections.abc import Iterator

from opencv_tools.image.errors import VideoError

#: Start code of a NAL unit in an Annex B byte stream.
START_CODE = b'\0\0\0\1'

_PREFIX = b'\0\0\1'
_MAX_UNITS = 10_000  # largest number of NAL units or OBUs in a packet
_MAX_HEADER = 4096  # bytes of a header that are read
_MAX_ZEROS = 31  # of an exp-Golomb code
_MAX_LEB128 = 8  # bytes


class BitReader:
    """Numbers in the first 4096 bytes of a header, from the highest bit of each byte."""

    def __init__(self, data: bytes) -> None:
        """
        Begin at the first bit.

        :param data: header without emulation prevention bytes.
        """
        self._data = data[:_MAX_HEADER]
        self._position = 0

    def bits(self, count: int) -> int:
        """
        Read an unsigned number with a fixed number of bits.

        :raises VideoError: the header ends too early.
        """
        begin, end = self._position, self._position + count
        if end > 8 * len(self._data):
            raise VideoError('a header of a video packet ends too early: the packet is damaged')
        self._position = end
        last = -(-end // 8)
        value = int.from_bytes(self._data[begin // 8:last], 'big') >> 8 * last - end
        return value & (1 << count) - 1

    def flag(self) -> bool:
        """Read one bit."""
        return bool(self.bits(1))

    def unsigned(self) -> int:
        """Read an unsigned exp-Golomb code: ue(v) of H.264, uvlc() of AV1."""
        zeros = 0
        while not self.flag():
            zeros += 1
            if zeros > _MAX_ZEROS:
                raise VideoError('a video packet has a number of more than 32 bits: it is damaged')
        return (1 << zeros) - 1 + self.bits(zeros)

    def signed(self) -> int:
        """Read a signed exp-Golomb code: se(v) of H.264."""
        code = self.unsigned()
        return (code + 1) // 2 if code % 2 else -(code // 2)


def unescaped(unit: bytes) -> bytes:
    """Return the first bytes of a NAL unit without emulation prevention bytes."""
    return unit[:_MAX_HEADER].replace(b'\0\0\3', b'\0\0')


def nal_units(data: bytes) -> Iterator[bytes]:
    """
    Yield the NAL units of an Annex B byte stream, without start codes and trailing zeros.

    :raises VideoError: there are more than 10000 NAL units.
    """
    begin = data.find(_PREFIX)
    for _ in range(_MAX_UNITS):
        if begin < 0:
            return
        begin += len(_PREFIX)
        end = data.find(_PREFIX, begin)
        unit = (data[begin:end] if end >= 0 else data[begin:]).rstrip(b'\0')
        if unit:
            yield unit
        begin = end
    raise VideoError(f'a video packet has more than {_MAX_UNITS} NAL units: it is damaged')


def obus(data: bytes) -> Iterator[tuple[int, bytes]]:
    """
    Yield the type and the payload of each OBU of AV1, in the low-overhead format.

    :raises VideoError: an OBU is damaged, or there are more than 10000 OBUs.
    """
    position = 0
    for _ in range(_MAX_UNITS):
        if position >= len(data):
            return
        header = data[position]
        position += 2 if header & 4 else 1  # with or without an extension
        size = len(data) - position
        if header & 2:
            size, position = _leb128(data, position)
        if header & 0x80 or size < 0 or position + size > len(data):
            raise VideoError('a video packet has an OBU that is longer than the packet')
        yield header >> 3 & 15, data[position:position + size]
        position += size
    raise VideoError(f'a video packet has more than {_MAX_UNITS} OBUs: it is damaged')


def obu(kind: int, payload: bytes) -> bytes:
    """Return an OBU with a size field, as ``obus`` reads it."""
    size, field = len(payload), bytearray()
    while size > 0x7f:
        field.append(size & 0x7f | 0x80)
        size >>= 7
    return bytes((kind << 3 | 2, *field, size)) + payload


def _leb128(data: bytes, position: int) -> tuple[int, int]:
    """Return a number and the offset after it."""
    value = 0
    for index, byte in enumerate(data[position:position + _MAX_LEB128]):
        value |= (byte & 0x7f) << 7 * index
        if byte < 0x80:
            return value, position + index + 1
    raise VideoError('a video packet has an OBU without a size: it is damaged')
