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

"""A test pattern with numbered frames, for use without a camera or file."""

from __future__ import annotations

from dataclasses import dataclass
import re
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from opencv_tools.capture.frame import CapturedFrame, MAX_RATE

_SPEC = re.compile(r'pattern(?::([0-9]+)x([0-9]+)(?:@([0-9]+(?:\.[0-9]+)?))?)?')
_MAX_SIDE = 16384

# Colour bars in BGR, in the order of a television test card.
_BARS = ((192, 192, 192), (0, 192, 192), (192, 192, 0), (0, 192, 0),
         (192, 0, 192), (0, 0, 192), (192, 0, 0), (16, 16, 16))

# Digits of 3 x 5 cells. Each string is a row of cells.
_DIGITS = (
    ('###', '# #', '# #', '# #', '###'), (' # ', '## ', ' # ', ' # ', '###'),
    ('###', '  #', '###', '#  ', '###'), ('###', '  #', '###', '  #', '###'),
    ('# #', '# #', '###', '  #', '  #'), ('###', '#  ', '###', '  #', '###'),
    ('###', '#  ', '###', '# #', '###'), ('###', '  #', '  #', '  #', '  #'),
    ('###', '# #', '###', '# #', '###'), ('###', '# #', '###', '  #', '###'),
)


@dataclass(frozen=True)
class PatternSpec:
    """
    The settings of a test pattern.

    :param width: width in pixels.
    :param height: height in pixels.
    :param rate: frames per second.
    """

    width: int = 640
    height: int = 480
    rate: float = 30.0


def parse_pattern(spec: str) -> PatternSpec:
    """
    Read the settings of a test pattern from text.

    :param spec: ``pattern[:WIDTHxHEIGHT[@FPS]]``; defaults are 640x480 and 30.
    :raises ValueError: the text has another form, or a number is out of range.
    """
    match = _SPEC.fullmatch(spec)
    if not match:
        raise ValueError('write a pattern as pattern[:WIDTHxHEIGHT[@FPS]], '
                         'for example pattern:640x480@30')
    default = PatternSpec()
    parsed = PatternSpec(int(match[1] or default.width), int(match[2] or default.height),
                         float(match[3] or default.rate))
    if not (1 <= parsed.width <= _MAX_SIDE and 1 <= parsed.height <= _MAX_SIDE
            and 0 < parsed.rate <= MAX_RATE):
        raise ValueError(f'give a pattern a width and a height from 1 to {_MAX_SIDE} pixels '
                         f'and a rate above 0 and up to {MAX_RATE:g} frames per second')
    return parsed


class PatternSource:
    """An endless source of colour bars with a moving line and the number of the frame."""

    live: Literal[False] = False
    count = 0

    def __init__(self, spec: PatternSpec) -> None:
        self.name = f'pattern {spec.width}x{spec.height}'
        self.rate = spec.rate
        self.description = f'bgr8 {spec.width}x{spec.height} at {spec.rate:g} Hz'
        self._background = _draw_background(spec.width, spec.height)
        self._number = 0

    def skip(self) -> bool:
        self._number += 1
        return True

    def read(self) -> CapturedFrame:
        image = _draw_over(self._background, self._number)
        self._number += 1
        return CapturedFrame(image, 'bgr8', position=(self._number - 1) / self.rate)

    def rewind(self) -> None:
        self._number = 0

    def close(self) -> None:
        pass


def _draw_over(background: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    """Return a copy of the background with a white vertical line and the number of a frame."""
    image = np.array(background)
    width = image.shape[1]
    left = number % 64 * width // 64  # crosses the image from left to right in 64 frames
    image[:, left:left + max(1, width // 64)] = 255
    _draw_number(image, number)
    return image


def _draw_background(width: int, height: int) -> NDArray[np.uint8]:
    """Return the colour bars with a gray ramp from black to white below them."""
    image = np.empty((height, width, 3), np.uint8)
    columns = np.arange(width)
    image[:] = np.array(_BARS, np.uint8)[columns * len(_BARS) // width]
    image[height * 5 // 6:] = (columns * 255 // max(1, width - 1)).astype(np.uint8)[:, None]
    return image


def _draw_number(image: NDArray[np.uint8], number: int) -> None:
    """Draw the number of the frame in white on black, in the middle of the image."""
    digits = [_DIGITS[int(digit)] for digit in f'{number:06d}']
    rows = [' '.join(digit[row] for digit in digits) for row in range(5)]
    cells = np.pad([[cell == '#' for cell in row] for row in rows], 1)
    height, width = image.shape[:2]
    scale = max(1, min(width // 2 // cells.shape[1], height // 3 // cells.shape[0]))
    label = np.kron(cells, np.ones((scale, scale), bool))[:height, :width]
    top, left = (height - label.shape[0]) // 2, (width - label.shape[1]) // 2
    image[top:top + label.shape[0], left:left + label.shape[1]] = label[..., None] * np.uint8(255)
