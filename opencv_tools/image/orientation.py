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

"""Orientation of images: that in EXIF, mirroring, and rotation by multiples of 90 degrees."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.encodings import Encoding, find_encoding
from opencv_tools.image.errors import ConversionError
from opencv_tools.image.jpeg import jpeg_segment

_APP1, _NAME = 0xe1, b'Exif\0\0'
_BYTE_ORDERS = {b'II*\0': '<', b'MM\0*': '>'}
_ORIENTATION, _SHORT = 0x0112, 3
_ENTRY_BYTES, _MAX_ENTRIES = 12, 1000

# Whether rows become columns, then the steps of the rows and of the columns, by orientation.
_TURNS = {1: (False, 1, 1), 2: (False, 1, -1), 3: (False, -1, -1), 4: (False, -1, 1),
          5: (True, 1, 1), 6: (True, 1, -1), 7: (True, -1, -1), 8: (True, -1, 1)}
#: Step of the rows and of the columns for each mirroring; -1 reverses the order.
FLIPS = {'none': (1, 1), 'horizontal': (1, -1), 'vertical': (-1, 1), 'both': (-1, -1)}
ROTATIONS = (0, 90, 180, 270)


def jpeg_orientation(jpeg: bytes) -> int:
    """Return the Exif orientation of a JPEG, 1 to 8; 1 if it has none."""
    data = jpeg_segment(jpeg, _APP1, _NAME)
    order = _BYTE_ORDERS.get(data[:4])
    if order is None:
        return 1
    try:
        begin = struct.unpack_from(f'{order}I', data, 4)[0]
        count = struct.unpack_from(f'{order}H', data, begin)[0]
        for place in range(min(count, _MAX_ENTRIES)):
            tag, kind, values, value = struct.unpack_from(
                f'{order}HHIH', data, begin + 2 + _ENTRY_BYTES * place)
            if tag == _ORIENTATION:
                return value if (kind, values) == (_SHORT, 1) and value in _TURNS else 1
    except struct.error:
        pass
    return 1


def matrix_orientation(matrix: bytes) -> int:
    """
    Return the Exif orientation, 1 to 8, that a video has by its display matrix.

    :param matrix: nine int32 of FFmpeg; the first and the second row are what a step to the right
        and a step down become on the screen.
    """
    (a, b, _), (c, d, _) = struct.iter_unpack('=3i', matrix[:24])
    is_turned = abs(b) + abs(c) > abs(a) + abs(d)
    right, down = (c, b) if is_turned else (a, d)
    turn = is_turned, -1 if down < 0 else 1, -1 if right < 0 else 1
    return next(orientation for orientation, other in _TURNS.items() if other == turn)


def is_sideways(orientation: int) -> bool:
    """Return whether an image with an Exif orientation is shown with rows as columns."""
    return _TURNS[orientation][0]


def reversed_axes(orientation: int) -> tuple[bool, bool]:
    """Return whether the columns and the rows of the shown image are in reverse order."""
    _, rows, columns = _TURNS[orientation]
    return columns < 0, rows < 0


def turn_upright(image: NDArray[Any], orientation: int) -> NDArray[Any]:
    """
    Return a view of an image as it is shown.

    :param image: (h, w) or (h, w, c) array.
    :param orientation: Exif orientation, 1 to 8.
    """
    is_turned, rows, columns = _TURNS[orientation]
    return (image.swapaxes(0, 1) if is_turned else image)[::rows, ::columns]


def orient(
    image: NDArray[Any], encoding: Encoding, flip: str, degrees: int,
) -> tuple[NDArray[Any], Encoding]:
    """
    Mirror an image, then rotate it.

    :param image: (h, w) or (h, w, c) array, which is not changed.
    :param flip: one of ``FLIPS``; ``'horizontal'`` swaps left and right.
    :param degrees: clockwise rotation in degrees, one of ``ROTATIONS``.
    :returns: a view of the image, (w, h) or (w, h, c) for 90 and 270 degrees, and its encoding;
        for a Bayer image the encoding with the new pattern.
    :raises ConversionError: the encoding is YUV, whose pixels share their chroma.
    """
    if flip == 'none' and not degrees:
        return image, encoding
    if encoding.kind == 'yuv':
        raise ConversionError(f'a {encoding.name} image cannot be flipped or rotated, because its '
                              'pixels share their chroma; set encoding to bgr8 or mono8')
    if encoding.kind == 'bayer':
        height, width = image.shape[:2]
        cells = np.tile(np.array(list(encoding.order)).reshape(2, 2), (2, 2))
        cells = _turn(cells[:2 + height % 2, :2 + width % 2], flip, degrees)
        order = ''.join(cells[:2, :2].flat)
        encoding = find_encoding(encoding.name.replace(encoding.order, order))
    return _turn(image, flip, degrees), encoding


def turned_axes(flip: str, degrees: int) -> NDArray[Any]:
    """
    Return the matrix by which ``orient`` transforms directions in an image.

    :param flip: one of ``FLIPS``.
    :param degrees: clockwise rotation in degrees, one of ``ROTATIONS``.
    :returns: (2, 2) orthogonal float64 matrix of -1.0, 0.0 and 1.0; maps a direction (x, y) of
        the image to the direction in the mirrored and rotated image.
    """
    rows, columns = FLIPS[flip]
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    return np.linalg.matrix_power(quarter, degrees // 90) @ np.diag([columns, rows]) + 0.0


def _turn(image: NDArray[Any], flip: str, degrees: int) -> NDArray[Any]:
    rows, columns = FLIPS[flip]
    return np.rot90(image[::rows, ::columns], -degrees // 90)
