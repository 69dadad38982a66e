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

"""Statistics against numpy, and against LeRobot's way of joining them and of counting images."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st
import numpy as np
from opencv_tools.datasets.statistics import (
    ImageStatistics, joined, numbers_statistics, sampled_rows)
import pytest
from rows import each_row

LEVELS = {'q01': 0.01, 'q10': 0.1, 'q50': 0.5, 'q90': 0.9, 'q99': 0.99}
numbers = st.floats(-1e6, 1e6, allow_subnormal=False)
episode = st.lists(st.tuples(numbers, numbers), min_size=1, max_size=40).map(np.array)


def check_exact(found: dict[str, np.ndarray], values: np.ndarray) -> None:
    tolerance = 1e-9 * (1 + np.abs(values).max())
    assert found['count'].tolist() == [len(values)]
    for name in ('min', 'max', 'mean', 'std'):
        # A standard deviation is a root, which is less exact.
        slack = np.sqrt(tolerance * (1 + np.abs(values).max())) * 1e-3 if name == 'std' else 0
        assert np.allclose(found[name], getattr(values, name)(axis=0), rtol=1e-9,
                           atol=tolerance + slack), name


@given(episode)
def test_statistics_of_numbers(values: np.ndarray) -> None:
    found = numbers_statistics(values)
    check_exact(found, values)
    for name, level in LEVELS.items():
        if len(values) == 1:
            assert (found[name] == values[0]).all()
            continue
        # A histogram is exact to one bin: the quantile lies between the numbers around it.
        bins = np.ptp(values, axis=0) / 5000 + 1e-9 * np.abs(values).max() + 1e-9
        place = level * len(values)
        ordered = np.sort(values, axis=0)
        low = ordered[max(0, int(np.ceil(place)) - 1)]
        assert (found[name] >= low - bins).all() and (found[name] <= low + bins).all(), name


def lerobot_quantile(values: np.ndarray, level: float) -> float:
    """Return what ``RunningQuantileStats`` of LeRobot computes for one batch of a column."""
    edges = np.linspace(values.min() - 1e-10, values.max() + 1e-10, 5001)
    sums = np.cumsum(np.histogram(values, bins=edges)[0])
    target = level * len(values)
    place = np.searchsorted(sums, target)
    if place == 0:
        return edges[0]
    if place >= len(sums):
        return edges[-1]
    below, inside = sums[place - 1], sums[place] - sums[place - 1]
    share = (target - below) / inside if inside else 0.0
    return edges[place] + share * (edges[place + 1] - edges[place])


@settings(max_examples=40)
@given(st.lists(numbers, min_size=2, max_size=60))
def test_quantiles_are_those_of_lerobot(column: list[float]) -> None:
    values = np.array(column)[:, None]
    found = numbers_statistics(values)
    for name, level in LEVELS.items():
        assert found[name][0] == pytest.approx(lerobot_quantile(values[:, 0], level), rel=1e-12)


@settings(max_examples=60)
@given(st.lists(episode, min_size=1, max_size=5))
def test_joined_statistics_are_those_of_all_rows(parts: list[np.ndarray]) -> None:
    each = [numbers_statistics(part) for part in parts]
    found = joined(each)
    check_exact(found, np.concatenate(parts))
    for name, level in LEVELS.items():
        outer = np.min if level <= 0.5 else np.max
        assert np.array_equal(found[name], outer([one[name] for one in each], axis=0)), name


def test_statistics_of_images_are_in_rgb_and_from_0_to_1() -> None:
    images = np.random.default_rng(2).integers(0, 256, (7, 20, 30, 3), np.uint8)
    images[..., 0] //= 4  # blue
    counted = ImageStatistics()
    for image in images:
        counted.add(image)
    found = counted.statistics()
    pixels = images[..., ::-1].reshape(-1, 3) / 255
    assert found['count'].tolist() == [7]
    for name in ('min', 'max', 'mean', 'std'):
        assert found[name].shape == (3, 1, 1)
        assert np.allclose(found[name].ravel(), getattr(pixels, name)(axis=0)), name
    for name, level in LEVELS.items():
        assert np.allclose(found[name].ravel(), np.quantile(pixels, level, axis=0), atol=0.005)


def test_large_image_is_sampled_as_lerobot_does() -> None:
    image = np.random.default_rng(3).integers(0, 256, (480, 640, 3), np.uint8)
    counted = ImageStatistics()
    counted.add(image)
    small = image[::4, ::4, ::-1].reshape(-1, 3) / 255  # 640 // 150
    assert np.allclose(counted.statistics()['mean'].ravel(), small.mean(axis=0))


@each_row(('count', 'samples'), [
    (1, 1), (99, 99), (100, 100), (500, 105), (10_000, 1000), (10_000_000, 10_000)])
def test_rows_whose_images_are_counted(count: int, samples: int) -> None:
    rows = sampled_rows(count)
    assert (len(rows), rows[0], rows[-1]) == (samples, 0, count - 1)
    assert (np.diff(rows) > 0).all()
