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

"""Format and size of compressed frames, read from their headers without decoding."""

from __future__ import annotations

from dataclasses import dataclass
import struct
from typing import Any
import zlib

from opencv_tools.image.errors import CodecError
from opencv_tools.image.image_size import PNG_SIGNATURE
from opencv_tools.image.jpeg import jpeg_size, JPEG_SOI
from opencv_tools.image_codecs import check_complete

_PNG_ENDS = b'\0\0\0\0IEND\xaeB`\x82'
_CHUNK_BYTES = 12  # length, type and checksum of a chunk


@dataclass(frozen=True)
class ImageHeader:
    """
    Format and size of a compressed image.

    :param suffixes: file name extensions of the format; empty for an unknown format.
    :param width: width in pixels.
    :param height: height in pixels.
    """

    suffixes: tuple[str, ...]
    width: int = 0
    height: int = 0


def read_image_header(data: Any) -> ImageHeader:
    """
    Read the header of a compressed image and check that the image is complete.

    A PNG is checked by its checksums. A JPEG is checked by its markers, without decoding.

    :param data: buffer with the compressed image.
    :returns: format and size of a PNG or JPEG.
    :raises CodecError: the PNG or JPEG is damaged or incomplete.
    """
    content = bytes(data)
    if content.startswith(PNG_SIGNATURE):
        return ImageHeader(('.png',), *_check_png(content))
    if content.startswith(JPEG_SOI):
        check_complete(content)
        return ImageHeader(('.jpg', '.jpeg'), *jpeg_size(content))
    return ImageHeader(())


def _check_png(png: bytes) -> tuple[int, int]:
    """Check the chunks of a PNG and return its width and height."""
    if not png.endswith(_PNG_ENDS):
        raise CodecError(f'{len(png)} bytes of a PNG picture whose end is missing')
    view = memoryview(png)
    position, kinds = len(PNG_SIGNATURE), set()
    try:
        while position < len(png):
            length, kind = struct.unpack_from('>I4s', png, position)
            ends = position + _CHUNK_BYTES + length
            if struct.unpack_from('>I', png, ends - 4)[0] != zlib.crc32(
                    view[position + 4:ends - 4]):
                raise CodecError(f'{len(png)} bytes of a PNG picture that is damaged')
            kinds.add(kind)
            position = ends
        if not {b'IHDR', b'IDAT', b'IEND'} <= kinds or png[12:16] != b'IHDR':
            raise struct.error('chunks are missing')
        width, height = struct.unpack_from('>II', png, 16)
    except struct.error as err:
        raise CodecError(f'{len(png)} bytes of a PNG picture that is damaged') from err
    return width, height
