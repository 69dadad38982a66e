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

from __future__ import annotations

from typing import Any

import cv2
from images import draw_pattern
import numpy as np
from opencv_tools.capture.frame import CapturedFrame, JPEG, Recorded
from opencv_tools.capture.output_image import (
    depth_form, depth_loss, describe_reduction, expected_encoding, OutputImage, why_no_depth)
from opencv_tools.capture.settings import CaptureSettings
from opencv_tools.frames.frame import Frame
from opencv_tools.image.cdr import NO_HEADER, WireCompressedImage
from opencv_tools.image.compressed_depth import DepthSettings
from opencv_tools.image.encodings import Encoding, find_encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.image.layout import view_image
from opencv_tools.image.orientation import FLIPS, orient
from opencv_tools.image_codecs import decode_compressed, encode_depth
import pytest

PICTURE = draw_pattern(12, 64, 48)
JPEG_BYTES = cv2.imencode('.jpg', PICTURE)[1].reshape(-1)
DECODED = cv2.imdecode(JPEG_BYTES, cv2.IMREAD_UNCHANGED)


NUMBERS = np.random.default_rng(4).integers(0, 256, (72, 64, 2), np.uint8)


def frame_of(encoding: str) -> CapturedFrame:
    image = {
        'bgr8': PICTURE, 'mono8': cv2.cvtColor(PICTURE, cv2.COLOR_BGR2GRAY),
        'rgb8': PICTURE[..., ::-1], 'bgr16': PICTURE * np.uint16(257),
        'yuv422_yuy2': NUMBERS[:48], 'yuyv': NUMBERS[:48], 'yuv422': NUMBERS[:48],
        'nv12': NUMBERS[..., 0], 'bayer_rggb8': NUMBERS[:48, :, 1],
        'mono16': NUMBERS.view(np.uint16)[:48, :, 0], '16UC1': NUMBERS.view(np.uint16)[:48, :, 0],
        'rgba8': NUMBERS.reshape(36, 64, 4), '32FC1': np.ones((48, 64), np.float32),
        JPEG: JPEG_BYTES}[encoding]
    return CapturedFrame(image, encoding)


@pytest.mark.parametrize(('captured', 'requested'), [
    ('bgr8', ''), ('bgr8', 'bgr8'), ('yuv422_yuy2', ''), ('32FC1', ''), ('nv12', 'nv12'),
    ('yuv422_yuy2', 'yuv422_yuy2'), ('yuv422_yuy2', 'yuyv'), ('yuyv', 'yuv422_yuy2'),
    ('yuv422', 'uyvy')])
def test_pixels_in_the_requested_encoding_are_not_copied(captured: str, requested: str) -> None:
    frame = frame_of(captured)
    output = OutputImage(frame, CaptureSettings(encoding=requested))
    assert output.image is frame.image
    assert output.encoding == (requested or captured)
    assert output.size == (64, 48)


@pytest.mark.parametrize(('captured', 'requested', 'published', 'code'), [
    ('rgb8', 'bgr8', 'bgr8', cv2.COLOR_RGB2BGR), ('bgr8', 'rgba8', 'rgba8', cv2.COLOR_BGR2RGBA),
    (JPEG, '', 'bgr8', None), (JPEG, 'rgb8', 'rgb8', cv2.COLOR_BGR2RGB),
    (JPEG, 'mono8', 'mono8', cv2.COLOR_BGR2GRAY),
    ('yuv422_yuy2', 'bgr8', 'bgr8', cv2.COLOR_YUV2BGR_YUYV),
    ('yuv422', 'rgb8', 'rgb8', cv2.COLOR_YUV2RGB_UYVY),
    ('nv12', 'bgr8', 'bgr8', cv2.COLOR_YUV2BGR_NV12),
    ('bayer_rggb8', 'bgr8', 'bgr8', cv2.COLOR_BayerBG2BGR)])
def test_pixels_are_converted_flipped_and_rotated(
        captured: str, requested: str, published: str, code: int | None) -> None:
    frame = frame_of(captured)
    output = OutputImage(frame, CaptureSettings(encoding=requested))
    assert output.encoding == published
    assert output.size == (64, 48)
    image = DECODED if captured == JPEG else np.ascontiguousarray(frame.image)
    expected = image if code is None else cv2.cvtColor(image, code)
    np.testing.assert_array_equal(output.image, expected, strict=True)


TURNS = [(flip, degrees) for flip in FLIPS for degrees in (0, 90, 180, 270)]


@pytest.mark.parametrize(('captured', 'requested', 'lends'), [
    ('rgb8', 'bgr8', True), ('bgr8', '', False), ('mono8', '', False), ('bgr16', 'mono8', True),
    (JPEG, 'rgb8', True), (JPEG, '', True), (JPEG, 'bgr8', True), (JPEG, 'mono8', True),
    ('yuv422_yuy2', 'bgr8', True), ('nv12', 'mono8', True), ('bayer_rggb8', 'bgr8', True),
    ('bayer_rggb8', '', False), ('32FC1', '', False)])
def test_last_conversion_writes_to_lent_memory(
        captured: str, requested: str, lends: bool) -> None:
    lent: list[np.ndarray] = []

    def lend(height: int, width: int, encoding: Encoding) -> np.ndarray:
        lent.append(view_image(
            np.zeros(encoding.size(height, width), np.uint8), height, width, encoding))
        return lent[0]

    usual = OutputImage(frame_of(captured), CaptureSettings(encoding=requested))
    wrong = []
    for flip, degrees in TURNS:
        lent.clear()
        expected, encoding = orient(
            usual.image, find_encoding(usual.encoding), flip, degrees)
        output = OutputImage(frame_of(captured), CaptureSettings(
            encoding=requested, flip=flip, rotate=degrees))
        output.lend = lend
        image = output.image
        is_turned = (flip, degrees) != ('none', 0)
        if ((image.dtype, output.encoding) != (expected.dtype, encoding.name)
                or not all(np.array_equal(one, expected) for one in (image, *lent))
                or len(lent) != (lends or is_turned)):
            wrong.append((flip, degrees))
    assert not wrong


def test_image_that_opencv_does_not_turn() -> None:
    image = np.arange(70, dtype='>u2').reshape(2, 7, 5)
    output = OutputImage(
        CapturedFrame(image, '16UC5'), CaptureSettings(flip='horizontal', rotate=90))
    output.lend = lambda *_: pytest.fail('nothing is written')
    assert np.array_equal(output.image, np.rot90(image[:, ::-1], -1))


def test_colours_are_converted_before_depth() -> None:
    output = OutputImage(frame_of(JPEG), CaptureSettings(encoding='mono16'))
    gray = cv2.cvtColor(DECODED, cv2.COLOR_BGR2GRAY)
    np.testing.assert_array_equal(output.image, gray * np.uint16(257), strict=True)


def test_camera_jpeg_is_published_unchanged() -> None:
    frame = frame_of(JPEG)
    for encoding in ('', 'bgr8', 'rgb8'):
        data, format_text = OutputImage(frame, CaptureSettings(encoding=encoding)).compressed
        assert data is frame.image
        assert format_text == f'{encoding or "bgr8"}; jpeg compressed bgr8'


def test_gray_camera_jpeg_is_declared_as_mono8() -> None:
    gray = cv2.imencode('.jpg', cv2.cvtColor(PICTURE, cv2.COLOR_BGR2GRAY))[1].reshape(-1)
    for encoding in ('', 'bgr8', 'rgb8', 'mono8'):
        data, format_text = OutputImage(
            CapturedFrame(gray, JPEG), CaptureSettings(encoding=encoding)).compressed
        assert data is gray
        assert format_text == 'mono8; jpeg compressed mono8'
    rotated = OutputImage(CapturedFrame(gray, JPEG), CaptureSettings(encoding='mono8', rotate=90))
    assert rotated.compressed[1] == format_text


@pytest.mark.parametrize('settings', [
    CaptureSettings(flip='vertical'), CaptureSettings(rotate=180),
    CaptureSettings(encoding='mono8')])
def test_camera_jpeg_is_encoded_again_for_other_settings(settings: CaptureSettings) -> None:
    output = OutputImage(frame_of(JPEG), settings)
    data, _ = output.compressed
    shown = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    expected = cv2.imdecode(cv2.imencode(
        '.jpg', np.ascontiguousarray(output.image), (cv2.IMWRITE_JPEG_QUALITY, 95))[1],
        cv2.IMREAD_UNCHANGED)
    assert np.array_equal(shown, expected)
    assert not np.array_equal(shown, DECODED)


@pytest.mark.parametrize(('captured', 'format_text'), [
    ('bgr8', 'bgr8; jpeg compressed bgr8'), ('rgb8', 'rgb8; jpeg compressed bgr8'),
    ('mono8', 'mono8; jpeg compressed mono8'), ('bgr16', 'bgr16; png compressed bgr16'),
    ('yuv422_yuy2', 'bgr8; jpeg compressed bgr8'), ('nv12', 'bgr8; jpeg compressed bgr8'),
    ('bayer_rggb8', 'bgr8; jpeg compressed bgr8'), ('rgba8', 'rgba8; png compressed bgra8'),
    ('mono16', 'mono16; png compressed mono16'), ('16UC1', '16UC1; png compressed 16UC1')])
def test_format_string_is_that_of_compressed_image_transport(
        captured: str, format_text: str) -> None:
    data, actual = OutputImage(frame_of(captured), CaptureSettings()).compressed
    assert actual == format_text
    shown = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    channels = find_encoding(format_text.split()[-1]).channels
    height = 36 if captured == 'rgba8' else 48
    assert shown.shape == ((height, 64) if channels == 1 else (height, 64, channels))
    assert shown.dtype == find_encoding(format_text.split()[-1]).dtype


@pytest.mark.parametrize('captured', ['bgr8', 'rgb8', 'bgr16'])
def test_colours_of_the_compressed_image(captured: str) -> None:
    data, _ = OutputImage(frame_of(captured), CaptureSettings()).compressed
    shown = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    assert np.abs(shown // (257 if captured == 'bgr16' else 1) - PICTURE.astype(int)).mean() < 8


def test_higher_quality_makes_larger_jpegs() -> None:
    outputs = [OutputImage(frame_of('bgr8'), CaptureSettings(jpeg_quality=quality))
               for quality in (1, 50, 100)]
    sizes = [output.compressed[0].size for output in outputs]
    assert sizes == sorted(set(sizes))


@pytest.mark.parametrize(('captured', 'wanted', 'format_text', 'dtype'), [
    ('mono16', 'jpeg', 'mono8; jpeg compressed mono8', 'uint8'),
    ('bgr16', 'jpeg', 'bgr8; jpeg compressed bgr8', 'uint8'),
    ('rgba8', 'jpeg', 'rgba8; jpeg compressed bgr8', 'uint8'),
    ('bgr8', 'png', 'bgr8; png compressed bgr8', 'uint8'),
    (JPEG, 'png', 'bgr8; png compressed bgr8', 'uint8')])
def test_format_that_the_user_gives(
        captured: str, wanted: str, format_text: str, dtype: str) -> None:
    output = OutputImage(frame_of(captured), CaptureSettings(compressed_format=wanted))
    data, actual = output.compressed
    assert (actual, output.why_not_compressed) == (format_text, '')
    assert cv2.imdecode(data, cv2.IMREAD_UNCHANGED).dtype == dtype


@pytest.mark.parametrize('captured', ['mono16', '16UC1', 'bgr16', 'rgba8'])
def test_compressed_form_keeps_bits_and_alpha(captured: str) -> None:
    frame = frame_of(captured)
    data, format_text = OutputImage(frame, CaptureSettings()).compressed
    message = WireCompressedImage(header=NO_HEADER, format=format_text, data=data.data)
    assert np.array_equal(Frame(message, captured).image, frame.image)


@pytest.mark.parametrize(('captured', 'wanted', 'reason'), [
    ('32FC1', 'auto', 'an image of 32FC1 cannot be stored as png'),
    ('16UC1', 'jpeg',
     'an image of 16UC1 cannot be stored as jpeg, but with compressed_format auto')])
def test_image_without_a_compressed_form(captured: str, wanted: str, reason: str) -> None:
    output = OutputImage(frame_of(captured), CaptureSettings(compressed_format=wanted))
    assert output.why_not_compressed == reason


@pytest.mark.parametrize(('captured', 'settings'), [
    ('32FC1', CaptureSettings(encoding='bgr8')), ('bgr8', CaptureSettings(encoding='yuv422_yuy2')),
    ('yuv422_yuy2', CaptureSettings(encoding='uyvy')), ('nv12', CaptureSettings(rotate=90))])
def test_impossible_conversions_are_refused(captured: str, settings: CaptureSettings) -> None:
    with pytest.raises(ImageError):
        _ = OutputImage(frame_of(captured), settings).image


@pytest.mark.parametrize('data', [b'', b'no picture', JPEG_BYTES.tobytes()[:-300]])
def test_damaged_jpeg_is_refused(data: bytes) -> None:
    frame = CapturedFrame(np.frombuffer(data, np.uint8), JPEG)
    with pytest.raises(ImageError):
        _ = OutputImage(frame, CaptureSettings()).size


def test_output_forms_are_computed_on_demand_and_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    for name in ('decode_image', 'encode_compressed', 'convert_image'):
        original = getattr(__import__('opencv_tools.capture.output_image', fromlist=['x']), name)
        monkeypatch.setattr(
            f'opencv_tools.capture.output_image.{name}',
            lambda *args, name=name, original=original, **options: (
                calls.append(name) or original(*args, **options)))
    output = OutputImage(frame_of(JPEG), CaptureSettings(encoding='mono8'))
    assert not calls
    for _ in range(2):
        assert output.image.shape == (48, 64)
        assert output.compressed[1] == 'mono8; jpeg compressed mono8'
    assert calls == ['decode_image', 'convert_image', 'encode_compressed']


@pytest.mark.parametrize(('captured', 'requested', 'reduction'), [
    ('mono16', 'bgr8', 'mono16 images lose 8 bits in bgr8'), ('mono16', '', ''),
    ('bgr16', 'rgb16', ''), ('rgba8', 'mono8', 'rgba8 images lose alpha in mono8'),
    ('rgba8', 'bgra8', ''), ('bgr8', 'mono16', ''), (JPEG, 'mono8', '')])
def test_reduction_by_the_encoding(captured: str, requested: str, reduction: str) -> None:
    assert describe_reduction(captured, requested) == reduction


@pytest.mark.parametrize('codec', ['png', 'rvl'])
def test_depth_of_a_bag_is_decoded(codec: str) -> None:
    depth = NUMBERS.view(np.uint16)[:23, :37, 0].copy()
    content, format_text = encode_depth(depth, '16UC1', codec)
    message = WireCompressedImage(header=NO_HEADER, format=format_text, data=content)
    frame = CapturedFrame(np.frombuffer(content, np.uint8), JPEG,
                          recorded=Recorded(message=message, topic='/depth', log_ns=1))
    output = OutputImage(frame, CaptureSettings())
    assert output.size == (37, 23)
    assert why_no_depth(output) == ''
    assert depth_form(output) == (frame.image, format_text)
    assert not depth_loss(output) and not output.is_decoded
    assert np.array_equal(output.image, depth) and output.encoding == '16UC1'
    picture, picture_format = output.compressed
    assert picture_format == '16UC1; png compressed 16UC1'
    assert np.array_equal(cv2.imdecode(picture, cv2.IMREAD_UNCHANGED), depth)


@pytest.mark.parametrize(('encoding', 'settings', 'expected'), [
    ('16UC1', {}, '16UC1'), ('>16UC1', {}, '16UC1'), ('32FC1', {'depth_max': 5.0}, '32FC1'),
    ('mono16', {'flip': 'both'}, 'mono16')])
@pytest.mark.parametrize('codec', ['png', 'rvl'])
def test_forms_of_depth(
        encoding: str, settings: dict[str, Any], expected: str, codec: str) -> None:
    depth = (np.arange(13 * 21) * 7 % 903).reshape(13, 21)  # never 500, a limit below
    is_float = encoding == '32FC1'
    image = (depth / 100).astype('f4') if is_float else depth.astype(
        '>u2' if encoding.startswith('>') else 'u2')
    output = OutputImage(CapturedFrame(image, encoding.lstrip('>')),
                         CaptureSettings(depth_format=codec, **settings))
    assert expected_encoding(output) == output.encoding == expected
    content, format_text = depth_form(output)
    assert format_text == f'{expected}; compressedDepth {codec}'
    decoded, _ = decode_compressed(np.frombuffer(content, np.uint8), format_text)
    turned = depth[::-1, ::-1] if settings.get('flip') else depth
    if is_float:
        lost, near = (depth >= 500) | (depth == 0), depth < 15
        assert np.array_equal(np.isnan(decoded), lost)
        assert np.abs(decoded - image)[~(lost | near)].max() < 0.003
        assert np.unique(decoded[near & ~lost]) == pytest.approx([0.149], 0.01)
        assert depth_loss(output) == (
            'depths of 5 m and more are lost and those below 0.15 m become 0.15 m')
    else:
        assert np.array_equal(decoded, turned)
        assert depth_loss(output) == ''


@pytest.mark.parametrize('encoding', ['bgr8', '16UC3', '32FC2', '16SC1', 'mono8', 'bayer_rggb16'])
def test_images_without_depth(encoding: str) -> None:
    output = OutputImage(CapturedFrame(np.zeros((4, 6), np.uint8), encoding), CaptureSettings())
    assert why_no_depth(output) == f'an image of {encoding} has no depth'


def test_png_without_its_message_becomes_a_jpeg() -> None:
    content = cv2.imencode('.png', PICTURE)[1].reshape(-1)
    output = OutputImage(CapturedFrame(content, JPEG), CaptureSettings(encoding='bgr8'))
    data, format_text = output.compressed
    assert format_text == 'bgr8; jpeg compressed bgr8' and data[:2].tobytes() == b'\xff\xd8'
    assert np.abs(cv2.imdecode(data, cv2.IMREAD_COLOR).astype(int) - PICTURE).mean() < 8


@pytest.mark.parametrize(('stored', 'wanted', 'is_kept'), [
    ('jpeg', 'auto', True), ('jpeg', 'jpeg', True), ('jpeg', 'png', False),
    ('png', 'auto', True), ('png', 'png', True), ('png', 'jpeg', False),
    ('webp', 'auto', True), ('webp', 'png', False)])
def test_format_of_compressed_images_of_a_bag(stored: str, wanted: str, is_kept: bool) -> None:
    content = cv2.imencode(f'.{stored}', PICTURE)[1].reshape(-1)
    message = WireCompressedImage(header=NO_HEADER, format=stored, data=content.tobytes())
    output = OutputImage(
        CapturedFrame(content, JPEG, recorded=Recorded(message=message, topic='/a', log_ns=1)),
        CaptureSettings(compressed_format=wanted))
    data, format_text = output.compressed
    assert (data is content) == is_kept
    assert format_text == (stored if is_kept else f'bgr8; {wanted} compressed bgr8')
    assert np.abs(cv2.imdecode(data, cv2.IMREAD_COLOR).astype(int) - PICTURE).mean() < 8


def test_settings_of_depth() -> None:
    assert DepthSettings() == DepthSettings('png', 10.0)
    assert DepthSettings('rvl', np.float32(20)).farthest == 20
    for settings in ({'codec': 'jpeg'}, {'codec': 3}, {'codec': ['png']}, *(
            {'farthest': far} for far in (0, float('nan'), 1e9, 0.09, True, 'x', None, 1j))):
        with pytest.raises(ValueError, match=r'depth is .*: give '):
            DepthSettings(**settings)
