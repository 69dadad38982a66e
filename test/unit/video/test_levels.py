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

"""Levels by size and bit rate, in the parameter sets of every encoder."""

from __future__ import annotations

import numpy as np
from opencv_tools.video.bit_stream import BitReader, nal_units, START_CODE, unescaped
from opencv_tools.video.encoder import VideoEncoder
from opencv_tools.video.levels import find_level, with_level
from opencv_tools.video.settings import VideoSettings
import pytest

SLICE = START_CODE + b'\x65\x88'


@pytest.mark.parametrize(('codec', 'width', 'height', 'bits', 'level'), [
    ('h264', 320, 240, 0, 31), ('h264', 1280, 720, 500_000, 42), ('h264', 1920, 1080, 0, 42),
    ('h264', 3840, 2160, 0, 52), ('h264', 320, 240, 20_000_000, 42), ('h264', 16384, 16, 0, 62),
    ('h264', 37, 1003, 0, 31), ('h264', 16384, 16384, 0, 62), ('h265', 640, 480, 0, 93),
    ('h265', 1280, 720, 0, 123), ('h265', 3840, 2160, 0, 153), ('h265', 7680, 4320, 0, 186),
    ('h265', 640, 480, 15_000_000, 123), ('h265', 640, 480, 10**9, 186), ('av1', 640, 480, 0, 0)])
def test_levels(codec: str, width: int, height: int, bits: int, level: int) -> None:
    assert find_level(codec, width, height, bits) == level


@pytest.mark.parametrize(('codec', 'sets', 'level', 'changed'), [
    ('h264', '27 64000d ac', 42, '27 64002a ac'),
    # The bytes before the level of H.265 have two or three emulation prevention bytes.
    ('h265', '42 01 01 21 60000003009000000300000300 d5 a0', 93,
     '42 01 01 01 60000003009000000300000300 5d a0'),
    ('h265', '42 01 01 21 60000003000003000003000003 00 78 a0', 123,
     '42 01 01 01 60000003000003000003000003 00 7b a0'),
    ('h265', '40 01 0c 01 ffff 21 60000003009000000300000300 b7 ba', 186,
     '40 01 0c 01 ffff 01 60000003009000000300000300 ba ba')])
def test_level_of_an_encoder_is_replaced(
        codec: str, sets: str, level: int, changed: str) -> None:
    begin, after = START_CODE + b'\x09\x10', START_CODE[1:] + bytes.fromhex(sets)
    if codec == 'h265':
        begin = START_CODE + b'\x46\x01\x10'
    assert with_level(codec, begin + after + SLICE, level) == (
        begin + START_CODE[1:] + bytes.fromhex(changed) + SLICE)


def test_references_fit_the_level() -> None:
    packet = VideoEncoder(VideoSettings(preset='veryslow'), 1280, 720, 30).encode(
        np.zeros((720, 1280, 3), np.uint8), 'bgr8', 0)
    sps = next(unit for unit in nal_units(packet.data) if unit[0] & 31 == 7)
    reader = BitReader(unescaped(sps)[1:])
    assert reader.bits(24) == 0x64002a
    # Up to log2_max_frame_num_minus4, pic_order_cnt_type and max_num_ref_frames.
    assert [reader.unsigned() for _ in range(4)] == [0, 1, 0, 0] and reader.bits(2) == 0
    _, order, references = (reader.unsigned() for _ in range(3))
    assert order == 2 and references == 34_816 // (80 * 45)  # MaxDpbMbs of level 4.2
