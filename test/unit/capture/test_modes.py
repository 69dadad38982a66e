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

import cv2
import numpy as np
from opencv_tools.capture.errors import BrokenFrameError
from opencv_tools.capture.pattern import draw_pattern
from opencv_tools.capture.v4l2 import videodev2
from opencv_tools.capture.v4l2.modes import CameraRequest, choose_mode, describe_modes, Mode
from opencv_tools.capture.v4l2.pixel_formats import (
    check_fourcc, pack_fourcc, PIXEL_FORMATS, read_pixels, unpack_fourcc)
from opencv_tools.image.encodings import find_encoding
import pytest

# A typical webcam: raw frames have a low rate at large sizes.
RATES = {
    Mode('YUYV', 640, 480): [15.0, 30.0], Mode('YUYV', 1280, 720): [10.0],
    Mode('YUYV', 1920, 1080): [5.0], Mode('MJPG', 640, 480): [30.0],
    Mode('MJPG', 1280, 720): [30.0, 60.0], Mode('MJPG', 1920, 1080): [30.0],
    Mode('H264', 1920, 1080): [30.0],
}


@pytest.mark.parametrize(('request_', 'chosen'), [
    (CameraRequest(), 'YUYV 640x480'),
    (CameraRequest(width=1280), 'MJPG 1280x720'),
    (CameraRequest(width=1920, height=1080), 'MJPG 1920x1080'),
    (CameraRequest(width=1920, height=1080, fps=5.0), 'YUYV 1920x1080'),
    (CameraRequest(width=1920, height=1080, fourcc='YUYV'), 'YUYV 1920x1080'),
    (CameraRequest(width=1920, height=1080, encoding='yuv422_yuy2'), 'YUYV 1920x1080'),
    (CameraRequest(width=1920, height=1080, encoding='yuyv'), 'YUYV 1920x1080'),
    (CameraRequest(height=700, encoding='bgr8'), 'MJPG 1280x720'),
    (CameraRequest(fps=60.0, width=1280), 'MJPG 1280x720'),
    (CameraRequest(width=9999, height=9999), 'MJPG 1920x1080'),
    (CameraRequest(fourcc='GREY', width=320), 'YUYV 640x480'),
])
def test_the_mode_that_comes_nearest_is_chosen(request_: CameraRequest, chosen: str) -> None:
    mode = choose_mode(list(RATES), request_, RATES.__getitem__)
    assert f'{mode.fourcc} {mode.size}' == chosen


@pytest.mark.parametrize(('encoding', 'chosen'), [
    ('', 'YUYV'), ('bgr8', 'YUYV'), ('mono8', 'GREY'), ('mono16', 'Y16'), ('nv12', 'NV12'),
    ('yuv422_yuy2', 'YUYV'), ('yuyv', 'YUYV'), ('yuv422', 'UYVY'), ('uyvy', 'UYVY'),
    ('16UC1', 'Z16')])
def test_an_encoding_that_a_format_has_is_preferred(encoding: str, chosen: str) -> None:
    modes = [Mode(fourcc, 640, 480)
             for fourcc in ('GREY', 'NV12', 'Y16', 'YUYV', 'UYVY', 'MJPG', 'Z16')]
    assert choose_mode(modes, CameraRequest(encoding=encoding), lambda _: []).fourcc == chosen


@pytest.mark.parametrize(('encoding', 'chosen'), [
    ('', 'YUYV'), ('bgr8', 'YUYV'), ('mono8', 'YUYV'), ('yuyv', 'YUYV'), ('bgr16', 'YUYV'),
    ('nv12', 'NV12'), ('mono16', 'Y16')])
def test_a_size_counts_more_than_a_format_that_others_can_become(
        encoding: str, chosen: str) -> None:
    modes = [Mode('BGR3', 640, 480), Mode('NV12', 640, 480), Mode('GREY', 640, 480),
             Mode('Y16', 640, 480), Mode('YUYV', 1920, 1080)]
    request = CameraRequest(width=1920, height=1080, encoding=encoding)
    assert choose_mode(modes, request, lambda _: []).fourcc == chosen


def test_a_camera_of_unknown_formats_has_no_mode() -> None:
    modes = [Mode('H264', 640, 480), Mode('Y16-BE', 640, 480)]
    assert choose_mode(modes, CameraRequest(), lambda _: []) is None
    assert choose_mode([], CameraRequest(), lambda _: []) is None


def test_modes_are_described_by_their_sizes() -> None:
    assert describe_modes([*RATES, Mode('GREY', 640, 480), Mode('GREY', 1280, 720),
                           Mode('GREY', 1920, 1080)]) == (
        'YUYV MJPG GREY in 640x480 1280x720 1920x1080; H264 in 1920x1080')


@pytest.mark.parametrize(('text', 'number'), [
    ('YUYV', 0x56595559), ('Y16', 0x20363159), ('Y16-BE', 0xa0363159), ('RGB3', 0x33424752)])
def test_four_letters_are_a_number_and_back(text: str, number: int) -> None:
    assert pack_fourcc(text) == number  # from v4l2_fourcc of <linux/videodev2.h>
    assert unpack_fourcc(number) == text


def test_letters_that_are_no_known_format() -> None:
    check_fourcc('')
    check_fourcc('MJPG')
    with pytest.raises(ValueError, match='BGR3, RGB3'):
        check_fourcc('H264')


HEIGHT, WIDTH = 6, 8
PADDING = 4


@pytest.mark.parametrize('padding', [0, PADDING])
@pytest.mark.parametrize('fourcc', [
    fourcc for fourcc, known in PIXEL_FORMATS.items()
    if known.encoding != 'jpeg' and fourcc not in ('YU12', 'YV12', 'NV24')])
def test_pixels_are_read_without_the_padding(fourcc: str, padding: int) -> None:
    known = PIXEL_FORMATS[fourcc]
    encoding = find_encoding(known.encoding)
    rows = encoding.rows(HEIGHT)
    content = np.random.default_rng(3).integers(
        0, 255, (rows, WIDTH * encoding.pixel_bytes), np.uint8)
    padded = np.pad(content, ((0, 0), (0, padding * encoding.pixel_bytes)), constant_values=77)
    data = padded.tobytes()
    image = read_pixels(known, data, HEIGHT, WIDTH, padded.shape[1])
    assert image.tobytes() == content.tobytes()
    assert image.dtype == encoding.dtype
    with pytest.raises(BrokenFrameError, match='the camera sent an incomplete frame'):
        read_pixels(known, data[:len(data) // 2], HEIGHT, WIDTH, padded.shape[1])


@pytest.mark.parametrize('padding', [0, PADDING])
@pytest.mark.parametrize(('fourcc', 'order'), [('YU12', (0, 1)), ('YV12', (1, 0))])
def test_planes_become_bgr(fourcc: str, order: tuple[int, int], padding: int) -> None:
    picture = draw_pattern(3, 64, 48)
    planes = cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420)
    luma, chroma = planes[:48], planes[48:].reshape(2, 24, 32)
    lines = [np.pad(luma, ((0, 0), (0, 2 * padding)))]
    lines += [np.pad(chroma[index], ((0, 0), (0, padding))) for index in order]
    data = b''.join(line.tobytes() for line in lines)
    image = read_pixels(PIXEL_FORMATS[fourcc], data, 48, 64, 64 + 2 * padding)
    assert np.array_equal(image, cv2.cvtColor(planes, cv2.COLOR_YUV2BGR_I420))


def test_a_jpeg_is_left_as_it_is() -> None:
    image = read_pixels(PIXEL_FORMATS['MJPG'], b'\xff\xd8 and so on', 48, 64, 0)
    assert image.tobytes() == b'\xff\xd8 and so on'


@pytest.mark.parametrize(('name', 'number'), [
    ('QUERYCAP', 0x80685600), ('ENUM_FMT', 0xc0405602), ('S_FMT', 0xc0d05605),
    ('REQBUFS', 0xc0145608), ('QUERYBUF', 0xc0585609), ('QBUF', 0xc058560f),
    ('DQBUF', 0xc0585611), ('STREAMON', 0x40045612), ('G_PARM', 0xc0cc5615),
    ('S_PARM', 0xc0cc5616), ('G_CTRL', 0xc008561b), ('S_CTRL', 0xc008561c),
    ('QUERYMENU', 0xc02c5625), ('ENUM_FRAMESIZES', 0xc02c564a),
    ('ENUM_FRAMEINTERVALS', 0xc034564b), ('DQEVENT', 0x80885659),
    ('SUBSCRIBE_EVENT', 0x4020565a), ('QUERY_EXT_CTRL', 0xc0e85667)])
def test_ioctl_numbers_of_64_bit_linux(name: str, number: int) -> None:
    assert getattr(videodev2, f'VIDIOC_{name}') == number


@pytest.mark.parametrize(('structure', 'field', 'offset'), [
    ('v4l2_capability', 'device_caps', 88), ('v4l2_fmtdesc', 'pixelformat', 44),
    ('v4l2_frmsizeenum', 'union', 12), ('v4l2_frmivalenum', 'union', 20),
    ('v4l2_format', 'fmt', 8), ('v4l2_pix_format', 'bytesperline', 16),
    ('v4l2_pix_format_mplane', 'plane_fmt', 20), ('v4l2_plane_pix_format', 'bytesperline', 4),
    ('v4l2_captureparm', 'timeperframe', 8), ('v4l2_plane', 'm', 8),
    ('v4l2_plane', 'data_offset', 16), ('v4l2_buffer', 'timestamp', 24),
    ('v4l2_buffer', 'sequence', 56), ('v4l2_buffer', 'm', 64), ('v4l2_buffer', 'length', 72),
    ('v4l2_query_ext_ctrl', 'flags', 72), ('v4l2_event', 'id', 96)])
def test_offsets_in_v4l2_structures(structure: str, field: str, offset: int) -> None:
    assert getattr(getattr(videodev2, structure), field).offset == offset
