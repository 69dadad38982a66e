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

"""The orientation of a JPEG by its Exif data."""

from __future__ import annotations

import struct
from typing import Any

from numpy.typing import NDArray
from opencv_tools.image.jpeg import jpeg_segment

_APP1, _NAME = 0xe1, b'Exif\0\0'
_BYTE_ORDERS = {b'II*\0': '<', b'MM\0*': '>'}
_ORIENTATION, _SHORT = 0x0112, 3
_ENTRY_BYTES, _MAX_ENTRIES = 12, 1000

# Whether rows become columns, then the steps of the rows and of the columns, by orientation.
_TURNS = {1: (False, 1, 1), 2: (False, 1, -1), 3: (False, -1, -1), 4: (False, -1, 1),
          5: (True, 1, 1), 6: (True, 1, -1), 7: (True, -1, -1), 8: (True, -1, 1)}


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
