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

"""The values of the rows of episodes: numbers of features, of rows, and times of samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.units import NANO
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.plan import ACTION, Plan, STATE
from opencv_tools.datasets.rows import interpolate, match, Rows
from opencv_tools.datasets.tracks import Recording


def shortened(plan: Plan, episodes: Sequence[Rows]) -> list[Rows]:
    """Return the rows that have an action: with ``next_action``, the last one has none."""
    return [rows.part(0, len(rows.times) - 1) if plan.next_action else rows for rows in episodes]


def shown_rows(episodes: Sequence[Rows], shown: Mapping[str, NDArray[np.int64]],
               warnings: list[str]) -> list[Rows]:
    """
    Return rows with the samples that cameras really show, and add a warning about the others.

    :param shown: number of the sample of each row of all episodes, by the name of the camera.
    :param warnings: sentences about the bag, to which others are added.
    """
    for name, samples in shown.items():
        wanted = np.concatenate([rows.samples[name] for rows in episodes])
        lost = len(np.setdiff1d(wanted, samples))
        if lost:
            warnings.append(f'{name}: {lost} pictures cannot be decoded, so rows repeat those '
                            'before them')
    found, begin = [], 0
    for rows in episodes:
        end = begin + len(rows.times)
        found.append(replace(rows, samples={
            **rows.samples, **{name: one[begin:end] for name, one in shown.items()}}))
        begin = end
    return found


def topic_accounts(recording: Recording, wanted: Sequence[Rows], shown: Sequence[Rows],
                   ) -> dict[str, dict[str, Any]]:
    """
    Return what became of all messages of each topic, by the name of its samples.

    :param wanted: rows with the samples that belong to them.
    :param shown: the same rows with those that they have.
    """
    found = {}
    for name, track in recording.tracks.items():
        one = match(track.times, track.oldest, wanted, shown, name)
        found[name] = asdict(replace(
            one, dropped=one.dropped + track.late + track.partial,
            before=one.before + track.left_out, failed=one.failed + track.failed,
            messages=one.messages + track.late + track.partial + track.left_out + track.failed))
    return found


def unused_topics(recording: Recording, plan: Plan) -> dict[str, int]:
    """Return the number of messages of each topic that the plan does not name."""
    used = {track.topic.name for track in recording.tracks.values()}
    used |= {plan.episodes.topic} if plan.episodes else set()
    return {topic.name: count for topic, count in recording.bag.topics.items()
            if topic.name not in used}


def row_numbers(rows: Rows, episode: int, fps: int) -> dict[str, NDArray[Any]]:
    """Return the columns that number the rows of an episode; tasks are numbered by the merge."""
    count = len(rows.times)
    frames = np.arange(count)
    return {'timestamp': (frames / fps).astype(np.float32), 'frame_index': frames,
            'episode_index': np.full(count, episode), 'index': frames,
            'task_index': np.zeros(count, np.int64)}


def row_stamps(recording: Recording, rows: Rows) -> NDArray[np.int64]:
    """Return the time of each sample of each row, (n, d) in nanoseconds."""
    return np.stack([track.times[rows.samples[name]]
                     for name, track in recording.tracks.items()], axis=1)


def row_vectors(plan: Plan, recording: Recording, episodes: Sequence[Rows],
                ) -> dict[str, list[NDArray[np.float64]]]:
    """
    Return the numbers of each feature, for each episode an (n, d) array.

    :param episodes: all rows; with ``next_action`` the last one of each has no action.
    :raises DatasetError: a number is not finite.
    """
    found: dict[str, list[NDArray[np.float64]]] = {}
    for key, sources in plan.vectors:
        found[key] = [np.hstack([_numbers(plan, recording, str(source), rows)
                                 for source in sources]) for rows in episodes]
    if plan.next_action:
        states = found[STATE]
        found[ACTION] = [values[1:] for values in states]
        found = {key: values if key == ACTION else [one[:-1] for one in values]
                 for key, values in found.items()}
    return found


def _numbers(plan: Plan, recording: Recording, name: str, rows: Rows) -> NDArray[np.float64]:
    track = recording.tracks[name]
    with np.errstate(over='ignore', invalid='ignore'):  # what is too large becomes infinite
        values = (interpolate(track.times, track.values, rows.times)
                  if plan.vector_choice == 'linear' else track.values[rows.samples[name]])
        bad = ~np.isfinite(values.astype(np.float32)).all(axis=1)
    if bad.any():
        at = (int(rows.times[int(np.argmax(bad))]) - recording.start_ns) / NANO
        raise DatasetError(f'{name} is not finite {at:.3f} s after the begin, in '
                           f'{np.count_nonzero(bad)} rows')
    return values
