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

"""Headers of compressed frames."""

from __future__ import annotations

import struct
import zlib

from opencv_tools.image.errors import CodecError
from opencv_tools.recording.image_header import ImageHeader, read_image_header
import pytest

BEGINS, ENDS = b'\xff\xd8', b'\xff\xd9'
COMMENT = b'\xff\xfe\x00\x04ab'
SIZE = b'\x00\x0b\x08\x00\x05\x01\x07\x01\x01\x11\x00'  # 263x5
SCAN = b'\xff\xda\x00\x08\x01\x01\x00\x00\x3f\x00' + bytes(40)


def jpeg(*segments: bytes) -> bytes:
    return b''.join((BEGINS, *segments, SCAN, ENDS))


def png(*chunks: tuple[bytes, bytes]) -> bytes:
    return b'\x89PNG\r\n\x1a\n' + b''.join(
        struct.pack('>I', len(content)) + kind + content
        + struct.pack('>I', zlib.crc32(kind + content))
        for kind, content in (*chunks, (b'IEND', b'')))


IHDR = b'IHDR', b'\0\0\1\7\0\0\0\5\x08\0\0\0\0'


@pytest.mark.parametrize('marker', [*range(0xc0, 0xd0)])
def test_size_in_every_kind_of_jpeg_frame_header(marker: int) -> None:
    data = jpeg(COMMENT, bytes([0xff, marker]) + SIZE)
    if marker in (0xc4, 0xc8, 0xcc):
        with pytest.raises(CodecError, match=f'^{len(data)} bytes of a picture without a size'):
            read_image_header(data)
    else:
        assert read_image_header(data) == ImageHeader(('.jpg', '.jpeg'), 263, 5)


@pytest.mark.parametrize('marker', [0x01, *range(0xd0, 0xd8)])
def test_markers_without_a_length_are_skipped(marker: int) -> None:
    data = jpeg(bytes([0xff, marker]), COMMENT, b'\xff\xc0' + SIZE)
    assert read_image_header(memoryview(data)) == ImageHeader(('.jpg', '.jpeg'), 263, 5)


@pytest.mark.parametrize('data', [
    jpeg(b'\x00\xc0' + SIZE), jpeg(COMMENT, b'\xfe\xc0' + SIZE), jpeg(b'\xff\xe0\x00\xff'),
    jpeg(BEGINS, b'\xff\xc0' + SIZE),
    jpeg(b'\xff\xc0\x00\x0b'), jpeg(), jpeg(*[COMMENT] * 1000, b'\xff\xc0' + SIZE)],
    ids=['zero', 'fill', 'long', 'again', 'short', 'nothing', 'many'])
def test_jpeg_without_a_size_is_refused(data: bytes) -> None:
    with pytest.raises(CodecError, match=f'^{len(data)} bytes of a picture without a size$'):
        read_image_header(data)


def test_size_is_found_after_many_segments() -> None:
    data = jpeg(*[COMMENT] * 999, b'\xff\xc0' + SIZE)
    assert read_image_header(data) == ImageHeader(('.jpg', '.jpeg'), 263, 5)


@pytest.mark.parametrize('data', [
    b'\x89PNG\r\n\x1a\n' + bytes(100), BEGINS + b'\xff\xc0' + SIZE, BEGINS])
def test_jpeg_without_an_end_is_refused(data: bytes) -> None:
    with pytest.raises(CodecError, match=f'^{len(data)} bytes of .* whose end is missing$'):
        read_image_header(data)


@pytest.mark.parametrize('data', [b'', b'text', b'\xff', b'II*\0' + bytes(100)])
def test_other_formats_have_no_header(data: bytes) -> None:
    assert read_image_header(data) == ImageHeader((), 0, 0)


def test_size_of_a_png() -> None:
    assert read_image_header(png(IHDR, (b'IDAT', b'x'))) == ImageHeader(('.png',), 263, 5)


@pytest.mark.parametrize('data', [
    png(), png(IHDR), png((b'IDAT', b'x')), png((b'IDAT', b'x'), IHDR),
    png(IHDR, (b'IDAT', b'x')).replace(b'IDATx', b'IDATy'),
    png(IHDR)[:-12] + b'rubbish' + png()[-12:],
    png(IHDR)[:-12] + b'\xff\xff\xff\xffIDAT' + png()[-12:]],
    ids=['nothing', 'no pixels', 'no header', 'header later', 'sum', 'rubbish', 'long'])
def test_damaged_png_is_refused(data: bytes) -> None:
    with pytest.raises(CodecError, match=f'^{len(data)} bytes of a PNG picture .* damaged$'):
        read_image_header(data)
