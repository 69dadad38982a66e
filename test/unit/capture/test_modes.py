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

"""The choice of a camera mode."""

from __future__ import annotations

from opencv_tools.capture.v4l2.modes import CameraRequest, choose_mode, describe_modes, Mode
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
def test_closest_mode_is_chosen(request_: CameraRequest, chosen: str) -> None:
    mode = choose_mode(list(RATES), request_, RATES.__getitem__)
    assert f'{mode.fourcc} {mode.size}' == chosen


@pytest.mark.parametrize(('encoding', 'chosen'), [
    ('', 'YUYV'), ('bgr8', 'YUYV'), ('mono8', 'GREY'), ('mono16', 'Y16'), ('nv12', 'NV12'),
    ('yuv422_yuy2', 'YUYV'), ('yuyv', 'YUYV'), ('yuv422', 'UYVY'), ('uyvy', 'UYVY'),
    ('16UC1', 'Z16')])
def test_format_with_the_requested_encoding_is_preferred(encoding: str, chosen: str) -> None:
    modes = [Mode(fourcc, 640, 480)
             for fourcc in ('GREY', 'NV12', 'Y16', 'YUYV', 'UYVY', 'MJPG', 'Z16')]
    assert choose_mode(modes, CameraRequest(encoding=encoding), lambda _: []).fourcc == chosen


@pytest.mark.parametrize(('encoding', 'chosen'), [
    ('', 'YUYV'), ('bgr8', 'YUYV'), ('mono8', 'YUYV'), ('yuyv', 'YUYV'), ('bgr16', 'YUYV'),
    ('nv12', 'NV12'), ('mono16', 'Y16')])
def test_size_counts_more_than_a_convertible_encoding(encoding: str, chosen: str) -> None:
    modes = [Mode('BGR3', 640, 480), Mode('NV12', 640, 480), Mode('GREY', 640, 480),
             Mode('Y16', 640, 480), Mode('YUYV', 1920, 1080)]
    request = CameraRequest(width=1920, height=1080, encoding=encoding)
    assert choose_mode(modes, request, lambda _: []).fourcc == chosen


def test_camera_with_unknown_formats_has_no_mode() -> None:
    modes = [Mode('HEVC', 640, 480), Mode('Y16-BE', 640, 480)]
    assert choose_mode(modes, CameraRequest(), lambda _: []) is None
    assert choose_mode([], CameraRequest(), lambda _: []) is None


def test_description_of_modes_groups_formats_by_size() -> None:
    assert describe_modes([*RATES, Mode('GREY', 640, 480), Mode('GREY', 1280, 720),
                           Mode('GREY', 1920, 1080)]) == (
        'YUYV MJPG GREY in 640x480 1280x720 1920x1080; H264 in 1920x1080')
