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

"""Values of the pixels that a page asks for: of one, along a line, and how often they occur."""

from __future__ import annotations

import asyncio
from base64 import b64encode
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.cv_bridge import CvBridgeError
from opencv_tools.image.encodings import Encoding
from opencv_tools.image.errors import CodecError, ImageError
from opencv_tools.viewer.errors import MAX_MESSAGE, RequestError
from opencv_tools.viewer.protocol import parse_point, parse_region, topic_of, valid_number
from opencv_tools.viewer.region import Region, region_within
from opencv_tools.viewer.streams.channel import Channel
from opencv_tools.viewer.streams.depth_colors import missing_numbers, UNITS, within_range
from opencv_tools.viewer.streams.pixels import DISPARITY, Pixels

#: Samples of a line at most, and bins of a histogram.
MAX_SAMPLES, BINS = 512, 64
# Values that a text or a chart has at most.
_MAX_VALUES, _MAX_CURVES = 8, 3
# Rows whose extremes are found at once.
_BAND_ROWS = 64
# Cells of a side of the picture of over-exposed pixels at most.
_MAX_CELLS = 320
# Pixels that a histogram counts at most.
_MAX_COUNTED = 500_000
_MILLIMETRES = 1000  # in a metre, the unit of depth in 16 bits

_Chart = dict[str, Any]


def describe_pixel(pixels: Pixels, x: int, y: int) -> str:
    """
    Return the value of a pixel as a text.

    :raises CodecError: there is no such pixel.
    """
    _check_inside(pixels, x, y)
    image, encoding = pixels.image, pixels.encoding
    if encoding.kind == 'yuv':
        return ', '.join(f'{name} {value}' for name, value in
                         zip('YUV', _yuv_values(image, encoding, x, y), strict=True))
    values = np.atleast_1d(pixels.numbers(image[y:y + 1, x:x + 1])[0, 0])
    if encoding.kind == 'bayer':
        return f'{encoding.order[y % 2 * 2 + x % 2].upper()} {values[0]}'
    if encoding.kind == 'color' and encoding.order != 'y':
        return ', '.join(f'{name.upper()} {value}'
                         for name, value in zip(encoding.order, values, strict=True))
    more = ', ...' if len(values) > _MAX_VALUES else ''
    return ', '.join(_describe_number(value, encoding) for value in values[:_MAX_VALUES]) + more


def line_profile(pixels: Pixels, begin: tuple[int, int], end: tuple[int, int]) -> _Chart:
    """
    Return the values along a line.

    :param begin: column and row of the first pixel.
    :param end: column and row of the last pixel.
    :returns: ``names`` and ``curves``, lists of numbers with None for values that are not finite,
        ``low`` and ``high``, the smallest and the largest number, and ``ends``, their text.
    :raises CodecError: an end is outside of the image.
    """
    _check_inside(pixels, *begin)
    _check_inside(pixels, *end)
    planes, names = _planes(pixels)
    count = min(MAX_SAMPLES, max(abs(begin[0] - end[0]), abs(begin[1] - end[1])) + 1)
    columns, rows = (np.linspace(first, last, count).round().astype(int)
                     for first, last in zip(begin, end, strict=True))
    curves = [pixels.numbers(plane[rows, columns]).astype(float) for plane in planes]
    low, high = _limits([curve[np.isfinite(curve)] for curve in curves])
    dtype = pixels.numbers(planes[0][:0]).dtype
    return {'names': names, 'low': low, 'high': high,
            'ends': _describe_ends(low, high, dtype, pixels.encoding)
            or _describe_number(np.nan, pixels.encoding),
            'curves': [[value if np.isfinite(value) else None for value in curve.tolist()]
                       for curve in curves]}


def histogram(pixels: Pixels, region: Region | None) -> _Chart:
    """
    Count the values of a part of an image.

    :param region: the part; None for the whole image.
    :returns: ``names`` and ``curves``, the parts of all pixels in each bin, from ``low`` to
        ``high``, whose text is ``ends``; and the parts of the pixels that are ``over`` and
        ``under`` exposed, with the largest or the smallest value of their type, and that have no
        number (``missing``), with what they lack (``lacking``). ``low`` and ``high`` are None if
        all pixels lack it.
    """
    planes, names = _planes(pixels)
    part = region_within(region, *pixels.size)
    step = int(np.ceil(np.sqrt(part.width * part.height / _MAX_COUNTED))) or 1
    if pixels.encoding.kind == 'bayer':
        step |= 1  # so that all colours are counted
    planes = [pixels.numbers(part.crop(plane)[::step, ::step]) for plane in planes]
    dtype, has_depth = planes[0].dtype, pixels.encoding.name in UNITS
    missing = np.logical_or.reduce([missing_numbers(plane, pixels.encoding) for plane in planes])
    over = under = np.zeros(planes[0].shape, bool)
    if dtype.kind == 'u' and not has_depth:
        over = _over(planes)
        under = np.logical_and.reduce([plane == 0 for plane in planes])
    found = [plane[~missing] for plane in planes]
    low, high = (0.0, 255.0) if dtype == np.uint8 else _limits(found)
    count = max(1, missing.size)
    lacking = 'depth' if has_depth else 'a number'
    return {'names': names, 'low': low, 'high': high, **_extremes(pixels, part),
            'ends': _describe_ends(low, high, dtype, pixels.encoding),
            'over': float(over.mean()), 'under': float(under.mean()),
            'missing': float(missing.mean()),
            'lacking': DISPARITY.name if pixels.encoding is DISPARITY else lacking,
            'curves': [(_count(values, low, high) / count).tolist() for values in found]}


def exposed(pixels: Pixels, region: Region | None) -> _Chart:
    """
    Find the over-exposed pixels of a part of an image.

    :param region: the part; None for the whole image.
    :returns: ``bits`` in base64, one for each cell and row by row; a cell of ``step`` x ``step``
        pixels counts if one of them is over-exposed. ``place`` is where the part begins.
    :raises CodecError: the values have no largest one.
    """
    part = region_within(region, *pixels.size)
    planes = [pixels.numbers(part.crop(plane)) for plane in _planes(pixels)[0]]
    if planes[0].dtype.kind != 'u' or pixels.encoding.name in UNITS:
        raise CodecError(f'{pixels.encoding.name} has no largest value: no pixel is over-exposed')
    over, step = _over(planes), -(-max(part.width, part.height) // _MAX_CELLS)
    over = np.pad(over, [(0, -side % step) for side in over.shape])
    rows, columns = over.shape[0] // step, over.shape[1] // step
    cells = over.reshape(rows, step, columns, step).any(axis=(1, 3))
    return {'bits': b64encode(np.packbits(cells).tobytes()).decode(), 'columns': columns,
            'step': step, 'place': [part.x, part.y]}


def _over(planes: list[NDArray[Any]]) -> NDArray[Any]:
    """Return which pixels have the largest value of their type in a channel."""
    return np.logical_or.reduce([plane == np.iinfo(plane.dtype).max for plane in planes])


def _extremes(pixels: Pixels, part: Region) -> _Chart:
    """Return the texts of the smallest and the largest value, each with its column and row."""
    best: dict[str, tuple[Any, int, int]] = {}
    for first in range(0, part.height, _BAND_ROWS):  # a whole image would need much memory
        band = [pixels.numbers(part.crop(plane)[first:first + _BAND_ROWS])
                for plane in _planes(pixels)[0]]
        places = np.flatnonzero(~np.logical_or.reduce(
            [missing_numbers(one, pixels.encoding) for one in band]))
        for name, reduce, place_of in (('least', np.minimum.reduce, np.argmin),
                                       ('most', np.maximum.reduce, np.argmax)):
            if places.size:
                values = reduce(band)
                place = int(places[place_of(values.ravel()[places])])
                row, column = divmod(place, values.shape[1])
                new = (values[row, column], part.x + column, part.y + first + row)
                old = best.setdefault(name, new)
                if place_of([old[0], new[0]]):
                    best[name] = new
    return {name: [_describe_number(value, pixels.encoding), *place]
            for name, (value, *place) in best.items()}


def _count(values: NDArray[Any], low: float | None, high: float | None) -> NDArray[Any]:
    """Count values in bins of equal width; equal values are in the middle."""
    if values.dtype == np.uint8:
        return np.bincount(values >> 2, minlength=BINS)
    if low is None or high is None or low == high:
        return np.eye(1, BINS, BINS // 2)[0] * values.size
    return np.histogram(values.astype(float), BINS, (low, high))[0]


def _limits(found: list[NDArray[Any]]) -> tuple[float, float] | tuple[None, None]:
    """Return the smallest and the largest number, if any; larger ones than a range has are cut."""
    numbers = [values for values in found if values.size]
    if not numbers:
        return None, None
    return (within_range(min(values.min() for values in numbers)),
            within_range(max(values.max() for values in numbers)))


def _check_inside(pixels: Pixels, x: int, y: int) -> None:
    width, height = pixels.size
    if not (0 <= x < width and 0 <= y < height):
        raise CodecError(f'there is no pixel {x}, {y} in an image of {width}x{height} pixels')


def _planes(pixels: Pixels) -> tuple[list[NDArray[Any]], list[str]]:
    """Return the channels of a chart, and their names; those of YUV are luma alone."""
    image, encoding = pixels.image, pixels.encoding
    if encoding.kind == 'yuv':
        luma = image[..., encoding.order.index('y')] if image.ndim == 3 else image
        return [luma[:pixels.size[1]]], ['Y']
    if image.ndim == 2:
        return [image], ['']
    names = [name.upper() for name in encoding.order] or [
        str(place) for place in range(image.shape[2])]
    shown = [place for place, name in enumerate(names) if name != 'A'][:_MAX_CURVES]
    return [image[..., place] for place in shown], [names[place] for place in shown]


def _yuv_values(image: NDArray[Any], encoding: Encoding, x: int, y: int) -> tuple[int, int, int]:
    """Return luma and chroma of a pixel; two or four pixels share their chroma."""
    even = x & ~1
    if image.ndim == 3:  # two bytes a pixel: luma, and U or V in turn
        luma = encoding.order.index('y')
        other = min(even + 1, image.shape[1] - 1)
        return image[y, x, luma], image[y, even, 1 - luma], image[y, other, 1 - luma]
    height, width = encoding.height(image.shape[0]), image.shape[1]
    chroma = image[height:].reshape(-1)
    place = y * 2 * width + 2 * x if encoding.row_factor == 3 else y // 2 * width + even
    first, second = chroma[place], chroma[place + 1]
    return (image[y, x], second, first) if encoding.order == 'nv21' else (
        image[y, x], first, second)


def _describe_ends(low: float | None, high: float | None, dtype: np.dtype[Any],
                   encoding: Encoding) -> str:
    """Return the limits of a chart as the values of pixels are described; '' for none."""
    return '' if low is None or high is None else ' to '.join(
        _describe_number(dtype.type(value), encoding) for value in (low, high))


def _describe_number(value: Any, encoding: Encoding) -> str:
    """Return a number as it is in the message, with its unit; depth in metres as well."""
    if encoding is DISPARITY:
        return f'{value} px' if np.isfinite(value) else 'no disparity'
    if encoding.name not in UNITS:
        return str(value)
    if not np.isfinite(value) or not value:
        return f'{value!s} (no depth)'
    is_millimetres = encoding.name == '16UC1'
    return f'{value} ({value / _MILLIMETRES:.3f} m)' if is_millimetres else f'{value!s} m'


#: Topics of a page whose frames are kept for its questions.
MAX_LOOKS = 4

_Message = dict[str, Any]
_Answer = Callable[[Pixels], _Message]


def _pixel(message: _Message) -> _Answer:
    x, y = parse_point(message.get('at'), 'at')
    return lambda pixels: {'text': describe_pixel(pixels, x, y)
                           + (f' of the {pixels.codec}' if pixels.codec else '')}


def _profile(message: _Message) -> _Answer:
    begin, end = (parse_point(message.get(name), name) for name in ('from', 'to'))
    return lambda pixels: line_profile(pixels, begin, end)


def _histogram(message: _Message) -> _Answer:
    region = parse_region(message.get('region'))
    return lambda pixels: histogram(pixels, region)


def _exposed(message: _Message) -> _Answer:
    region = parse_region(message.get('region'))
    return lambda pixels: exposed(pixels, region)


# What answers each word of a page, given its message.
_ANSWERS: dict[str, Callable[[_Message], _Answer]] = {
    'pixel': _pixel, 'profile': _profile, 'histogram': _histogram,
    'exposed': _exposed}


@dataclass(frozen=True)
class _Question:
    """
    A question about a picture.

    :param channel: what sends the pictures of the topic; None for nothing.
    :param read: reads the pixels of the frame, which waits with the question; None if the frame
        is gone.
    :param answer: returns the answer, given the pixels.
    """

    picture: int
    channel: object
    read: Callable[[], Awaitable[Pixels]] | None
    answer: _Answer


class Looks:
    """
    Answer the questions of a page, one after another.

    A question replaces one of the same kind about the same topic that still waits. The frame waits
    with the question, because the page may draw the next picture meanwhile.
    """

    def __init__(self, channel_of: Callable[[str], object],
                 write: Callable[[_Message], Awaitable[None]]) -> None:
        """
        Create an object without questions.

        :param channel_of: returns what sends the pictures of a topic to the page.
        :param write: sends an answer, and waits until it is sent.
        """
        self._channel_of = channel_of
        self._write = write
        self._waiting: dict[tuple[str, str], _Question] = {}
        self._task: asyncio.Task[None] | None = None

    def ask(self, message: _Message) -> bool:
        """
        Answer a message soon, if it is a question.

        :returns: whether it is one.
        :raises RequestError: a value is invalid, or too many questions wait.
        """
        kind = next((word for word in _ANSWERS if word in message), None)
        if kind is None:
            return False
        topic = topic_of(message[kind])
        picture = int(valid_number(message.get('picture'), 'picture', 0, 2**53))
        channel = self._channel_of(topic)
        read = None
        if (isinstance(channel, Channel) and channel.options.looks  # of MAX_LOOKS topics
                and (frame := channel.shown.of(picture))):
            read = partial(channel.stream.pixels, frame)
        self._waiting[kind, topic] = _Question(picture, channel, read, _ANSWERS[kind](message))
        if len(self._waiting) > len(_ANSWERS) * MAX_LOOKS:
            del self._waiting[kind, topic]
            raise RequestError(f'questions about {MAX_LOOKS} topics wait for an answer: wait')
        if self._task is None or self._task.done():
            self._task = asyncio.ensure_future(self._answer_all())
        return True

    def close(self) -> None:
        """Answer nothing any more."""
        self._waiting.clear()
        if self._task:
            self._task.cancel()

    async def _answer_all(self) -> None:
        while self._waiting:
            kind, topic = key = next(iter(self._waiting))
            question = self._waiting.pop(key)
            try:
                answer = await _answer(question)
            except (CvBridgeError, ImageError, RequestError) as err:
                answer = {'error': printable(err, MAX_MESSAGE)}
            await self._write({kind: {'topic': topic, 'picture': question.picture, **answer}})


async def _answer(question: _Question) -> _Message:
    """
    Return the answer to a question.

    :raises RequestError: the frame of the picture is not kept, or is video.
    """
    channel = question.channel
    if channel is not None and not isinstance(channel, Channel):
        raise RequestError('the browser decodes this video, so the node has no pixels of it: '
                           'pause the page, or add quality=90 to its address to get images')
    if channel is None or question.read is None:
        raise RequestError(describe_gone(channel))
    return await channel.stream.in_pool(question.answer, await question.read())


def describe_gone(channel: object) -> str:
    """Return the sentence about a picture whose frame is not kept, and what to do."""
    is_live = isinstance(channel, Channel) and not channel.options.held
    return ('the node has the frame of this picture no more: '
            + ('wait for the next one' if is_live else 'resume the page'))
