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

"""File formats: which frames each can hold, and the bytes it makes of them."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.color import convert
from opencv_tools.image.encodings import Encoding, find_encoding, generic_encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.pictures import encode_picture, FORMATS as PICTURE_FORMATS, PictureError


class UnwritableError(ImageError):
    """A frame that a file format cannot hold; the message names one that can."""


_ANYTHING = '.npy'

#: What each format keeps without a loss (JPEG: but for its compression), as OpenCV names types.
FORMATS = {
    **{suffix: PICTURE_FORMATS[suffix]
       for suffix in ('.png', '.jpg', '.jpeg', '.tif', '.tiff', '.bmp', '.webp')},
    _ANYTHING: frozenset[str](),
}

# OpenCV's encoders take colours in this order.
_FILE_ORDER = {'rgb': 'bgr', 'rgba': 'bgra'}


def check_format(suffix: str) -> None:
    """
    Refuse a format that is not known.

    :param suffix: file name extension with its dot, in lower case.
    :raises ValueError: nothing here writes such files.
    """
    if suffix not in FORMATS:
        raise ValueError(f'the extension is one of {", ".join(FORMATS)}')


def encode_frame(image: NDArray[Any], encoding_name: str, suffix: str) -> bytes:
    """
    Make the content of a file of a frame.

    :param image: (h, w) or (h, w, c) array of any byte order; it is not changed.
    :param encoding_name: its sensor_msgs/Image encoding.
    :param suffix: the format, one of ``FORMATS``; ``.npy`` keeps the array as it is.
    :returns: the bytes of the file.
    :raises UnwritableError: the format cannot hold the frame without changing it.
    """
    encoding = find_encoding(encoding_name)
    if suffix == _ANYTHING:
        file = io.BytesIO()
        np.save(file, image)
        return file.getvalue()
    # An array of luma and chroma has the type of a gray picture, but is none.
    type_name = generic_encoding(image).name if encoding.planes == 1 else encoding_name
    if type_name not in FORMATS[suffix]:
        able = [other for other, types in FORMATS.items() if type_name in types] + [_ANYTHING]
        raise UnwritableError(f'a {encoding_name} frame cannot be kept as {suffix}; '
                              f'set the extension of file_name to {" or ".join(able)}')
    if not image.size:
        raise UnwritableError(f'an empty frame, {image.shape[1]}x{image.shape[0]}, '
                              f'cannot be kept as {suffix}')
    try:
        return encode_picture(_file_order(image, encoding), suffix).tobytes()
    except PictureError as err:
        raise UnwritableError(f'a {encoding_name} frame was not encoded: {err}') from err


def _file_order(image: NDArray[Any], encoding: Encoding) -> NDArray[Any]:
    """Put colours in the order of OpenCV's encoders, and numbers in native byte order."""
    order = _FILE_ORDER.get(encoding.order)
    if order:
        target = find_encoding(encoding.name.replace(encoding.order, order))
        return convert(image, encoding, target)
    return np.ascontiguousarray(image, np.dtype(encoding.dtype))
