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

"""V4L2 pixel formats, and their conversion to arrays."""

from __future__ import annotations

import cv2
from images import draw_pattern
import numpy as np
from opencv_tools.capture.errors import BrokenFrameError
from opencv_tools.capture.v4l2.pixel_formats import (
    check_fourcc, pack_fourcc, PIXEL_FORMATS, read_pixels, unpack_fourcc)
from opencv_tools.image.encodings import find_encoding
import pytest


@pytest.mark.parametrize(('text', 'number'), [
    ('YUYV', 0x56595559), ('Y16', 0x20363159), ('Y16-BE', 0xa0363159), ('RGB3', 0x33424752)])
def test_fourcc_round_trip(text: str, number: int) -> None:
    assert pack_fourcc(text) == number  # from v4l2_fourcc of <linux/videodev2.h>
    assert unpack_fourcc(number) == text


def test_unknown_fourcc_is_refused() -> None:
    check_fourcc('')
    check_fourcc('MJPG')
    with pytest.raises(ValueError, match='BGR3, RGB3'):
        check_fourcc('HEVC')


HEIGHT, WIDTH = 6, 8
PADDING = 4


@pytest.mark.parametrize('padding', [0, 1, 7, 32])
@pytest.mark.parametrize('fourcc', [
    fourcc for fourcc, known in PIXEL_FORMATS.items()
    if known.encoding not in ('jpeg', 'video') and fourcc not in ('YU12', 'YV12', 'NV24')])
def test_padding_of_lines_is_skipped(fourcc: str, padding: int) -> None:
    known = PIXEL_FORMATS[fourcc]
    encoding = find_encoding(known.encoding)
    rows = encoding.rows(HEIGHT)
    content = np.random.default_rng(3).integers(
        0, 255, (rows, WIDTH * encoding.pixel_bytes), np.uint8)
    padded = np.pad(content, ((0, 0), (0, padding)), constant_values=77)
    data = padded.tobytes()
    image = read_pixels(known, data, HEIGHT, WIDTH, padded.shape[1])
    assert image.tobytes() == content.tobytes()
    assert image.dtype == encoding.dtype
    with pytest.raises(BrokenFrameError, match='the camera sent an incomplete frame'):
        read_pixels(known, data[:len(data) // 2], HEIGHT, WIDTH, padded.shape[1])


@pytest.mark.parametrize('padding', [0, PADDING])
@pytest.mark.parametrize(('fourcc', 'order'), [('YU12', (0, 1)), ('YV12', (1, 0))])
def test_planar_formats_become_bgr(fourcc: str, order: tuple[int, int], padding: int) -> None:
    picture = draw_pattern(3, 64, 48)
    planes = cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420)
    luma, chroma = planes[:48], planes[48:].reshape(2, 24, 32)
    lines = [np.pad(luma, ((0, 0), (0, 2 * padding)))]
    lines += [np.pad(chroma[index], ((0, 0), (0, padding))) for index in order]
    data = b''.join(line.tobytes() for line in lines)
    image = read_pixels(PIXEL_FORMATS[fourcc], data, 48, 64, 64 + 2 * padding)
    assert np.array_equal(image, cv2.cvtColor(planes, cv2.COLOR_YUV2BGR_I420))


def test_jpeg_data_are_not_converted() -> None:
    image = read_pixels(PIXEL_FORMATS['MJPG'], b'\xff\xd8 and so on', 48, 64, 0)
    assert image.tobytes() == b'\xff\xd8 and so on'
