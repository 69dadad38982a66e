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

"""Colours of numbers, such as depth, and of pixels without a number."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.cv_bridge import cvtColorForDisplay
from opencv_tools.image.encodings import Encoding
from opencv_tools.image_codecs import apply_colormap
from opencv_tools.viewer.depth_range import Limits, measure_limits
from opencv_tools.viewer.pixels import DISPARITY, Pixels

#: Units of the encodings of depth, by REP 118, and of disparity.
UNITS = {'16UC1': 'mm', '32FC1': 'm', DISPARITY.name: 'px'}

# Colormap of OpenCV, and the colour of pixels without depth in BGR, which no depth has.
_COLORS: dict[str, tuple[int | None, tuple[int, int, int]]] = {
    'gray': (None, (110, 0, 0)), 'turbo': (cv2.COLORMAP_TURBO, (128, 128, 128))}
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
    if colormap is not None:
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
