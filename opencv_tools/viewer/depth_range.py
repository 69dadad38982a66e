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

"""The range of the numbers in pictures of depth, which follows them slowly."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Smallest and largest number of a picture.
Limits = tuple[float, float]

# Parts of the pixels that are below and above the range: a few wild pixels do not change it.
_LARGEST = 1e300  # so that differences are finite
_PERCENTILES = 2, 98
# Time in which the range follows to two thirds.
_FOLLOW_SECONDS = 2.0


def measure_limits(numbers: NDArray[Any]) -> Limits:
    """
    Return the limits of most numbers; 0.0 twice if there are none.

    :param numbers: finite numbers.
    """
    if not numbers.size:
        return 0.0, 0.0
    low, high = np.percentile(numbers, _PERCENTILES, method='nearest')
    low, high = (min(_LARGEST, max(-_LARGEST, float(one))) for one in (low, high))
    return low, high


class DepthRange:
    """Limits that follow those of the frames slowly, so that colours do not flicker."""

    def __init__(self) -> None:
        """Begin without limits."""
        self._limits: Limits | None = None
        self._followed_at = 0.0

    @property
    def limits(self) -> Limits | None:
        """Limits of the next picture; None for those of the picture itself."""
        return self._limits

    def follow(self, measured: Limits, now: float) -> None:
        """
        Use the limits of a frame.

        :param measured: limits of the numbers of the frame.
        :param now: monotonic clock in seconds.
        """
        before = self._limits
        if before is None or measured[0] > before[1] or measured[1] < before[0]:
            self._limits = measured  # the first one, or another scene
        else:
            part = 1 - math.exp(-(now - self._followed_at) / _FOLLOW_SECONDS)
            low, high = (old + (new - old) * part
                         for old, new in zip(before, measured, strict=True))
            self._limits = low, high
        self._followed_at = now
