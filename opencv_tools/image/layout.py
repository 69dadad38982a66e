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

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.encodings import Encoding
from opencv_tools.image.errors import LayoutError


def view_pixels(
    data: Any, height: int, width: int, step: int,
    encoding: Encoding, is_bigendian: bool = False,
) -> NDArray[Any]:
    """
    View the bytes of an image message as an array, without a copy.

    :param data: a buffer of bytes, long enough for all rows, which the view keeps alive; a list
        of numbers is copied.
    :param height: rows of the picture.
    :param width: pixels a row.
    :param step: bytes from one row to the next; padding behind the pixels is left out.
    :param encoding: what a pixel is made of.
    :param is_bigendian: byte order of channels wider than a byte.
    :returns: a view of shape (h, w) for one channel, (h, w, c) otherwise; where chroma has rows
        of its own, of shape (encoding.rows(h), w), and of padded ``nv24`` a copy.
    :raises LayoutError: the step cannot hold the pixels of a row or a whole number of them, the
        data are too short, or the size leaves half a pair of pixels without its chroma.
    """
    def error(reason: str) -> LayoutError:
        return LayoutError(f'{width}x{height} {encoding.name} image with step {step}{reason}')

    pixel = encoding.pixel_bytes
    row = width * pixel
    if step < row:
        raise error(f': a row needs {row} bytes, more than the step')
    if step % pixel:
        raise error(f': the step is not a whole number of pixels of {pixel} bytes')
    if not encoding.is_possible(height, width):
        raise error(': width and height must be even, because the chroma is subsampled 2x2')
    rows = encoding.rows(height)
    content = _view_bytes(data)
    if content.size < rows * step:
        raise error(f' needs {rows * step} bytes, but data has {content.size}')
    dtype = np.dtype(encoding.dtype).newbyteorder('>' if is_bigendian else '<')
    shape = (rows, width) if encoding.channels == 1 else (rows, width, encoding.channels)
    if step == row or not row:
        tight: NDArray[Any] = content[:rows * row].view(dtype).reshape(shape)
        return tight
    lines: NDArray[Any] = content[:rows * step].reshape(rows, step)
    if encoding.planes == 3:
        # The lines of chroma are twice as long, and only behind both halves is there padding.
        chroma = lines[height:].reshape(height, 2 * step)[:, :2 * row].reshape(2 * height, row)
        lines = np.concatenate([lines[:height, :row], chroma])
    pixels: NDArray[Any] = lines[:, :row].view(dtype).reshape(shape)
    return pixels


def _view_bytes(data: Any) -> NDArray[np.uint8]:
    """View anything that holds bytes as an array of them."""
    try:
        return np.frombuffer(data if not isinstance(data, list) else bytes(data), np.uint8)
    except (BufferError, TypeError, ValueError) as err:
        raise LayoutError(f'data must be bytes, but its type is {type(data).__name__}: '
                          f'{err}') from err


def pack_pixels(image: NDArray[Any]) -> memoryview:
    """
    Give the bytes of an array as a message has them, row by row.

    :param image: array of any shape, strides and byte order.
    :returns: the bytes, a view where the array is contiguous, which stays alive with it.
    """
    return np.ascontiguousarray(image).reshape(-1).view(np.uint8).data


def is_bigendian(dtype: np.dtype[Any]) -> bool:
    """Tell whether numbers of a type have their most significant byte first."""
    return dtype.byteorder == '>' or (dtype.byteorder == '=' and sys.byteorder == 'big')
