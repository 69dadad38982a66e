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

"""Videos of depth without loss: FFV1 with one channel of 16 bits."""

from __future__ import annotations

from collections.abc import Mapping
import zlib

from opencv_tools.base.text import printable

#: Encodings that such a video holds, with the unit of their numbers by REP 118; '' for none.
LOSSLESS_ENCODINGS = {'16UC1': 'mm', 'mono16': ''}
#: Pixel format of FFmpeg for all of them.
LOSSLESS_PIXELS = 'gray16le'

_ENCODING, _UNIT = 'encoding', 'depth_unit'
# At the end of a slice: its size, its state and its checksum.
_SIZE_BYTES, _END_BYTES = 3, 8
_REVERSED = bytes(int(f'{byte:08b}'[::-1], 2) for byte in range(256))
# The polynomial is that of zlib, with the bits of each byte in the other order and without
# inversion. FFmpeg begins with 0, or with 0x79408c7a for slicecrc=2, and ends with the same.
_BEGINS = (0xffffffff, 0xa1cefd61)


def lossless_tags(encoding: str) -> dict[str, str]:
    """Return the metadata of the stream of an encoding."""
    unit = LOSSLESS_ENCODINGS[encoding]
    return {_ENCODING: encoding, **({_UNIT: unit} if unit else {})}


def tagged_encoding(tags: Mapping[str, str]) -> str:
    """Return the encoding in the metadata of a stream; '' if there is no valid one."""
    found = {name.lower(): value for name, value in tags.items()}.get(_ENCODING, '')
    return found if found in LOSSLESS_ENCODINGS else ''


def describe_tags(tags: Mapping[str, str]) -> str:
    """Return which metadata of a stream are not those of its frames; '' if all are."""
    found = {name.lower(): value for name, value in tags.items()}
    encoding, unit = (found.get(name, '') for name in (_ENCODING, _UNIT))
    used = tagged_encoding(tags) or 'mono16'
    wrong = [f'the {_ENCODING} {printable(encoding)}'] * (encoding not in (used, ''))
    wrong += [f'the {_UNIT} {printable(unit)}'] * (unit not in (LOSSLESS_ENCODINGS[used], ''))
    return f'{" and ".join(wrong)}, but is read as {used}' if wrong else ''


def has_valid_sums(packet: bytes) -> bool:
    """
    Return whether each slice of an FFV1 packet has a correct checksum (RFC 9043, 4.9.3).

    FFmpeg replaces damaged slices by older ones without an error.
    """
    slices = [one.translate(_REVERSED) for one in _slices(packet, _END_BYTES)]
    return bool(slices) and any(
        all(zlib.crc32(one, begin) == begin for one in slices) for begin in _BEGINS)


def has_no_sums(packet: bytes) -> bool:
    """Return whether the slices of an FFV1 packet end with their sizes, without checksums."""
    return bool(_slices(packet, _SIZE_BYTES))


def _slices(packet: bytes, end_bytes: int) -> list[bytes]:
    """Return the slices of a packet, the last one first; [] if their sizes are not its size."""
    slices, end = [], len(packet)
    while end >= end_bytes:
        size_at = end - end_bytes
        begin = size_at - int.from_bytes(packet[size_at:size_at + _SIZE_BYTES], 'big')
        if begin < 0:
            return []
        slices.append(packet[begin:end])
        end = begin
    return [] if end else slices
