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

"""
Depth in data sets: metres as 12-bit codes of LeRobot, or as millimetres of a PNG.

Source of the codes: ``datasets/depth_utils.py`` and ``configs/video.py`` of LeRobot. Unlike there,
the code 0 is only for pixels without depth, so that these are not mixed up with near ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.capture.bag_pictures import OTHER_IMAGES
from opencv_tools.capture.output_image import check_conversion, OutputImage
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.plan import DEPTH_RANGE, LEROBOT, Plan
from opencv_tools.image.compressed_depth import DEPTH_ENCODINGS
from opencv_tools.image.errors import ImageError

METRE = 1000.0  # millimetres
#: Settings of a feature in info.json, and the values that LeRobot takes for missing ones.
_KEYS: dict[str, Any] = {'video.depth_min': DEPTH_RANGE[0], 'video.depth_max': DEPTH_RANGE[1],
                         'video.shift': 3.5, 'video.use_log': True}
_IS_DEPTH, _UNITS = ('is_depth_map', 'video.is_depth_map'), ('m', 'mm')
_LEAST = 1e-6  # metres of a range: the logarithms of its limits differ
_POINTS = 8  # of the small picture, in each direction


@dataclass(frozen=True)
class DepthCodes:
    """
    How depths are stored as integers: the codes from 0 to ``last`` are from ``low`` to ``high``.

    :param low: depth in metres of the code 0.
    :param high: depth in metres of the last code.
    :param shift: metres that are added before the logarithm.
    :param is_log: whether equal steps are those of the logarithm of the depth, not of the depth.
    """

    low: float
    high: float
    shift: float = _KEYS['video.shift']
    is_log: bool = True
    last: int = 4095

    @classmethod
    def of_feature(cls, feature: Mapping[str, Any]) -> DepthCodes | None:
        """
        Return the codes of a feature in ``info.json``; None if it is no depth.

        :raises DatasetError: the settings are invalid.
        """
        info = feature.get('info')
        marks = [info.get(key) for key in _IS_DEPTH] if isinstance(info, dict) else []
        if not all(one is None or isinstance(one, bool) for one in marks):
            raise DatasetError(f'it has is_depth_map {printable(marks)}, not true or false')
        if not isinstance(info, dict) or not any(marks):
            return None
        if info.get('depth_unit', 'm') not in _UNITS:
            raise DatasetError(f'it has depth_unit {printable(info["depth_unit"])}, not '
                               f'{" or ".join(_UNITS)}')
        low, high, shift, is_log = given = [info.get(key, value) for key, value in _KEYS.items()]
        if not isinstance(is_log, bool) or not all(
                type(one) in (int, float) and abs(one) < 1e6 for one in given[:3]) or (
                not low + _LEAST <= high or (is_log and low + shift <= 0)):
            raise DatasetError('it has the depth settings '
                               f'{", ".join(map(repr, given))[:80]}, which give no range')
        return cls(low, high, shift, is_log)

    @property
    def info(self) -> dict[str, Any]:
        """Return the settings of a feature in ``info.json``."""
        return dict(zip(_KEYS, (self.low, self.high, self.shift, self.is_log)))

    @cached_property
    def metres(self) -> NDArray[np.float32]:
        """Depth of each code in metres, (last + 1,)."""
        first, end = (self._place(one) for one in (self.low, self.high))
        places = first + np.arange(self.last + 1) * ((end - first) / self.last)
        depths = np.exp(places) - self.shift if self.is_log else places
        return np.clip(depths, self.low, self.high).astype(np.float32)

    @property
    def nearest(self) -> float:
        """Depth in metres below which a pixel becomes the nearest depth that is stored."""
        return self.low or float(self.metres[1])

    @property
    def largest_error(self) -> float:
        """Largest error in metres of a depth from ``low`` to ``high``."""
        return float(max(self.metres[1] - self.metres[0], (self.metres[-1] - self.metres[-2]) / 2))

    def codes(self, depth: NDArray[np.float32]) -> NDArray[np.uint16]:
        """
        Return the codes of depths in metres; those outside of the range get the nearest code.

        :returns: 0 for pixels without depth: zero, negative and NaN.
        """
        first, end = (self._place(one) for one in (self.low, self.high))
        with np.errstate(all='ignore'):
            places = np.log(depth + np.float32(self.shift)) if self.is_log else depth
            numbers = np.rint((places - first) * (self.last / (end - first)))
        numbers = np.where(depth > 0, np.clip(numbers, 1, self.last), 0)
        return numbers.astype(np.uint16)

    def errors(self, depth: NDArray[np.float32], codes: NDArray[np.uint16]) -> NDArray[np.float32]:
        """Return the errors in metres of codes of depths; 0 outside of the range."""
        is_inside = (depth > 0) & (depth >= self.nearest) & (depth <= self.high)
        return np.abs(self.metres[codes] - np.where(is_inside, depth, self.metres[codes]))

    def _place(self, depth: float) -> float:
        return math.log(depth + self.shift) if self.is_log else depth


def codes_of(plan: Plan) -> DepthCodes:
    """Return the codes of a data set; those of a PNG are millimetres."""
    if plan.format == LEROBOT:
        return DepthCodes(*plan.depth_range, is_log=plan.depth_scale == 'log')
    return DepthCodes(0.0, 65.535, 0.0, False, 65535)


class DepthImages:
    """The depth images of a camera while they are written: codes and account."""

    def __init__(self, name: str, codes: DepthCodes) -> None:
        self._name, self._codes = name, codes
        self._picture: OutputImage | None = None
        self._numbers = np.zeros((0, 0), np.uint16)
        #: Depths in metres of the last image, 8 x 8 points as (256,) bytes.
        self.points = np.zeros(0, np.uint8)
        #: Number of all pixels, of those without depth and out of the range, and largest error.
        self.account: dict[str, float] = dict.fromkeys(
            ('pixels', 'none', 'nearer', 'farther', 'largest_error'), 0)

    def read(self, picture: OutputImage) -> NDArray[np.uint16]:
        """
        Return the codes of an image of depth, (h, w); the same image again counts once.

        :raises DatasetError: the image is no depth.
        """
        if picture is self._picture:
            return self._numbers
        if picture.encoding not in DEPTH_ENCODINGS:
            remedy = 'use --image'
            try:
                check_conversion(picture.encoding, 'bgr8')
            except ImageError:
                remedy = OTHER_IMAGES
            raise DatasetError(f'{self._name}: an image of {picture.encoding} is no depth, which '
                               f'is {", ".join(DEPTH_ENCODINGS)}; {remedy}')
        image, account, codes = picture.image, self.account, self._codes
        depth = image.astype(np.float32)
        if image.dtype.kind == 'u':
            depth /= np.float32(METRE)
        self._picture, self._numbers = picture, codes.codes(depth)
        self.points = depth_points(depth).view(np.uint8)
        has_depth = depth > 0
        account['pixels'] += depth.size
        account['none'] += int(depth.size - np.count_nonzero(has_depth))
        account['nearer'] += int(np.count_nonzero(has_depth & (depth < codes.nearest)))
        account['farther'] += int(np.count_nonzero(depth > codes.high))
        account['largest_error'] = max(account['largest_error'],
                                       float(codes.errors(depth, self._numbers).max()))
        return self._numbers

    @property
    def warnings(self) -> list[str]:
        """Return a sentence about the pixels that are nearer, and about those that are farther."""
        limits = {'nearer': self._codes.nearest, 'farther': self._codes.high}
        return [f'{self._name}: {self.account[key]} of {self.account["pixels"]} pixels are {key} '
                f'than {limit:g} m, and become the nearest depth that is stored'
                for key, limit in limits.items() if self.account[key]]


def millimetres(metres: float) -> str:
    """Return a length as text, such as ``2.22 mm``, of which no more than 0 becomes 0.00."""
    value = METRE * metres
    return f'{value:.2f} mm' if not 0 < value < 0.1 else f'{value:.2g} mm'


def depth_points(image: NDArray[Any]) -> NDArray[Any]:
    """Return the pixels of an image by which ``--check`` recognises a frame of depth, (64,)."""
    rows, columns = ((np.arange(_POINTS) * 2 + 1) * size // (2 * _POINTS) for size in image.shape)
    return image[np.ix_(rows, columns)].ravel()
