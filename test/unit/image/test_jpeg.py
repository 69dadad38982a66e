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

"""Truncated JPEG: detected where the check is certain, and complete JPEG passes."""

from __future__ import annotations

import cv2
import numpy as np
from opencv_tools.image.errors import CodecError, JpegError
from opencv_tools.image.jpeg import check_jpeg, jpeg_components, jpeg_size
from opencv_tools.image_codecs import decode_picture
import pytest

ENDS = b'\xff\xd9'
# The value that libjpeg writes for missing pixels.
FILLING = 128


def photo(height: int = 96, width: int = 128, channels: int = 3) -> np.ndarray:
    """Return an image with as much variation as a photo."""
    random = np.random.default_rng(5).integers(0, 256, (height, width, channels), np.uint8)
    blurred = cv2.GaussianBlur(random, (9, 9), 2)
    return blurred.reshape(random.shape[:2 if channels == 1 else 3])


def encoded(image: np.ndarray, *options: int) -> bytes:
    done, data = cv2.imencode('.jpg', image, options)
    assert done
    return data.tobytes()


def broken_off(jpeg: bytes, part: float) -> bytes:
    """Return a JPEG with a part of the data of its last scan, and with an end marker."""
    begin = jpeg.rfind(b'\xff\xda') + 14
    return jpeg[:begin + int(part * (len(jpeg) - begin))].rstrip(b'\xff') + ENDS


OPTIONS = {
    'baseline': (), 'quality': (cv2.IMWRITE_JPEG_QUALITY, 30),
    'optimized': (cv2.IMWRITE_JPEG_OPTIMIZE, 1),
    'restarts': (cv2.IMWRITE_JPEG_RST_INTERVAL, 4),
    'progressive': (cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
}


@pytest.mark.parametrize('kind', OPTIONS)
@pytest.mark.parametrize('image', [
    photo(), photo(channels=1), photo(17, 9), photo(1, 1), np.full((64, 64, 3), FILLING, np.uint8),
    np.full((33, 65), FILLING, np.uint8), np.zeros((480, 640, 3), np.uint8)],
    ids=['photo', 'mono', 'odd', 'one', 'gray', 'gray mono', 'black'])
def test_a_whole_jpeg_passes(image: np.ndarray, kind: str) -> None:
    jpeg = encoded(image, *OPTIONS[kind])
    assert jpeg_size(jpeg) == (image.shape[1], image.shape[0])
    assert jpeg_components(jpeg) == (1 if image.ndim == 2 else 3)
    assert jpeg[check_jpeg(jpeg):].startswith(ENDS)
    assert np.array_equal(decode_picture(jpeg), cv2.imdecode(
        np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED))


@pytest.mark.parametrize('upright', [False, True])
@pytest.mark.parametrize('kind', ['baseline', 'quality', 'optimized', 'restarts'])
@pytest.mark.parametrize('part', [0.0, 0.01, 1 / 3, 0.5, 0.9, 0.97])
@pytest.mark.parametrize('channels', [1, 3])
def test_a_scan_that_breaks_off_is_no_picture(
        kind: str, part: float, channels: int, upright: bool) -> None:
    jpeg = encoded(photo(channels=channels), *OPTIONS[kind])
    with pytest.raises(CodecError, match=r'whose end is missing$'):
        decode_picture(broken_off(jpeg, part), upright)


def test_a_scan_that_ends_with_any_restart_interval_is_no_picture() -> None:
    jpeg = encoded(photo(), *OPTIONS['restarts'])
    begin = jpeg.rfind(b'\xff\xda')
    ends = [place for place in range(begin, len(jpeg) - 2)
            if jpeg[place] == 0xff and 0xd0 <= jpeg[place + 1] <= 0xd7]
    assert len(ends) > 8
    for place in ends:
        for data in (jpeg[:place] + ENDS, jpeg[:place + 2] + ENDS):
            with pytest.raises(CodecError, match=r'whose end is missing$'):
                decode_picture(data)


@pytest.mark.parametrize('kind', ['baseline', 'optimized', 'restarts', 'progressive'])
def test_a_scan_with_too_few_bits_is_refused_without_being_decoded(kind: str) -> None:
    jpeg = encoded(photo(480, 640), *OPTIONS[kind])
    begin = jpeg.find(b'\xff\xda') + 14
    with pytest.raises(JpegError, match=r'whose end is missing$'):
        check_jpeg(jpeg[:begin] + bytes(20) + ENDS)


def test_a_component_without_a_scan_is_missing() -> None:
    jpeg = encoded(photo())
    first = jpeg.find(b'\xff\xda')
    one = jpeg[:first] + b'\xff\xda\0\x08\1\1\0\0\x3f\0' + jpeg[first + 14:]
    with pytest.raises(JpegError, match=r'whose end is missing$'):
        check_jpeg(one)


@pytest.mark.parametrize(('old', 'new'), [
    (b'\xff\xc0\0\x11', b'\xff\xc0\0\x10'), (b'\xff\xda\0\x0c', b'\xff\xda\0\x0e'),
    (b'\xff\xda\0\x0c\3', b'\xff\xda\0\x0c\2'), (b'\xff\xc4\0\x1f', b'\xff\xc4\0\x18'),
    (b'\xff\xda\0\x0c\3\1', b'\xff\xda\0\x0c\3\7'), (b'\xff\xda', b'\xff\xd8')])
def test_rubbish_between_head_and_end_is_refused(old: bytes, new: bytes) -> None:
    jpeg = encoded(photo())
    check_jpeg(jpeg)
    damaged = jpeg.replace(old, new, 1)
    assert damaged != jpeg
    with pytest.raises(JpegError):
        check_jpeg(damaged)


def test_fill_bytes_and_stray_bytes_before_a_marker_are_passed_over_as_libjpeg_does() -> None:
    jpeg = encoded(photo())
    padded = jpeg[:2] + b'\xff\xff\xff' + jpeg[2:-2] + b'\xff\xff' + ENDS
    assert jpeg_size(padded) == (128, 96)
    assert np.array_equal(decode_picture(padded), decode_picture(jpeg))
