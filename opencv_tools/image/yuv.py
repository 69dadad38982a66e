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

"""Image luma and chroma: YUV encodings turned into gray, RGB and BGR, as OpenCV does it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.blocks import row_blocks
from opencv_tools.image.columns import write_columns
from opencv_tools.image.encodings import Encoding
from opencv_tools.image.errors import ConversionError

# ITU-R BT.601 with video range, scaled by 2**20 as OpenCV's cvtColor has it.
_SHIFT = np.int32(20)
_LUMA = 1220542
_BLACK, _WHITE = 16, 255  # what is darker than black counts as black
_CHROMA = {'r': (0, 1673527), 'g': (-409993, -852492), 'b': (2116026, 0)}  # of U, of V
_NEUTRAL = 128
_HALF = 1 << 19

# U and V, and some lumas that share them: of every column or of the even and of the odd ones, with
# the rows of the picture that they make.
_Part = tuple[Sequence[NDArray[Any]], Sequence[tuple[Sequence[NDArray[Any]], NDArray[Any]]]]


def yuv_to_color(image: NDArray[Any], encoding: Encoding, target: str) -> NDArray[Any]:
    """
    Turn luma and chroma into colours, or leave the chroma out.

    ``R = (y + 1673527 v + h) >> 20``, ``G = (y - 852492 v - 409993 u + h) >> 20`` and
    ``B = (y + 2116026 u + h) >> 20`` with ``y = 1220542 max(0, Y - 16)``, ``u = U - 128``,
    ``v = V - 128`` and ``h = 2**19``, saturated to a byte. Pixels share the nearest chroma.

    :param image: contiguous uint8 array: (h, w, 2) when luma and chroma are packed, otherwise
        (rows, w), the luma's rows followed by those of the chroma.
    :param encoding: one of the yuv encodings.
    :param target: channels in order: ``'y'``, ``'rgb'``, ``'bgr'``, ``'rgba'`` or ``'bgra'``.
    :returns: a fresh contiguous uint8 array, (h, w) for ``'y'``.
    :raises ConversionError: colours are wanted of rows with half a pair of pixels.
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
        tints = _tints(chroma, target)
        for lumas, wanted in rows:
            write_columns([_add_luma(luma, tints) for luma in lumas], wanted)
    return colors


def _luma(image: NDArray[Any], encoding: Encoding, height: int) -> NDArray[Any]:
    """Take the luma alone."""
    if image.ndim == 2:
        luma: NDArray[Any] = image[:height].copy()
        return luma
    pixels = image.view('<u2')[..., 0]
    gray = np.empty(pixels.shape, np.uint8)
    for rows in row_blocks(*pixels.shape):
        even, odd = _halves(pixels[rows])
        gray[rows] = even if encoding.order == 'yuyv' else odd
    return gray


def _halves(numbers: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Split numbers into their lower and their upper half, keeping the type."""
    bits = numbers.dtype.type(numbers.itemsize * 4)
    low = numbers & numbers.dtype.type((1 << int(bits)) - 1)
    return low, numbers >> bits


def _split_packed(
    image: NDArray[Any], colors: NDArray[Any], order: str,
) -> Iterator[_Part]:
    """Give a 4:2:2 image a block of rows at a time: two columns share their chroma."""
    pixels = image.view('<u2')[..., 0]
    for rows in row_blocks(len(pixels), pixels.shape[1] // 2):
        even, odd = _halves(pixels[rows])
        luma, chroma = (even, odd) if order == 'yuyv' else (odd, even)
        np.clip(luma, _BLACK, _WHITE, out=luma)
        yield _halves(chroma.view('<i4')), [(_halves(luma.view('<i4')), colors[rows])]


def _split_planar(
    image: NDArray[Any], colors: NDArray[Any], order: str,
) -> Iterator[_Part]:
    """Give an image whose chroma is in rows of its own a block at a time."""
    height = len(colors)
    step = 1 if order == 'nv24' else 2  # rows and columns that share a chroma
    chroma_rows = image[height:].reshape(height // step, -1).view('<u2')
    for rows in row_blocks(*chroma_rows.shape):
        chroma = [half.astype(np.int32) for half in _halves(chroma_rows[rows])]
        picture = slice(rows.start * step, rows.stop * step)
        luma = np.clip(image[picture], _BLACK, _WHITE)
        columns = (luma,) if step == 1 else _halves(luma.view('<u2'))
        yield chroma[::-1] if order == 'nv21' else chroma, [
            ([column[row::step].astype(np.int32) for column in columns],
             colors[picture][row::step])
            for row in range(step)]


def _tints(chroma: Sequence[NDArray[Any]], order: str) -> list[NDArray[Any]]:
    """Give what the chroma, U and V, adds to each channel, with all that is constant."""
    tints = []
    for channel in order[:3]:
        weights = _CHROMA[channel]
        first, *others = (part * np.int32(weight) for part, weight in zip(chroma, weights)
                          if weight)
        for other in others:
            np.add(first, other, out=first)
        offset = _HALF - _BLACK * _LUMA - _NEUTRAL * sum(weights)
        tints.append(np.add(first, np.int32(offset), out=first))
    return tints


def _add_luma(luma: NDArray[Any], tints: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """
    Mix luma with what the chroma adds.

    :param luma: int32 array of shape (h, n), not below black; it is changed.
    :param tints: an array of the same shape for each channel.
    :returns: bytes as an int16 array of shape (c, h, n).
    """
    np.multiply(luma, np.int32(_LUMA), out=luma)
    mixed = np.empty_like(luma)
    values = np.empty((len(tints), *luma.shape), np.int16)
    for tint, value in zip(tints, values):
        np.add(luma, tint, out=mixed)
        np.right_shift(mixed, _SHIFT, out=mixed)
        value[...] = mixed
    return np.clip(values, 0, 255, out=values)
