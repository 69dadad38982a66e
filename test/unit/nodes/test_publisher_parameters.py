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

"""The size of frames that is expected before the node exists."""

from __future__ import annotations

import os
from pathlib import Path

from conftest import CLIP
import cv2
import numpy as np
from opencv_tools.nodes.executable import Executable
from opencv_tools.nodes.publisher.parameters import PublisherSettings
import pytest

VGA = 640 * 480 * 3
FULL_HD = 1920 * 1080 * 3


PUBLISHER = Executable(
    name='img_publisher', node='image_publisher', settings=PublisherSettings)


def frame_bytes(*words: str) -> int:
    """Return the frame size of a command line with some ROS arguments."""
    return PUBLISHER.read_start(['img_publisher', '--ros-args', *words])[1]


@pytest.fixture(autouse=True)
def _in_a_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(('words', 'size'), [
    ((), VGA),
    (('-p', 'source:=pattern'), VGA),
    (('-p', 'source:=pattern:1920x1080@30'), FULL_HD),
    (('-p', 'width:=1280', '-p', 'height:=720'), 1280 * 720 * 3),
    (('-p', 'image_publisher:width:=1280', '--param', 'image_publisher:height:=720'),
     1280 * 720 * 3),
    (('-p', 'width:=1280'), 1280 * 480 * 3),
    (('-p', 'encoding:=mono8'), 640 * 480),
    (('-p', 'encoding:=rgba16'), 640 * 480 * 8),
    (('-p', 'encoding:=nv12'), 640 * 480 * 3 // 2),
    (('-p', "encoding:=''"), VGA),
    (('-p', 'source:=picture.png'), 64 * 48 * 3),
    (('-p', 'source:=.'), 64 * 48 * 3),
    (('-p', f'source:=file://{CLIP}'), 1280 * 720 * 3),
    (('-p', 'source:=picture.png', '-p', 'encoding:=mono8'), 64 * 48),
    (('-p', f'source:={CLIP}'), 1280 * 720 * 3),
    (('--params-file', 'cameras.yaml'), 320 * 240 * 3),
    (('--params-file', 'cameras.yaml', '-p', 'source:=pattern:160x120'), 160 * 120 * 3),
    (('-p', 'viewer:width:=1280'), VGA),
    (('-p', 'eye:width:=1280', '-r', '__node:=eye'), 1280 * 480 * 3),
    (('--params-file', 'cameras.yaml', '-r', '__node:=viewer'), 96 * 64 * 3),
    (('--params-file', 'every.yaml'), 32 * 24 * 3)])
def test_frame_size_from_the_command_line(
        tmp_path: Path, words: tuple[str, ...], size: int) -> None:
    cv2.imwrite(str(tmp_path / 'picture.png'), np.zeros((48, 64, 3), np.uint8))
    section = '{}:\n  ros__parameters:\n    source: pattern:{}\n'
    (tmp_path / 'cameras.yaml').write_text(
        section.format('/**/image_publisher', '320x240') + section.format('/viewer', '96x64'))
    (tmp_path / 'every.yaml').write_text(section.format('/**', '32x24'))
    assert frame_bytes(*words) == size


@pytest.mark.parametrize('words', [
    ('-p', 'source:=rtsp://camera/stream'), ('-p', 'source:=nowhere.mp4'), ('-p', 'source:='),
    ('-p', 'source:=broken.png'), ('-p', 'source:=pattern:0x0'), ('-p', 'encoding:=foo'),
    ('-p', 'width:=wide'), ('-p', 'width:=[1]'), ('-p', 'width:={'),
    ('--params-file', 'nul.yaml'), ('-p', 'source:=~nobody_at_all/a.png'),
    ('-p', 'source:=pipe'), ('-p', 'width:=.inf'), ('-p', f'source:={"[" * 600}'),
    ('--params-file', 'nowhere.yaml'), ('--params-file', 'broken.png'),
    ('--params-file', 'list.yaml')])
def test_full_hd_for_an_unknown_size(tmp_path: Path, words: tuple[str, ...]) -> None:
    os.mkfifo(tmp_path / 'pipe')  # opening it waits for a writer
    (tmp_path / 'broken.png').write_bytes(b'\x89PNG\0')
    (tmp_path / 'nul.yaml').write_text(
        'image_publisher:\n  ros__parameters:\n    source: "a\\0b"\n')
    (tmp_path / 'list.yaml').write_text('image_publisher:\n  ros__parameters:\n    - width\n')
    assert frame_bytes(*words) == FULL_HD
