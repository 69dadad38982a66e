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

"""Frames as image files: formats, lossless content, compressed frames and their headers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import struct
import zlib

import cv2
import numpy as np
from opencv_tools.image.encodings import COLOR_ENCODINGS, find_encoding
from opencv_tools.image.errors import CodecError, ImageError
from opencv_tools.image_codecs import encode_image
from opencv_tools.recording.errors import UnwritableError
from opencv_tools.recording.frames import CompressedFrame
from opencv_tools.recording.image_encoder import (
    encode_frame, EncoderSettings, IMAGE_FORMATS, ImageHeader, read_image_header)
from opencv_tools.recording.naming import FrameMetadata
import pytest
from recordings import frame_of, NANO, random_image

ENCODINGS = ('mono8', 'mono16', 'bgr8', 'rgb8', 'bgra8', 'rgba8', 'bgr16', 'rgb16', 'rgba16',
             '8UC1', '8UC2', '8UC3', '8UC4', '16UC1', '16UC3', '16SC1', '32SC1', '32FC1', '32FC3',
             '64FC1')
EIGHT_BITS = ('mono8', 'bgr8', 'rgb8', '8UC1', '8UC3')
ALPHA_AND_16_BITS = ('mono16', 'bgra8', 'rgba8', 'bgr16', 'rgb16', 'rgba16', '8UC4', '16UC1',
                     '16UC3')
FLOATS = ('32FC1', '32FC3', '64FC1')
READ_AS_COLORS = ('8UC1', '8UC3', '8UC4', '16UC3')

# Encodings of ENCODINGS that each format stores; .npy stores them all.
STORED = {
    '.png': (*EIGHT_BITS, *ALPHA_AND_16_BITS), '.jpg': EIGHT_BITS, '.jpeg': EIGHT_BITS,
    '.tif': (*EIGHT_BITS, *ALPHA_AND_16_BITS, *FLOATS),
    '.tiff': (*EIGHT_BITS, *ALPHA_AND_16_BITS, *FLOATS), '.bmp': EIGHT_BITS,
    '.webp': ('bgr8', 'rgb8', '8UC3')}
LOSSLESS = ('.png', '.tif', '.tiff', '.bmp', '.webp')


def write_frame(path: Path, image: np.ndarray, encoding: str) -> Path:
    """Write a frame of 8x10 pixels; assert that its content has its encoding and its size."""
    content = encode_frame(frame_of(image, encoding), EncoderSettings(path.suffix))
    assert (content.encoding, content.width, content.height) == (encoding, 8, 10)
    path.write_bytes(b''.join(content.parts()))
    return path


def in_order_of_opencv(image: np.ndarray, encoding: str) -> np.ndarray:
    """Return an image with blue as its first channel, if the image has colours."""
    return image[..., [2, 1, 0, 3][:image.shape[2]]] if encoding.startswith('rgb') else image


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_frames_as_arrays(tmp_path: Path, encoding: str) -> None:
    image = random_image(encoding)
    np.testing.assert_array_equal(np.load(write_frame(tmp_path / 'a.npy', image, encoding)), image)


@pytest.mark.parametrize(('encoding', 'suffix'), [
    (encoding, suffix) for suffix in LOSSLESS for encoding in STORED[suffix]])
def test_frames_as_lossless_pictures(tmp_path: Path, encoding: str, suffix: str) -> None:
    image = random_image(encoding)
    path = write_frame(tmp_path / f'file{suffix}', image, encoding)
    kept = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(kept, in_order_of_opencv(image, encoding))
    assert kept.dtype == image.dtype and kept.shape == image.shape


@pytest.mark.parametrize('suffix', ['.jpg', '.jpeg'])
@pytest.mark.parametrize('encoding', EIGHT_BITS)
def test_frames_as_jpeg(tmp_path: Path, encoding: str, suffix: str) -> None:
    image = random_image(encoding)
    path = write_frame(tmp_path / f'file{suffix}', image, encoding)
    kept = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    expected = cv2.imencode(suffix, in_order_of_opencv(image, encoding))[1]
    np.testing.assert_array_equal(kept, cv2.imdecode(expected, cv2.IMREAD_UNCHANGED))
    assert kept.dtype == image.dtype and kept.shape == image.shape


@pytest.mark.parametrize(('encoding', 'suffix'), [
    (encoding, suffix) for suffix, stored in STORED.items()
    for encoding in ENCODINGS if encoding not in stored])
def test_frames_that_a_format_cannot_store(encoding: str, suffix: str) -> None:
    with pytest.raises(UnwritableError) as caught:
        encode_frame(frame_of(random_image(encoding), encoding), EncoderSettings(suffix))
    assert f'a {encoding} frame cannot be stored as {suffix}' in str(caught.value)
    remedy = str(caught.value).partition('.npy')[2]
    is_number = encoding in ('mono16', '16UC1', '16SC1', '32SC1', '32FC1', '64FC1')
    assert remedy == (', or allow a loss and give the range of the numbers' if is_number else
                      ', or allow a loss' if encoding in (*COLOR_ENCODINGS, *READ_AS_COLORS)
                      else '')


@pytest.mark.parametrize('suffix', ['.jpg', '.bmp', '.webp'])
@pytest.mark.parametrize('encoding', [
    'bgra8', 'rgba8', 'bgr16', 'rgb16', 'rgba16', '8UC4', '16UC3', '16UC4'])
def test_lossy_colours(tmp_path: Path, encoding: str, suffix: str) -> None:
    image = random_image(encoding)
    content = encode_frame(frame_of(image, encoding), EncoderSettings(suffix, lossy=True))
    (tmp_path / f'a{suffix}').write_bytes(b''.join(content.parts()))
    kept = cv2.imread(str(tmp_path / f'a{suffix}'), cv2.IMREAD_UNCHANGED)
    assert content.encoding == 'bgr8' and kept.dtype == np.uint8
    expected = in_order_of_opencv(image, encoding)[..., :3].astype(float)
    expected /= 257 if image.dtype == np.uint16 else 1
    assert suffix == '.jpg' or np.abs(kept - expected).max() <= 0.5


@pytest.mark.parametrize('encoding', ['mono8', '8UC1'])
def test_lossy_gray_where_a_format_has_colours_only(encoding: str) -> None:
    image = random_image(encoding)
    content = encode_frame(frame_of(image, encoding), EncoderSettings('.webp', lossy=True))
    kept = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(kept, np.dstack([image] * 3))
    assert content.encoding == 'bgr8'


@pytest.mark.parametrize('suffix', ['.jpg', '.bmp', '.webp'])
@pytest.mark.parametrize(('encoding', 'low', 'high'), [
    ('16UC1', 370, 4900), ('mono16', 0, 3071), ('32FC1', 0.37, 4.9), ('32SC1', -7, 70_000)])
def test_lossy_numbers_within_a_range(
        tmp_path: Path, encoding: str, low: float, high: float, suffix: str) -> None:
    steps = np.linspace(low, high, 6)
    least = 0 if encoding in ('16UC1', 'mono16') else low - 1
    image = np.array([[low - 1, *steps, high + 1]]).clip(least).astype(
        find_encoding(encoding).dtype)
    if encoding == '32FC1':
        image[0, 0] = np.nan
    settings = EncoderSettings(suffix, lossy=True, limits=(low, high))
    content = encode_frame(frame_of(np.repeat(image, 16, axis=0), encoding), settings)
    (tmp_path / f'a{suffix}').write_bytes(b''.join(content.parts()))
    kept = cv2.imread(str(tmp_path / f'a{suffix}'), cv2.IMREAD_GRAYSCALE)
    difference = np.abs(kept.astype(int) - [[0, 0, 51, 102, 153, 204, 255, 255]])
    assert difference.max() <= (20 if suffix == '.jpg' else 1)
    with pytest.raises(UnwritableError, match='or allow a loss and give the range'):
        encode_frame(frame_of(image, encoding), EncoderSettings(suffix, lossy=True))


# The first and the last colour of each colormap in BGR, as its authors publish them.
COLORMAPS = {
    'turbo': ((59, 18, 48), (3, 4, 122)), 'jet': ((128, 0, 0), (0, 0, 128)),
    'viridis': ((84, 1, 68), (37, 231, 253)), 'cividis': ((78, 34, 0), (56, 232, 254)),
    'magma': ((4, 0, 0), (191, 253, 252)), 'inferno': ((4, 0, 0), (164, 255, 252)),
    'plasma': ((135, 8, 13), (33, 249, 240))}


@pytest.mark.parametrize('suffix', ['.png', '.bmp', '.webp', '.tiff'])
@pytest.mark.parametrize('colors', COLORMAPS)
@pytest.mark.parametrize(('encoding', 'low', 'high'), [
    ('16UC1', 370, 4900), ('mono16', 1, 3071), ('32FC1', 0.37, 4.9), ('32SC1', 7, 70_000)])
def test_lossy_numbers_in_colours(
        encoding: str, low: float, high: float, colors: str, suffix: str) -> None:
    image = np.array([[0, low, high, 2 * high, 0]]).repeat(3, axis=0).astype(
        find_encoding(encoding).dtype)
    if encoding == '32FC1':
        image[0, 4] = np.nan
    settings = EncoderSettings(suffix, lossy=True, limits=(low, high), colors=colors)
    content = encode_frame(frame_of(image, encoding), settings)
    kept = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_UNCHANGED)
    first, last = COLORMAPS[colors]
    assert (content.encoding, kept.dtype) == ('bgr8', np.uint8)
    for row in kept:
        np.testing.assert_allclose(
            row.astype(int), [(0, 0, 0), first, last, last, (0, 0, 0)], atol=2)


def test_zero_is_a_number_in_a_range_with_negative_ones() -> None:
    image = np.array([[-1, 0, 1, np.nan]], np.float32)
    settings = EncoderSettings('.png', lossy=True, limits=(-1, 1), colors='viridis')
    content = encode_frame(frame_of(image, '32FC1'), settings)
    kept = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_allclose(  # the middle one is #21918c
        kept[0].astype(int), [(84, 1, 68), (140, 145, 33), (37, 231, 253), (0, 0, 0)],
        atol=2)


def test_colours_change_numbers_only() -> None:
    settings = EncoderSettings('.png', lossy=True, limits=(0, 90), colors='turbo')
    for encoding in ('mono8', 'bgra8', 'bgr16', '8UC1'):
        image = random_image(encoding)
        content = encode_frame(frame_of(image, encoding), settings)
        kept = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(kept, image)
    depth = compressed('.png', '16UC1; png compressed 16UC1', random_image('16UC1'))
    assert encode_frame(depth, settings).encoding == 'bgr8'


def test_lossy_keeps_what_a_format_can_store() -> None:
    image = random_image('mono16')
    settings = EncoderSettings('.png', lossy=True)
    assert encode_frame(frame_of(image, 'mono16'), settings).encoding == 'mono16'


@pytest.mark.parametrize('suffix', ['.png', '.tiff', '.jpg', '.bmp'])
def test_range_makes_a_picture_to_look_at(suffix: str) -> None:
    image = np.array([[0, 100, 200, 300, 65535]], np.uint16)
    settings = EncoderSettings(suffix, lossy=True, limits=(100, 300), jpeg_quality=100)
    content = encode_frame(frame_of(image, 'mono16'), settings)
    assert content.encoding == 'mono8'
    shown = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_allclose(shown[0].astype(int), [0, 0, 128, 255, 255], atol=2)


def test_all_formats_are_tested() -> None:
    assert {*STORED, '.npy'} == {*IMAGE_FORMATS}


@pytest.mark.parametrize(('encoding', 'color'), [
    ('bayer_rggb8', cv2.COLOR_BayerRGGB2BGR), ('bayer_gbrg16', cv2.COLOR_BayerGBRG2BGR),
    ('uyvy', cv2.COLOR_YUV2BGR_UYVY), ('yuv422_yuy2', cv2.COLOR_YUV2BGR_YUYV),
    ('nv12', cv2.COLOR_YUV2BGR_NV12), ('nv21', cv2.COLOR_YUV2BGR_NV21)])
def test_bayer_and_yuv_become_colours_or_stay_arrays(encoding: str, color: int) -> None:
    image = random_image(encoding)
    picture = encode_frame(frame_of(image, encoding), EncoderSettings('.png'))
    assert picture.encoding == ('bgr16' if encoding.endswith('16') else 'bgr8')
    assert (picture.width, picture.height) == (8, 10)
    np.testing.assert_array_equal(
        cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_UNCHANGED),
        cv2.cvtColor(image, color))
    array = encode_frame(frame_of(image, encoding), EncoderSettings('.npy'))
    assert (array.encoding, array.width, array.height) == (encoding, 8, 10)
    assert b''.join(array.parts())[-image.nbytes:] == image.tobytes()


@pytest.mark.parametrize('encoding', ['uyvy', 'nv12'])
def test_yuv_without_conversion_to_colours(encoding: str) -> None:
    with pytest.raises(UnwritableError, match=f'a {encoding} frame cannot .* to .npy$'):
        encode_frame(frame_of(random_image(encoding), encoding),
                     EncoderSettings('.png', to_color=False))


@pytest.mark.parametrize('encoding', ['bayer_rggb8', 'bayer_rggb16'])
def test_bayer_without_conversion_to_colours(encoding: str) -> None:
    image = random_image(encoding)
    content = encode_frame(frame_of(image, encoding), EncoderSettings('.png', to_color=False))
    assert content.encoding == encoding
    np.testing.assert_array_equal(
        cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_UNCHANGED), image)


def test_big_endian_frames_keep_their_values() -> None:
    image = random_image('mono16') + 1000
    content = encode_frame(frame_of(image.astype('>u2'), 'mono16'), EncoderSettings('.png'))
    kept = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(kept, image)


def test_frame_that_opencv_cannot_encode_is_refused() -> None:
    with pytest.raises(UnwritableError, match=r'^the mono8 frame was not encoded: '):
        encode_frame(frame_of(np.zeros((1, 70_000), np.uint8), 'mono8'), EncoderSettings('.jpg'))


def test_default_encoder_settings() -> None:
    assert EncoderSettings('.png') == EncoderSettings(
        '.png', to_color=True, jpeg_quality=95, png_compression=1, crf=23)


def test_empty_frame_is_refused_with_its_size() -> None:
    with pytest.raises(UnwritableError, match=r'an empty frame \(0x5\) cannot be stored as \.png'):
        encode_frame(frame_of(np.zeros((5, 0, 3), np.uint8), 'bgr8'), EncoderSettings('.png'))


def test_quality_and_compression_change_the_file_size() -> None:
    image = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (200, 300, 3), np.uint8),
                             (9, 9), 0)
    frame = frame_of(image, 'bgr8')
    jpegs = [len(encode_frame(frame, EncoderSettings('.jpg', jpeg_quality=quality)).data)
             for quality in (100, 95, 50, 1)]
    pngs = [len(encode_frame(frame, EncoderSettings('.png', png_compression=level)).data)
            for level in (0, 1, 9)]
    assert jpegs == sorted(jpegs, reverse=True) and len(set(jpegs)) == 4
    assert pngs == sorted(pngs, reverse=True) and len(set(pngs)) == 3


def compressed(suffix: str, format_text: str, image: np.ndarray) -> CompressedFrame:
    data = memoryview(encode_image(image, suffix))
    return CompressedFrame(
        metadata=FrameMetadata(NANO, 'camera', format_text, '/video_frames/compressed'),
        receive_ns=NANO, data=data)


@pytest.mark.parametrize(('suffix', 'format_text'), [
    ('.jpg', 'rgb8; jpeg compressed bgr8'), ('.jpeg', 'jpeg'), ('.png', '; png compressed ')])
def test_compressed_frame_is_stored_unchanged(suffix: str, format_text: str) -> None:
    frame = compressed(suffix, format_text, random_image('bgr8'))
    content = encode_frame(frame, EncoderSettings(suffix))
    assert content.data is frame.data
    assert (content.encoding, content.width, content.height) == (format_text, 8, 10)


def test_compressed_frame_is_decoded_for_another_format() -> None:
    image = random_image('bgr8')
    content = encode_frame(compressed('.png', 'png', image), EncoderSettings('.npy'))
    assert content.encoding == 'bgr8'
    assert b''.join(content.parts())[-image.nbytes:] == image.tobytes()
    jpeg = encode_frame(compressed('.png', 'png', image), EncoderSettings('.jpg', jpeg_quality=30))
    assert jpeg.data.tobytes() == encode_image(image, '.jpg', 30).tobytes()


@pytest.mark.parametrize('suffix', ['.jpg', '.png'])
def test_truncated_compressed_frame_is_refused(suffix: str) -> None:
    whole = compressed(suffix, suffix[1:], np.zeros((300, 300, 3), np.uint8))
    for data in (whole.data[:-20], whole.data[:9], b'', b'text', bytes(whole.data[:2]) * 1000,
                 bytes(whole.data[:2]) + b'\xff' * 1000 + b'\xff\xd9'):
        broken = replace(whole, data=data)
        with pytest.raises(ImageError):
            encode_frame(broken, EncoderSettings(suffix))


BEGINS, ENDS = b'\xff\xd8', b'\xff\xd9'
COMMENT = b'\xff\xfe\x00\x04ab'
SIZE = b'\x00\x0b\x08\x00\x05\x01\x07\x01\x01\x11\x00'  # 263x5
SCAN = b'\xff\xda\x00\x08\x01\x01\x00\x00\x3f\x00' + bytes(40)


def jpeg(*segments: bytes) -> bytes:
    return b''.join((BEGINS, *segments, SCAN, ENDS))


def png(*chunks: tuple[bytes, bytes]) -> bytes:
    return b'\x89PNG\r\n\x1a\n' + b''.join(
        struct.pack('>I', len(content)) + kind + content
        + struct.pack('>I', zlib.crc32(kind + content))
        for kind, content in (*chunks, (b'IEND', b'')))


IHDR = b'IHDR', b'\0\0\1\7\0\0\0\5\x08\0\0\0\0'


NO_FRAME_HEADERS = (0xc4, 0xc8, 0xcc)


@pytest.mark.parametrize('marker', sorted({*range(0xc0, 0xd0)} - {*NO_FRAME_HEADERS}))
def test_size_in_every_kind_of_jpeg_frame_header(marker: int) -> None:
    data = jpeg(COMMENT, bytes([0xff, marker]) + SIZE)
    assert read_image_header(data) == ImageHeader(('.jpg', '.jpeg'), 263, 5)


@pytest.mark.parametrize('marker', NO_FRAME_HEADERS)
def test_size_in_other_jpeg_segments(marker: int) -> None:
    data = jpeg(COMMENT, bytes([0xff, marker]) + SIZE)
    with pytest.raises(CodecError, match=f'^{len(data)} bytes of a picture without a size'):
        read_image_header(data)


@pytest.mark.parametrize('marker', [0x01, *range(0xd0, 0xd8)])
def test_markers_without_a_length_are_skipped(marker: int) -> None:
    data = jpeg(bytes([0xff, marker]), COMMENT, b'\xff\xc0' + SIZE)
    assert read_image_header(memoryview(data)) == ImageHeader(('.jpg', '.jpeg'), 263, 5)


@pytest.mark.parametrize('data', [
    jpeg(b'\x00\xc0' + SIZE), jpeg(COMMENT, b'\xfe\xc0' + SIZE), jpeg(b'\xff\xe0\x00\xff'),
    jpeg(BEGINS, b'\xff\xc0' + SIZE),
    jpeg(b'\xff\xc0\x00\x0b'), jpeg(), jpeg(*[COMMENT] * 1000, b'\xff\xc0' + SIZE)],
    ids=['zero', 'fill', 'long', 'again', 'short', 'nothing', 'many'])
def test_jpeg_without_a_size_is_refused(data: bytes) -> None:
    with pytest.raises(CodecError, match=f'^{len(data)} bytes of a picture without a size$'):
        read_image_header(data)


def test_size_is_found_after_many_segments() -> None:
    data = jpeg(*[COMMENT] * 999, b'\xff\xc0' + SIZE)
    assert read_image_header(data) == ImageHeader(('.jpg', '.jpeg'), 263, 5)


@pytest.mark.parametrize('data', [
    b'\x89PNG\r\n\x1a\n' + bytes(100), BEGINS + b'\xff\xc0' + SIZE, BEGINS])
def test_jpeg_without_an_end_is_refused(data: bytes) -> None:
    with pytest.raises(CodecError, match=f'^{len(data)} bytes of .* whose end is missing$'):
        read_image_header(data)


@pytest.mark.parametrize('data', [b'', b'text', b'\xff', b'II*\0' + bytes(100)])
def test_other_formats_have_no_header(data: bytes) -> None:
    assert read_image_header(data) == ImageHeader((), 0, 0)


def test_size_of_a_png() -> None:
    assert read_image_header(png(IHDR, (b'IDAT', b'x'))) == ImageHeader(('.png',), 263, 5)


@pytest.mark.parametrize('data', [
    png(), png(IHDR), png((b'IDAT', b'x')), png((b'IDAT', b'x'), IHDR),
    png(IHDR, (b'IDAT', b'x')).replace(b'IDATx', b'IDATy'),
    png(IHDR)[:-12] + b'rubbish' + png()[-12:],
    png(IHDR)[:-12] + b'\xff\xff\xff\xffIDAT' + png()[-12:]],
    ids=['nothing', 'no pixels', 'no header', 'header later', 'sum', 'rubbish', 'long'])
def test_damaged_png_is_refused(data: bytes) -> None:
    with pytest.raises(CodecError, match=f'^{len(data)} bytes of a PNG picture .* damaged$'):
        read_image_header(data)
