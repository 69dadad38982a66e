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

"""Packets of compressed video, and the pictures that they show."""

from __future__ import annotations

from functools import lru_cache

from av.codec.codec import Codec, UnknownCodecError
import numpy as np
from opencv_tools.video.encoder import VideoEncoder
from opencv_tools.video.packet import ENCODED, VideoPacket
from opencv_tools.video.settings import VideoSettings
import pytest

PERIOD_NS = 33_333_333
DECODERS = {'h264': 'h264', 'h265': 'hevc', 'av1': 'libdav1d'}


def has_encoder(name: str) -> bool:
    """Return whether the installed PyAV has an encoder."""
    try:
        return bool(Codec(name, 'w'))
    except UnknownCodecError:
        return False


HERE = tuple(codec for codec in ENCODED if has_encoder(VideoSettings(codec=codec).encoder_name))
every_codec = pytest.mark.parametrize('codec', HERE)


def draw(width: int, height: int, number: int) -> np.ndarray:
    """Draw a picture of smooth colours that move."""
    rows, columns = np.mgrid[:height, :width]
    return np.dstack((columns + 3 * number, rows * 2, rows + columns + 5 * number)
                     ).astype(np.uint8) // 2 + 60


def encoded(settings: VideoSettings, width: int, height: int, count: int) -> list[VideoPacket]:
    """Encode pictures at a constant rate."""
    encoder = VideoEncoder(settings, width, height, 30)
    return [encoder.encode(draw(width, height, number), 'bgr8', number * PERIOD_NS)
            for number in range(count)]


@lru_cache
def packets(codec: str, width: int = 160, height: int = 120, count: int = 6,
            ) -> tuple[VideoPacket, ...]:
    """Return packets of moving pictures; the first one is the only key frame."""
    return tuple(encoded(VideoSettings(codec=codec), width, height, count))
