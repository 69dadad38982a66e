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

"""RVL against its paper: bytes derived by hand, a second implementation, and hostile content."""

from __future__ import annotations

from collections.abc import Iterator
import tracemalloc

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.errors import CodecError
from opencv_tools.image.rvl import decode_rvl, encode_rvl
import pytest


def nibbles_of(number: int) -> Iterator[int]:
    while number > 7:
        yield number % 8 + 8
        number //= 8
    yield number


def encode_by_pixel(image: NDArray[np.uint16]) -> bytes:
    """Encode an image pixel by pixel, as the paper describes the format."""
    numbers: list[int] = []
    pixels = image.tolist()
    place = last = 0
    while place < len(pixels):
        start = place
        while place < len(pixels) and not pixels[place]:
            place += 1
        numbers.append(place - start)
        start = place
        while place < len(pixels) and pixels[place]:
            place += 1
        numbers.append(place - start)
        for pixel in pixels[start:place]:
            numbers.append(2 * (pixel - last) if pixel >= last else 2 * (last - pixel) - 1)
            last = pixel
    text = ''.join(f'{nibble:x}' for number in numbers for nibble in nibbles_of(number))
    text += '0' * (-len(text) % 8)
    return b''.join(bytes.fromhex(text[first:first + 8])[::-1] for first in range(0, len(text), 8))


def random_image(random: np.random.Generator) -> NDArray[np.uint16]:
    image = random.integers(0, random.choice([2, 9, 70, 3000, 65536]), random.integers(1, 200))
    image[random.random(image.size) < random.random()] = 0
    return np.repeat(image, random.integers(1, 20)).astype(np.uint16)


@pytest.mark.parametrize(('pixels', 'nibbles'), [
    ([0, 0, 5, 6, 0], '2 2 a1 2 1 0 0'),  # 2 zeros, 2 pixels: +5, +1; 1 zero, 0 pixels
    ([7], '0 1 e1 0000'),
    ([0] * 9, '91 0 00000'),
    ([65535, 1], '0 2 effff3 bffff3 00')])
def test_bytes_derived_by_hand(pixels: list[int], nibbles: str) -> None:
    image = np.array(pixels, np.uint16)
    words = bytes.fromhex(nibbles.replace(' ', ''))
    content = np.frombuffer(words, '>u4').astype('<u4').tobytes()
    assert encode_rvl(image) == content
    assert np.array_equal(decode_rvl(content, len(pixels)), image)


@pytest.mark.parametrize('count', [300, pytest.param(10_000, marks=pytest.mark.thorough)])
def test_random_images_against_a_second_implementation(count: int) -> None:
    random = np.random.default_rng(count)
    for _ in range(count):
        image = random_image(random)
        content = encode_rvl(image)
        assert content == encode_by_pixel(image)
        assert np.array_equal(decode_rvl(content, image.size), image)


@pytest.mark.parametrize('shape', [(480, 640), (3, 70_001), (1, 262_143)])
def test_image_of_several_blocks(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(5)
    image = random.integers(900, 1000, shape).astype(np.uint16)
    image[random.random(shape) < 0.2] = 0
    content = encode_rvl(image)
    assert content == encode_by_pixel(image.reshape(-1))
    assert np.array_equal(decode_rvl(content + b'more', image.size), image.reshape(-1))


def words(nibbles: str) -> bytes:
    return np.frombuffer(bytes.fromhex(nibbles.ljust(-(-len(nibbles) // 8) * 8, '0')),
                         '>u4').astype('<u4').tobytes()


@pytest.mark.parametrize(('content', 'reason'), [
    (b'', '0 of 5 pixels'), (b'\0\0', '0 of 5 pixels'),
    (words('21222222')[:3], '0 of 5 pixels'), (words('05111888'), 'is incomplete'),
    (words('00000000'), 'a run without pixels'),
    (words('60'), '6 pixels instead of 5'),
    (words('4700000'), '11 pixels instead of 5'),
    (words('f' * 40), 'more than 30 bits'),
    (words('f' * 10 + '7'), 'more than 30 bits'),
    (b'\xff' * 400_000, 'more than 30 bits')])
def test_hostile_content(content: bytes, reason: str) -> None:
    with pytest.raises(CodecError, match=reason):
        decode_rvl(content, 5)


def test_random_content_is_refused_or_has_its_pixels() -> None:
    random = np.random.default_rng(8)
    outcomes = set()
    for _ in range(500):
        try:
            image = decode_rvl(random.bytes(random.integers(0, 60)), 11)
        except CodecError:
            outcomes.add('refused')
        else:
            outcomes.add('decoded')
            assert image.shape == (11,) and image.dtype == np.uint16
    assert outcomes == {'refused', 'decoded'}


def test_memory_grows_with_pixels_and_not_with_more_content() -> None:
    content = encode_rvl(np.arange(1, 20_001, dtype=np.uint16))
    tracemalloc.start()
    try:
        decode_rvl(content + bytes(40_000_000), 20_000)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 90_000_000  # the content and its copy, and a block of numbers
