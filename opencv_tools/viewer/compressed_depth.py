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

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.encodings import Encoding, find_encoding
from opencv_tools.image.errors import CodecError
from opencv_tools.image.image_size import check_size, image_size, MAX_PIXELS
from opencv_tools.image.text import printable
from opencv_tools.image_codecs import decode_image

# Number of the kind of compression, and two parameters of the quantisation.
_HEAD = struct.Struct('<iff')
_PNG = b'\x89PNG'


def is_compressed_depth(format_text: str) -> bool:
    """Return whether a message is an image of depth, given its format string."""
    return 'compressedDepth' in format_text


def decode_compressed_depth(content: bytes, format_text: str) -> tuple[NDArray[Any], Encoding]:
    """
    Decode an image of depth.

    A float is stored as the number ``a / depth + b`` of 16 bits, where 0 means that there is no
    depth; ``a`` and ``b`` are in the head before the PNG.

    :param content: content of the message.
    :param format_text: format string, such as ``'32FC1; compressedDepth png'``.
    :returns: (h, w) uint16 array in millimetres, or float32 array in metres with NaN.
    :raises CodecError: the content is not a PNG of 16 bits behind a head.
    """
    if len(content) < _HEAD.size or not content.startswith(_PNG, _HEAD.size):
        raise CodecError(f'{printable(format_text, 40)!r} of {len(content)} bytes is not a PNG of '
                         'depth: set the parameter compressedDepth.format of the camera to png')
    picture = content[_HEAD.size:]
    check_size(*image_size(picture), MAX_PIXELS)
    image = decode_image(picture)
    if image.dtype != np.uint16 or image.ndim != 2:
        raise CodecError(f'a PNG of depth has 16 bits and one channel, not {image.dtype} '
                         f'and {image.ndim} dimensions')
    if not format_text.startswith('32FC1'):
        return image, find_encoding('16UC1')
    _, numerator, offset = _HEAD.unpack_from(content)
    with np.errstate(all='ignore'):
        depth = (np.float32(numerator) / (image.astype(np.float32) - np.float32(offset)))
    depth[(image == 0) | ~np.isfinite(depth)] = np.nan
    return depth, find_encoding('32FC1')
