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

"""Colours of numbers such as depth, and their range, which follows the pictures slowly."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.cv_bridge import cvtColorForDisplay
from opencv_tools.image.encodings import Encoding
from opencv_tools.image_codecs import apply_colormap
from opencv_tools.opencv import cv2
from opencv_tools.viewer.protocol import LARGEST
from opencv_tools.viewer.streams.pixels import DISPARITY, Pixels

#: Smallest and largest number of a picture.
Limits = tuple[float, float]

# Parts of the pixels that are below and above the range: a few wild pixels do not change it.
_PERCENTILES = 2, 98
# Time in which the range follows to two thirds.
_FOLLOW_SECONDS = 2.0


def measure_limits(numbers: NDArray[Any]) -> Limits:
    """Return the limits of most numbers; 0.0 twice if there are none."""
    if not numbers.size:
        return 0.0, 0.0
    low, high = np.percentile(numbers, _PERCENTILES, method='nearest')
    return within_range(low), within_range(high)


def within_range(number: float) -> float:
    """Return a finite number, or the nearest one that a range may have."""
    return min(LARGEST, max(-LARGEST, float(number)))


@dataclass(frozen=True)
class Steady:
    """
    Limits that a frame changes.

    :param limits: limits before the frame; None if there are none.
    :param part: part of the way that they follow those of the frame, 0 to 1.
    """

    limits: Limits | None = None
    part: float = 0.0

    def after(self, measured: Limits) -> Limits:
        """
        Return the limits after a frame.

        :param measured: limits of the numbers of the frame; those of another scene are used as
            they are.
        """
        before = self.limits
        if before is None or measured[0] > before[1] or measured[1] < before[0]:
            return measured
        low, high = (old + (new - old) * self.part
                     for old, new in zip(before, measured, strict=True))
        return low, high


#: No limits before the frame.
NO_LIMITS = Steady()


class DepthRange:
    """Limits that follow those of the frames slowly, so that colours do not flicker."""

    def __init__(self) -> None:
        self._limits: Limits | None = None
        self._followed_at = 0.0

    @property
    def limits(self) -> Limits | None:
        """Limits after the last frame; None before the first one."""
        return self._limits

    def at(self, now: float) -> Steady:
        """
        Return how a frame changes the limits.

        :param now: monotonic clock in seconds.
        """
        return Steady(self._limits, 1 - math.exp(-(now - self._followed_at) / _FOLLOW_SECONDS))

    def follow(self, measured: Limits, now: float) -> None:
        """
        Use the limits of a frame.

        :param now: monotonic clock in seconds.
        """
        self._limits = self.at(now).after(measured)
        self._followed_at = now


#: Units of the encodings of depth, by REP 118, and of disparity.
UNITS = {'16UC1': 'mm', '32FC1': 'm', DISPARITY.name: 'px'}

# Colormap of OpenCV, and the colour of pixels without depth in BGR, which no depth has.
_COLORS: dict[str, tuple[str, tuple[int, int, int]]] = {
    'gray': ('', (110, 0, 0)), 'turbo': ('COLORMAP_TURBO', (128, 128, 128))}
# Pixels that are measured at most.
_MEASURED = 50_000


def is_number(encoding: Encoding) -> bool:
    """Return whether pixels are numbers with a range; labels and 8 bits have none."""
    return (encoding.channels == 1 and encoding.kind in ('color', 'generic')
            and encoding.name != '32SC1' and np.dtype(encoding.dtype) != np.uint8)


def measure_image(pixels: Pixels) -> Limits:
    """Return the limits of most numbers of an image."""
    step = int(np.ceil(np.sqrt(pixels.image.size / _MEASURED))) or 1
    numbers = pixels.numbers(pixels.image[::step, ::step])
    return measure_limits(numbers[~missing_numbers(numbers, pixels.encoding)])


def color_numbers(
    image: NDArray[Any], encoding: Encoding, limits: Limits, colors: str,
) -> NDArray[np.uint8]:
    """
    Return the colours of numbers.

    :param limits: numbers that get the first and the last colour; all get the middle one if both
        are equal.
    :param colors: ``gray``, or ``turbo`` for depth; other numbers are gray.
    :returns: (h, w) or (h, w, 3) array in BGR.
    """
    low, high = limits
    shown = (np.full(image.shape, 128, np.uint8) if low == high else
             cvtColorForDisplay(image, 'passthrough', 'mono8', False, low, high))
    colormap, no_number = _COLORS[colors if encoding.name in UNITS else 'gray']
    if colormap:
        shown = apply_colormap(shown, colormap)
    missing = missing_numbers(image, encoding)
    if missing.any():
        shown = shown if shown.ndim == 3 else cv2.cvtColor(shown, cv2.COLOR_GRAY2BGR)
        shown[missing] = no_number
    return shown


def missing_numbers(image: NDArray[Any], encoding: Encoding) -> NDArray[np.bool_]:
    """Return which pixels have no number; 0 in an image of depth means no depth."""
    missing = ~np.isfinite(image)
    if encoding.name in UNITS and encoding is not DISPARITY:
        missing |= image == 0
    return missing
