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

"""Image layout: bytes of a message seen as an array, checked before they are touched."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.encodings import Encoding


class LayoutError(ValueError):
    """The size, step and data of an image that contradict each other."""


def view_pixels(
    data: memoryview | bytes | bytearray, height: int, width: int, step: int,
    encoding: Encoding, is_bigendian: bool = False,
) -> NDArray[Any]:
    """
    View the bytes of an image message as an array, without a copy.

    :param data: a buffer of bytes, at least ``height * step`` long; the view keeps it alive.
    :param height: rows.
    :param width: pixels a row.
    :param step: bytes from one row to the next; padding behind the pixels is left out.
    :param encoding: what a pixel is made of.
    :param is_bigendian: byte order of channels wider than a byte.
    :returns: a view of shape (h, w) for one channel, (h, w, c) otherwise.
    :raises LayoutError: the step cannot hold the pixels of a row, or the data are too short.
    """
    row = width * encoding.pixel_bytes
    itemsize = np.dtype(encoding.dtype).itemsize
    described = f'{width}x{height} {encoding.name} image with step {step}'
    if step < row:
        raise LayoutError(f'{described}: a row takes {row} bytes, more than the step')
    if step % itemsize:
        raise LayoutError(f'{described}: the step is not a multiple of {itemsize} bytes')
    flat = np.frombuffer(data, np.uint8)
    if flat.size < height * step:
        raise LayoutError(f'{described} takes {height * step} bytes, but data has {flat.size}')
    dtype = np.dtype(encoding.dtype).newbyteorder('>' if is_bigendian else '<')
    rows = flat[:height * step].reshape(height, step)[:, :row]
    pixels = rows.view(dtype) if row else np.empty((height, 0), dtype)
    if encoding.channels == 1:
        return pixels
    return pixels.reshape(height, width, encoding.channels)
