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

"""Conversion of depth, labels and other numbers to images for display, as cv_bridge does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.color import convert
from opencv_tools.image.depth import change_depth
from opencv_tools.image.encodings import Encoding, ENCODINGS, find_encoding, opencv_encoding
from opencv_tools.image.errors import ConversionError

# The named colours of CSS in alphabetical order, from aliceblue to yellowgreen, with the rounding
# of cv_bridge.
_LABEL_COLORS = np.frombuffer(bytes.fromhex(
    'eff8ff f9ebd6 00ffff 7effd3 efffff f5f5dc ffe3c4 000000 ffebcd 0000ff 892be1 a42a2a '
    'deb886 5f9e9f 7eff00 d2691e ff7e50 6394ec fff8dc dc133b 00ffff 00008a 008a8a b8850a '
    'a9a9a9 006300 a9a9a9 bcb76b 8a008a 546b2e ff8b00 9931cc 8a0000 e99579 8fbb8f 473c8a '
    '2e4f4f 2e4f4f 00ced1 9300d2 ff1392 00beff 696969 696969 1e90ff b12121 fff9ef 218a21 '
    'ff00ff dcdcdc f8f8ff ffd600 daa41f 808080 008000 acff2e 808080 efffef ff69b4 cd5c5c '
    '4a0082 ffffef efe68b e6e6f9 ffeff5 7bfb00 fff9cd acd7e6 ef8080 dfffff f9f9d2 d2d2d2 '
    '90ed90 d2d2d2 ffb6c1 ff9f79 1fb1aa 86cef9 778799 778799 afc4de ffffdf 00ff00 31cd31 '
    'f9efe6 ff00ff 800000 66cdaa 0000cd b954d2 926fdb 3bb370 7a68ed 00f99a 47d1cc c61585 '
    '18186f f5fff9 ffe3e0 ffe3b5 ffdeac 000080 fcf5e6 808000 6b8e22 ffa400 ff4500 da6fd5 '
    'ede8aa 97fa97 aeeded ffeed4 ffdab8 cd853e ffc0ca dd9fdd afdfe6 800080 ff0000 bb8f8f '
    '4169e0 8a4512 f98071 f9a35f 2d8a56 fff5ed 9f522c c0c0c0 86ceeb 6a5acd 6f8090 6f8090 '
    'fff9f9 00ff7e 4682b4 d2b48b 008080 d7bed7 ff6246 40dfd0 ed82ed f5deb3 ffffff f5f5f5 '
    'ffff00 9acd31 '
), np.uint8).reshape(-1, 3)
_LABELS = '32SC1'
_FLOAT_COLORS = {1: 'mono8', 3: 'bgr8', 4: 'bgra8'}

Colormap = Callable[[NDArray[Any]], NDArray[Any]]


def to_display_image(
    image: NDArray[Any], source: Encoding, target_name: str,
    limits: tuple[float, float] | None = None, colormap: Colormap | None = None,
) -> NDArray[Any]:
    """
    Convert an image of any encoding to 8-bit colours or gray.

    - ``32SC1`` to ``bgr8``: each label gets a colour; negative labels become black.
    - With limits: numbers between the limits become black to white, or colours of a colormap.
    - Floats without limits: the smallest and the largest finite number are the limits.
    - Generic types such as ``8UC1`` or ``16UC3``: channels are read as gray, BGR or BGRA.
    - All others: converted as by ``convert``.

    :param image: (h, w) or (h, w, c) array of any byte order, which is not changed.
    :param target_name: name of the encoding of the result: 8-bit colours or ``'mono8'``; ``''``
        for ``'bgr8'``.
    :param limits: the numbers that become black and white; all pixels become 128 if both are
        equal.
    :param colormap: function that converts (h, w) uint8 to (h, w, 3) BGR; NaN becomes black.
    :returns: a new contiguous uint8 array: (h, w) for ``'mono8'``, (h, w, c) otherwise.
    :raises ConversionError: the encoding cannot be displayed, or the conversion is not supported.
    """
    target = _find_target(target_name)
    if target.name == 'bgr8' and source.name == _LABELS:
        return _color_labels(image)
    is_float = np.dtype(source.dtype).kind == 'f'
    if limits is None and is_float and source.channels in _FLOAT_COLORS:
        limits = finite_limits(image)
    if limits is not None:
        if source.channels != 1 and not (is_float and source.channels in _FLOAT_COLORS):
            raise ConversionError('cv_bridge.cvtColorForDisplay() scaling for images '
                                  'with more than one channel is unsupported')
        scaled_image, encoding = _normalize(image, limits), _FLOAT_COLORS[source.channels]
        if colormap and scaled_image.ndim == 2:
            scaled_image, encoding = colormap(scaled_image), 'bgr8'
            if is_float:
                scaled_image[np.isnan(image)] = 0
        return convert(scaled_image, find_encoding(encoding), target)
    try:
        return convert(image, opencv_encoding(image) if source.is_generic else source, target)
    except ConversionError as err:
        raise ConversionError(
            f'cv_bridge.cvtColorForDisplay() while trying to convert image from '
            f"'{source.name}' to '{target.name}' an exception was thrown ({err})") from err


def finite_limits(image: NDArray[Any]) -> tuple[float, float]:
    """Return the smallest and the largest finite number of an image; 0.0 twice if it has none."""
    finite = image[np.isfinite(image)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)


def _find_target(target_name: str) -> Encoding:
    """Return the encoding for display, which must be 8-bit colour or gray."""
    target = ENCODINGS.get(target_name or 'bgr8')
    if target is None or target.kind != 'color' or target.dtype != 'uint8':
        raise ConversionError('cv_bridge.cvtColorForDisplay() does not have an output encoding '
                              'that is color or mono, and has is bit in depth')
    return target


def _color_labels(labels: NDArray[Any]) -> NDArray[Any]:
    """Return a BGR image with a colour for each label; negative labels, as -1, are black."""
    colors = _LABEL_COLORS[labels % len(_LABEL_COLORS)][..., ::-1].copy()
    colors[labels < 0] = 0
    return colors


def _normalize(image: NDArray[Any], limits: tuple[float, float]) -> NDArray[Any]:
    """Return numbers scaled linearly from two limits to 0 and 255, and clipped to that range."""
    least, greatest = limits
    if least == greatest:
        return np.full(image.shape, 128, np.uint8)
    dtype = image.dtype.newbyteorder('=')
    # As in OpenCV: float32 cannot represent all numbers of int32 and float64.
    work: Any = np.float64 if dtype.name in ('int32', 'float64') else np.float32
    with np.errstate(invalid='ignore', over='ignore'):
        above = change_depth(image.astype(work) - work(least), dtype.name)
        scaled = above.astype(np.float32) * np.float32(255 / (greatest - least))
        return change_depth(scaled, 'uint8')
