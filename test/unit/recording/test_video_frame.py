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

"""Frames for the video encoder: colours of the standard, and frames that are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.recording.errors import VideoError
from opencv_tools.recording.video.writer import to_video_frame, VideoWriter
import pytest
from videos import BT_601, COLORS, decode


def planes(image: np.ndarray, encoding: str) -> list[np.ndarray]:
    """Return Y, Cb and Cr of a frame as the encoder gets them."""
    frame = to_video_frame(image, encoding, '.mkv').frame
    return [np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)[:, :plane.width]
            for plane in frame.planes]


@pytest.mark.parametrize('size', [(16, 16), (1, 256)])
def test_every_gray_has_the_luma_of_bt_601(size: tuple[int, int]) -> None:
    ramp = np.arange(256, dtype=np.uint8).reshape(size)
    luma, *chroma = planes(ramp, 'mono8')
    np.testing.assert_array_equal(luma, np.rint(16 + 219 / 255 * ramp))
    assert all((plane == 128).all() for plane in chroma)


@pytest.mark.parametrize('size', [(2, 4), (3, 5)])
@pytest.mark.parametrize('color', COLORS)
def test_colors_are_those_of_bt_601(color: str, size: tuple[int, int]) -> None:
    image = np.full((*size, 3), COLORS[color], np.uint8)
    expected = BT_601 @ [*np.divide(COLORS[color], 255), 1]
    for frame in (planes(image, 'bgr8'), planes(image[..., ::-1], 'rgb8')):
        for plane, value in zip(frame, expected):
            assert np.abs(plane - value).max() < 0.75


TAKEN = {'mono8', 'rgb8', 'bgr8', '8UC1', '8UC3', '8U'}
CONVERTED = {'bayer_rggb8', 'bayer_bggr8', 'bayer_gbrg8', 'bayer_grbg8', 'yuv422', 'uyvy',
             'yuv422_yuy2', 'yuyv', 'nv12', 'nv21', 'nv24'}


LOSSLESS = {'mono16', '16UC1'}
REFUSED = {*ENCODINGS, '8UC2', '8UC4', '8SC1', '16UC3', '16SC1', '16SC3', '32FC1', '64FC3'
           } - TAKEN - CONVERTED - LOSSLESS


def gray_image(name: str) -> np.ndarray:
    """Return a frame of 6x8 pixels whose bytes or numbers are all 100."""
    encoding = find_encoding(name)
    shape = (encoding.rows(8), 6, encoding.channels)[:2 + (encoding.channels > 1)]
    return np.full(shape, 100, encoding.dtype)


@pytest.mark.parametrize(('name', 'to_color'), [
    *((name, to_color) for name in sorted(TAKEN) for to_color in (False, True)),
    *((name, True) for name in sorted(CONVERTED))])
def test_accepted_encodings(name: str, to_color: bool) -> None:
    picture = to_video_frame(gray_image(name), name, '.mkv', to_color)
    assert picture.stream_format == (6, 8, 'yuv420p', '')


@pytest.mark.parametrize('name', sorted(LOSSLESS))
def test_numbers_of_16_bits_are_lossless_in_matroska(name: str) -> None:
    picture = to_video_frame(gray_image(name), name, '.mkv')
    assert picture.stream_format == (6, 8, 'gray16le', name)
    assert (picture.frame.to_ndarray() == 100).all()
    for suffix in ('.mp4', '.avi'):
        with pytest.raises(VideoError, match=f'a {name} frame cannot be stored as {suffix}'):
            to_video_frame(gray_image(name), name, suffix)


@pytest.mark.parametrize(('name', 'to_color'), [
    *((name, to_color) for name in sorted(REFUSED) for to_color in (False, True)),
    *((name, False) for name in sorted(CONVERTED))])
def test_refused_encodings(name: str, to_color: bool) -> None:
    with pytest.raises(VideoError) as caught:
        to_video_frame(gray_image(name), name, '.mkv', to_color)
    assert str(caught.value) == f'a {name} frame cannot be stored as .mkv'


@pytest.mark.parametrize(('name', 'image', 'color'), [
    ('bayer_rggb8', np.tile(np.uint8([[200, 90], [90, 40]]), (16, 16)), (40, 90, 200)),
    ('bayer_bggr8', np.tile(np.uint8([[40, 90], [90, 200]]), (16, 16)), (40, 90, 200)),
    ('uyvy', np.tile(np.uint8([[[90, 81], [240, 81]]]), (32, 16, 1)), (0, 0, 254)),
    ('nv12', np.vstack([np.full((32, 32), 81, np.uint8),
                        np.tile(np.uint8([90, 240]), (16, 16))]), (0, 0, 254)),
])
def test_bayer_and_yuv_frames_are_converted(
        tmp_path: Path, name: str, image: np.ndarray, color: tuple[int, int, int]) -> None:
    path = tmp_path / 'video.mp4'
    picture = to_video_frame(image, name, '.mp4', to_color=True)
    writer = VideoWriter(path, picture, 0, 12)
    writer.write(picture, 0)
    writer.close()
    (kept,) = decode(path)
    assert kept.shape == (32, 32, 3)
    assert np.abs(kept[8:-8, 8:-8].reshape(-1, 3).mean(axis=0) - color).max() < 5


def test_empty_frame_is_refused_with_its_size() -> None:
    with pytest.raises(VideoError, match=r'an empty frame \(0x5\) cannot be stored as \.mp4$'):
        to_video_frame(np.zeros((5, 0, 3), np.uint8), 'bgr8', '.mp4')


@pytest.mark.parametrize('size', [(20, 30), (21, 31)])
def test_view_is_converted_and_not_changed(size: tuple[int, int]) -> None:
    large = np.random.default_rng(1).integers(0, 256, (2 * size[0], 100, 4), np.uint8)
    large.flags.writeable = False
    view = large[::-2, 2:2 + size[1], 2::-1]
    before = large.copy()
    picture = to_video_frame(view, 'bgr8', '.mkv')
    other = to_video_frame(view.copy(), 'bgr8', '.mkv')
    kept = [picture.frame.to_ndarray(format='rgb24') for picture in (picture, other)]
    np.testing.assert_array_equal(*kept)
    np.testing.assert_array_equal(large, before)
