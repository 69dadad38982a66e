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

"""Grid of times, choice of samples, interpolation and account, against a model by hand."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

from hypothesis import given, settings, strategies as st
import numpy as np
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.rows import choose, grid, interpolate, match, pieces, Rows, TOLERANCE_NS
import pytest

NANO = 10**9
BEGAN = 1_700_000_000 * NANO
TICK = 1500  # ns, more than the tolerance
increasing = st.lists(st.integers(0, 200), min_size=1, max_size=20, unique=True).map(
    lambda numbers: [TICK * number for number in sorted(numbers)])
times_and_rows = st.tuples(increasing, increasing).map(
    lambda pair: (pair[0], [pair[0][0] + one for one in pair[1]]))


@given(st.integers(0, 10**11), st.integers(1, 1000))
def test_grid_is_exact_and_whole(length: int, fps: int) -> None:
    fps = fps if length < 10**10 else fps % 50 + 1
    times = grid(BEGAN, BEGAN + length, fps)
    # Row k is at floor(k / fps), and exists if that is not after the end.
    number = 0
    for number in (0, 1, len(times) // 2, len(times) - 1):
        if number < len(times):
            assert times[number] == BEGAN + int(Fraction(number * NANO, fps))
    assert times[-1] <= BEGAN + length < BEGAN + int(Fraction(len(times) * NANO, fps))


def test_grid_has_all_frames_of_a_camera_with_whole_nanoseconds() -> None:
    # The last of 60 frames is at 1.966666666 s, a third of a nanosecond before 59 / 30 s.
    assert len(grid(BEGAN, BEGAN + 59 * NANO // 30, 30)) == 60


def test_grid_without_time_and_with_too_much() -> None:
    assert len(grid(5, 4, 30)) == len(grid(NANO, 0, 30)) == 0
    assert grid(5, 5, 1).tolist() == [5]
    with pytest.raises(DatasetError, match='1000000000 s have 30000000001 rows at 30 Hz'):
        grid(0, 10**9 * NANO, 30)


@given(times_and_rows)
def test_last_and_nearest_sample(pair: tuple[list[int], list[int]]) -> None:
    times, rows = pair
    last = [max(place for place, time in enumerate(times) if time <= row) for row in rows]
    # Of two that are as near, the earlier one.
    nearest = [min(range(len(times)), key=lambda place, row=row: (abs(times[place] - row), place))
               for row in rows]
    assert choose(np.array(times), np.array(rows), 'last').tolist() == last
    assert choose(np.array(times), np.array(rows), 'nearest').tolist() == nearest


def test_sample_of_a_row_may_be_a_little_late() -> None:
    # Both clocks are cut: row 2 is at 0.099999999 s, the frame at 0.1 s.
    camera = np.arange(1, 60) * NANO // 30
    rows = grid(camera[0], camera[-1], 30)
    assert choose(camera, rows, 'last').tolist() == [*range(59)]
    assert choose(camera + TOLERANCE_NS - 1, rows[1:], 'last').tolist() == [*range(1, 59)]
    assert choose(camera + TOLERANCE_NS + 2, rows[1:], 'last').tolist() == [*range(58)]


@given(increasing, st.data())
def test_linear_interpolation(times: list[int], data: st.DataObject) -> None:
    rows = sorted(data.draw(st.lists(st.integers(times[0], times[-1]), max_size=9)))
    values = np.array(data.draw(st.lists(
        st.tuples(*[st.floats(-1e6, 1e6)] * 2), min_size=len(times), max_size=len(times))))
    found = interpolate(np.array(times), values, np.array(rows, np.int64))
    expected = [[np.interp(row, times, column) for column in values.T] for row in rows]
    assert np.allclose(found, np.array(expected).reshape(-1, 2), rtol=1e-9, atol=1e-6)


@given(st.lists(st.booleans(), max_size=30))
def test_pieces_are_the_longest_sequences(good: list[bool]) -> None:
    found = list(pieces(np.array(good, np.bool_)))
    assert [row for begin, end in found for row in range(begin, end)] == [
        row for row, one in enumerate(good) if one]
    assert all(begin < end for begin, end in found)
    assert all(one[1] < other[0] for one, other in pairwise(found))


@settings(max_examples=60)
@given(times_and_rows, st.integers(0, 19))
def test_account_of_samples(pair: tuple[list[int], list[int]], cut: int) -> None:
    times, rows = (np.array(one, np.int64) for one in pair)
    samples = choose(times, rows, 'last')
    whole = Rows(rows, {'a': samples})
    episodes = [one for one in (whole.part(0, cut), whole.part(cut, len(rows))) if len(one.times)]
    account = match(times, times, episodes, episodes, 'a')
    used = set(samples.tolist())
    reused = sum(len(one.times) - len(set(one.samples['a'].tolist())) for one in episodes)
    others = [time for place, time in enumerate(times.tolist()) if place not in used]
    before, after = (sum(one < rows[0] for one in others), sum(one > rows[-1] for one in others))
    errors = sorted(int(row - times[sample]) for row, sample in zip(rows, samples))
    assert (account.used, account.reused, account.before, account.after) == (
        len(used), reused, before, after)
    assert account.used + account.dropped + before + after == account.messages == len(times)
    assert 0 <= len(rows) - account.used - reused < len(episodes)
    assert account.failed == 0
    assert account.largest_error == errors[-1] / NANO
    assert np.isclose(account.median_error * NANO, np.median(errors))


def test_account_has_the_age_of_the_oldest_number() -> None:
    times = np.array([0, 10, 20]) * NANO
    rows = [Rows(times + NANO, {'a': np.arange(3)})]
    account = match(times, times - np.array([0, 3, 9]) * NANO, rows, rows, 'a')
    assert (account.median_error, account.largest_error) == (4, 10)
