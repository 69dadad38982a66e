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

"""The format string of a sensor_msgs/CompressedImage."""

from __future__ import annotations

from dataclasses import dataclass
import re
from typing import Any

from numpy.typing import NDArray
from opencv_tools.image.encodings import (
    Encoding, find_encoding, generic_encoding, opencv_encoding,
)
from opencv_tools.image.errors import EncodingError
from opencv_tools.image.jpeg import JPEG_SOI

# The form of compressed_image_transport: 'rgb8; jpeg compressed bgr8', '16UC1; png compressed '.
_TRANSPORT = re.compile(r'([^;]*);\s*(\w+)\s+compressed\s*(\w*).*', re.DOTALL)
_LOSSY_WEBP, _WEBP_CHUNK = b'WEBPVP8 ', 8  # name of the first chunk, and its place


@dataclass(frozen=True)
class CompressedFormat:
    """
    The format of a compressed image.

    :param codec: name of the codec, such as ``'jpeg'`` or ``'png'``.
    :param original: encoding of the image before the compression; ``''`` if not given.
    :param stored: encoding of the compressed image; ``''`` if not given.
    """

    codec: str
    original: str = ''
    stored: str = ''


def parse_format(text: str) -> CompressedFormat:
    """
    Read the format string of a compressed image.

    :param text: name of a codec, such as ``'jpeg'``, or the form of compressed_image_transport,
        such as ``'rgb8; jpeg compressed bgr8'``.
    :returns: the parts of the format string.
    """
    parts = _TRANSPORT.fullmatch(text)
    if not parts:
        return CompressedFormat(text.strip())
    return CompressedFormat(parts[2], parts[1].strip(), parts[3])


def decoded_encoding(image: NDArray[Any], format_text: str) -> Encoding:
    """
    Return the encoding of a decoded image.

    :param image: (h, w) or (h, w, c) array, as OpenCV decodes it.
    :returns: the encoding in the format string if it fits the array; otherwise gray, BGR or BGRA.
    :raises EncodingError: OpenCV has no type like that of the array.
    """
    parsed = parse_format(format_text)
    actual = generic_encoding(image)
    for name in (parsed.stored, parsed.original):
        try:
            found = find_encoding(name)
        except EncodingError:
            continue
        if (found.dtype, found.channels, found.row_factor) == (actual.dtype, actual.channels, 1):
            return found
    return opencv_encoding(image)


def lossy_codec(content: bytes) -> str:
    """Return the name of the codec of a file, if it changes values; '' for another file."""
    if content.startswith(JPEG_SOI):
        return 'JPEG'
    return 'WebP' if content.startswith(_LOSSY_WEBP, _WEBP_CHUNK) else ''
