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

"""The size of an image file, read from its header without decoding."""

from __future__ import annotations

from pathlib import Path
import struct
import subprocess
import sys
from types import SimpleNamespace
import zlib

from conftest import PRINT_PEAK_MEMORY
import cv2
import numpy as np
from opencv_tools.cv_bridge import CvBridge, CvBridgeError
from opencv_tools.image.errors import CodecError, SizeError
from opencv_tools.image.image_size import check_size, image_size, MAX_PIXELS
from opencv_tools.image_codecs import decode_image
import pytest
from waiting import LONGEST_SECONDS

COLOR = np.random.default_rng(1).integers(0, 256, (37, 53, 3), np.uint8)
FORMATS = {
    **dict.fromkeys(('.jpg', '.png', '.bmp', '.tif', '.webp', '.ppm', '.sr', '.gif', '.jp2',
                     '.avif', '.pam'), COLOR),
    **dict.fromkeys(('.pgm', '.pbm'), COLOR[..., 0]),
    **dict.fromkeys(('.hdr', '.pfm'), COLOR.astype(np.float32)),
}
FORMATS = {suffix: image for suffix, image in FORMATS.items()
           if cv2.haveImageWriter(f'x{suffix}')}  # OpenCV 4 writes fewer formats


def encoded(image: np.ndarray, suffix: str) -> bytes:
    done, data = cv2.imencode(suffix, image)
    assert done
    return data.tobytes()


def huge_jpeg() -> bytes:
    """Return a small JPEG whose header claims almost 2**30 pixels."""
    jpeg = encoded(np.zeros((16, 16, 3), np.uint8), '.jpg')
    place = jpeg.find(b'\xff\xc0') + 5
    return jpeg[:place] + struct.pack('>HH', 32767, 32767) + jpeg[place + 4:]


def huge_png() -> bytes:
    """Return a PNG whose header claims almost 2**30 pixels, with a hundredth of them."""
    pixels = zlib.compress(bytes(327 * (1 + 32767)), 1)
    chunks = ((b'IHDR', struct.pack('>II5B', 32767, 32767, 8, 0, 0, 0, 0)), (b'IDAT', pixels),
              (b'IEND', b''))
    return b'\x89PNG\r\n\x1a\n' + b''.join(
        struct.pack('>I', len(content)) + kind + content
        + struct.pack('>I', zlib.crc32(kind + content)) for kind, content in chunks)


@pytest.mark.parametrize('suffix', FORMATS)
def test_size_equals_that_of_the_decoded_image(suffix: str) -> None:
    data = encoded(FORMATS[suffix], suffix)
    assert image_size(data) == (53, 37)
    assert decode_image(data).shape[:2] == (37, 53)


@pytest.mark.parametrize('suffix', FORMATS)
def test_image_with_too_many_pixels_is_refused(suffix: str) -> None:
    data = encoded(FORMATS[suffix], suffix)
    assert decode_image(data, max_pixels=53 * 37).shape[:2] == (37, 53)
    with pytest.raises(CodecError, match=r'^53x37 pixels are more than max_pixels=1960$'):
        decode_image(data, max_pixels=53 * 37 - 1)


@pytest.mark.parametrize(('data', 'size'), [
    (b'RIFF....WEBPVP8X' + bytes(8) + b'\xff\xff\xff\xff\xff\xff', (2**24, 2**24)),
    (b'RIFF....WEBPVP8L' + bytes(5) + b'\xff\xff\xff\x0f', (16384, 16384)),
    (b'BM' + bytes(12) + b'\x28\0\0\0' + struct.pack('<ii', -5, -7), (5, 7)),
    (b'BM' + bytes(12) + b'\x0c\0\0\0' + struct.pack('<HH', 5, 7), (5, 7)),
    (b'MM\0*\0\0\0\x08\0\4' + b''.join(
        struct.pack('>HHIHxx', tag, 3, 1, side)
        for tag, side in ((256, 5), (257, 7), (322, 9), (256, 6))), (9, 7)),
    (b'II+\0\x08\0\0\0' + struct.pack('<QQ', 16, 2) + b''.join(
        struct.pack('<HHQQ', tag, 16, 1, 2**33) for tag in (256, 257)), (2**33, 2**33)),
    (b'P6 # 1 1\n 99999 # \r 88888\n255\n', (99999, 88888)),
    (b'P7\nWIDTH 5\nHEIGHT 7\nWIDTH 500\nENDHDR\nWIDTH 9000', (500, 7)),
    (b'#?RADIANCE\n\n-Y 7 +X 5\n-Y 70 +X 50\n', (50, 70)),
    (b'\xff\x4f\xff\x51\0\0\0\0\0\0\0\5\0\0\0\7' + b'\xff\x4f\xff\x51\0\0\0\0\0\0\1\0\0\0\0\1',
     (256, 7)),
    (b'\x76\x2f\x31\x01' + b'dataWindow\0box2i\0\0\0\0\x10' + struct.pack('<4i', -5, 0, 4, 6),
     (10, 7)),
], ids=['webp', 'lossless', 'bmp', 'os2', 'tiff', 'bigtiff', 'pnm', 'pam', 'hdr', 'jp2', 'exr'])
def test_largest_declared_size_is_read(data: bytes, size: tuple[int, int]) -> None:
    assert image_size(data) == size


@pytest.mark.parametrize('data', [
    b'', b'text', b'\xff\xd8', b'\x89PNG\r\n\x1a\n', b'RIFF', b'RIFF....WEBP', b'BM', b'II*\0',
    b'II*\0\x08\0\0\0\xff\xff', b'II*\0\xff\xff\xff\xff', b'P6\n5', b'P6\n' + b'#' * 10**6,
    b'P7\nENDHDR', b'\x59\xa6\x6a\x95', b'GIF89a', b'#?RGBE\n', b'\xff\x4f\xff\x51',
    b'\xff\x4f\xff\x51' * 1000, b'....ftypavif', b'\x76\x2f\x31\x01', bytes(1000)])
def test_header_without_a_size_is_refused(data: bytes) -> None:
    with pytest.raises(SizeError, match=f'^{len(data)} bytes '):
        image_size(data)
    with pytest.raises(CodecError):
        decode_image(data)


def test_header_truncated_anywhere_is_a_clear_error() -> None:
    for suffix, image in FORMATS.items():
        data = encoded(image, suffix)
        for length in range(min(200, len(data))):
            try:
                assert image_size(data[:length]) == (53, 37)
            except SizeError as err:
                assert str(err).startswith(f'{length} bytes ')


def test_largest_allowed_size_passes() -> None:
    check_size(2**20, 2**7, MAX_PIXELS)
    with pytest.raises(SizeError):
        check_size(2**20 + 1, 2**7, MAX_PIXELS)


def test_bridge_refuses_images_with_too_many_pixels() -> None:
    with pytest.raises(CvBridgeError, match=r'^32767x32767 pixels are more than max_pixels'):
        CvBridge().compressed_imgmsg_to_cv2(SimpleNamespace(format='jpeg', data=huge_jpeg()))


@pytest.mark.process
@pytest.mark.parametrize('make', [huge_jpeg, huge_png])
def test_refused_image_takes_no_memory(make: object, tmp_path: Path) -> None:
    path = tmp_path / 'picture.png'
    path.write_bytes(make())
    script = ('import pathlib, sys\n'
              'from opencv_tools.capture.errors import BrokenFrameError\n'
              'from opencv_tools.capture.image_files import ImageFileSource\n'
              'from opencv_tools.image.errors import CodecError\n'
              'from opencv_tools.image_codecs import decode_image\n'
              'path = pathlib.Path(sys.argv[1])\n'
              'try: decode_image(path.read_bytes())\n'
              'except CodecError as err: print(err)\n'
              'try: ImageFileSource([path], "").read()\n'
              'except BrokenFrameError as err: print(err)\n'
              f'{PRINT_PEAK_MEMORY}')
    finished = subprocess.run([sys.executable, '-c', script, str(path)], capture_output=True,
                              text=True, timeout=LONGEST_SECONDS, check=True)
    *sentences, peak = finished.stdout.splitlines()
    assert len(sentences) == 2
    assert all('32767x32767 pixels are more' in sentence for sentence in sentences)
    assert int(peak) < 400_000  # KiB
