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

"""Conversion between gray, RGB, BGR and YUV encodings, with the arithmetic of OpenCV."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.bayer import bayer_to_color
from opencv_tools.image.blocks import row_blocks, write_columns
from opencv_tools.image.depth import change_depth
from opencv_tools.image.encodings import Encoding, encodings_between
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


# ITU-R BT.601 weights of red, green and blue times 2**15, as in OpenCV's cvtColor.
_GRAY_WEIGHTS = {'r': 9798, 'g': 19235, 'b': 3735}
_GRAY_SHIFT = 15


def reorder(image: NDArray[Any], source: str, target: str) -> NDArray[Any]:
    """
    Convert an image from one order of channels to another. A new alpha channel is opaque.

    :param image: contiguous (h, w) or (h, w, c) array of uint8 or uint16 in native byte order.
    :param source: channels of the image in order: ``'y'``, ``'rgb'``, ``'bgr'``, ``'rgba'`` or
        ``'bgra'``.
    :param target: channels of the result in order; one of the same values, but not ``source``.
    :returns: a new contiguous array of the same type: (h, w) for ``'y'``, (h, w, c) otherwise.
    """
    if target == 'y':
        return _weigh_to_gray(image, source)
    reordered = np.empty((*image.shape[:2], len(target)), image.dtype)
    pixels = image.reshape(-1, len(source))
    result = reordered.reshape(-1, len(target))
    if image.dtype == np.uint8 and len(pixels) > 2:
        _copy_words(pixels, result, source, target)
    else:
        for block in row_blocks(len(pixels), 1):
            _copy_channels(pixels[block], result[block], source, target)
    return reordered


def _copy_channels(
    source: NDArray[Any], target: NDArray[Any], source_order: str, target_order: str,
) -> None:
    """Copy pixels between arrays of shape (n, c), one channel at a time."""
    for index, channel in enumerate(target_order):
        if source_order == 'y' and channel != 'a':
            target[:, index] = source[:, 0]
        elif channel in source_order:
            target[:, index] = source[:, source_order.index(channel)]
        else:
            target[:, index] = np.iinfo(target.dtype).max


def _copy_words(
    source: NDArray[Any], target: NDArray[Any], source_order: str, target_order: str,
) -> None:
    """
    Copy 8-bit pixels as words of four bytes, which needs one copy instead of one a channel.

    A word consists of a pixel of three bytes and the byte after the pixel. To swap red and blue,
    the bytes of the word are swapped, and the word has the byte before the pixel instead. In both
    cases the extra byte is written after the pixel. The next word or the alpha channel overwrites
    it, because numpy copies one dimension from the first to the last element. The first and the
    last pixel may have no such neighbour, so they are copied channel by channel.

    :param source: contiguous (n, 1), (n, 3) or (n, 4) array of uint8, n > 2.
    :param target: contiguous (n, 3) or (n, 4) output array of uint8.
    :param source_order: channels of ``source`` in order.
    :param target_order: channels of ``target`` in order.
    """
    inner = (len(source) - 2,)
    read = source.shape[1]
    written = target.shape[1]
    target_words: NDArray[Any] = np.ndarray(inner, '<u4', target, written, (written,))
    if source_order == 'y':
        for block in row_blocks(*inner, 1):
            words = source[1:-1, 0][block].astype('<u4')
            target_words[block] = np.multiply(words, np.uint32(0x01010101), out=words)
    elif source_order[0] == target_order[0]:
        target_words[...] = np.ndarray(inner, '<u4', source, read, (read,))
    else:
        target_words[...] = np.ndarray(inner, '>u4', source, read - 1, (read,))
    if written == read == 4:
        target[:, 3] = source[:, 3]
    elif written == 4:
        whole_words = target.reshape(-1).view('<u4')
        for block in row_blocks(len(whole_words), 1):
            whole_words[block] |= np.uint32(0xff000000)
    for edge in (slice(1), slice(-1, None)):
        _copy_channels(source[edge], target[edge], source_order, target_order)


def _weigh_to_gray(image: NDArray[Any], order: str) -> NDArray[Any]:
    """Return the gray of each pixel: ``(9798 R + 19235 G + 3735 B + 2**14) >> 15``."""
    gray = np.empty(image.shape[:2], image.dtype)
    weigh = _weigh_uint8 if image.dtype == np.uint8 else _weigh_uint16
    weights = [_GRAY_WEIGHTS[channel] for channel in order[:3]]
    pixels = image.reshape(-1, len(order))
    result = gray.reshape(-1)
    for block in row_blocks(len(pixels), 1):
        weigh(pixels[block], result[block], weights)
    return gray


def _weigh_uint16(source: NDArray[Any], target: NDArray[Any], weights: list[int]) -> None:
    weighed = np.full(len(source), 1 << (_GRAY_SHIFT - 1), np.uint32)
    for index, weight in enumerate(weights):
        channel = source[:, index].astype(np.uint32)
        weighed += np.multiply(channel, np.uint32(weight), out=channel)
    weighed >>= np.uint32(_GRAY_SHIFT)
    target[...] = weighed


def _weigh_uint8(source: NDArray[Any], target: NDArray[Any], weights: list[int]) -> None:
    """
    Write the gray of 8-bit pixels, in 16-bit arithmetic.

    numpy computes with 16 bits four times as fast as with 32 bits. Each weight is split into
    ``256 * high + low``, so that the sums of both parts fit into 16 bits. The gray is exactly
    ``(64 + sum of high parts + (sum of low parts >> 8)) >> 7``. The first two channels are read
    as one number ``pair``, and ``weight * first`` is computed as
    ``weight * (pair - 256 * second)``. Overflows of 16 bits cancel out.

    :param source: (n, c) array of uint8.
    :param target: (n,) output array of uint8.
    :param weights: weights of the first three channels times 2**15.
    """
    pair = source[:, :2].view('<u2')[:, 0].astype(np.uint16)
    second = pair >> np.uint16(8)
    third = source[:, 2].astype(np.uint16)
    product = np.empty_like(pair)
    sums = []
    for parts in ([weight & 255 for weight in weights], [weight >> 8 for weight in weights]):
        total = pair * np.uint16(parts[0])
        for channel, part in ((second, parts[1] - 256 * parts[0]), (third, parts[2])):
            np.multiply(channel, np.uint16(part & 0xffff), out=product)
            np.add(total, product, out=total)
        sums.append(total)
    low, high = sums
    low >>= np.uint16(8)
    high += low
    high += np.uint16(64)
    high >>= np.uint16(7)
    target[...] = high


def convert(
    image: NDArray[Any], source: Encoding, target: Encoding,
) -> NDArray[Any]:
    """
    Convert an image from one encoding to another: colours first, then depth.

    :param image: (h, w) or (h, w, c) array of any byte order and strides, which is not changed;
        (rows, w) for encodings with chroma in separate rows, which follow the luma rows.
    :returns: a new contiguous array in native byte order: (h, w) for one channel, (h, w, c)
        otherwise.
    :raises ConversionError: the conversion is not supported; the texts are those of cv_bridge.
    """
    if source.name == target.name:
        return np.array(image, source.dtype, order='C')
    _check_conversion(source, target)
    native = np.ascontiguousarray(image, np.dtype(source.dtype))
    if not native.size:
        rows = source.height(len(native)) if target.kind == 'color' else len(native)
        channels = () if target.channels == 1 else (target.channels,)
        return np.empty((rows, native.shape[1], *channels), target.dtype)
    converted = native
    if target.kind == 'color' and source.order != target.order:
        if source.kind == 'bayer':
            converted = bayer_to_color(native, source.order, target.order)
        elif source.kind == 'yuv':
            converted = yuv_to_color(native, source, target.order)
        else:
            converted = reorder(native, source.order, target.order)
    converted = change_depth(converted, target.dtype)
    return converted.copy() if np.may_share_memory(converted, image) else converted


def convert_to(image: NDArray[Any], source: Encoding, desired: str) -> NDArray[Any]:
    """
    Convert an image to an encoding given by name, as cv_bridge does.

    :param image: as for ``convert``.
    :param desired: as for ``encodings_between``.
    :returns: as from ``convert``.
    :raises EncodingError: as from ``encodings_between``.
    :raises ConversionError: the conversion is not supported; the texts are those of cv_bridge.
    """
    return convert(image, *encodings_between(source, desired))


def _check_conversion(source: Encoding, target: Encoding) -> None:
    """Check that a conversion is supported; the texts of the errors are those of cv_bridge."""
    if not source.is_generic and target.kind == 'color':
        return
    if not source.is_generic and not target.is_generic:
        raise ConversionError(
            f'Unsupported conversion from [{source.name}] to [{target.name}]')
    if not target.is_generic:
        raise ConversionError(f'[{source.name}] is not a color format. but [{target.name}] is. '
                              'The conversion does not make sense')
    if not source.is_generic and (
            source.channels != target.channels or source.row_factor != 1):
        raise ConversionError(
            f'[{source.name}] is a color format but [{target.name}] is not so they must have '
            'the same OpenCV type, CV_8UC3, CV16UC1 ....')
    if source.channels != target.channels:
        raise ConversionError(
            f'[{source.name}] and [{target.name}] do not have the same number of channel')
    if not target.dtype:
        raise ConversionError(f'Unrecognized image encoding [{target.name}]')
