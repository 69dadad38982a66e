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

"""Depth images of compressed_depth_image_transport."""

from __future__ import annotations

from dataclasses import dataclass
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.image.errors import CodecError
from opencv_tools.image.image_size import check_size, image_size
from opencv_tools.image_codecs import decode_image

#: What the format string of such an image has.
COMPRESSED_DEPTH = 'compressedDepth'

# Number of the kind of compression, and two parameters of the quantisation.
_HEAD = struct.Struct('<iff')
# A depth camera has fewer; a PNG of a single depth has 250 KB for four times as many.
_MAX_PIXELS = 2**25
_PNG = b'\x89PNG'


@dataclass(frozen=True)
class Quantisation:
    """
    How a float is stored as the number ``numerator / depth + offset`` of 16 bits.

    The number 0 means that there is no depth.
    """

    numerator: float
    offset: float

    def depth_of(self, stored: NDArray[Any]) -> NDArray[np.float32]:
        """Return the depth of stored numbers in metres, with NaN for none."""
        depth = stored.astype(np.float32)
        with np.errstate(all='ignore'):
            depth -= np.float32(self.offset)
            np.divide(np.float32(self.numerator), depth, out=depth)
        depth[(stored == 0) | ~np.isfinite(depth)] = np.nan
        return depth


def is_compressed_depth(format_text: str) -> bool:
    """Return whether a message is an image of depth, given its format string."""
    return COMPRESSED_DEPTH in format_text


def decode_compressed_depth(
    content: bytes, format_text: str,
) -> tuple[NDArray[np.uint16], Quantisation | None]:
    """
    Decode an image of depth.

    :param format_text: format string, such as ``'32FC1; compressedDepth png'``.
    :returns: (h, w) array, and how it stores floats; None for millimetres. Only the pixels that
        somebody needs become floats, because a small message may have many pixels.
    :raises CodecError: the content is not a PNG of 16 bits behind a head.
    :raises SizeError: the image has too many pixels.
    """
    if len(content) < _HEAD.size or not content.startswith(_PNG, _HEAD.size):
        raise CodecError(f'{printable(format_text, 40)!r} of {len(content)} bytes is not a PNG of '
                         'depth: set the parameter compressedDepth.format of the camera to png')
    picture = content[_HEAD.size:]
    check_size(*image_size(picture), _MAX_PIXELS)
    image = decode_image(picture)
    if image.dtype != np.uint16 or image.ndim != 2:
        raise CodecError(f'a PNG of depth has 16 bits and one channel, not {image.dtype} '
                         f'and {image.ndim} dimensions')
    _, numerator, offset = _HEAD.unpack_from(content)
    return image, Quantisation(numerator, offset) if format_text.startswith('32FC1') else None
