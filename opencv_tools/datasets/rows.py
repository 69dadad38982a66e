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
Rows of a data set: a grid of times, and which sample of each topic belongs to each.

Times are integers in nanoseconds. Row k of an episode has the time of row 0 plus k / fps.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.units import NANO
from opencv_tools.datasets.errors import DatasetError

Times = NDArray[np.int64]

#: A sample that is so little after a row belongs to it: many stamps are cut to microseconds.
TOLERANCE_NS = 1000
_BEFORE = 0.99  # share of the images that come before their row
_MOST_ROWS = 10_000_000  # of a bag: four days at 30 Hz


@dataclass(frozen=True)
class Rows:
    """
    The rows of an episode.

    :param times: (n,) time of each row.
    :param samples: (n,) number of the sample of each row, by topic.
    :param task: text of the task; '' for that of the plan.
    """

    times: Times
    samples: Mapping[str, Times]
    task: str = ''

    def part(self, begin: int, end: int) -> Rows:
        """Return some of the rows."""
        return Rows(self.times[begin:end],
                    {name: one[begin:end] for name, one in self.samples.items()}, self.task)


def grid(start: int, end: int, fps: int) -> Times:
    """
    Return the times of the rows from a start to an end, both included.

    :raises DatasetError: there are too many rows.
    """
    count = ((end - start + 1) * fps - 1) // NANO + 1  # those whose time, cut to ns, is in it
    if count > _MOST_ROWS:
        raise DatasetError(f'{(end - start) / NANO:.0f} s have {count} rows at {fps} Hz, at most '
                           f'{_MOST_ROWS} are possible; check the times, or use --clock log')
    return start + np.arange(max(0, count), dtype=np.int64) * NANO // fps


def choose(times: Times, rows: Times, choice: str) -> Times:
    """
    Choose a sample for each row.

    :param times: (n,) increasing times of the samples; the first is not after the first row.
    :param rows: (m,) increasing times of the rows.
    :param choice: 'last' for the last sample that is not after the row, apart from
        ``TOLERANCE_NS``, or 'nearest' for the nearest.
    :returns: (m,) numbers of samples.
    """
    if choice == 'last':
        return _last(times, rows + TOLERANCE_NS)
    last = _last(times, rows)
    following = np.minimum(last + 1, len(times) - 1)
    return np.where(np.abs(times[following] - rows) < np.abs(rows - times[last]), following, last)


def needed_delay(times: Times, rows: Times, fps: int) -> int:
    """
    Return by how much rows must be later, so that 99 % of the images come before them.

    Rows that begin at the time of an image are a little before or after the next images. The last
    image before such a row would be that of the row before, or this one, at random.

    :param times: (n,) increasing times of the samples.
    :param rows: (m,) times of the rows, m at least 1.
    :returns: time in nanoseconds, from 0 to half of a row.
    """
    late = times[choose(times, rows, 'nearest')] - rows
    late = late[np.abs(late) <= NANO // fps // 2]
    delay = int(np.quantile(late, _BEFORE, method='higher')) if len(late) else 0
    return delay if delay > TOLERANCE_NS else 0


def _last(times: Times, rows: Times) -> Times:
    return np.maximum(np.searchsorted(times, rows, side='right') - 1, 0)


def interpolate(times: Times, values: NDArray[np.float64], rows: Times,
                ) -> NDArray[np.float64]:
    """
    Interpolate numbers linearly between the samples before and after each row.

    :param times: (n,) increasing times of the samples.
    :param values: (n, d) numbers.
    :param rows: (m,) times of the rows, within the times.
    :returns: (m, d) numbers.
    """
    last = _last(times, rows)
    following = np.minimum(last + 1, len(times) - 1)
    span = np.maximum(times[following] - times[last], 1)
    share = ((rows - times[last]) / span)[:, np.newaxis]
    return values[last] + (values[following] - values[last]) * share


def pieces(is_good: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Yield the begin and the end of each sequence of rows that are good."""
    borders = np.flatnonzero(np.diff(np.concatenate(([False], is_good, [False])).astype(np.int8)))
    yield from zip(borders[::2].tolist(), borders[1::2].tolist())


@dataclass(frozen=True)
class Match:
    """
    How the samples of a topic fit the rows.

    :param used: number of samples that are in a row.
    :param reused: number of rows that repeat the sample of the row before.
    :param dropped: number of samples between the first and the last row that are in no row.
    :param before: number of samples before the first row that are in no row.
    :param after: number of samples after the last row that are in no row.
    :param failed: number of messages that cannot be read or decoded.
    :param messages: number of messages of the topic, the sum of these but ``reused``.
    :param median_error: median distance between a row and the oldest number of its sample, or
        the sample itself, in seconds.
    :param largest_error: largest one of these distances, in seconds.
    """

    used: int = 0
    reused: int = 0
    dropped: int = 0
    before: int = 0
    after: int = 0
    failed: int = 0
    messages: int = 0
    median_error: float = 0.0
    largest_error: float = 0.0


def sample_ages(times: Times, oldest: Times, rows: Times, samples: Times) -> Times:
    """
    Return the distance of rows from their samples, or from the oldest numbers of these, in ns.

    :param times: (n,) increasing times of the samples.
    :param oldest: (n,) time of the oldest number of each sample.
    :param rows: (m,) times of the rows.
    :param samples: (m,) number of the sample of each row.
    :returns: (m,) the larger one of both.
    """
    return np.maximum(np.abs(rows - times[samples]), rows - oldest[samples])


def match(times: Times, oldest: Times, wanted: Sequence[Rows], shown: Sequence[Rows], name: str,
          ) -> Match:
    """
    Return how the samples of a topic fit the rows of some episodes.

    :param times: (n,) increasing times of the samples.
    :param oldest: (n,) time of the oldest number of each sample.
    :param wanted: rows with the samples that belong to them.
    :param shown: the same rows with those that they have; the others could not be decoded.
    """
    rows = np.concatenate([one.times for one in shown])
    samples = np.concatenate([one.samples[name] for one in shown])
    used = np.unique(samples)
    failed = np.setdiff1d(np.concatenate([one.samples[name] for one in wanted]), used)
    rest = np.delete(times, np.union1d(used, failed))
    before, after = (int(np.count_nonzero(one)) for one in (rest < rows[0], rest > rows[-1]))
    errors = sample_ages(times, oldest, rows, samples)
    return Match(
        len(used), len(rows) - sum(len(np.unique(one.samples[name])) for one in shown),
        len(rest) - before - after, before, after, len(failed), len(times),
        float(np.median(errors)) / NANO, int(errors.max()) / NANO)
