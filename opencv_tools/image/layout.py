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

"""Conversion between the bytes of an image message and arrays, with checked sizes."""

from __future__ import annotations

from functools import lru_cache
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.cdr import NO_HEADER, WireHeader, WireImage
from opencv_tools.image.encodings import Encoding
from opencv_tools.image.errors import LayoutError


def view_pixels(
    data: Any, height: int, width: int, step: int,
    encoding: Encoding, is_bigendian: bool = False,
) -> NDArray[Any]:
    """
    Return the pixels of an image message as an array, without a copy if possible.

    :param data: buffer of bytes, which the view keeps alive; a list of numbers is copied.
    :param height: height in pixels.
    :param width: width in pixels.
    :param step: bytes from the start of one row to the start of the next, any number that holds a
        row; the padding at the end of a row is skipped.
    :param encoding: encoding of the pixels.
    :param is_bigendian: whether numbers of several bytes are big-endian.
    :returns: a view: (h, w) for one channel, (h, w, c) otherwise, and (encoding.rows(h), w) for
        encodings with separate chroma rows. A copy for ``nv24`` with padding, and if the step is
        not a whole number of channel values.
    :raises LayoutError: the step is smaller than a row; the data are too short; or the size is odd
        although the chroma is subsampled 2x2.
    """
    size, dtype, shape = _layout(height, width, step, encoding, is_bigendian)
    content = _view_bytes(data)
    if content.size < size:
        raise LayoutError(f'{width}x{height} {encoding.name} image with step {step} needs {size} '
                          f'bytes, but data has {content.size}')
    row = width * encoding.pixel_bytes
    if step == row:
        return np.ndarray(shape, dtype, content)
    lines = content[:size].reshape(shape[0], step)
    if encoding.row_factor == 3:
        # A chroma line of nv24 has twice the length, and all its padding is at its end.
        chroma = lines[height:].reshape(height, 2 * step)[:, :2 * row].reshape(2 * height, row)
        lines = np.concatenate([lines[:height, :row], chroma])
    lines = lines[:, :row]
    if step % dtype.itemsize:
        lines = lines.copy()  # OpenCV before 5 refuses an array whose rows are not aligned
    return lines.view(dtype).reshape(shape)


@lru_cache(64, typed=True)  # the same for most images of a topic
def _layout(
    height: int, width: int, step: int, encoding: Encoding, is_bigendian: bool,
) -> tuple[int, np.dtype[Any], tuple[int, ...]]:
    """
    Return the bytes of an image, the type of its numbers, and the shape of its array.

    :raises LayoutError: see `view_pixels`.
    """
    error = f'{width}x{height} {encoding.name} image with step {step}: '
    row = width * encoding.pixel_bytes
    if step < row:
        raise LayoutError(f'{error}a row needs {row} bytes, more than the step')
    if not encoding.is_valid_size(height, width):
        raise LayoutError(
            f'{error}width and height must be even, because the chroma is subsampled 2x2')
    rows = encoding.rows(height)
    dtype = np.dtype(encoding.dtype).newbyteorder('>' if is_bigendian else '<')
    shape = (rows, width) if encoding.channels == 1 else (rows, width, encoding.channels)
    return rows * step, dtype, shape


def view_image(data: Any, height: int, width: int, encoding: Encoding) -> NDArray[Any]:
    """
    Return memory as an image in native byte order without padding, see `view_pixels`.

    :param data: buffer of at least ``encoding.size(height, width)`` bytes.
    """
    return view_pixels(data, height, width, width * encoding.pixel_bytes, encoding,
                       sys.byteorder == 'big')


def _view_bytes(data: Any) -> NDArray[np.uint8]:
    """Return a buffer as a uint8 array without a copy; a list is copied."""
    try:
        return np.frombuffer(data if not isinstance(data, list) else bytes(data), np.uint8)
    except (BufferError, TypeError, ValueError) as err:
        raise LayoutError(f'data must be bytes, but its type is {type(data).__name__}: '
                          f'{err}') from err


def array_to_wire(
    image: NDArray[Any], encoding: Encoding, header: WireHeader = NO_HEADER,
    data: NDArray[np.uint8] | None = None,
) -> WireImage:
    """
    Convert an array to the fields of an image message, without a copy.

    :param image: (h, w) or (h, w, c) array of any strides and byte order; copied only if it is
        not contiguous. Separate chroma rows (``nv12``) follow the luma rows.
    :param encoding: encoding of the array, as ``declared_encoding`` returns it.
    :param data: (n,) array of the memory of a contiguous image, if there is one.
    :returns: the message, without padding at the end of rows; its data are a view of the array.
    """
    rows, width = image.shape[:2]
    order = image.dtype.byteorder
    return WireImage(
        header=header, height=encoding.height(rows), width=width, encoding=encoding.name,
        is_bigendian=order == '>' or (order == '=' and sys.byteorder == 'big'),
        step=width * encoding.pixel_bytes,
        data=np.ascontiguousarray(image).reshape(-1).view(np.uint8).data if data is None else data)
