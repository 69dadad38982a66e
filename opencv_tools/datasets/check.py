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

"""Check of a LeRobot data set of any origin: its rows, its videos and the report."""

from __future__ import annotations

from collections.abc import Iterator
import math
from pathlib import Path
from typing import Any

import numpy as np
from opencv_tools.base.logs import Log
from opencv_tools.base.text import enumerated, MAX_PATH, printable
from opencv_tools.datasets.check_meta import (
    file_problems, FrameStatistics, info_problems, statistics_problems, task_problems)
from opencv_tools.datasets.check_videos import DepthFrames, has_fingerprints, video_problems
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.lerobot import import_pyarrow, INFO, row_columns
from opencv_tools.datasets.merge import SOURCES
from opencv_tools.datasets.set_reader import MAX_TIME_ERROR, SetReader
from opencv_tools.datasets.set_writing import COUNTS, topic_lines

_MOST_PROBLEMS = 20


def check_set(folder: Path, log: Log) -> bool:
    """Log what is wrong with a data set, or what it has; return whether it is right."""
    problems: list[str] = []
    depths: dict[str, DepthFrames] = {}
    account: list[str] = []
    try:
        reader = SetReader(folder)
        episodes = reader.episodes()
        columns: dict[str, np.ndarray[Any, Any]] = {}
        frames = FrameStatistics([row['length'] for row in episodes])
        reader.on_frame = frames.add
        problems += row_problems(reader, episodes, columns)
        problems += account_problems(reader, episodes, account)
        problems += info_problems(reader, episodes)
        problems += task_problems(reader, episodes, columns.get('task_index', np.zeros(0)))
        problems += file_problems(reader, episodes)
        problems += video_problems(reader, episodes, depths)
        problems += statistics_problems(reader, episodes, columns, frames)
    except DatasetError as err:
        problems.append(str(err))
    for problem in problems[:_MOST_PROBLEMS]:
        log.error(problem)
    if problems:
        log.error(f'{printable(folder, MAX_PATH)} has {len(problems)} errors')
        return False
    for line in account + reader.notes:
        log.info(line)
    for key, found in depths.items():
        log.info(f'{printable(key)}: {found.description}')
    videos = enumerated([printable(key) for key in reader.video_keys]) or 'no videos'
    compared = 'compared with the bags' if has_fingerprints(reader) else (
        'not compared with their origin, which is unknown')
    pictures = f'; the pictures are {compared}' if reader.video_keys else ''
    log.info(f'{printable(folder, MAX_PATH)} is complete: {len(episodes)} episodes, '
             f'{episodes[-1]["dataset_to_index"]} rows, {videos}{pictures}')
    return True


def account_problems(reader: SetReader, episodes: list[dict[str, Any]], lines: list[str],
                     ) -> Iterator[str]:
    """
    Yield what is wrong with the account of the messages of the bags, if there is one.

    :param lines: list to which the sentences of the account are added.
    :raises DatasetError: the file cannot be read.
    """
    if not (reader.folder / SOURCES).is_file():
        return
    parts = reader.read_json(SOURCES, list)
    lengths = [row['length'] for row in episodes]
    try:
        for part in parts:
            own, lengths = lengths[:part['episodes']], lengths[part['episodes']:]
            for name, one in part['topics'].items():
                yield from _topic_problems(printable(name), one, own)
        if lengths:
            yield f'{SOURCES} has {len(episodes) - len(lengths)} of {len(episodes)} episodes'
        lines += topic_lines(parts)
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as err:
        yield f'{SOURCES} has no valid account: {type(err).__name__}: {printable(err)}'


def _topic_problems(name: str, one: dict[str, Any], lengths: list[int]) -> Iterator[str]:
    """
    Yield what is wrong with the account of a topic.

    :param lengths: number of rows of each episode of the bag.
    """
    total = sum(one[key] for key in COUNTS)
    wrong = [key for key in (*COUNTS, 'reused') if type(one[key]) is not int or one[key] < 0]
    if wrong:
        yield (f'{SOURCES} has {one[wrong[0]]!r} for {wrong[0]} of {name}, not an integer from 0 '
               'on')
    if total != one['messages']:
        yield f'{SOURCES} has {one["messages"]!r} messages of {name}, but accounts for {total}'
    # The sample before the border of two episodes may be in both.
    if not 0 <= sum(lengths) - one['used'] - one['reused'] < max(1, len(lengths)):
        yield (f'{SOURCES} has {one["used"]} samples of {name} in rows and {one["reused"]} rows '
               f'that repeat one, but its episodes have {sum(lengths)} rows')


_NUMBERS = ('bool', 'int8', 'int16', 'int32', 'int64', 'uint8', 'uint16', 'uint32', 'uint64',
            'float16', 'float32', 'float64')


def row_problems(reader: SetReader, episodes: list[dict[str, Any]],
                 columns: dict[str, Any]) -> Iterator[str]:
    """
    Yield what is wrong with the rows.

    :param columns: dictionary to which the (n, d) numbers of all rows are added by feature.
    :raises DatasetError: a file cannot be read.
    """
    yield from _total_problems(reader, episodes)
    seen: dict[str, list[Any]] = {}
    rows = 0
    for place in dict.fromkeys((row['data/chunk_index'], row['data/file_index'])
                               for row in episodes):
        for table in reader.tables(reader.file_path('data_path', *place)):
            wrong = {*row_columns(reader.features)} ^ {*table.column_names}
            if wrong:
                raise DatasetError(f'data and {INFO} differ in the columns '
                                   f'{enumerated(sorted(map(printable, wrong)))}')
            found = {name: _numbers(reader, table, name) for name in table.column_names
                     if reader.features[name]['dtype'] in _NUMBERS}
            for problem, count in _value_problems(reader, found).items():
                yield f'{count} {problem} in rows from {rows} on'
            for name, values in found.items():
                seen.setdefault(name, []).append(values)
            expected = _expected(episodes, rows, table.num_rows)
            for name, values in expected.items():
                bad = np.flatnonzero(found[name][:, 0] != values)
                if len(bad):
                    yield (f'row {rows + bad[0]} has {name} {found[name][bad[0], 0]}, not '
                           f'{values[bad[0]]}')
            rows += table.num_rows
    if rows != episodes[-1]['dataset_to_index']:
        yield f'there are {rows} rows, but the episodes have {episodes[-1]["dataset_to_index"]}'
    if rows:
        columns.update({name: np.concatenate(values) for name, values in seen.items()})


def _total_problems(reader: SetReader, episodes: list[dict[str, Any]]) -> Iterator[str]:
    begin = 0
    for number, row in enumerate(episodes):
        place = (row['episode_index'], row['dataset_from_index'], row['dataset_to_index'])
        expected = (number, begin, begin + row['length'])
        if place != expected or row['length'] < 1:
            yield (f'episode {number} has number, first and last row {place}, not {expected}, and '
                   f'{row["length"]} rows')
        begin += row['length']
    totals = {'total_episodes': len(episodes), 'total_frames': begin,
              'splits': {'train': f'0:{len(episodes)}'}}
    for name, value in totals.items():
        found = reader.info.get(name)
        has_other_splits = name == 'splits' and isinstance(found, dict) and 'train' not in found
        if found != value and not has_other_splits:
            yield f'{INFO} has {name} {printable(found)}, but the episodes have {value}'


def _numbers(reader: SetReader, table: Any, name: str) -> np.ndarray[Any, Any]:
    """Return the values of a column, (n, d)."""
    size = math.prod(reader.features[name]['shape'])
    pa = import_pyarrow()
    column = table.column(name).combine_chunks()
    try:
        while str(column.type).startswith(
                ('list', 'fixed_size_list', 'large_list', 'extension')):
            column = column.storage if hasattr(column, 'storage') else column.flatten()
        values: np.ndarray[Any, Any] = column.to_numpy(zero_copy_only=False)
    except (ValueError, pa.ArrowException) as err:
        raise DatasetError(f'{printable(name)} cannot be read: {printable(err)}') from err
    if values.size != table.num_rows * size or values.dtype.kind not in 'biuf':
        raise DatasetError(f'{printable(name)} has {values.size} numbers in {table.num_rows} '
                           f'rows, but its shape is {reader.features[name]["shape"]}')
    return values.reshape(table.num_rows, size)


def _value_problems(reader: SetReader, columns: dict[str, Any]) -> dict[str, int]:
    found = {f'values of {printable(name)} that are not finite':
             int(np.count_nonzero(~np.isfinite(values.astype(np.float64))))
             for name, values in columns.items()}
    times = columns['frame_index'] / reader.fps
    found['timestamps that are not frame_index / fps'] = int(np.count_nonzero(
        np.abs(columns['timestamp'] - times) > MAX_TIME_ERROR + 1e-6 * times))
    for name, values in columns.items():
        kind = reader.features[name]['dtype']
        found[f'values of {printable(name)} that are {values.dtype}, not {kind}'] = (
            0 if values.dtype == kind else values.size)
    return {text: count for text, count in found.items() if count}


def _expected(episodes: list[dict[str, Any]], begin: int, count: int) -> dict[str, Any]:
    """Return the numbers that some rows must have."""
    index = np.arange(begin, begin + count)
    firsts = np.array([row['dataset_from_index'] for row in episodes])
    numbers = np.maximum(np.searchsorted(firsts, index, side='right') - 1, 0)
    return {'index': index, 'episode_index': numbers, 'frame_index': index - firsts[numbers]}
