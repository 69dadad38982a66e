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

from dataclasses import dataclass, replace
from functools import cache, partial
import re
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from opencv_tools.capture.frame import CapturedFrame, MAX_RATE

_SPEC = re.compile(
    r'pattern(?P<depth>:depth)?(?::([0-9]+)x([0-9]+)(?:@([0-9]+(?:\.[0-9]+)?))?)?')
_MAX_SIDE = 16384

# Colour bars in BGR, in the order of a television test card.
_BARS = ((192, 192, 192), (0, 192, 192), (192, 192, 0), (0, 192, 0),
         (192, 0, 192), (0, 0, 192), (192, 0, 0), (16, 16, 16))

# Depths in millimetres: of the left and right edge of a plane and how much nearer it is in each of
# 64 frames, and of the number of the frame and its label.
_LEFT, _RIGHT, _STEP, _DIGIT, _LABEL = 1500, 4000, 16, 700, 900

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
    :param is_depth: whether the frames are images of depth.
    """

    width: int = 640
    height: int = 480
    rate: float = 30.0
    is_depth: bool = False


def parse_pattern(spec: str) -> PatternSpec:
    """
    Read the settings of a test pattern from text.

    :param spec: ``pattern[:depth][:WIDTHxHEIGHT[@FPS]]``; defaults are 640x480 and 30.
    :raises ValueError: the text has another form, or a number is out of range.
    """
    match = _SPEC.fullmatch(spec)
    if not match:
        raise ValueError('write a pattern as pattern[:depth][:WIDTHxHEIGHT[@FPS]], '
                         'for example pattern:640x480@30')
    default = PatternSpec()
    parsed = PatternSpec(int(match[2] or default.width), int(match[3] or default.height),
                         float(match[4] or default.rate), bool(match['depth']))
    if not (1 <= parsed.width <= _MAX_SIDE and 1 <= parsed.height <= _MAX_SIDE
            and 0 < parsed.rate <= MAX_RATE):
        raise ValueError(f'give a pattern a width and a height from 1 to {_MAX_SIDE} pixels '
                         f'and a rate above 0 and up to {MAX_RATE:g} frames per second')
    return parsed


class PatternSource:
    """
    An endless source of numbered frames: colour bars with a moving line, or depth.

    Depth is ``16UC1`` in millimetres: a plane that comes nearer, with a hole of no data.
    """

    live: Literal[False] = False
    warnings = ()
    count = 0

    def __init__(self, spec: PatternSpec) -> None:
        size = f'{spec.width}x{spec.height}'
        self.name = f'pattern depth {size}' if spec.is_depth else f'pattern {size}'
        self.rate = spec.rate
        self._encoding = '16UC1' if spec.is_depth else 'bgr8'
        self.description = f'{self._encoding} {size} at {spec.rate:g} Hz'
        self._draw = _draw_plane if spec.is_depth else _draw_over
        self._background = (_draw_slope if spec.is_depth else _draw_background)(
            spec.width, spec.height)
        self._number = 0

    def skip(self) -> bool:
        self._number += 1
        return True

    def read(self) -> CapturedFrame:
        frame = self.read_ahead()
        return replace(frame, pixels=frame.image)

    def read_ahead(self) -> CapturedFrame:
        drawn = cache(partial(self._draw, self._background, self._number))
        self._number += 1
        return CapturedFrame(drawn, self._encoding, position=(self._number - 1) / self.rate)

    def rewind(self) -> None:
        self._number = 0

    def close(self) -> None:
        pass


def _draw_over(background: NDArray[Any], number: int) -> NDArray[Any]:
    """Return a copy of the background with a white vertical line and the number of a frame."""
    image = np.array(background)
    width = image.shape[1]
    left = number % 64 * width // 64  # crosses the image from left to right in 64 frames
    image[:, left:left + max(1, width // 64)] = 255
    _draw_number(image, number, 255, 0)
    return image


def _draw_plane(background: NDArray[Any], number: int) -> NDArray[Any]:
    """Return the plane nearer, with a hole that moves, and the number of a frame."""
    image = background - np.uint16(number % 64 * _STEP)
    height, width = image.shape[:2]
    left = number % 64 * width // 64
    image[height // 8:height // 4, left:left + max(1, width // 8)] = 0
    _draw_number(image, number, _DIGIT, _LABEL)
    return image


def _draw_slope(width: int, height: int) -> NDArray[np.uint16]:
    """Return a plane whose right edge is farther away."""
    return np.tile(np.linspace(_LEFT, _RIGHT, width).astype(np.uint16), (height, 1))


def _draw_background(width: int, height: int) -> NDArray[np.uint8]:
    """Return the colour bars with a gray ramp from black to white below them."""
    image = np.empty((height, width, 3), np.uint8)
    columns = np.arange(width)
    image[:] = np.array(_BARS, np.uint8)[columns * len(_BARS) // width]
    image[height * 5 // 6:] = (columns * 255 // max(1, width - 1)).astype(np.uint8)[:, None]
    return image


def _draw_number(image: NDArray[Any], number: int, digit: int, label: int) -> None:
    """Draw the number of the frame with one value on another, in the middle of the image."""
    digits = [_DIGITS[int(digit)] for digit in f'{number:06d}']
    rows = [' '.join(digit[row] for digit in digits) for row in range(5)]
    cells = np.pad([[cell == '#' for cell in row] for row in rows], 1)
    height, width = image.shape[:2]
    scale = max(1, min(width // 2 // cells.shape[1], height // 3 // cells.shape[0]))
    drawn = np.kron(cells, np.ones((scale, scale), bool))[:height, :width]
    top, left = (height - drawn.shape[0]) // 2, (width - drawn.shape[1]) // 2
    part = image[top:top + drawn.shape[0], left:left + drawn.shape[1]]
    part[...] = label
    part[drawn] = digit
