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

"""Conversion of YUV encodings to gray, RGB and BGR, as OpenCV does."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.blocks import row_blocks, write_columns
from opencv_tools.image.encodings import Encoding
from opencv_tools.image.errors import ConversionError

# ITU-R BT.601 with video range, times 2**20 as in OpenCV's cvtColor.
_SHIFT = np.int32(20)
_LUMA = 1220542
_BLACK, _WHITE = 16, 255  # values below black are clipped to black
_CHROMA = {'r': (0, 1673527), 'g': (-409993, -852492), 'b': (2116026, 0)}  # factors of U and V
_NEUTRAL = 128
_HALF = 1 << 19

# A block of rows: U and V, then the luma and the output rows of each row group that shares them.
# The luma is one array, or one of the even and one of the odd columns.
_Part = tuple[Sequence[NDArray[Any]], Sequence[tuple[Sequence[NDArray[Any]], NDArray[Any]]]]


def yuv_to_color(image: NDArray[Any], encoding: Encoding, target: str) -> NDArray[Any]:
    """
    Convert luma and chroma to colours, or luma to gray.

    ``R = (y + 1673527 v + h) >> 20``, ``G = (y - 852492 v - 409993 u + h) >> 20`` and
    ``B = (y + 2116026 u + h) >> 20`` with ``y = 1220542 max(0, Y - 16)``, ``u = U - 128``,
    ``v = V - 128`` and ``h = 2**19``, clipped to a byte. The chroma is not interpolated.

    :param image: contiguous uint8 array: (h, w, 2) for packed luma and chroma; otherwise (rows, w)
        with the luma rows followed by the chroma rows.
    :param encoding: encoding of the image, one of the YUV encodings.
    :param target: channels in order: ``'y'``, ``'rgb'``, ``'bgr'``, ``'rgba'`` or ``'bgra'``.
    :returns: a new contiguous uint8 array: (h, w) for ``'y'``, (h, w, c) otherwise.
    :raises ConversionError: the target has colours, but the width of a packed image is odd.
    """
    height, width = encoding.height(len(image)), image.shape[1]
    packed = encoding.order in ('uyvy', 'yuyv')
    if target == 'y':
        return _luma(image, encoding, height)
    if packed and width % 2:
        raise ConversionError(
            f'a [{encoding.name}] image must have an even width for a conversion to colours, '
            f'but a row has {width} pixels; convert it to mono8')
    colors = np.empty((height, width, len(target)), np.uint8)
    if target.endswith('a'):
        colors[..., 3] = 255
    split = _split_packed if packed else _split_planar
    for chroma, rows in split(image, colors, encoding.order):
        terms = _chroma_terms(chroma, target)
        for lumas, target_rows in rows:
            write_columns([_add_luma(luma, terms) for luma in lumas], target_rows)
    return colors


def _luma(image: NDArray[Any], encoding: Encoding, height: int) -> NDArray[Any]:
    """Return a copy of the luma, (h, w)."""
    if image.ndim == 2:
        return image[:height].copy()
    pixels = image.view('<u2')[..., 0]
    gray = np.empty(pixels.shape, np.uint8)
    for rows in row_blocks(*pixels.shape):
        even, odd = _split_words(pixels[rows])
        gray[rows] = even if encoding.order == 'yuyv' else odd
    return gray


def _split_words(numbers: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the lower and the upper half of the bits of numbers, in the same type."""
    bits = numbers.dtype.type(numbers.itemsize * 4)
    low = numbers & numbers.dtype.type((1 << int(bits)) - 1)
    return low, numbers >> bits


def _split_packed(
    image: NDArray[Any], colors: NDArray[Any], order: str,
) -> Iterator[_Part]:
    """Yield blocks of rows of a packed 4:2:2 image, in which two columns share their chroma."""
    pixels = image.view('<u2')[..., 0]
    for rows in row_blocks(len(pixels), pixels.shape[1] // 2):
        even, odd = _split_words(pixels[rows])
        luma, chroma = (even, odd) if order == 'yuyv' else (odd, even)
        np.clip(luma, _BLACK, _WHITE, out=luma)
        yield _split_words(chroma.view('<i4')), [(_split_words(luma.view('<i4')), colors[rows])]


def _split_planar(
    image: NDArray[Any], colors: NDArray[Any], order: str,
) -> Iterator[_Part]:
    """Yield blocks of rows of an image with separate chroma rows."""
    height = len(colors)
    step = 1 if order == 'nv24' else 2  # rows, and columns, that share their chroma
    chroma_rows = image[height:].reshape(height // step, -1).view('<u2')
    for rows in row_blocks(*chroma_rows.shape):
        chroma = [half.astype(np.int32) for half in _split_words(chroma_rows[rows])]
        picture = slice(rows.start * step, rows.stop * step)
        luma = np.clip(image[picture], _BLACK, _WHITE)
        columns = (luma,) if step == 1 else _split_words(luma.view('<u2'))
        yield chroma[::-1] if order == 'nv21' else chroma, [
            ([column[row::step].astype(np.int32) for column in columns],
             colors[picture][row::step])
            for row in range(step)]


def _chroma_terms(chroma: Sequence[NDArray[Any]], order: str) -> list[NDArray[Any]]:
    """
    Return the terms of the colour formula that do not depend on the luma.

    :param chroma: U and V, int32 arrays.
    :param order: channels in order.
    :returns: an int32 array for each channel except alpha, with all constants included.
    """
    terms = []
    for channel in order[:3]:
        weights = _CHROMA[channel]
        first, *others = (part * np.int32(weight) for part, weight in zip(chroma, weights)
                          if weight)
        for other in others:
            np.add(first, other, out=first)
        offset = _HALF - _BLACK * _LUMA - _NEUTRAL * sum(weights)
        terms.append(np.add(first, np.int32(offset), out=first))
    return terms


def _add_luma(luma: NDArray[Any], terms: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """
    Return the colours from luma and the chroma terms.

    :param luma: (h, n) int32 array, not below black; it is overwritten.
    :param terms: chroma terms, an array of the same shape for each channel.
    :returns: (c, h, n) int16 array of values from 0 to 255.
    """
    np.multiply(luma, np.int32(_LUMA), out=luma)
    mixed = np.empty_like(luma)
    values = np.empty((len(terms), *luma.shape), np.int16)
    for term, value in zip(terms, values):
        np.add(luma, term, out=mixed)
        np.right_shift(mixed, _SHIFT, out=mixed)
        value[...] = mixed
    return np.clip(values, 0, 255, out=values)
