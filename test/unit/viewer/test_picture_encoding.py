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

"""Pictures of every encoding, scaled and unscaled, and broken images."""

from __future__ import annotations

import cv2
from images import oriented_jpeg, random_image, UPRIGHT
import numpy as np
from opencv_tools.cv_bridge import CvBridgeError
from opencv_tools.image.cdr import NO_HEADER, WireCompressedImage, WireImage
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.image.errors import CodecError, ImageError
from opencv_tools.image.layout import array_to_wire
from opencv_tools.image_codecs import encode_image
from opencv_tools.viewer.region import Region
from opencv_tools.viewer.streams.depth_colors import Steady
from opencv_tools.viewer.streams.encoding import encode_picture, Picture, PictureOptions
import pytest

FULL = PictureOptions(0, 95)


def pixels(picture: Picture) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image.shape[:2] == (picture.height, picture.width)
    return image


def gradient(width: int = 640, height: int = 480) -> np.ndarray:
    """Return a colour image that a JPEG hardly changes."""
    rows, columns = np.mgrid[:height, :width]
    return np.dstack((columns * 255 // width, rows * 255 // height,
                      np.full((height, width), 90))).astype(np.uint8)


def wire(image: np.ndarray, encoding: str) -> WireImage:
    return array_to_wire(image, find_encoding(encoding))


def compressed(data: bytes, name: str = 'jpeg') -> WireCompressedImage:
    return WireCompressedImage(header=NO_HEADER, format=name, data=data)


def turned(shown: np.ndarray, orientation: int) -> bytes:
    """Return a JPEG of an image that browsers turn by its Exif orientation."""
    inverse = {6: 8, 8: 6}.get(orientation, orientation)
    return oriented_jpeg(np.ascontiguousarray(UPRIGHT[inverse](shown)), orientation)


@pytest.mark.parametrize('width', [0, 33, 64, 640])
def test_every_encoding_is_shown(width: int) -> None:
    wrong = []
    for encoding in (*ENCODINGS, '8UC1', '8UC3', '16UC1', '16SC1', '32SC1', '32FC1', '64FC1',
                     '32FC3', '16UC3'):
        picture = encode_picture(wire(random_image(encoding, 48, 64), encoding),
                                 PictureOptions(width, 80))
        if (picture.source_size != (64, 48) or picture.width > (width or 64)
                or pixels(picture).dtype != np.uint8):
            wrong.append(encoding)
    assert not wrong


@pytest.mark.parametrize('encoding', ['bgr8', 'rgb8', 'bgra8', 'mono8'])
def test_colours_stay(encoding: str) -> None:
    image = gradient()
    codes = {'rgb8': cv2.COLOR_BGR2RGB, 'bgra8': cv2.COLOR_BGR2BGRA, 'mono8': cv2.COLOR_BGR2GRAY}
    source = cv2.cvtColor(image, codes[encoding]) if encoding in codes else image
    expected = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if encoding == 'mono8' else image
    for width, scale in ((0, 1), (320, 2), (160, 4)):
        shown = pixels(encode_picture(wire(source, encoding), PictureOptions(width, 95)))
        difference = np.abs(shown.astype(int) - cv2.resize(
            expected, (640 // scale, 480 // scale), interpolation=cv2.INTER_AREA))
        assert difference.max() < 12


def test_pictures_are_never_enlarged() -> None:
    picture = encode_picture(wire(gradient(64, 48), 'bgr8'), PictureOptions(640, 80, height=480))
    assert (picture.width, picture.height) == (64, 48)


@pytest.mark.parametrize(('options', 'size'), [
    (PictureOptions(320, 80), (320, 240)), (PictureOptions(0, 80, height=120), (160, 120)),
    (PictureOptions(320, 80, height=120), (160, 120)), (PictureOptions(1, 80), (1, 1))])
def test_sizes(options: PictureOptions, size: tuple[int, int]) -> None:
    for message in (wire(gradient(), 'bgr8'), compressed(encode_image(gradient(), '.jpg'))):
        picture = encode_picture(message, options)
        assert (picture.width, picture.height) == size
        assert not picture.is_kept


def test_jpeg_is_kept_byte_for_byte() -> None:
    jpeg = encode_image(gradient(), '.jpg').tobytes()
    for options in (PictureOptions(0, 50), PictureOptions(640, 50), PictureOptions(1280, 50)):
        picture = encode_picture(compressed(jpeg), options)
        assert picture.is_kept
        assert picture.data == jpeg
        assert picture.source_size == (640, 480)
    lower = encode_picture(compressed(jpeg), PictureOptions(0, 20, keep=False))
    assert len(lower.data) < len(jpeg)


def test_png_of_a_compressed_topic_becomes_jpeg() -> None:
    png = encode_image(gradient(), '.png').tobytes()
    picture = encode_picture(compressed(png, 'bgr8; png compressed bgr8'), FULL)
    assert picture.data.startswith(b'\xff\xd8')
    assert np.abs(pixels(picture).astype(int) - gradient()).max() < 12


def test_depth_is_scaled_from_the_frame_or_the_given_range() -> None:
    depth = np.tile(np.linspace(1000, 3000, 64).astype(np.uint16), (48, 1))
    depth[0] = 0  # no depth was measured
    picture = encode_picture(wire(depth, '16UC1'), FULL)
    assert picture.limits == picture.measured == (depth[1, 1], depth[1, -2])  # without the ends
    assert picture.unit == 'mm'
    shown = pixels(picture)[24].astype(int)
    assert shown[0].max() < 6 and shown[-1].min() > 249 and np.abs(shown[32] - 128).max() < 8
    given = pixels(encode_picture(wire(depth, '16UC1'), PictureOptions(0, 95, limits=(0, 6000))))
    assert np.abs(given[24, -1].astype(int) - 128).max() < 6


def test_floats_with_holes_are_scaled() -> None:
    depth = np.tile(np.linspace(0.5, 4.5, 64).astype(np.float32), (48, 1))
    depth[:8], depth[8:16], depth[16:24] = np.nan, np.inf, -np.inf
    picture = encode_picture(wire(depth, '32FC1'), FULL)
    assert picture.limits == (depth[-1, 1], depth[-1, -2])
    assert picture.unit == 'm'
    assert pixels(picture)[40, -1].min() > 249


@pytest.mark.parametrize(('encoding', 'value'), [
    ('16UC1', 0), ('32FC1', 0), ('32FC1', np.nan), ('32FC1', np.inf), ('64FC1', -np.inf)])
@pytest.mark.parametrize('size', [(48, 64), (480, 640)])
def test_pixels_without_depth_are_blue(
        encoding: str, value: float, size: tuple[int, int]) -> None:
    depth = np.full(size, 700, f'{encoding[2].lower()}{int(encoding[:2]) // 8}')
    depth[:, size[1] // 2:] = 2000
    depth[:size[0] // 2] = value
    shown = pixels(encode_picture(wire(depth, encoding), FULL)).astype(int)
    missing, near, far = shown[5, 5], shown[-5, 5], shown[-5, -5]
    assert missing[0] - missing[1:].max() > 80
    assert near.max() < 6 and far.min() > 249


def test_constant_depth_is_gray_and_no_depth_is_blue() -> None:
    near, none = (pixels(encode_picture(wire(np.full((48, 64), value, np.uint16), '16UC1'), FULL))
                  for value in (700, 0))
    assert near.shape == (48, 64) and (near == 128).all()
    assert np.abs(none.astype(int) - (110, 0, 0)).max() < 8


@pytest.mark.parametrize('width', [0, 320])
def test_exif_orientation_is_applied_like_in_a_browser(width: int) -> None:
    picture = encode_picture(
        compressed(turned(gradient(480, 640), 6)), PictureOptions(width, 80))
    assert picture.height > picture.width
    assert picture.is_kept == (width == 0)
    assert (picture.source_size, picture.region.values) == ((480, 640), (0, 0, 480, 640))


@pytest.mark.parametrize('size', [(639, 640), (640, 639), (15, 16)])
@pytest.mark.parametrize('orientation', [1, 6])
def test_jpeg_that_is_nearly_square(size: tuple[int, int], orientation: int) -> None:
    message = compressed(turned(gradient(*size), orientation))
    for options in (FULL, PictureOptions(size[0] // 8, 90), PictureOptions(0, 90, keep=False)):
        picture = encode_picture(message, options)
        assert (picture.source_size, picture.region.values) == (size, (0, 0, *size))


@pytest.mark.quick_cases(12)
@pytest.mark.parametrize('orientation', range(1, 9))
@pytest.mark.parametrize(('region', 'width'), [
    (None, 100), (None, 480), ((0, 0, 1000, 1000), 300), ((1006, 1002, 604, 594), 70),
    ((1002, 1006, 901, 499), 300), ((602, 222, 999, 1279), 40)])
def test_place_of_a_region_of_a_reduced_jpeg(
        orientation: int, region: tuple[int, int, int, int] | None, width: int) -> None:
    edge = (803, 709) if region and region[0] == 0 else (1203, 1109)  # white begins there
    shown = np.zeros((1505, 1903, 3), np.uint8)
    shown[edge[1]:, edge[0]:] = 255
    wanted = region and Region(**dict(zip(('x', 'y', 'width', 'height'), region, strict=True)))
    picture = encode_picture(compressed(turned(shown, orientation)),
                             PictureOptions(width, 100, region=wanted))
    found = pixels(picture)[..., 0] / 255
    assert found.shape[1] == width and picture.source_size == (1903, 1505)
    x, y, *sides = picture.region.values
    for axis, begin in enumerate((x, y)):
        count = found.shape[1 - axis]
        line = found[-1] if axis == 0 else found[:, -1]
        place = begin + (count - line.sum()) * sides[axis] / count
        assert place == pytest.approx(edge[axis], abs=0.2 * sides[axis] / count)


def test_broken_images_are_refused() -> None:
    jpeg = encode_image(gradient(), '.jpg').tobytes()
    huge = bytearray(jpeg)
    place = jpeg.index(b'\xff\xc0')
    huge[place + 5:place + 9] = b'\xff\xff\xff\xff'  # 65535 x 65535 pixels
    broken = [compressed(jpeg[:-200]), compressed(jpeg[:30]), compressed(b''), compressed(b'x'),
              compressed(bytes(huge)), compressed(b'\xff\xd8' + bytes(1000)),
              wire(np.zeros((0, 0, 3), np.uint8), 'bgr8'),
              WireImage(header=NO_HEADER, height=48, width=64, encoding='bgr8',
                        is_bigendian=False, step=192, data=bytes(100)),
              WireImage(header=NO_HEADER, height=2**31, width=2**31, encoding='bgr8',
                        is_bigendian=False, step=0, data=b''),
              WireImage(header=NO_HEADER, height=1, width=1, encoding='nonsense',
                        is_bigendian=False, step=1, data=b'1')]
    for message in broken:
        for options in (FULL, PictureOptions(160, 80)):
            with pytest.raises((CvBridgeError, ImageError)):
                encode_picture(message, options)


@pytest.mark.parametrize('size', [(65_501, 1), (1, 65_501)])
def test_picture_that_is_too_long_for_jpeg(
        size: tuple[int, int], capfd: pytest.CaptureFixture[str]) -> None:
    image = np.zeros(size, np.uint8)
    with pytest.raises(CodecError, match='picture is too long for JPEG'):
        encode_picture(wire(image, 'mono8'), FULL)
    assert capfd.readouterr() == ('', '')  # OpenCV logs what it refuses
    longest = image[:65_500, :65_500]
    assert pixels(encode_picture(wire(longest, 'mono8'), FULL)).shape == longest.shape


@pytest.mark.skipif(not hasattr(cv2, 'IMWRITE_JPEG_SAMPLING_FACTOR'),
                    reason='OpenCV before 4.7 stores the colour of four pixels as one')
def test_colours_of_single_pixels() -> None:
    image = np.array([[[0, 0, 255], [0, 255, 0]], [[255, 0, 0], [255, 255, 255]]], np.uint8)
    image = np.tile(image, (8, 8, 1))
    picture = encode_picture(wire(image, 'bgr8'), PictureOptions(0, 95))
    shown = cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(shown.astype(int) - image).max() < 40


def test_fine_pattern_that_is_made_much_smaller() -> None:
    image = np.zeros((700, 700), np.uint8)
    image[:, ::7] = 210  # every seventh column, a mean of 30
    picture = encode_picture(wire(image, 'mono8'), PictureOptions(100, 100))
    shown = cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert np.abs(shown.astype(int) - 30).max() <= 2


REGION = Region(x=128, y=64, width=64, height=48)


@pytest.mark.parametrize('encoding', [*ENCODINGS, '16UC1', '32SC1', '32FC1'])
@pytest.mark.parametrize('width', [0, 32])
def test_region_has_the_pixels_of_the_whole_picture(encoding: str, width: int) -> None:
    image = random_image(encoding, 192, 256)
    if encoding == '16UC1':
        image = np.maximum(image, 1)  # each pixel has a depth
    limits = (0, 1000) if encoding in ('16UC1', 'mono16', '32FC1') else None
    whole, part = (encode_picture(wire(image, encoding), PictureOptions(
        size, 100, limits=limits, region=region))
        for size, region in ((4 * width, None), (width, REGION)))
    assert part.source_size == whole.source_size == (256, 192)
    assert (part.region, whole.region.values) == (REGION, (0, 0, 256, 192))
    assert (part.width, part.height) == ((32, 24) if width else (64, 48))
    factor = 2 if width else 1
    expected = pixels(whole)[64 // factor:112 // factor, 128 // factor:192 // factor].astype(int)
    # The colours at the edges of a Bayer image and of the blocks of a JPEG differ.
    assert np.median(np.abs(pixels(part).astype(int) - expected)) < 6


@pytest.mark.parametrize(('name', 'ending'), [('jpeg', '.jpg'), ('png', '.png')])
@pytest.mark.parametrize('width', [0, 80])
def test_region_of_a_compressed_image(name: str, ending: str, width: int) -> None:
    message = compressed(encode_image(gradient(), ending).tobytes(), name)
    region = Region(x=320, y=160, width=160, height=120)
    picture = encode_picture(message, PictureOptions(width, 95, region=region))
    assert not picture.is_kept
    assert (picture.region, picture.source_size) == (region, (640, 480))
    expected = cv2.resize(region.crop(gradient()), (picture.width, picture.height),
                          interpolation=cv2.INTER_AREA)
    assert picture.width == (width or 160)
    assert np.abs(pixels(picture).astype(int) - expected).max() < 12


def test_region_of_a_turned_jpeg_is_that_of_the_shown_image() -> None:
    shown = cv2.rotate(gradient(), cv2.ROTATE_90_CLOCKWISE)
    region = Region(x=0, y=480, width=480, height=160)  # below a picture that is not turned
    picture = encode_picture(compressed(turned(shown, 6)),
                             PictureOptions(0, 95, region=region))
    assert (picture.region, picture.source_size) == (region, (480, 640))
    expected = region.crop(shown)
    assert np.abs(pixels(picture).astype(int) - expected).max() < 12


def test_depth_in_turbo() -> None:
    depth = np.tile(np.linspace(1000, 3000, 640).astype(np.uint16), (480, 1))
    depth[:240] = 0
    options = PictureOptions(0, 95, colors='turbo', limits=(1000, 3000))
    shown = pixels(encode_picture(wire(depth, '16UC1'), options)).astype(int)
    expected = cv2.applyColorMap(np.array([[0, 128, 255]], np.uint8), cv2.COLORMAP_TURBO)[0]
    for column, color in zip((0, 320, 639), expected, strict=True):
        assert np.abs(shown[400, column] - color).max() < 16
    assert np.abs(shown[100] - 128).max() < 4  # no depth is gray, as no colour of the map
    mono = pixels(encode_picture(wire(depth, 'mono16'), options)).astype(int)
    assert mono.ndim == 2  # not a depth


def test_wild_pixels_do_not_change_the_range() -> None:
    depth = np.random.default_rng(3).normal(2000, 100, (480, 640)).astype(np.uint16)
    calm = encode_picture(wire(depth, '16UC1'), FULL).limits
    depth.flat[::101] = 65535
    assert encode_picture(wire(depth, '16UC1'), FULL).limits == pytest.approx(calm, rel=0.02)


def test_steady_range_is_used_unless_a_range_is_chosen() -> None:
    depth = wire(np.tile(np.arange(1000, 1640).astype(np.uint16), (480, 1)), '16UC1')
    picture = encode_picture(depth, FULL, Steady((0.0, 5000.0)))
    assert picture.limits == (0, 5000) and picture.measured == pytest.approx((1013, 1626), abs=3)
    chosen = encode_picture(depth, PictureOptions(0, 95, limits=(1, 2)), Steady((0.0, 5000.0)))
    assert chosen.limits == (1, 2)
    region = PictureOptions(0, 95, region=REGION)
    assert encode_picture(depth, region).measured == picture.measured  # of the whole image
