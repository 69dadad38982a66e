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

"""Values of pixels of every encoding, along lines and in histograms."""

from __future__ import annotations

from base64 import b64decode
import json

from images import random_image
import numpy as np
from opencv_tools.image.cdr import NO_HEADER, WireCompressedImage, WireDisparity
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.image.errors import CodecError
from opencv_tools.image.layout import array_to_wire
from opencv_tools.image_codecs import convert_image, encode_image
from opencv_tools.viewer.inspect.looks import (
    BINS, describe_pixel, exposed, histogram, line_profile, MAX_SAMPLES)
from opencv_tools.viewer.region import Region
from opencv_tools.viewer.streams.pixels import Pixels, read_pixels
import pytest

GENERIC = ['8UC1', '8UC3', '16UC1', '16SC1', '32SC1', '32FC1', '64FC1', '32FC3', '16UC3', '8UC16']


def pixels_of(image: np.ndarray, encoding: str) -> Pixels:
    return read_pixels(array_to_wire(image, find_encoding(encoding)))


@pytest.mark.parametrize('encoding', [
    name for name, one in ENCODINGS.items() if one.kind == 'color'])
def test_value_of_a_colour(encoding: str) -> None:
    image = random_image(encoding, 48, 64)
    pixels = pixels_of(image, encoding)
    for x, y in ((0, 0), (63, 47), (17, 30)):
        values = np.atleast_1d(image[y, x])
        order = find_encoding(encoding).order
        expected = str(values[0]) if order == 'y' else ', '.join(
            f'{name.upper()} {value}' for name, value in zip(order, values, strict=True))
        assert describe_pixel(pixels, x, y) == expected


def test_value_of_a_bayer_pixel_has_its_colour() -> None:
    pixels = pixels_of(np.array([[1, 2], [3, 4]], np.uint16), 'bayer_gbrg16')
    assert [describe_pixel(pixels, x, y) for y in (0, 1) for x in (0, 1)] == [
        'G 1', 'B 2', 'R 3', 'G 4']


@pytest.mark.parametrize('encoding', [
    name for name, one in ENCODINGS.items() if one.kind == 'yuv'])
def test_value_of_yuv_becomes_the_shown_colour(encoding: str) -> None:
    """Compare with the conversion of OpenCV: equal values of YUV have equal colours."""
    image = random_image(encoding, 48, 64)
    pixels = pixels_of(image, encoding)
    found = find_encoding(encoding)
    colours = convert_image(image, found, find_encoding('bgr8')).astype(int)
    for x, y in ((0, 0), (63, 47), (17, 30), (16, 31)):
        luma, u, v = (int(one.split()[1]) for one in describe_pixel(pixels, x, y).split(', '))
        bright, u, v = 1.164 * max(0, luma - 16), u - 128, v - 128  # ITU-R BT.601
        expected = bright + 2.018 * u, bright - 0.391 * u - 0.813 * v, bright + 1.596 * v
        assert np.abs(np.clip(expected, 0, 255) - colours[y, x]).max() < 3


@pytest.mark.parametrize(('encoding', 'value', 'text'), [
    ('16UC1', 1234, '1234 (1.234 m)'), ('16UC1', 0, '0 (no depth)'), ('32FC1', 1.1, '1.1 m'),
    ('32FC1', np.nan, 'nan (no depth)'), ('32FC1', np.inf, 'inf (no depth)'),
    ('32FC1', 0, '0.0 (no depth)'), ('64FC1', -1.5, '-1.5'), ('32SC1', -7, '-7'),
    ('mono16', 1234, '1234'), ('16SC1', -5, '-5'), ('8UC3', 9, '9, 9, 9'),
    ('8UC16', 1, '1, 1, 1, 1, 1, 1, 1, 1, ...')])
def test_value_of_numbers(encoding: str, value: float, text: str) -> None:
    found = find_encoding(encoding)
    shape = (2, 2) if found.channels == 1 else (2, 2, found.channels)
    assert describe_pixel(pixels_of(np.full(shape, value, found.dtype), encoding), 1, 1) == text


def test_value_of_a_turned_jpeg_is_that_of_the_shown_pixel() -> None:
    image = np.full((48, 64, 3), 10, np.uint8)
    image[:, :8] = 200  # the left edge is the upper one after a quarter turn
    jpeg = encode_image(image, '.jpg').tobytes()
    exif = bytes.fromhex('ffe1 0022 457869660000 49492a0008000000 0100 1201030001000000 06000000 '
                         '00000000')
    pixels = read_pixels(WireCompressedImage(
        header=NO_HEADER, format='jpeg', data=jpeg[:2] + exif + jpeg[2:]), upright=True)
    assert pixels.size == (48, 64)
    assert describe_pixel(pixels, 40, 2) == 'B 200, G 200, R 200'
    assert describe_pixel(pixels, 2, 40) == 'B 10, G 10, R 10'


@pytest.mark.parametrize(('x', 'y'), [(64, 0), (0, 48), (2**31, 2**31)])
def test_pixel_outside_is_refused(x: int, y: int) -> None:
    pixels = pixels_of(np.zeros((48, 64), np.uint8), 'mono8')
    with pytest.raises(CodecError, match='64x48'):
        describe_pixel(pixels, x, y)
    for ends in (((0, 0), (x, y)), ((x, y), (0, 0))):
        with pytest.raises(CodecError, match='64x48'):
            line_profile(pixels, *ends)


@pytest.mark.parametrize('encoding', [*ENCODINGS, *GENERIC])
def test_charts_of_every_encoding(encoding: str) -> None:
    pixels = pixels_of(random_image(encoding, 48, 64), encoding)
    for chart in (line_profile(pixels, (3, 4), (60, 40)), histogram(pixels, None)):
        assert 1 <= len(chart['names']) == len(chart['curves']) <= 3
        assert len(json.dumps(chart, allow_nan=False)) < 50_000


def test_profile_has_the_values_of_the_line() -> None:
    image = random_image('bgr8', 48, 64)
    chart = line_profile(pixels_of(image, 'bgr8'), (10, 20), (5, 20))
    assert chart['names'] == ['B', 'G', 'R']
    assert chart['curves'] == image[20, 10:4:-1].T.tolist()
    assert (chart['low'], chart['high']) == (image[20, 5:11].min(), image[20, 5:11].max())
    point = line_profile(pixels_of(image, 'bgr8'), (10, 20), (10, 20))
    assert point['curves'] == [[value] for value in image[20, 10].tolist()]


def test_long_profile_is_bounded_and_has_gaps() -> None:
    image = np.arange(5000, dtype=np.float32)[np.newaxis]
    image[0, :100] = np.nan
    chart = line_profile(pixels_of(image, '32FC1'), (0, 0), (4999, 0))
    assert len(chart['curves'][0]) == MAX_SAMPLES
    assert chart['curves'][0][0] is None and chart['curves'][0][-1] == 4999
    nothing = line_profile(pixels_of(np.full((1, 9), np.inf, np.float32), '32FC1'), (0, 0), (8, 0))
    assert nothing['low'] is None and nothing['curves'] == [[None] * 9]


def test_histogram_of_a_region_and_its_exposure() -> None:
    image = np.zeros((480, 640, 3), np.uint8)
    image[:, 320:] = (100, 255, 3)
    whole = histogram(pixels_of(image, 'bgr8'), None)
    assert (whole['low'], whole['high'], whole['over'], whole['under']) == (0, 255, 0.5, 0.5)
    for curve, place in zip(whole['curves'], (25, 63, 0), strict=True):
        assert len(curve) == BINS and sum(curve) == pytest.approx(1)
        assert curve[place] == (1 if place == 0 else 0.5)
    part = histogram(pixels_of(image, 'bgr8'), Region(x=320, y=0, width=10, height=10))
    assert (part['over'], part['under']) == (1, 0)


@pytest.mark.parametrize(('encoding', 'dtype', 'texts'), [
    ('mono8', np.uint8, ('5', '201', '100')), ('mono16', np.uint16, ('5', '201', '100')),
    ('32FC1', np.float32, ('5.0 m', '201.0 m', '100.0 m')),
    ('bgr8', np.uint8, ('5', '201', '100')),
    ('16UC1', np.uint16, ('5 (0.005 m)', '201 (0.201 m)', '100 (0.100 m)'))])
def test_places_of_the_extremes(encoding: str, dtype: type, texts: tuple[str, str, str]) -> None:
    image = np.full((480, 1280, 3) if encoding == 'bgr8' else (480, 1280), 100, dtype)
    image[7, 1279], image[479, 3] = 201, 5
    image[9, 9] = np.nan if dtype is np.float32 else 100
    chart = histogram(pixels_of(image, encoding), None)
    assert (chart['least'], chart['most']) == ([texts[0], 3, 479], [texts[1], 1279, 7])
    part = histogram(pixels_of(image, encoding), Region(x=1000, y=0, width=280, height=40))
    assert part['most'] == [texts[1], 1279, 7] and part['least'][0] == texts[2]
    nothing = histogram(pixels_of(np.full((2, 2), np.nan, np.float32), '32FC1'), None)
    assert 'least' not in nothing


@pytest.mark.parametrize(('encoding', 'values', 'line', 'counts'), [
    ('16UC1', [1816, 0, 2779], '0 (no depth) to 2779 (2.779 m)',
     '1816 (1.816 m) to 2779 (2.779 m)'),
    ('32FC1', [1.5, np.nan, 2], '1.5 m to 2.0 m', '1.5 m to 2.0 m'),
    ('32FC1', [np.nan], 'nan (no depth)', ''), ('mono8', [7, 9], '7 to 9', '0 to 255'),
    ('32SC1', [-7, 9], '-7 to 9', '-7 to 9')])
def test_ends_of_charts_as_values_of_pixels(
        encoding: str, values: list[float], line: str, counts: str) -> None:
    pixels = pixels_of(np.array([values], find_encoding(encoding).dtype), encoding)
    assert line_profile(pixels, (0, 0), (len(values) - 1, 0))['ends'] == line
    assert histogram(pixels, None)['ends'] == counts


@pytest.mark.parametrize(('width', 'height'), [(1, 1), (320, 240), (641, 479), (3840, 2)])
def test_each_over_exposed_pixel_is_in_a_cell(width: int, height: int) -> None:
    image = np.zeros((height, width), np.uint8)
    image[0, width // 2], image[height - 1, width - 1] = 254, 255
    found = exposed(pixels_of(image, 'mono8'), None)
    cells = np.unpackbits(np.frombuffer(b64decode(found['bits']), np.uint8))
    place, = np.flatnonzero(cells)
    row, column = divmod(int(place), found['columns'])
    assert (column, row) == ((width - 1) // found['step'], (height - 1) // found['step'])
    assert found['columns'] <= 320
    part = exposed(pixels_of(image, 'mono8'), Region(x=0, y=0, width=1, height=1))
    assert part['place'] == [0, 0]


def test_floats_are_not_over_exposed() -> None:
    with pytest.raises(CodecError, match='32FC1 has no largest value'):
        exposed(pixels_of(np.zeros((2, 2), np.float32), '32FC1'), None)


def test_histogram_of_floats() -> None:
    image = np.tile(np.linspace(-1, 3, 400, dtype=np.float32), (4, 1))
    image[0] = np.nan
    chart = histogram(pixels_of(image, '32FC1'), None)
    assert (chart['low'], chart['high'], chart['over'], chart['missing']) == (-1, 3, 0, 0.25)
    assert sum(chart['curves'][0]) == pytest.approx(0.75)
    for values in ([1e308, -1e308], [np.nan], [5, 5], [-1e308] * 2):
        extreme = histogram(pixels_of(np.array([values], np.float64), '64FC1'), None)
        json.dumps(extreme, allow_nan=False)
        assert len(extreme['curves'][0]) == BINS
    assert (extreme['low'], extreme['high']) == (-1e300, -1e300)


@pytest.mark.parametrize(('values', 'encoding', 'bounds'), [
    ([3, 3], '16UC1', (3, 3)), ([7, 7], '32SC1', (7, 7)), ([-2.5] * 2, '32FC1', (-2.5, -2.5)),
    ([1e300, 1e308], '64FC1', (1e300, 1e300)), ([3, 14], 'mono16', (3, 14)),
    ([np.nan] * 2, '32FC1', (None, None)), ([0, 0], '16UC1', (None, None))])
def test_bounds_of_a_histogram(
        values: list[float], encoding: str, bounds: tuple[float | None, float | None]) -> None:
    image = np.array([values], find_encoding(encoding).dtype)
    chart = histogram(pixels_of(image, encoding), None)
    assert (chart['low'], chart['high']) == bounds
    (curve,) = chart['curves']
    assert sum(curve) == (0 if bounds[0] is None else 1) and len(curve) == BINS
    assert sum(value > 0 for value in curve) == len({*bounds} - {None})


@pytest.mark.parametrize(('encoding', 'over', 'under', 'missing', 'lacking'), [
    ('16UC1', 0, 0, 0.25, 'depth'), ('32FC1', 0, 0, 0.25, 'depth'),
    ('mono16', 0.25, 0.25, 0, 'a number'), ('64FC1', 0, 0, 0, 'a number')])
def test_exposure_and_pixels_without_depth(
        encoding: str, over: float, under: float, missing: float, lacking: str) -> None:
    image = np.array([[0, 65535, 4, 5]], find_encoding(encoding).dtype)
    chart = histogram(pixels_of(image, encoding), None)
    assert (chart['over'], chart['under'], chart['missing'], chart['lacking']) == (
        over, under, missing, lacking)


def test_histogram_of_a_large_bayer_image_counts_all_colours() -> None:
    image = np.zeros((1024, 1280), np.uint8)
    image[::2, 1::2] = image[1::2, ::2] = 255  # the green pixels of rggb
    chart = histogram(pixels_of(image, 'bayer_rggb8'), None)
    assert chart['over'] == pytest.approx(0.5, abs=0.01)


def test_histogram_of_the_largest_floats() -> None:
    chart = histogram(pixels_of(np.full((4, 4), 1.5e308), '64FC1'), None)
    assert np.isfinite([chart['low'], chart['high']]).all()


def test_values_of_disparity() -> None:
    numbers = np.array([[-1, 0, 1.5], [np.nan, 2, np.inf]], np.float32)
    pixels = read_pixels(WireDisparity(
        header=NO_HEADER, height=2, width=3, encoding='32FC1', is_bigendian=False, step=12,
        data=numbers.tobytes(), min_disparity=0.5))
    assert [[describe_pixel(pixels, x, y) for x in range(3)] for y in range(2)] == [
        ['no disparity', 'no disparity', '1.5 px'], ['no disparity', '2.0 px', 'no disparity']]
    assert line_profile(pixels, (0, 0), (2, 0))['curves'] == [[None, None, 1.5]]
