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
import itertools
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.color import convert
from opencv_tools.image.encodings import Encoding, find_encoding, generic_encoding


class UnwritableError(ValueError):
    """A frame that a file format cannot hold; the message names one that can."""


def _types(depths: str, channels: str) -> frozenset[str]:
    return frozenset(f'{depth}C{count}' for depth, count in
                     itertools.product(depths.split(), channels.split()))


_ANYTHING = '.npy'

#: What each format keeps without a loss (JPEG: but for its compression), as OpenCV names types.
FORMATS = {
    '.png': _types('8U 16U', '1 3 4'),
    '.jpg': _types('8U', '1 3'),
    '.jpeg': _types('8U', '1 3'),
    '.tif': _types('8U 16U', '1 3 4') | _types('32F 64F', '1 3'),
    '.tiff': _types('8U 16U', '1 3 4') | _types('32F 64F', '1 3'),
    '.bmp': _types('8U', '1 3'),
    '.webp': _types('8U', '3 4'),
    _ANYTHING: frozenset[str](),
}

# Left alone, OpenCV 4 packs 32FC3 TIFF as LogLuv, which loses; 5 is lossless LZW.
_TIFF_OPTIONS = (cv2.IMWRITE_TIFF_COMPRESSION, 5)
_ENCODER_OPTIONS = {'.tif': _TIFF_OPTIONS, '.tiff': _TIFF_OPTIONS}

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
    type_name = generic_encoding(image).name
    if type_name not in FORMATS[suffix]:
        able = [other for other, types in FORMATS.items() if type_name in types] + [_ANYTHING]
        raise UnwritableError(f'a {encoding_name} frame cannot be kept as {suffix}; '
                              f'set the extension of file_name to {" or ".join(able)}')
    if not image.size:
        raise UnwritableError(f'an empty frame, {image.shape[1]}x{image.shape[0]}, '
                              f'cannot be kept as {suffix}')
    picture = _file_order(image, encoding)
    try:
        encoded, content = cv2.imencode(suffix, picture, _ENCODER_OPTIONS.get(suffix, ()))
    except cv2.error as err:
        raise UnwritableError(f'a {image.shape[1]}x{image.shape[0]} {encoding_name} frame '
                              f'cannot be kept as {suffix}: {err.err}') from err
    if not encoded:
        raise UnwritableError(f'OpenCV made no {suffix} of a {image.shape[1]}x{image.shape[0]} '
                              f'{encoding_name} frame')
    data: bytes = content.tobytes()
    return data


def _file_order(image: NDArray[Any], encoding: Encoding) -> NDArray[Any]:
    """Put colours in the order of OpenCV's encoders, and numbers in native byte order."""
    order = _FILE_ORDER.get(encoding.order)
    if order:
        target = find_encoding(encoding.name.replace(encoding.order, order))
        return convert(image, encoding, target)
    return np.ascontiguousarray(image, np.dtype(encoding.dtype))
