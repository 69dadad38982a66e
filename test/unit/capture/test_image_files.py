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

"""Image files as a source: one file, a folder, or the matches of a glob pattern."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
from images import oriented_jpeg, UPRIGHT
import numpy as np
from opencv_tools.base.regular_files import natural_order
from opencv_tools.capture.errors import BrokenFrameError, CaptureError
from opencv_tools.capture.source import expected_size, open_source
from playback import frames_of, numbers, play
import pytest
from special_files import KINDS

PICTURES = {
    'mono8.png': ('mono8', (4, 5), np.uint8), 'mono16.png': ('mono16', (4, 5), np.uint16),
    'bgr8.bmp': ('bgr8', (4, 5, 3), np.uint8), 'bgr16.tiff': ('bgr16', (4, 5, 3), np.uint16),
    'bgra8.png': ('bgra8', (4, 5, 4), np.uint8), 'float.tiff': ('32FC1', (4, 5), np.float32),
}


@pytest.mark.parametrize('name', PICTURES)
def test_image_keeps_its_depth_and_channels(tmp_path: Path, name: str) -> None:
    encoding, shape, dtype = PICTURES[name]
    image = np.random.default_rng(3).integers(0, 255, shape).astype(dtype)
    cv2.imwrite(str(tmp_path / name), image)
    (frame,) = frames_of(open_source(str(tmp_path / name)))
    assert frame.encoding == encoding
    assert np.array_equal(frame.image, image)


@pytest.mark.parametrize('orientation', UPRIGHT)
def test_images_are_rotated_by_their_exif_orientation(tmp_path: Path, orientation: int) -> None:
    image = np.random.default_rng(3).integers(0, 255, (16, 24, 3), np.uint8)
    jpeg = oriented_jpeg(image, orientation)
    (tmp_path / 'lying.jpg').write_bytes(jpeg)
    lying = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED)
    for text in (tmp_path, tmp_path / 'lying.jpg'):
        (frame,) = frames_of(open_source(str(text)))
        np.testing.assert_array_equal(frame.image, UPRIGHT[orientation](lying), strict=True)
        assert frame.encoding == 'bgr8'
    width, height = (16, 24) if orientation >= 5 else (24, 16)
    assert expected_size(str(tmp_path)) == (width, height)


def test_image_files_of_every_extension_are_found(tmp_path: Path) -> None:
    suffixes = ['png', 'jpg', 'jpeg', 'jpe', 'jp2', 'bmp', 'dib', 'tif', 'tiff', 'webp', 'pbm',
                'pgm', 'ppm', 'pnm', 'pxm', 'exr', 'hdr', 'pic', 'sr', 'ras', 'PNG']
    picture = cv2.imencode('.png', np.zeros((2, 2), np.uint8))[1].tobytes()
    for suffix in suffixes:
        (tmp_path / f'picture.{suffix}').write_bytes(picture)
    assert len(list(frames_of(open_source(str(tmp_path))))) == len(suffixes)


def test_folder_and_glob_are_read_in_natural_order(tmp_path: Path) -> None:
    for number in (10, 9, 1, 2):
        cv2.imwrite(str(tmp_path / f'f{number}.png'), np.full((2, 2), number, np.uint8))
    (tmp_path / 'notes.txt').write_text('no picture')
    (tmp_path / 'folder.png').mkdir()
    for text in (tmp_path, tmp_path / '*', tmp_path / 'f*.png'):
        values = [int(frame.image[0, 0]) for frame in frames_of(open_source(str(text)))]
        assert values == [1, 2, 9, 10]
    assert sorted(map(Path, ('a10', 'a9', 'b', '1')), key=natural_order) == [
        Path('1'), Path('a9'), Path('a10'), Path('b')]


def test_broken_image_file_is_skipped_and_reported(tmp_path: Path) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f'{number}.png'), np.full((2, 2), number, np.uint8))
    (tmp_path / '1.png').write_text('no picture')
    source = open_source(str(tmp_path))
    broken: list[BrokenFrameError] = []
    player = play(source, broken.append, publish_rate=100.0)
    assert [int(frame.image[0, 0]) for frame in player.frames()] == [0, 2]
    assert [str(err) for err in broken] == [
        f'{tmp_path}/1.png cannot be read: 10 bytes are not a picture that OpenCV can read']


@pytest.mark.parametrize('kind', ['socket', 'device', 'folder'])
def test_non_regular_file_in_a_sequence_is_skipped(tmp_path: Path, kind: str) -> None:
    for name in ('1.png', '2.png', '3.png'):
        cv2.imwrite(str(tmp_path / name), np.full((2, 2), int(name[0]), np.uint8))
    source = open_source(str(tmp_path))
    (tmp_path / '2.png').unlink()
    KINDS[kind][0](tmp_path / '2.png')
    reasons: list[str] = []
    player = play(source, lambda err: reasons.append(str(err)), publish_rate=500.0)
    assert numbers(player, 9) == [1, 3]
    assert len(reasons) == 1
    assert KINDS[kind][1] in reasons[0]


def test_image_file_that_is_too_large_is_skipped(tmp_path: Path) -> None:
    (tmp_path / '1.png').touch()
    os.truncate(tmp_path / '1.png', 1 << 42)
    reasons: list[str] = []
    with pytest.raises(CaptureError, match='has no readable frame'):
        list(play(open_source(str(tmp_path)), lambda err: reasons.append(str(err))).frames())
    assert '1.png cannot be read: 1.png is larger than' in reasons[0]
