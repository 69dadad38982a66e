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

"""Videos whose frames show their number, and their decoding by other programs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import av
import cv2
import numpy as np
from opencv_tools.recording.video.writer import to_video_frame, VIDEO_FORMATS, VideoWriter
import pytest

START_NS = 1_700_000_000_123_456_789
BLOCK = 8
BITS = 16
TOLERANCE_MS = {'.mp4': 0.02, '.mkv': 0.51, '.avi': 1.7}
every_format = pytest.mark.parametrize('suffix', VIDEO_FORMATS)


def draw(number: int, height: int = 2 * BLOCK) -> np.ndarray:
    """Draw a number above noise, in blocks that survive any compression."""
    bits = np.array([number >> bit & 1 for bit in range(BITS)], np.uint8) * 255
    noise = np.random.default_rng(number).integers(0, 256, (height, BITS * BLOCK), np.uint8)
    noise[:2 * BLOCK] = np.kron(bits, np.ones((2 * BLOCK, BLOCK), np.uint8))
    return noise


def read(image: np.ndarray) -> int:
    """Read the number that is drawn in an image."""
    blocks = image[:2 * BLOCK].reshape(2 * BLOCK, BITS, BLOCK, -1).mean(axis=(0, 2, 3)) > 127
    return sum(1 << bit for bit in range(BITS) if blocks[bit])


def record(path: Path, frames: dict[int, int], crf: int = 23) -> VideoWriter:
    """Write a video of numbers, each at its time."""
    pictures = {number: to_video_frame(draw(number), 'mono8', path.suffix) for number in frames}
    writer = VideoWriter(path, next(iter(pictures.values())), START_NS, crf)
    for number, time_ns in frames.items():
        writer.write(pictures[number], time_ns)
    writer.close()
    return writer


def play(path: Path) -> Iterator[tuple[float, np.ndarray]]:
    """Yield the times in ms and the frames of a video, as OpenCV reads them."""
    capture = cv2.VideoCapture(str(path))
    assert capture.isOpened()
    while True:
        is_read, image = capture.read()
        if not is_read:
            return
        yield capture.get(cv2.CAP_PROP_POS_MSEC), image


def decode(path: Path) -> list[np.ndarray]:
    """Return the frames of a video as PyAV reads them; PyAV raises if one is damaged."""
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format='bgr24') for frame in container.decode(video=0)]


def numbers(path: Path) -> list[int]:
    """Read the numbers in a video with two programs that must agree."""
    found = [read(image) for _, image in play(path)]
    assert found == [read(image) for image in decode(path)]
    return found


COLORS = {'red': (0, 0, 255), 'green': (0, 255, 0), 'blue': (255, 0, 0), 'gray': (128, 128, 128),
          'black': (0, 0, 0), 'white': (255, 255, 255), 'brown': (30, 80, 140)}
# Y, Cb and Cr of B, G, R and 1, as tables of the standard have it.
BT_601 = np.array([[24.966, 128.553, 65.481, 16], [112, -74.203, -37.797, 128],
                   [-18.214, -93.786, 112, 128]])
