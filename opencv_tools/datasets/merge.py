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

"""Merge of parts to a LeRobot data set. Nothing is encoded: episodes are numbered anew."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from opencv_tools.base.regular_files import open_regular
from opencv_tools.base.text import printable
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.lerobot import (
    CHUNK_FILES, DATA_MEGABYTES, DATA_PATH, EPISODES_PATH, Features, flat_statistics,
    import_pyarrow, INFO, info, row_columns, STATS, TASKS, tasks_table, VIDEO_MEGABYTES,
    VIDEO_PATH)
from opencv_tools.datasets.part import FINGERPRINT, ROWS
from opencv_tools.datasets.plan import IMAGES, LEROBOT
from opencv_tools.datasets.sample_files import BAGS, gather_samples
from opencv_tools.datasets.statistics import joined, numbers_statistics, Statistics
from opencv_tools.datasets.videos import join_videos, stream_settings

#: What this package adds to a set: the bags and their reports, and small pictures for --check.
SOURCES, FINGERPRINTS = 'meta/opencv_tools/bags.json', 'meta/opencv_tools/fingerprints.parquet'
#: SHA-256 of all other files, by their paths.
FILES = 'meta/opencv_tools/files.json'
#: Files, one of which every data set of this package has.
MARKS = INFO, BAGS
_MEGABYTE = 1 << 20
_INDEX_KEYS = ('index', 'episode_index', 'task_index')


def file_sha256(path: Path) -> str:
    """
    Return the SHA-256 digest of a file, in hexadecimal digits.

    :raises OSError: the file cannot be read.
    """
    with os.fdopen(open_regular(path), 'rb') as file:
        digest = hashlib.sha256()
        while block := file.read(_MEGABYTE):
            digest.update(block)
        return digest.hexdigest()


@dataclass
class _File:
    """The file that is being filled: its number, and what belongs to it."""

    number: int = 0
    size: int = 0
    items: list[Any] = field(default_factory=list)

    @property
    def place(self) -> dict[str, int]:
        return {'chunk_index': self.number // CHUNK_FILES, 'file_index': self.number % CHUNK_FILES}

    def next(self) -> None:  # noqa: A003
        self.number, self.size, self.items = self.number + 1, 0, []


def merge_parts(parts: Sequence[Path], described: list[dict[str, Any]], folder: Path) -> None:
    """
    Write a data set of parts, of the format that they have.

    :param parts: folders of the parts, in the order of their episodes.
    :param described: what their part.json says; see ``check_alike``.
    :param folder: new folder of the data set, which exists and is empty.
    :raises DatasetError: a part is damaged.
    :raises OSError: a file cannot be read or written.
    """
    if described[0]['format'] == LEROBOT:
        _Merge(parts, described, folder).write()
    else:
        gather_samples(parts, described, folder)


def check_alike(parts: list[dict[str, Any]]) -> None:
    """
    Check that all parts have the same features, apart from the settings of their encoders.

    :raises DatasetError: they do not fit each other.
    """
    first = parts[0]
    for other in parts[1:]:
        for name in ('fps', 'robot_type', 'format'):
            if other[name] != first[name]:
                raise DatasetError(f'{name} of {printable(other["bag"])} is {other[name]!r}, that '
                                   f'of {printable(first["bag"])} is {first[name]!r}')
        keys = [*dict.fromkeys([*first['features'], *other['features']])]
        for key in keys:
            one, two = ({name: part['features'].get(key, {}).get(name)
                         for name in ('dtype', 'shape', 'names')} for part in (first, other))
            if one != two:
                raise DatasetError(
                    f'{key} of {printable(other["bag"])} is {printable(two)}, that of '
                    f'{printable(first["bag"])} is {printable(one)}: convert them with one plan, '
                    'or to two sets')


class _Merge:
    """A data set while it is written."""

    def __init__(self, parts: Sequence[Path], described: list[dict[str, Any]], folder: Path,
                 ) -> None:
        self._parts, self._described, self._folder = parts, described, folder
        self._features: Features = described[0]['features']
        self._videos = [key for key, feature in self._features.items()
                        if feature['dtype'] == 'video']
        self._tasks = [*dict.fromkeys(
            episode['task'] for part in described for episode in part['episodes'])]
        self._statistics: list[dict[str, Statistics]] = []
        self._episodes: list[dict[str, Any]] = []

    def write(self) -> None:
        """Write all files, ``info.json`` last."""
        self._write_rows()
        for key in self._videos:
            self._write_videos(key)
        self._write_episodes()
        pa = import_pyarrow()
        pa.parquet.write_table(tasks_table(self._tasks), self._path(TASKS))
        total = {key: joined([one[key] for one in self._statistics])
                 for key in self._statistics[0]}
        self._write_json(STATS, {key: {name: value.tolist() for name, value in found.items()}
                                 for key, found in total.items()})
        self._write_json(SOURCES, [{name: value for name, value in part.items()
                                    if name not in ('episodes', 'features')} | {
                                        'episodes': len(part['episodes'])}
                                   for part in self._described])
        frames = self._episodes[-1]['dataset_to_index']
        self._write_json(INFO, info(self._described[0], self._features, len(self._episodes),
                                    frames, len(self._tasks)))
        self._write_json(FILES, {
            path.relative_to(self._folder).as_posix(): file_sha256(path)
            for path in sorted(self._folder.rglob('*')) if path.is_file()})

    def _write_rows(self) -> None:
        """Write the rows, the small pictures, and what an episode has apart from videos."""
        pa = import_pyarrow()
        file, writer, prints, begin = _File(), None, None, 0
        columns = row_columns(self._features)
        try:
            for episode, table in self._tables():
                count = episode['length']
                numbers = {'index': begin, 'episode_index': len(self._episodes),
                           'task_index': self._tasks.index(episode['task'])}
                rows = table.select(columns)
                for key, value in numbers.items():
                    values = np.arange(begin, begin + count) if key == 'index' else np.full(
                        count, value)
                    rows = rows.set_column(columns.index(key), rows.schema.field(key),
                                           pa.array(values, pa.int64()))
                if writer and file.size + rows.nbytes >= DATA_MEGABYTES * _MEGABYTE:
                    writer.close()
                    writer = None
                    file.next()
                writer = writer or pa.parquet.ParquetWriter(
                    self._path(DATA_PATH.format(**file.place)), rows.schema)
                writer.write_table(rows, row_group_size=count)
                file.size += rows.nbytes
                if self._videos:
                    small = table.select([one for one in table.column_names
                                          if one.startswith(FINGERPRINT)])
                    prints = prints or pa.parquet.ParquetWriter(
                        self._path(FINGERPRINTS), small.schema)
                    prints.write_table(small, row_group_size=count)
                self._add_episode(episode, numbers, rows)
                self._episodes[-1].update({f'data/{name}': value
                                           for name, value in file.place.items()})
                begin += count
        finally:
            for opened in (writer, prints):
                if opened:
                    opened.close()

    def _tables(self) -> Iterator[tuple[dict[str, Any], Any]]:
        """Yield the description and the rows of each episode."""
        pa = import_pyarrow()
        for part, described in zip(self._parts, self._described):
            try:
                table = pa.parquet.read_table(part / ROWS)
            except pa.ArrowInvalid as err:
                raise DatasetError(f'{printable(part / ROWS)} is damaged: {err}') from err
            begin = 0
            for episode in described['episodes']:
                yield episode, table.slice(begin, episode['length'])
                begin += episode['length']
            if begin != table.num_rows:
                raise DatasetError(f'{printable(part)} has {table.num_rows} rows instead of '
                                   f'{begin}: convert its bag again')

    def _add_episode(self, episode: dict[str, Any], numbers: dict[str, int], rows: Any) -> None:
        statistics = {key: {name: np.array(value) for name, value in found.items()}
                      for key, found in episode['statistics'].items()}
        statistics |= {key: numbers_statistics(rows.column(key).to_numpy().reshape(-1, 1))
                       for key in _INDEX_KEYS}
        self._statistics.append(statistics)
        self._episodes.append({
            'episode_index': numbers['episode_index'], 'tasks': [episode['task']],
            'length': episode['length'], 'dataset_from_index': numbers['index'],
            'dataset_to_index': numbers['index'] + episode['length']})

    def _write_videos(self, key: str) -> None:
        """Join the videos of a camera to files of a limited size."""
        name, file, settings = f'{key.removeprefix(IMAGES)}.mp4', _File(), ('', '', b'')
        fps, frames, number = self._described[0]['fps'], 0, 0
        for part, described in zip(self._parts, self._described):
            size, found = (part / name).stat().st_size, stream_settings(part / name)
            if file.items and (file.size + size >= VIDEO_MEGABYTES * _MEGABYTE
                               or found != settings):
                self._join(key, file, frames)
                file.next()
                frames = 0
            settings, file.size = found, file.size + size
            file.items.append(part / name)
            for episode in described['episodes']:
                end = frames + episode['length']
                place = {**file.place, 'from_timestamp': frames / fps, 'to_timestamp': end / fps}
                self._episodes[number].update({f'videos/{key}/{column}': value
                                               for column, value in place.items()})
                frames, number = end, number + 1
        self._join(key, file, frames)

    def _join(self, key: str, file: _File, frames: int) -> None:
        path = self._path(VIDEO_PATH.format(video_key=key, **file.place))
        join_videos(file.items, path, frames)

    def _write_episodes(self) -> None:
        pa = import_pyarrow()
        rows = [{**episode, **flat_statistics(statistics), 'meta/episodes/chunk_index': 0,
                 'meta/episodes/file_index': 0}
                for episode, statistics in zip(self._episodes, self._statistics)]
        path = self._path(EPISODES_PATH.format(chunk_index=0, file_index=0))
        pa.parquet.write_table(pa.Table.from_pylist(rows), path)

    def _write_json(self, name: str, content: Any) -> None:
        self._path(name).write_text(json.dumps(content, indent=4))

    def _path(self, name: str) -> Path:
        """Return the path of a file in the data set, whose folder exists."""
        path = self._folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path
