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

"""Episodes of a bag: intervals of its time, their rows, and the account of each topic."""

from __future__ import annotations

from collections.abc import Sequence
import csv
from dataclasses import replace
import io
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from opencv_tools.base.regular_files import read_regular
from opencv_tools.base.text import enumerated, printable
from opencv_tools.base.units import NANO
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.plan import Interval, Plan, SHORTEN
from opencv_tools.datasets.rows import (
    choose, grid, needed_delay, pieces, Rows, sample_ages, Times, TOLERANCE_NS)
from opencv_tools.datasets.tracks import Recording, Track

_MS = NANO // 1000
_END_NS = NANO  # by which a topic may end before the others without a sentence
_MAX_TABLE = 1 << 24  # bytes
_MOST = 100_000  # episodes of a bag
_MOST_SECONDS = 1e8  # of a bag: three years
_COLUMNS = ('start', 'end')

Span = tuple[int, int, str]  # start, end (not included) and task


def read_intervals(path: Path) -> tuple[Interval, ...]:
    """
    Read a table of episodes: CSV with the columns start, end and, if needed, bag and task.

    :raises DatasetError: the table is invalid.
    :raises OSError: the file cannot be read.
    """
    shown = printable(path.name)
    try:
        table = csv.DictReader(io.StringIO(read_regular(path, _MAX_TABLE).decode(
            'utf-8-sig')))
        columns = table.fieldnames or ()
        if not set(_COLUMNS) <= set(columns) or set(columns) - {*_COLUMNS, 'bag', 'task'}:
            raise DatasetError(f'{shown} has the columns {printable(", ".join(columns))}; give '
                               'start, end and, if needed, bag and task')
        found = tuple(_interval(row, f'{shown}, line {table.line_num}') for row in table)
    except (UnicodeDecodeError, csv.Error) as err:
        raise DatasetError(f'{shown} is not a table in CSV: {printable(err)}') from err
    if not found:
        raise DatasetError(f'{shown} has no episodes')
    return found


def _interval(row: dict[str, Any], where: str) -> Interval:
    if None in row:
        raise DatasetError(f'{where} has more fields than columns; put a text with commas in '
                           '"..."')
    try:
        start, end = (float(row[name]) for name in _COLUMNS)
    except (TypeError, ValueError) as err:
        raise DatasetError(f'{where}: start and end must be numbers of seconds') from err
    if not 0 <= start < end < _MOST_SECONDS:
        raise DatasetError(f'{where}: start {start:g} is not before end {end:g}, both from 0 to '
                           f'{_MOST_SECONDS:g} s')
    return Interval(row.get('bag') or '', start, end, row.get('task') or '')


def check_bags(intervals: Sequence[Interval], bags: Sequence[str]) -> None:
    """
    Check that there are the bags of a table of episodes.

    :param bags: names of all bags in the set.
    :raises DatasetError: a bag of the table is missing.
    """
    known = {'', *bags, *(Path(bag).name for bag in bags)}
    missing = next((one.bag for one in intervals if one.bag not in known), None)
    if missing is not None:
        raise DatasetError(f"the table of episodes has the bag '{printable(missing)}'; there is "
                           f'{enumerated([printable(bag) for bag in bags])}')


def episodes_of(recording: Recording, plan: Plan, bag: str) -> list[Rows]:
    """
    Return the rows of each episode of a bag.

    Sentences about episodes without rows are added to the warnings of the recording.

    :param bag: name of the bag in the set, for a table of episodes.
    :raises DatasetError: the topics have no time in common, a sample is too old, or two episodes
        overlap.
    """
    tracks = recording.tracks
    last = max(int(track.times[-1]) for track in tracks.values())
    topics = {part: replace(track, times=times) for name, track in tracks.items()
              for part, times in (track.parts or {name: track.times}).items()}
    latest = max(topics, key=lambda name: int(topics[name].times[0]))
    ends = {name: _end_of(track, plan, last) for name, track in topics.items()}
    earliest = min(ends, key=ends.__getitem__)
    start, end = int(topics[latest].times[0]), ends[earliest]
    if end < start:
        before = start - int(topics[earliest].times[-1])
        raise DatasetError(f'{earliest} ends {before / NANO:.3f} s before {latest} begins, '
                           'so no time has all topics')
    found: list[Rows] = []
    least = 2 if plan.next_action else 1
    for begin, stop, task in _spans(recording, plan, bag, last):
        first = min(int(track.times[0]) for track in tracks.values())
        _check_end(recording, plan, latest, 'first', start - max(begin, first))
        for name, track in topics.items():
            if name == earliest or not _is_seldom(track, plan):
                _check_end(recording, plan, name, 'last', min(stop, last) - int(track.times[-1]))
        times = _row_times(recording, plan, max(begin, start), min(stop - 1, end + TOLERANCE_NS))
        whole = Rows(times, {}, task)
        if len(times):
            whole = _checked(recording, plan, whole)
        parts = list(pieces(_is_good(recording, plan, whole)))
        kept = [whole.part(first, last) for first, last in parts if last - first >= least]
        left_out = len(times) - sum(len(rows.times) for rows in kept)
        if left_out or not kept:
            recording.warnings.append(
                f'{left_out} rows of the episode at '
                f'{(max(begin, start) - recording.start_ns) / NANO:.3f} s '
                'are left out' + ('' if len(times) else ', in which no row has all topics'))
        found += kept
    if not found:
        raise DatasetError('no row has all topics')
    return found


def _end_of(track: Track, plan: Plan, last: int) -> int:
    """
    Return until when a topic has samples for rows.

    A topic that ends with the others ends at its last sample. Numbers that come seldom, such as
    when they change, and a topic that ends long before the others keep their last sample, as in
    the middle.

    :param last: time of the last sample of all topics.
    """
    own, gap = int(track.times[-1]), round(plan.max_gap * NANO)
    if last - own > gap:
        return own if plan.ends == SHORTEN else own + gap
    return last if _is_seldom(track, plan) or last - own > _END_NS else own


def _is_seldom(track: Track, plan: Plan) -> bool:
    """Return whether a topic has numbers that come less often than every second row."""
    return bool(track.values.shape[1] and (len(track.times) < 2 or (
        np.median(np.diff(track.times)) > 2 * NANO // plan.fps)))


def _check_end(recording: Recording, plan: Plan, name: str, which: str, missing: int) -> None:
    """
    Check that the begin or end without samples of a topic is not too long, or warn of it.

    :param which: 'first' or 'last'.
    :param missing: time that the other topics have samples for, in nanoseconds.
    :raises DatasetError: it is longer than the largest gap.
    """
    if missing <= min(_END_NS, plan.max_gap * NANO):
        return
    text = f'{name} has no sample for the {which} {missing / NANO:.3f} s'
    if missing > plan.max_gap * NANO and not plan.splits and plan.ends != SHORTEN:
        raise DatasetError(f'{text} of the other topics; at most {plan.max_gap:g} s are allowed: '
                           'leave this time out with --ends shorten, or use a larger --max-gap')
    recording.warnings.append(f'{text} of the other topics')


def _row_times(recording: Recording, plan: Plan, start: int, end: int) -> Times:
    times = grid(start, end, plan.fps)
    if not len(times) or plan.image_choice != 'last':
        return times
    delay = max((needed_delay(recording.tracks[name].times, times, plan.fps)
                 for name, _ in plan.images), default=0)
    return grid(start + delay, end, plan.fps)


def _checked(recording: Recording, plan: Plan, rows: Rows) -> Rows:
    """Return rows with their samples; check that none is too old unless the plan splits there."""
    images = {name for name, _ in plan.images}
    samples = {name: choose(track.times, rows.times, plan.image_choice if name in images else (
        'nearest' if plan.vector_choice == 'linear' else 'last'))
        for name, track in recording.tracks.items()}
    complete = Rows(rows.times, samples, rows.task)
    if plan.splits:
        return complete
    if _are_doubled(recording, complete).any():
        tracks = {name: one for name, one in recording.tracks.items() if one.doubled.any()}
        times = np.concatenate([one.times[one.doubled | np.append(False, one.doubled[:-1])]
                                for one in tracks.values()]) - recording.start_ns
        name = next(iter(tracks))
        raise DatasetError(
            f'{name}: {tracks[name].step}, so rows from {times.min() // _MS / 1000:.3f} s to '
            f'{-(-times.max() // _MS) / 1000:.3f} s after the begin mix the samples of before and '
            'after: leave them out with --on-gap split, or by the times in --episodes TABLE.csv')
    for name, ages in _ages(recording, complete).items():
        worst = int(np.argmax(ages))
        if ages[worst] > plan.max_gap * NANO:
            stale = _oldest_number(recording.tracks[name], name, samples[name][worst])
            raise DatasetError(
                f'{stale} has no sample for {ages[worst] / NANO:.3f} s, '
                f'{(int(rows.times[worst]) - recording.start_ns) / NANO:.3f} s after the begin; '
                f'at most {plan.max_gap:g} s are allowed: use a larger --max-gap, or --on-gap '
                'split')
    return complete


def _oldest_number(track: Track, name: str, sample: int) -> str:
    """Return the name of the oldest number of a sample; that of the topic if all are as old."""
    time = track.times[sample]
    if track.oldest[sample] == time:
        return name
    return min(track.parts, key=lambda part: int(track.parts[part][
        np.searchsorted(track.parts[part], time, 'right') - 1]))


def _is_good(recording: Recording, plan: Plan, rows: Rows) -> np.ndarray[Any, np.dtype[np.bool_]]:
    good = ~_are_doubled(recording, rows)
    for ages in _ages(recording, rows).values():
        good &= ages <= plan.max_gap * NANO
    return good


def _are_doubled(recording: Recording, rows: Rows) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return which rows have a sample of a time that is there twice."""
    found = np.zeros(len(rows.times), np.bool_)
    for name, samples in rows.samples.items():
        found |= recording.tracks[name].doubled[samples]
    return found


def _ages(recording: Recording, rows: Rows) -> dict[str, Times]:
    """Return the age of the oldest number of each row in nanoseconds, by topic."""
    return {name: sample_ages(recording.tracks[name].times, recording.tracks[name].oldest,
                              rows.times, samples) for name, samples in rows.samples.items()}


def _spans(recording: Recording, plan: Plan, bag: str, end: int) -> list[Span]:
    """Return the intervals of a bag that become episodes, by the clock of its samples."""
    if plan.episodes:
        return _event_spans(recording, end)
    if not plan.intervals:
        return [(-1 << 62, 1 << 62, '')]
    spans = sorted((recording.start_ns + round(one.start * NANO),
                    recording.start_ns + round(one.end * NANO), one.task)
                   for one in plan.intervals if one.bag in ('', bag, Path(bag).name))
    if not spans:
        raise DatasetError(f'the table of episodes has no line for {printable(bag)}')
    for before, after in pairwise(spans):
        if after[0] < before[1]:
            at = (after[0] - recording.start_ns) / NANO
            raise DatasetError(f'two episodes of {printable(bag)} overlap at {at:.3f} s')
    return spans


def _event_spans(recording: Recording, end: int) -> list[Span]:
    spans: list[Span] = []
    current: Any = None
    begin = 0
    for time_ns, value in [*recording.events, (end + 1, None)]:
        if value == current:
            continue
        if current:
            spans.append((begin, time_ns, current if isinstance(current, str) else ''))
        begin, current = time_ns, value
    if not spans:
        raise DatasetError('no episode begins: the value of --episodes is never other than 0, '
                           "false or ''")
    if len(spans) > _MOST:
        raise DatasetError(f'{len(spans)} episodes begin, at most {_MOST} are possible')
    return spans
