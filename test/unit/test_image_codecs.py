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

"""Image files in messages: lossless codecs, quality, orientation and format strings."""

from __future__ import annotations

import itertools

import cv2
from images import oriented_jpeg, random_image, UPRIGHT
import numpy as np
from opencv_tools import image_codecs
from opencv_tools.cv_bridge import CvBridge, CvBridgeError
from opencv_tools.image.color import convert
from opencv_tools.image.encodings import COLOR_ENCODINGS, ENCODINGS
from opencv_tools.image.errors import CodecError, ImageError
from opencv_tools.image.picture_formats import MAX_SIDES
from opencv_tools.image_codecs import convert_image, decode_image, encode_image
from opencv_tools.recording.frames import CompressedFrame
from opencv_tools.recording.image_encoder import encode_frame, EncoderSettings
from opencv_tools.recording.naming import FrameMetadata
import pytest
from sensor_msgs.msg import CompressedImage
import simplejpeg

LOSSLESS = ('png', 'bmp', 'dib', 'tif', 'tiff', 'sr', 'ras', 'ppm')
LOSSY = ('jpg', 'jpeg', 'jpe')
# OpenCV before 4.14 has errors of 1 in the conversion of Bayer mosaics to gray.
OLD_BAYER = tuple(map(int, cv2.__version__.split('.')[:2])) < (4, 14)


def compressed(image: np.ndarray, suffix: str, text: str) -> CompressedImage:
    """Create a message with OpenCV only, as another node would."""
    message = CompressedImage(format=text)
    message.data.frombytes(cv2.imencode(suffix, image)[1].tobytes())
    return message


def smooth_image(height: int, width: int) -> np.ndarray:
    """Return a smooth BGR image, which JPEG stores with small errors."""
    return cv2.GaussianBlur(random_image('bgr8', height, width), (0, 0), 5)


@pytest.mark.parametrize('codec', LOSSLESS)
def test_lossless_codecs_keep_every_pixel(codec: str) -> None:
    bridge = CvBridge()
    image = random_image('bgr8', 40, 50)
    message = bridge.cv2_to_compressed_imgmsg(image, codec)
    assert message.format == codec
    np.testing.assert_array_equal(bridge.compressed_imgmsg_to_cv2(message), image)
    np.testing.assert_array_equal(
        bridge.compressed_imgmsg_to_cv2(message, 'rgb8'), image[..., ::-1])


@pytest.mark.parametrize('codec', LOSSY)
def test_jpeg_extensions_and_quality(codec: str) -> None:
    bridge = CvBridge()
    image = smooth_image(120, 160)
    sizes = []
    for quality in (10, 60, 100):
        message = bridge.cv2_to_compressed_imgmsg(image, codec, quality=quality)
        assert message.format == codec
        expected = cv2.imencode('.jpg', image, (cv2.IMWRITE_JPEG_QUALITY, quality))[1]
        assert message.data.tobytes() == expected.tobytes()
        sizes.append(len(message.data))
    assert sizes == sorted(sizes)
    default = bridge.cv2_to_compressed_imgmsg(image, codec)
    assert default.data.tobytes() == cv2.imencode('.jpg', image)[1].tobytes()


@pytest.mark.parametrize('suffix', MAX_SIDES)
def test_image_that_is_too_long_is_refused_without_a_log(
        suffix: str, capfd: pytest.CaptureFixture[str]) -> None:
    longest = np.zeros((MAX_SIDES[suffix], 1, 3), np.uint8)
    for image in (longest, longest.swapaxes(0, 1)):
        assert decode_image(encode_image(image, suffix)).shape == image.shape
        with pytest.raises(CodecError, match=f'is too long for {suffix[1:]}: the limit is'):
            encode_image(np.concatenate((image, image), axis=int(image.shape[0] == 1)), suffix)
    assert capfd.readouterr() == ('', '')  # OpenCV logs what it refuses


def test_16_bit_png_is_kept() -> None:
    bridge = CvBridge()
    depth = random_image('mono16', 30, 40)
    message = bridge.cv2_to_compressed_imgmsg(depth, 'png')
    np.testing.assert_array_equal(bridge.compressed_imgmsg_to_cv2(message), depth)
    np.testing.assert_array_equal(bridge.compressed_imgmsg_to_cv2(message, 'mono16'), depth)


@pytest.mark.parametrize('orientation', UPRIGHT)
def test_exif_orientation_is_applied_only_on_request(orientation: int) -> None:
    jpeg = oriented_jpeg(random_image('bgr8', 16, 24), orientation)
    lying = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(decode_image(jpeg), lying, strict=True)
    np.testing.assert_array_equal(
        decode_image(jpeg, upright=True), UPRIGHT[orientation](lying), strict=True)
    message = CompressedImage(format='jpeg')
    message.data.frombytes(jpeg)
    for desired in ('passthrough', '', 'bgr8'):
        np.testing.assert_array_equal(
            CvBridge().compressed_imgmsg_to_cv2(message, desired), lying, strict=True)
    recorded = CompressedFrame(
        metadata=FrameMetadata(1, 'camera', 'jpeg', '/video_frames/compressed'), receive_ns=1,
        data=jpeg)
    assert encode_frame(recorded, EncoderSettings('.jpg')).data is jpeg
    np.testing.assert_array_equal(recorded.decode().image, lying, strict=True)


SAMPLINGS = {name.rpartition('_')[2]: value for name, value in vars(cv2).items()
             if name.startswith('IMWRITE_JPEG_SAMPLING_FACTOR_')}


@pytest.mark.parametrize('sampling', [None, *SAMPLINGS.values()], ids=['', *SAMPLINGS])
@pytest.mark.parametrize('size', [(16, 32), (37, 53)])
def test_jpeg_decoded_into_an_array(size: tuple[int, int], sampling: int | None) -> None:
    options = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling) if sampling else ()
    content = cv2.imencode('.jpg', random_image('bgr8', *size), options)[1].tobytes()
    out = np.zeros((*size, 3), np.uint8)
    assert decode_image(content, lend=lambda *shape: out if shape == size else None) is out
    np.testing.assert_array_equal(out, decode_image(content))
    assert decode_image(content, lend=lambda *_: None) is not out


def test_damaged_jpeg_decoded_into_an_array() -> None:
    # The same image in each run: the decoders fill what is damaged in different ways at times.
    image = np.random.default_rng(7).integers(0, 256, (64, 64, 3), np.uint8)
    whole = cv2.imencode('.jpg', image)[1].tobytes()
    refused = 0
    for place in range(len(whole) // 2, len(whole) - 2, 40):
        # Neither a marker nor a stuffed zero comes or goes.
        content = whole[:place] + bytes([whole[place] ^ (1 < whole[place] < 254)]) + whole[
            place + 1:]
        try:
            simplejpeg.decode_jpeg(content)
        except ValueError:
            refused += 1
        out = np.zeros((64, 64, 3), np.uint8)
        assert decode_image(content, lend=lambda *_: out) is out  # noqa: B023
        np.testing.assert_array_equal(out, decode_image(content))
    assert refused > 5


@pytest.mark.parametrize('content', [
    cv2.imencode('.jpg', random_image('mono8', 6, 9))[1],
    cv2.imencode('.png', random_image('bgr8', 6, 9))[1]], ids=['gray', 'png'])
def test_images_that_are_not_decoded_into_an_array(content: np.ndarray) -> None:
    found = decode_image(content, lend=lambda *_: pytest.fail('nothing is written'))
    np.testing.assert_array_equal(found, cv2.imdecode(content, cv2.IMREAD_UNCHANGED))


def test_cut_jpeg_is_not_decoded_into_an_array() -> None:
    content = cv2.imencode('.jpg', random_image('bgr8', 64, 64))[1].tobytes()
    with pytest.raises(CodecError, match='end is missing'):
        decode_image(content[:-200], lend=lambda *_: np.zeros((64, 64, 3), np.uint8))


def test_jpeg_without_simplejpeg(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(image_codecs, '_simplejpeg', lambda: None)
    content = cv2.imencode('.jpg', random_image('bgr8', 6, 9))[1]
    found = decode_image(content, lend=lambda *_: pytest.fail('nothing is written'))
    np.testing.assert_array_equal(found, cv2.imdecode(content, cv2.IMREAD_UNCHANGED))


@pytest.mark.parametrize('upright', [False, True])
def test_only_a_jpeg_is_rotated_upright(upright: bool) -> None:
    for encoding in ('mono16', 'bgra8', 'bgr8'):
        image = random_image(encoding, 6, 9)
        png = cv2.imencode('.png', image)[1]
        np.testing.assert_array_equal(decode_image(png, upright), image, strict=True)


@pytest.mark.parametrize(('picture', 'suffix', 'text', 'desired', 'expected'), [
    ('bgr8', '.png', 'bgr8; png compressed bgr8', 'rgb8', 'bgr8'),
    ('bgr8', '.png', 'rgb8; png compressed bgr8', 'mono8', 'bgr8'),
    ('bgr8', '.png', 'rgb8; png compressed rgb8', 'bgr8', 'rgb8'),
    ('mono8', '.png', 'mono8; jpeg compressed mono8', 'bgr8', 'mono8'),
    ('mono8', '.png', 'bayer_rggb8; png compressed ', 'bgr8', 'bayer_rggb8'),
    ('mono16', '.png', '16UC1; png compressed ', '32FC1', '16UC1'),
    ('mono16', '.png', 'mono16; png compressed mono16', 'mono8', 'mono16'),
    ('bgra8', '.png', 'png', 'rgb8', 'bgra8'),
    ('mono8', '.png', 'png', 'rgb8', 'mono8'),
    ('mono8', '.png', 'foo; png compressed bar', 'rgb8', 'mono8'),
    ('bgr8', '.png', '32FC1; png compressed mono8', 'rgb8', 'bgr8'),
])
def test_encoding_in_the_format_string_is_used(
        picture: str, suffix: str, text: str, desired: str, expected: str) -> None:
    bridge = CvBridge()
    image = random_image(picture, 12, 14)
    message = compressed(image, suffix, text)
    np.testing.assert_array_equal(bridge.compressed_imgmsg_to_cv2(message), image)
    np.testing.assert_array_equal(bridge.compressed_imgmsg_to_cv2(message, ''), image)
    np.testing.assert_array_equal(
        bridge.compressed_imgmsg_to_cv2(message, desired),
        bridge.imgmsg_to_cv2(bridge.cv2_to_imgmsg(image, expected), desired))


def test_depth_image_is_not_read_as_gray() -> None:
    message = compressed(random_image('mono16', 4, 5), '.png', '16UC1; png compressed ')
    with pytest.raises(CvBridgeError, match=r'\[16UC1\] is not a color format. but \[mono8\] is.'):
        CvBridge().compressed_imgmsg_to_cv2(message, 'mono8')


def test_rgb_array_is_stored_as_bgr_by_its_format_string() -> None:
    bridge = CvBridge()
    image = random_image('rgb8', 12, 14)
    message = bridge.cv2_to_compressed_imgmsg(image, 'rgb8; png compressed bgr8')
    assert message.format == 'rgb8; png compressed bgr8'
    np.testing.assert_array_equal(bridge.compressed_imgmsg_to_cv2(message), image[..., ::-1])
    np.testing.assert_array_equal(bridge.compressed_imgmsg_to_cv2(message, 'rgb8'), image)


@pytest.mark.parametrize(('image', 'text', 'quality', 'reason'), [
    (np.zeros((2, 3), np.uint16), 'jpg', None,
     'a 3x2 16UC1 image cannot be stored as jpg; use png or tif or tiff or pgm'),
    (np.zeros((2, 3, 4), np.uint8), 'jpeg', None,
     'a 3x2 8UC4 image cannot be stored as jpeg; use png'),
    (np.zeros((2, 3, 2), np.float32), 'png', None, 'no picture format can store it'),
    (np.zeros((2, 3), np.uint8), 'gif2', None, "unknown picture format 'gif2'; give one of png"),
    (np.zeros((2, 3), np.uint8), '', None, "unknown picture format ''"),
    (np.zeros((2, 3), np.uint8), 'jpg', 101, 'quality 101 is invalid for jpg'),
    (np.zeros((2, 3), np.uint8), 'png', 50, 'quality 50 is invalid for png'),
    (np.zeros((2, 3, 3), np.uint8), 'mono8; png compressed mono8', None,
     'encoding specified as mono8, but image has incompatible type 8UC3'),
])
def test_images_that_cannot_be_compressed_are_refused(
        image: np.ndarray, text: str, quality: int | None, reason: str) -> None:
    with pytest.raises(CvBridgeError) as caught:
        CvBridge().cv2_to_compressed_imgmsg(image, text, quality=quality)
    assert reason in str(caught.value)
    with pytest.raises(TypeError, match='Your input type is not a numpy array'):
        CvBridge().cv2_to_compressed_imgmsg([1, 2])


def test_conversion_equals_that_without_opencv() -> None:
    sizes = ((0, 4), (1, 2), (2, 2), (3, 4), (7, 5), (34, 30))
    wrong = []
    for (source, left), desired, size in itertools.product(
            ENCODINGS.items(), COLOR_ENCODINGS, sizes):
        pair = 2 if left.kind == 'yuv' else 1
        image = random_image(source, size[0] // pair * pair, size[1] // pair * pair)
        tolerance = 1 if left.kind == 'bayer' and OLD_BAYER else 0
        for strided in (image, np.concatenate([image, image], 1)[:, :image.shape[1]]):
            expected = convert(strided, left, ENCODINGS[desired])
            converted = convert_image(strided, left, ENCODINGS[desired])
            if ((converted.dtype, converted.shape) != (expected.dtype, expected.shape)
                    or not np.allclose(converted, expected, rtol=0, atol=tolerance)
                    or np.shares_memory(converted, image)):
                wrong.append((source, desired, size, strided is image))
    assert not wrong


@pytest.mark.parametrize('source', [
    name for name, encoding in ENCODINGS.items()
    if encoding.dtype == 'uint8' and encoding.order != 'nv24'])
def test_opencv_converts_supported_pairs(monkeypatch: pytest.MonkeyPatch, source: str) -> None:
    left = ENCODINGS[source]
    image = random_image(source, 12, 14)
    targets = [ENCODINGS[name] for name in ('bgr8', 'rgb8', 'bgra8', 'rgba8', 'mono8')
               if name != source]
    expected = [convert(image, left, target) for target in targets]
    monkeypatch.setattr('opencv_tools.image_codecs.convert',
                        lambda *_: pytest.fail('not by OpenCV'))
    for target, settings in zip(targets, expected, strict=True):
        tolerance = 1 if left.kind == 'bayer' and OLD_BAYER else 0
        np.testing.assert_allclose(
            convert_image(image, left, target), settings, rtol=0, atol=tolerance)


@pytest.mark.parametrize(('source', 'target'), [
    ('uyvy', 'mono8'), ('yuyv', 'mono8'), ('nv24', 'mono8'),
    ('nv24', 'bgr8')])  # nv24 has chroma for each pixel
def test_odd_width_equals_the_conversion_without_opencv(source: str, target: str) -> None:
    left, right = ENCODINGS[source], ENCODINGS[target]
    image = random_image(source, 4, 5)
    np.testing.assert_array_equal(
        convert_image(image, left, right), convert(image, left, right), strict=True)


@pytest.mark.parametrize('source', ['uyvy', 'yuyv'])
def test_colours_of_an_odd_width(source: str) -> None:
    with pytest.raises(ImageError, match=r'must have an even width .* a row has 5 pixels'):
        convert_image(random_image(source, 4, 5), ENCODINGS[source], ENCODINGS['bgr8'])
