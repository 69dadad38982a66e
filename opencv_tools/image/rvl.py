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

"""
RVL, the lossless code of depth images, with numpy.

Source: A. D. Wilson, Fast Lossless Depth Image Compression, ISS 2017. An image is a sequence of
runs: the number of zeros, the number of other pixels, then the differences of these pixels to the
last one that is not zero. Each number is stored in groups of three bits, lowest first, with a bit
that announces another group. Eight of these nibbles are a word of 32 bits, first nibble highest.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.errors import CodecError

_BLOCK = 2**16  # numbers or nibbles that are processed at once, so that they stay in the cache
_WORD = 8  # nibbles
_BITS, _MORE = 3, 8  # bits of a number in a nibble, and the bit that announces another one
_MAX_NIBBLES = 10  # of a number, which is below 2**30

_Numbers = NDArray[np.uint32]


def encode_rvl(image: NDArray[np.uint16]) -> bytes:
    """
    Encode an image without loss.

    :param image: array of any shape with at least one pixel, in native byte order.
    :returns: words of 32 bits, little-endian.
    """
    parts = [*_nibbles_of(_numbers_of(image.reshape(-1)))]
    missing = -sum(part.size for part in parts) % _WORD
    nibbles = np.concatenate([*parts, np.zeros(missing, np.uint8)])
    words = (nibbles[::2] << 4 | nibbles[1::2]).view('>u4')
    return words.astype('<u4').tobytes()


def decode_rvl(content: bytes, pixels: int) -> NDArray[np.uint16]:
    """
    Decode an image.

    :param pixels: number of pixels, at least 1.
    :returns: (pixels,) array.
    :raises CodecError: the content has another number of pixels, or is no RVL.
    """
    numbers = np.concatenate([np.empty(0, np.uint32),
                              *_numbers_in(content, 2 * pixels + _WORD)])
    runs = _find_runs(numbers, pixels)
    lengths = np.stack((numbers[runs], numbers[runs + 1]), axis=1)
    is_pixel = np.repeat(np.arange(lengths.size, dtype=np.uint8) & 1, lengths.reshape(-1)) > 0
    is_difference = np.ones(numbers.size, bool)
    is_difference[runs] = is_difference[runs + 1] = False
    codes = numbers[is_difference][:np.count_nonzero(is_pixel)]
    # The codes 0, 1, 2, 3, 4 are 0, -1, 1, -2, 2. The sums wrap in 16 bits, as in the encoder.
    differences = (codes >> 1 ^ (0 - (codes & 1))).astype(np.uint16)
    image = np.zeros(pixels, np.uint16)
    image[is_pixel] = np.cumsum(differences, dtype=np.uint16)
    return image


def _numbers_of(pixels: NDArray[np.uint16]) -> _Numbers:
    """Return the numbers that describe an image: lengths of runs, and codes of differences."""
    is_pixel = pixels != 0
    edges = np.flatnonzero(is_pixel[1:] != is_pixel[:-1]) + 1
    # Runs of zeros and of pixels alternate. The first one has zeros, the last one pixels.
    lengths = np.diff(np.concatenate(([0] * (1 + int(is_pixel[0])), edges, [pixels.size])))
    lengths = np.append(lengths, [0] * (lengths.size % 2)).reshape(-1, 2).astype(np.intp)
    ends = np.cumsum(lengths[:, 1])
    runs = ends - lengths[:, 1] + 2 * np.arange(len(lengths))
    numbers = np.empty(int(ends[-1]) + lengths.size, np.uint32)
    is_difference = np.ones(numbers.size, bool)
    is_difference[runs] = is_difference[runs + 1] = False
    numbers[runs], numbers[runs + 1] = lengths.T
    differences = np.diff(pixels[is_pixel].astype(np.int32), prepend=np.int32(0))
    numbers[is_difference] = (differences << 1) ^ (differences >> 31)
    return numbers


def _nibbles_of(numbers: _Numbers) -> Iterator[NDArray[np.uint8]]:
    """Yield the nibbles of numbers."""
    for first in range(0, numbers.size, _BLOCK):
        rest = numbers[first:first + _BLOCK]
        sizes = np.ones(rest.size, np.uint8)
        for bits in range(_BITS, int(rest.max()).bit_length(), _BITS):
            sizes += rest >= np.uint32(1 << bits)
        ends = np.cumsum(sizes, dtype=np.intp)
        nibbles = np.empty(ends[-1], np.uint8)
        places = ends - sizes
        while rest.size:
            has_more = rest >= _MORE
            nibbles[places] = rest.astype(np.uint8) & (_MORE - 1) | has_more * np.uint8(_MORE)
            longer = np.flatnonzero(has_more)
            places, rest = places[longer] + 1, rest[longer] >> np.uint32(_BITS)
        yield nibbles


def _numbers_in(content: bytes, most: int) -> Iterator[_Numbers]:
    """Yield the numbers of an image until there are enough of them."""
    words = np.frombuffer(content, '<u4', len(content) // 4)
    before = 0  # nibbles of an earlier block that begin a number
    block = np.empty(_BLOCK + _MAX_NIBBLES, np.uint8)
    for first in range(0, words.size, _BLOCK // _WORD):
        pairs = words[first:first + _BLOCK // _WORD].astype('>u4').view(np.uint8)
        nibbles = block[:before + 2 * pairs.size]
        np.right_shift(pairs, 4, out=nibbles[before::2])
        np.bitwise_and(pairs, 15, out=nibbles[before + 1::2])
        ends = np.flatnonzero(nibbles < _MORE) + 1
        places = np.concatenate(([0], ends[:-1]))[:ends.size]
        rest = nibbles[ends[-1] if ends.size else 0:]
        values = np.zeros(ends.size, np.uint32)
        numbers: NDArray[np.intp] | slice = slice(None)
        for bits in range(0, _BITS * _MAX_NIBBLES, _BITS):
            parts = nibbles[places]
            values[numbers] |= (parts & (_MORE - 1)).astype(np.uint32) << np.uint32(bits)
            longer = np.flatnonzero(parts >= _MORE)
            places = places[longer] + 1
            numbers = longer if isinstance(numbers, slice) else numbers[longer]
        if places.size or rest.size > _MAX_NIBBLES:
            raise CodecError('an RVL image has a number of more than 30 bits')
        yield values
        most -= values.size
        if most <= 0:
            return
        before = rest.size
        block[:before] = rest


def _find_runs(numbers: _Numbers, pixels: int) -> NDArray[np.int64]:
    """Return the places of the lengths of runs; each has the number of zeros and of pixels."""
    lengths = numbers.data
    runs = []
    place = count = 0
    while count < pixels:
        if place + 1 >= len(lengths):
            raise CodecError(f'an RVL image has {count} of {pixels} pixels: it is incomplete')
        others = lengths[place + 1]
        run = lengths[place] + others
        if not run:
            raise CodecError('an RVL image has a run without pixels')
        runs.append(place)
        count += run
        place += 2 + others
    if count > pixels or place > len(lengths):
        raise CodecError(f'an RVL image has {count} pixels instead of {pixels}, or is incomplete')
    return np.array(runs)
