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
Statistics of a feature, as LeRobot computes them.

Quantiles come from a histogram with 5000 bins (``RunningQuantileStats`` of LeRobot). Statistics of
several episodes are joined as ``aggregate_feature_stats`` of LeRobot does: means and deviations
exactly, quantiles up to the median by the smallest one, those above by the largest one. LeRobot
0.4.4 still has the mean of the quantiles there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Statistics by name; each has the shape of a feature, but the count has one number.
Statistics = dict[str, NDArray[Any]]

#: Level of each quantile by its name.
QUANTILES = {'q01': 0.01, 'q10': 0.1, 'q50': 0.5, 'q90': 0.9, 'q99': 0.99}
_BINS = 5000
_PADDING = 1e-10
_LEVELS = 256  # of a pixel
_SMALL, _TARGET = 300, 150  # longest side in pixels that is not reduced, and of a reduced image


def numbers_statistics(values: NDArray[Any]) -> Statistics:
    """
    Return the statistics of the rows of an episode.

    :param values: (n, d) numbers, n at least 1.
    """
    return _joined_columns([_column_statistics(column, np.ones(len(column)))
                            for column in values.T], len(values))


def sampled_rows(count: int) -> NDArray[np.int64]:
    """Return the rows whose images LeRobot samples: all of 100, 1 % of a million."""
    samples = max(min(100, count), min(int(count ** 0.75), 10_000))
    return np.round(np.linspace(0, count - 1, samples)).astype(np.int64)


class ImageStatistics:
    """Statistics of the images of an episode, by a count of the levels of each channel."""

    def __init__(self, depths: NDArray[np.float32] | None = None) -> None:
        """
        Create statistics without an image.

        :param depths: (n,) depth of each code of images of depth; None for colours.
        """
        self._values = np.arange(_LEVELS) if depths is None else depths
        self._counts = np.zeros((3 if depths is None else 1, len(self._values)))
        self._scale = _LEVELS - 1 if depths is None else 1
        self._images = 0

    def add(self, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
        """
        Add an image, of which only some pixels are counted if it is large.

        :param image: (h, w, 3) array in BGR, or (h, w) codes of depth.
        """
        height, width = image.shape[:2]
        if max(height, width) >= _SMALL:
            step = max(1, (width if width > height else height) // _TARGET)
            image = image[::step, ::step]
        for counts, levels in zip(self._counts[::-1], np.moveaxis(np.atleast_3d(image), 2, 0)):
            counts += np.bincount(levels.ravel(), minlength=len(counts))
        self._images += 1

    def statistics(self) -> Statistics:
        """Return the statistics, of shape (3, 1, 1) in RGB and from 0 to 1, or (1, 1, 1)."""
        found = _joined_columns([
            _column_statistics(self._values[counts > 0].astype(np.float64), counts[counts > 0])
            for counts in self._counts], self._images)
        return {name: value if name == 'count' else (value / self._scale).reshape(-1, 1, 1)
                for name, value in found.items()}


def joined(statistics: Sequence[Statistics]) -> Statistics:
    """Join the statistics of a feature in several episodes."""
    stacked = {name: np.stack([one[name] for one in statistics]) for name in statistics[0]}
    counts = stacked['count']
    total = counts.sum(axis=0)
    weights = counts.reshape(-1, *[1] * (stacked['mean'].ndim - 1))
    mean = (stacked['mean'] * weights).sum(axis=0) / total
    variances = stacked['std'] ** 2 + (stacked['mean'] - mean) ** 2
    variance = (variances * weights).sum(axis=0) / total
    quantiles = {name: stacked[name].min(axis=0) if level <= 0.5 else stacked[name].max(axis=0)
                 for name, level in QUANTILES.items()}
    return {'min': stacked['min'].min(axis=0), 'max': stacked['max'].max(axis=0), 'mean': mean,
            'std': np.sqrt(variance), 'count': total, **quantiles}


def _joined_columns(columns: list[dict[str, float]], count: int) -> Statistics:
    found: Statistics = {name: np.array([one[name] for one in columns]) for name in columns[0]}
    return {**found, 'count': np.array([count])}


def _column_statistics(column: NDArray[Any], counts: NDArray[np.float64]) -> dict[str, float]:
    """
    Return the statistics of numbers that occur some number of times.

    The type of the numbers is also that of the bins. It decides in which of two bins a number at
    their border is.
    """
    total, values = counts.sum(), column.astype(np.float64)
    mean = float((values * counts).sum() / total)
    std = float(np.sqrt((((values - mean) ** 2) * counts).sum() / total))
    low, high = float(values.min()), float(values.max())
    found = {'min': low, 'max': high, 'mean': mean, 'std': std}
    if total < 2:
        return {**found, **dict.fromkeys(QUANTILES, mean)}
    edges = np.linspace(column.min() - _PADDING, column.max() + _PADDING, _BINS + 1)
    sums = np.cumsum(np.histogram(column, edges, weights=counts)[0])
    return {**found, **{name: _quantile(sums, edges, level * total)
                        for name, level in QUANTILES.items()}}


def _quantile(sums: NDArray[np.float64], edges: NDArray[np.float64], target: float) -> float:
    """Return a quantile of a histogram, linear within its bin."""
    place = int(np.searchsorted(sums, target))
    if place == 0:
        return float(edges[0])
    if place >= len(sums):
        return float(edges[-1])
    inside = sums[place] - sums[place - 1]
    share = (target - sums[place - 1]) / inside
    return float(edges[place] + share * (edges[place + 1] - edges[place]))
