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

"""The content of compressed frames, as far as it tells itself without being decoded."""

from __future__ import annotations

from dataclasses import dataclass
import struct
from typing import Any

from opencv_tools.image.errors import EncodingError
from opencv_tools.image.jpeg import read_jpeg_header
from opencv_tools.pictures import is_cut_off, JPEG_BEGINS, PictureError

_PNG_BEGINS, _PNG_ENDS = b'\x89PNG\r\n\x1a\n', b'\0\0\0\0IEND\xaeB`\x82'


@dataclass(frozen=True)
class Payload:
    """
    What a picture says of itself.

    :param suffixes: extensions of such files; empty for a format that is not looked into.
    :param width: pixels a row.
    :param height: rows.
    """

    suffixes: tuple[str, ...]
    width: int = 0
    height: int = 0


def read_payload(data: Any) -> Payload:
    """
    Look into the content of a picture file.

    :param data: a buffer with its bytes.
    :returns: the format and the size, where it is PNG or JPEG.
    :raises PictureError: it is one of these, but not a whole one.
    """
    content = bytes(data)
    try:
        if content.startswith(_PNG_BEGINS) and content.endswith(_PNG_ENDS):
            return Payload(('.png',), *struct.unpack_from('>II', content, 16))
        if content.startswith(JPEG_BEGINS) and not is_cut_off(content):
            header = read_jpeg_header(content)
            return Payload(('.jpg', '.jpeg'), header.width, header.height)
    except (struct.error, EncodingError) as err:
        raise PictureError(f'{len(content)} bytes of a picture without a size') from err
    if content.startswith((_PNG_BEGINS, JPEG_BEGINS)):
        raise PictureError(f'{len(content)} bytes of a picture whose end is missing')
    return Payload(())
