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

"""Messages of compressed_depth_image_transport, valid and broken."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
from opencv_tools.image.cdr import NO_HEADER, WireCompressedImage
from opencv_tools.image.errors import CodecError, ImageError
from opencv_tools.image_codecs import decode_depth, encode_image
from opencv_tools.viewer.inspect.looks import describe_pixel, histogram, line_profile
from opencv_tools.viewer.region import Region
from opencv_tools.viewer.streams.encoding import encode_picture, PictureOptions
from opencv_tools.viewer.streams.pixels import read_pixels
import pytest

MILLIMETRES, METRES = '16UC1; compressedDepth png', '32FC1; compressedDepth png'


def content_of(image: np.ndarray, numerator: float = 0.0, offset: float = 0.0) -> bytes:
    return struct.pack('<iff', 0, numerator, offset) + encode_image(image, '.png').tobytes()


def message_of(content: bytes, format_text: str = METRES) -> WireCompressedImage:
    return WireCompressedImage(header=NO_HEADER, format=format_text, data=content)


def test_millimetres_are_lossless() -> None:
    depth = np.random.default_rng(1).integers(0, 2**16, (48, 64)).astype(np.uint16)
    pixels = read_pixels(WireCompressedImage(
        header=NO_HEADER, format=MILLIMETRES, data=content_of(depth)))
    assert pixels.encoding.name == '16UC1'
    assert np.array_equal(pixels.image, depth)


def test_quantised_metres() -> None:
    depth = np.linspace(0.3, 9.9, 640, dtype=np.float32)[np.newaxis]
    # As compressed_depth_image_transport does, with depth_max 10 and depth_quantization 100.
    numerator = 100.0 * (100.0 + 1.0)
    offset = 1.0 - numerator / 10.0
    stored = (numerator / depth + offset).astype(np.uint16)
    stored[0, 5] = 0
    pixels = read_pixels(message_of(content_of(stored, numerator, offset)))
    image = pixels.numbers(pixels.image)
    assert pixels.encoding.name == '32FC1' and image.dtype == np.float32
    assert np.isnan(image[0, 5])
    known = np.arange(640) != 5
    assert np.abs(image[0, known] / depth[0, known] - 1).max() < 0.01


@pytest.mark.parametrize('content', [
    b'', bytes(11), bytes(12), bytes(50), content_of(np.zeros((4, 4), np.uint8)),
    content_of(np.zeros((4, 4, 3), np.uint16)), content_of(np.zeros((4, 4), np.uint16))[:-20],
    struct.pack('<iff', 0, 1, 1) + encode_image(np.zeros((4, 4), np.uint8), '.jpg').tobytes()])
def test_broken_content_is_refused(content: bytes) -> None:
    with pytest.raises((CodecError, ImageError)):
        decode_depth(content, METRES)


@pytest.mark.parametrize(('numerator', 'offset'), [
    (3e38, -3e38), (1e-44, 0), (3e38, 0.9999999), (1, -3e38)])
def test_odd_quantisation_gives_no_infinite_depth(numerator: float, offset: float) -> None:
    image, quantisation = decode_depth(
        content_of(np.arange(16, dtype=np.uint16).reshape(4, 4), numerator, offset), METRES)
    assert quantisation and not np.isinf(quantisation.depth_of(image)).any()


def test_values_charts_and_picture_of_quantised_metres() -> None:
    stored = np.zeros((48, 64), np.uint16)
    stored[:24], stored[24] = 500, 1000
    pixels = read_pixels(message_of(content_of(stored, 1000.0, 0.0)))
    assert describe_pixel(pixels, 3, 2) == '2.0 m'
    assert describe_pixel(pixels, 3, 24) == '1.0 m'
    assert describe_pixel(pixels, 3, 30) == 'nan (no depth)'
    assert line_profile(pixels, (0, 23), (0, 25))['curves'] == [[2.0, 1.0, None]]
    counts = histogram(pixels, None)
    assert (counts['low'], counts['high'], counts['lacking']) == (1, 2, 'depth')
    assert counts['missing'] == pytest.approx(23 / 48)
    picture = encode_picture(message_of(content_of(stored, 1000.0, 0.0)), PictureOptions(0, 95))
    assert (picture.encoding, picture.unit) == ('32FC1 compressedDepth', 'm')
    assert picture.measured == (1, 2)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(('format_text', 'limits'), [
    (METRES, None), (METRES, (0.0, 3.0)), (MILLIMETRES, None)])
def test_large_image_needs_little_more_memory_than_its_numbers(
        format_text: str, limits: tuple[float, float] | None) -> None:
    side = 3000
    message = message_of(
        content_of(np.full((side, side), 500, np.uint16), 1000.0), format_text)
    assert len(message.data) < side * side / 100
    tracemalloc.start()
    try:
        picture = encode_picture(message, PictureOptions(640, 80, limits=limits, colors='turbo'))
        pixels = read_pixels(message)
        assert describe_pixel(pixels, 0, 0) and histogram(pixels, None)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 2 * side * side * 2
    assert picture.source_size == (side, side) and picture.width <= 640
    whole = encode_picture(message, PictureOptions(0, 80))
    assert whole.width * whole.height <= 2**23
    region = Region(x=0, y=0, width=900, height=700)
    part = encode_picture(message, PictureOptions(0, 80, region=region))
    assert (part.width, part.height) == (900, 700)


def test_image_with_too_many_pixels_is_refused() -> None:
    large = encode_image(np.full((5800, 5800), 500, np.uint16), '.png').tobytes()
    with pytest.raises(ImageError, match='5800x5800 pixels are more than max_pixels=33554432'):
        decode_depth(bytes(12) + large, METRES)
