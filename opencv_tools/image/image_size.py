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

"""The size of an image file, read from its header without decoding."""

from __future__ import annotations

from collections.abc import Callable
import re
import struct

from opencv_tools.image.errors import SizeError
from opencv_tools.image.jpeg import jpeg_size, JPEG_SOI

PNG_SIGNATURE = b'\x89PNG\r\n\x1a\n'
#: Default limit of the number of pixels of an image to decode.
MAX_PIXELS = 2**27

#: Pixels of the largest picture of H.264, H.265 and AV1 at their level 6.2: 8192x4352.
MAX_VIDEO_PIXELS = 8192 * 4352

_HEADER_BYTES = 65536  # largest header that is searched in formats with a text header
_MAX_SIZES = 100  # largest number of sizes in a file of nested boxes
_BLANK = rb'(?:\s|#[^\r\n]*[\r\n])+'
_PNM = re.compile(rb'P[1-6Ff]' + _BLANK + rb'([0-9]{1,9})' + _BLANK + rb'([0-9]{1,9})\s')
_PAM = re.compile(rb'(WIDTH|HEIGHT)\s+([0-9]{1,9})\s')
_RADIANCE = re.compile(rb'[-+][XY]\s+([0-9]{1,9})\s+[-+][XY]\s+([0-9]{1,9})\s')
_JPEG_2000 = re.compile(rb'\xff\x4f\xff\x51')
_AVIF = re.compile(rb'ispe')
_EXR = re.compile(rb'(?:dataWindow|displayWindow)\0box2i\0')
_TIFF_NUMBERS = {1: 'B', 3: 'H', 4: 'I', 16: 'Q'}
# Tags of the image size and of the tile size. Tiles can be larger than the image.
_TIFF_WIDTHS, _TIFF_HEIGHTS = (256, 322), (257, 323)

# Function that reads the width and height from the content of a file.
_Reader = Callable[[bytes], tuple[int, int]]


def image_size(content: bytes) -> tuple[int, int]:
    """
    Read the size of an image file.

    :param content: content of a file in a format that OpenCV can read.
    :returns: width and height in pixels; the largest ones, if the file contains several sizes.
    :raises SizeError: the format is unknown, or the header contains no size.
    """
    for begins, read in _READERS:
        if begins.match(content):
            try:
                width, height = read(content)
            except (struct.error, ValueError) as err:
                raise SizeError(f'{len(content)} bytes of a picture without a size') from err
            if width > 0 and height > 0:
                return width, height
            raise SizeError(f'{len(content)} bytes of a picture without a size')
    raise SizeError(f'{len(content)} bytes are not a picture that OpenCV can read')


def check_size(width: int, height: int, max_pixels: int) -> None:
    """
    Check the size of an image.

    :param width: width in pixels.
    :param height: height in pixels.
    :param max_pixels: largest allowed number of pixels.
    :raises SizeError: the image has more pixels.
    """
    if width * height > max_pixels:
        raise SizeError(f'{width}x{height} pixels are more than max_pixels={max_pixels}')


def _fixed_reader(layout: str, offset: int) -> _Reader:
    """Create a reader for formats that have the width and height at a fixed offset."""
    def read(content: bytes) -> tuple[int, int]:
        width, height = struct.unpack_from(layout, content, offset)
        return width, height

    return read


def _bmp(content: bytes) -> tuple[int, int]:
    width, height = struct.unpack_from(
        '<HH' if content[14:18] == b'\x0c\0\0\0' else '<ii', content, 18)
    return abs(width), abs(height)


def _webp(content: bytes) -> tuple[int, int]:
    kind = content[12:16]
    if kind == b'VP8X':
        sides = [int.from_bytes(content[offset:offset + 3], 'little') + 1 for offset in (24, 27)]
        return sides[0], sides[1]
    if kind == b'VP8L':
        bits = struct.unpack_from('<I', content, 21)[0]
        return (bits & 0x3fff) + 1, (bits >> 14 & 0x3fff) + 1
    width, height = struct.unpack_from('<HH', content, 26)
    return width & 0x3fff, height & 0x3fff


def _tiff(content: bytes) -> tuple[int, int]:
    order = '<' if content[:2] == b'II' else '>'
    is_big = struct.unpack_from(f'{order}H', content, 2)[0] == 43
    offset, counts, step, values = (8, 'Q', 20, 12) if is_big else (4, 'H', 12, 8)
    directory = struct.unpack_from(f'{order}{"Q" if is_big else "I"}', content, offset)[0]
    count = struct.unpack_from(f'{order}{counts}', content, directory)[0]
    if count > 4096:
        raise ValueError('too many fields')
    sides: dict[int, int] = {}
    for index in range(count):
        entry = directory + struct.calcsize(f'={counts}') + index * step
        tag, kind = struct.unpack_from(f'{order}HH', content, entry)
        if tag in _TIFF_WIDTHS + _TIFF_HEIGHTS:
            side = struct.unpack_from(
                f'{order}{_TIFF_NUMBERS.get(kind, "I")}', content, entry + values)[0]
            sides[tag] = max(sides.get(tag, 0), side)
    return (max(sides.get(tag, 0) for tag in _TIFF_WIDTHS),
            max(sides.get(tag, 0) for tag in _TIFF_HEIGHTS))


def _pnm(content: bytes) -> tuple[int, int]:
    found = _PNM.match(content[:_HEADER_BYTES])
    if not found:
        raise ValueError('no size')
    return int(found[1]), int(found[2])


def _pam(content: bytes) -> tuple[int, int]:
    sides = _PAM.findall(content[:_HEADER_BYTES].partition(b'ENDHDR')[0])
    width, height = (max((int(side) for name, side in sides if name == field), default=0)
                     for field in (b'WIDTH', b'HEIGHT'))
    return width, height


def _radiance(content: bytes) -> tuple[int, int]:
    sides = _RADIANCE.findall(content[:_HEADER_BYTES])
    return max(int(width) for _, width in sides), max(int(height) for height, _ in sides)


def _box_reader(mark: re.Pattern[bytes], layout: str, skip: int) -> _Reader:
    """
    Create a reader for formats of nested boxes, in which the size can be at any offset.

    :param mark: pattern before each size.
    :param layout: ``struct`` format: width and height, or left, top, right and bottom.
    :param skip: bytes between the mark and the size.
    :returns: function that returns the largest width and height.
    """
    def read(content: bytes) -> tuple[int, int]:
        width = height = 0
        for index, found in enumerate(mark.finditer(content)):
            if index >= _MAX_SIZES:
                raise ValueError('too many sizes')
            offset = found.end() + skip
            if offset + struct.calcsize(layout) <= len(content):  # otherwise it is pixel data
                *begins, right, bottom = struct.unpack_from(layout, content, offset)
                left, top, more = (*begins, 1) if begins else (0, 0, 0)
                width, height = max(width, right - left + more), max(height, bottom - top + more)
        return width, height

    return read


_READERS: tuple[tuple[re.Pattern[bytes], _Reader], ...] = (
    (re.compile(re.escape(JPEG_SOI)), jpeg_size),
    (re.compile(re.escape(PNG_SIGNATURE)), _fixed_reader('>II', 16)),
    (re.compile(rb'RIFF....WEBP', re.DOTALL), _webp),
    (re.compile(rb'BM'), _bmp),
    (re.compile(rb'II[*+]\0|MM\0[*+]'), _tiff),
    (re.compile(rb'P[1-6Ff]\s'), _pnm),
    (re.compile(rb'P7\s'), _pam),
    (re.compile(rb'\x59\xa6\x6a\x95'), _fixed_reader('>II', 4)),
    (re.compile(rb'GIF8[79]a'), _fixed_reader('<HH', 6)),
    (re.compile(rb'#\?(RADIANCE|RGBE)'), _radiance),
    (re.compile(rb'\0\0\0\x0cjP  \r\n\x87\n|\xff\x4f\xff\x51'),
     _box_reader(_JPEG_2000, '>II', 4)),
    (re.compile(rb'....ftyp(avif|avis|mif1)', re.DOTALL), _box_reader(_AVIF, '>II', 4)),
    (re.compile(rb'\x76\x2f\x31\x01'), _box_reader(_EXR, '<iiii', 4)),
)
