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

"""Check of a LeRobot data set, of this package or any other: what it says against what it has."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import json
import math
from pathlib import Path
import re
from typing import Any

import numpy as np
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.lerobot import (
    DEFAULT_TYPES, import_pyarrow, INFO, row_columns, STATS, TASKS)
from opencv_tools.image.text import enumerated, MAX_PATH, printable
from opencv_tools.regular_files import open_regular, read_regular

_MAX_JSON = 1 << 28  # bytes
_MAX_GROUP = 1 << 31  # bytes of a row group in memory
_MAX_TIME_ERROR = 1e-4  # seconds, as in LeRobot
_PLACE = re.compile(r'\{(video_key|chunk_index:03d|file_index:03d)\}')


class SetReader:
    """Reader of the files of a data set."""

    def __init__(self, folder: Path) -> None:
        """
        Read ``info.json``.

        :raises DatasetError: the folder is no data set of version 3.
        """
        self.folder = folder
        self.info = self.read_json(INFO)
        version = self.info.get('codebase_version')
        if not isinstance(version, str) or not version.startswith('v3.'):
            raise DatasetError(f'{INFO} has codebase_version {printable(version)}, not v3.0; '
                               'LeRobot converts older data sets')
        features = self.info.get('features')
        if not isinstance(features, dict) or not all(
                isinstance(one, dict) and isinstance(one.get('dtype'), str)
                and isinstance(one.get('shape'), list) for one in features.values()):
            raise DatasetError(f'{INFO} has no valid features')
        self.features: dict[str, dict[str, Any]] = features
        fps = self.info.get('fps')
        if not isinstance(fps, int) or not 0 < fps <= 1000:
            raise DatasetError(f'{INFO} has fps {printable(fps)}, not an integer from 1 to 1000')
        self.fps = fps

    def read_json(self, name: str) -> dict[str, Any]:
        """
        Read a file of JSON.

        :raises DatasetError: it is missing or invalid.
        """
        try:
            content = json.loads(read_regular(self.folder / name, _MAX_JSON))
        except (OSError, ValueError, RecursionError) as err:
            reason = getattr(err, 'strerror', None) or err
            raise DatasetError(f'{name} cannot be read: {printable(reason)}') from err
        if not isinstance(content, dict):
            raise DatasetError(f'{name} has no object of JSON')
        return content

    def file_path(self, template: str, chunk: int, number: int, key: str = '') -> Path:
        """
        Return the path of a file in the set.

        :param template: name in ``info.json``, such as ``data_path``.
        :raises DatasetError: the path is missing, or outside of the set.
        """
        text = self.info.get(template)
        values = {'video_key': key, 'chunk_index:03d': f'{chunk:03d}',
                  'file_index:03d': f'{number:03d}'}
        name = _PLACE.sub(lambda found: values[found[1]], text) if isinstance(text, str) else ''
        path = self.folder / name
        if not name or '{' in name or not path.resolve().is_relative_to(self.folder.resolve()):
            raise DatasetError(f'{template} in {INFO} is {printable(text)}, which is not the path '
                               'of a file in the set')
        return path

    def tables(self, path: Path) -> Iterator[Any]:
        """
        Yield the row groups of a Parquet file.

        :raises DatasetError: the file cannot be read, or a row group is too large.
        """
        pa = import_pyarrow()
        shown = printable(path.relative_to(self.folder), MAX_PATH)
        try:
            with open(open_regular(path), 'rb') as opened:
                file = pa.parquet.ParquetFile(opened)
                for number in range(file.num_row_groups):
                    size = file.metadata.row_group(number).total_byte_size
                    if size > _MAX_GROUP:
                        raise DatasetError(f'{shown} has a row group of {size} bytes, at most '
                                           f'{_MAX_GROUP} are read')
                    yield file.read_row_group(number)
        except (OSError, pa.ArrowException) as err:
            reason = getattr(err, 'strerror', None) or err
            raise DatasetError(f'{shown} cannot be read: {printable(reason)}') from err

    def episodes(self) -> list[dict[str, Any]]:
        """
        Return the rows of the table of episodes, without statistics.

        :raises DatasetError: the table is missing or invalid.
        """
        found: list[dict[str, Any]] = []
        for path in sorted((self.folder / 'meta/episodes').glob('chunk-*/file-*.parquet')):
            for table in self.tables(path):
                found += table.select([name for name in table.column_names
                                       if not name.startswith('stats/')]).to_pylist()
        needed = {'episode_index', 'length', 'dataset_from_index', 'dataset_to_index',
                  'data/chunk_index', 'data/file_index', 'tasks'} | {
                      f'videos/{key}/{name}' for key in self.video_keys
                      for name in ('chunk_index', 'file_index', 'from_timestamp', 'to_timestamp')}
        for row in found:
            missing = sorted(needed - row.keys())
            wrong = [name for name in needed & row.keys()
                     if name != 'tasks' and not isinstance(row[name], int | float)]
            if missing or wrong:
                raise DatasetError(f'the table of episodes has no valid {(missing + wrong)[0]}')
        if not found:
            raise DatasetError('meta/episodes has no episode')
        return found

    @property
    def video_keys(self) -> list[str]:
        """Names of the features that are videos."""
        return [key for key, one in self.features.items() if one['dtype'] == 'video']


def row_problems(reader: SetReader, episodes: list[dict[str, Any]]) -> Iterator[str]:
    """
    Yield what is wrong with the rows, the tasks and the statistics.

    :raises DatasetError: a file cannot be read.
    """
    yield from _total_problems(reader, episodes)
    tasks = sum(table.num_rows for table in reader.tables(reader.folder / TASKS))
    seen: dict[str, list[Any]] = {}
    rows = 0
    for place in dict.fromkeys((row['data/chunk_index'], row['data/file_index'])
                               for row in episodes):
        for table in reader.tables(reader.file_path('data_path', *place)):
            wrong = {*row_columns(reader.features)} ^ {*table.column_names}
            if wrong:
                raise DatasetError(f'data and {INFO} differ in the columns '
                                   f'{enumerated(sorted(map(printable, wrong)))}')
            columns = {name: _numbers(reader, table, name) for name in table.column_names
                       if _is_number(reader.features[name])}
            for problem, count in _value_problems(reader, columns, tasks).items():
                yield f'{count} {problem} in rows from {rows} on'
            for name in columns:
                seen.setdefault(name, []).append(columns[name])
            expected = _expected(episodes, rows, table.num_rows)
            for name, values in expected.items():
                bad = np.flatnonzero(columns[name][:, 0] != values)
                if len(bad):
                    yield (f'row {rows + bad[0]} has {name} {columns[name][bad[0], 0]}, not '
                           f'{values[bad[0]]}')
            rows += table.num_rows
    if rows != episodes[-1]['dataset_to_index']:
        yield f'there are {rows} rows, but the episodes have {episodes[-1]["dataset_to_index"]}'
    yield from _statistics_problems(reader, {
        name: np.concatenate(values) for name, values in seen.items()})


def _total_problems(reader: SetReader, episodes: list[dict[str, Any]]) -> Iterator[str]:
    begin = 0
    for number, row in enumerate(episodes):
        place = (row['episode_index'], row['dataset_from_index'], row['dataset_to_index'])
        expected = (number, begin, begin + row['length'])
        if place != expected or row['length'] < 1:
            yield (f'episode {number} has number, first and last row {place}, not {expected}, and '
                   f'{row["length"]} rows')
        begin += max(0, int(row['length']))
    totals = {'total_episodes': len(episodes), 'total_frames': begin,
              'splits': {'train': f'0:{len(episodes)}'}}
    for name, value in totals.items():
        found = reader.info.get(name)
        if found != value and not (name == 'splits' and found and 'train' not in found):
            yield f'{INFO} has {name} {printable(found)}, but the episodes have {value}'


def _is_number(feature: Mapping[str, Any]) -> bool:
    return feature['dtype'] in ('bool', 'int64', 'int32', 'float32', 'float64', 'int8', 'int16',
                                'uint8', 'float16')


def _numbers(reader: SetReader, table: Any, name: str) -> np.ndarray[Any, Any]:
    """Return the values of a column, (n, d)."""
    size = math.prod(reader.features[name]['shape'])
    column = table.column(name).combine_chunks()
    while hasattr(column, 'flatten') and str(column.type).startswith(
            ('list', 'fixed_size_list', 'large_list', 'extension')):
        column = column.storage if hasattr(column, 'storage') else column.flatten()
    values: np.ndarray[Any, Any] = column.to_numpy(zero_copy_only=False)
    if values.size != table.num_rows * size or values.dtype.kind not in 'biuf':
        raise DatasetError(f'{printable(name)} has {values.size} numbers in {table.num_rows} '
                           f'rows, but its shape is {reader.features[name]["shape"]}')
    return values.reshape(table.num_rows, size)


def _value_problems(reader: SetReader, columns: dict[str, Any], tasks: int) -> dict[str, int]:
    found = {f'values of {printable(name)} that are not finite':
             int(np.count_nonzero(~np.isfinite(values.astype(np.float64))))
             for name, values in columns.items()}
    times = columns['frame_index'] / reader.fps
    found['timestamps that are not frame_index / fps'] = int(np.count_nonzero(
        np.abs(columns['timestamp'] - times) > _MAX_TIME_ERROR + 1e-6 * times))
    found['task numbers without a task'] = int(np.count_nonzero(
        (columns['task_index'] < 0) | (columns['task_index'] >= tasks)))
    for name, kind in DEFAULT_TYPES.items():
        found[f'values of {name} that are not {kind}'] = (
            0 if columns[name].dtype == kind else len(columns[name]))
    return {text: count for text, count in found.items() if count}


def _expected(episodes: list[dict[str, Any]], begin: int, count: int) -> dict[str, Any]:
    """Return the numbers that some rows must have."""
    index = np.arange(begin, begin + count)
    firsts = np.array([row['dataset_from_index'] for row in episodes])
    numbers = np.maximum(np.searchsorted(firsts, index, side='right') - 1, 0)
    return {'index': index, 'episode_index': numbers, 'frame_index': index - firsts[numbers]}


def _statistics_problems(reader: SetReader, columns: dict[str, Any]) -> Iterator[str]:
    statistics = reader.read_json(STATS)
    for key in reader.features:
        found = statistics.get(key)
        if not isinstance(found, dict):
            yield f'{STATS} has no statistics of {printable(key)}'
            continue
        if key not in columns:
            continue
        values = columns[key].astype(np.float64)
        exact = {'min': values.min(axis=0), 'max': values.max(axis=0), 'mean': values.mean(axis=0),
                 'std': values.std(axis=0), 'count': np.array([len(values)])}
        spread = 1e-4 * (np.abs(values).max(axis=0) + 1e-6)
        for name, value in exact.items():
            try:
                given = np.array(found.get(name), np.float64).ravel()
            except (TypeError, ValueError):
                given = np.array([])
            if given.shape != value.shape or not (np.abs(given - value) <= spread).all():
                yield f'{STATS} has another {name} of {printable(key)} than the rows'
