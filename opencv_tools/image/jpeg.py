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

"""The header of a JPEG, read without decoding the picture."""

from __future__ import annotations

from dataclasses import dataclass
import struct
from typing import Any

from opencv_tools.image.errors import EncodingError

_BEGINS = b'\xff\xd8'
# Of the markers of a JPEG, those that begin a frame; three in their row mean something else.
_FRAME_MARKERS = frozenset(range(0xc0, 0xd0)) - {0xc4, 0xc8, 0xcc}
_STANDALONE_MARKERS = frozenset((0x01, *range(0xd0, 0xd8)))
_MAX_SEGMENTS = 1000


@dataclass(frozen=True)
class JpegHeader:
    """
    What a JPEG says of its picture.

    :param width: pixels a row.
    :param height: rows.
    :param components: 1 for gray, 3 for colours.
    """

    width: int
    height: int
    components: int


def read_jpeg_header(jpeg: Any) -> JpegHeader:
    """
    Find the header of the picture in a JPEG; no more is read.

    :param jpeg: a buffer with its bytes, or with the first of them.
    :returns: the header.
    :raises EncodingError: it has none.
    """
    position = len(_BEGINS)
    try:
        for _ in range(_MAX_SEGMENTS):
            fill, marker, length = struct.unpack_from('>BBH', jpeg, position)
            if fill != 0xff:
                break
            if marker in _FRAME_MARKERS:
                height, width, components = struct.unpack_from('>HHB', jpeg, position + 5)
                return JpegHeader(width, height, components)
            position += 2 if marker in _STANDALONE_MARKERS else 2 + length
    except struct.error as err:
        raise EncodingError('a JPEG without a size') from err
    raise EncodingError('a JPEG without a size')
