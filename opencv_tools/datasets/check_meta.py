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

"""Check of what the metadata of a LeRobot data set say: names, tasks, statistics and files."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import enumerated, printable
from opencv_tools.datasets.errors import DatasetError, reason_of
from opencv_tools.datasets.lerobot import INFO, STATS, TASKS
from opencv_tools.datasets.merge import file_sha256, FILES
from opencv_tools.datasets.set_reader import SetReader, values_of
from opencv_tools.datasets.statistics import (
    ImageStatistics, joined, numbers_statistics, QUANTILES, sampled_rows, Statistics)
from opencv_tools.datasets.videos import stream_settings

_ORDER = ('min', *QUANTILES, 'max')
_IMAGE_MEAN, _IMAGE_STD = 0.03, 0.06  # errors of a codec and of a sample of pixels, from 0 to 1
_QUANTILE = 0.02  # error of a histogram, of the range
_ENCODERS = {'libx264': 'h264', 'libx265': 'hevc', 'libsvtav1': 'av1', 'libaom-av1': 'av1',
             'h265': 'hevc'}
_DATA_FILES = ('data/**/*.parquet', 'videos/**/*.mp4')


def info_problems(reader: SetReader, episodes: list[dict[str, Any]]) -> Iterator[str]:
    """Yield what is wrong with the features and the numbers of files in ``info.json``."""
    chunks = reader.info.get('chunks_size')
    if not isinstance(chunks, int) or isinstance(chunks, bool) or chunks < 1:
        yield f'{INFO} has chunks_size {printable(chunks)}, not an integer from 1 on'
    is_own = (reader.folder / FILES).parent.is_dir()
    for key, feature in reader.features.items():
        names = feature.get('names')
        lists = [*names.values()] if isinstance(names, dict) else [names]
        for one in (one for one in lists if isinstance(one, list) and one
                    and len(feature['shape']) == 1):
            size = feature['shape'][0]
            texts = [*map(str, one)]
            # Other programs name a whole feature, such as 'state'.
            if len(lists) == 1 and len(one) not in ((size,) if is_own else (1, size)):
                yield f'{INFO} has {len(one)} names of {printable(key)} for {size} numbers'
            elif len({*texts}) < len(texts):
                yield f'{INFO} has a name of {printable(key)} twice'
    for key in reader.video_keys:
        places = {(row[f'videos/{key}/chunk_index'], row[f'videos/{key}/file_index'])
                  for row in episodes}
        for place in sorted(places):
            path = reader.file_path('video_path', *place, key)
            try:
                yield from (f'{printable(path.relative_to(reader.folder))}: {text}'
                            for text in _stream_problems(reader, key, path))
            except DatasetError:
                continue  # the check of its frames says so


def _stream_problems(reader: SetReader, key: str, path: Path) -> Iterator[str]:
    feature = reader.features[key]
    given = feature.get('info') or feature.get('video_info') or {}
    codec, pixels, _ = stream_settings(path)
    expected = {'video.codec': codec, 'video.pix_fmt': pixels, 'video.fps': reader.fps}
    for name, value in expected.items() if isinstance(given, dict) else ():
        found = given.get(name, value)
        known = _ENCODERS.get(str(found), str(found).partition('_')[0])
        if found != value and not (name == 'video.codec' and known == value):
            yield f'{INFO} has {name} {printable(found)}, but it is {printable(value)}'


def task_problems(reader: SetReader, episodes: list[dict[str, Any]], tasks: NDArray[Any],
                  ) -> Iterator[str]:
    """
    Yield what is wrong with the tasks, and which episodes have other ones than their rows.

    :param tasks: (n,) number of the task of each row.
    """
    texts: list[Any] = []
    numbers: list[Any] = []
    for table in reader.tables(reader.folder / TASKS):
        numbers += values_of(table, 'task_index')
        texts += next((values_of(table, one) for one in ('task', '__index_level_0__')
                       if one in table.column_names), [])
    if numbers != [*range(len(numbers))]:
        yield f'{TASKS} does not number its {len(numbers)} tasks from 0'
    if reader.info.get('total_tasks') != len(numbers):
        yield (f'{INFO} has total_tasks {printable(reader.info.get("total_tasks"))}, but there '
               f'are {len(numbers)}')
    unknown = np.count_nonzero((tasks < 0) | (tasks >= len(numbers)))
    if unknown:
        yield f'{unknown} task numbers without a task in the rows'
    if len(texts) < len(numbers):
        return
    known = {number: str(text) for number, text in zip(numbers, texts)
             if isinstance(number, int)}
    columns = reader.episode_columns('tasks')
    for row, given in zip(episodes, columns.get('tasks', [None] * len(episodes))):
        begin, end = row['dataset_from_index'], row['dataset_to_index']
        found = {known.get(number) for number in np.unique(tasks[begin:end]).tolist()}
        if not isinstance(given, list) or found != {*map(str, given)}:
            yield (f'episode {row["episode_index"]} has the tasks {printable(given)}, but its '
                   f'rows have {enumerated([printable(one) for one in found])}')


def file_problems(reader: SetReader, episodes: list[dict[str, Any]]) -> Iterator[str]:
    """Yield which files belong to no episode, and which ones are not as they were written."""
    places = [('data_path', '', 'data')] + [
        ('video_path', key, f'videos/{key}') for key in reader.video_keys]
    used = {reader.file_path(template, row[f'{prefix}/chunk_index'], row[f'{prefix}/file_index'],
                             key) for template, key, prefix in places for row in episodes}
    rest = {path for pattern in _DATA_FILES for path in reader.folder.glob(pattern)} - used
    if rest:
        shown = [printable(path.relative_to(reader.folder)) for path in sorted(rest)]
        yield f'{len(rest)} files belong to no episode: {enumerated(shown)}'
    sums = reader.read_json(FILES) if (reader.folder / FILES).is_file() else {}
    written = {path.relative_to(reader.folder).as_posix()
               for path in used.union(reader.folder.glob('meta/**/*.*'))}
    bare = [printable(name) for name in sorted(written - {*sums, FILES})]
    if bare and (reader.folder / FILES).parent.is_dir():  # another program writes none
        reader.notes.append(f'{FILES} has no checksum of {enumerated(bare)}')
    for name, digest in sums.items():
        path = reader.folder / name
        try:
            if (path.resolve().is_relative_to(reader.folder.resolve())
                    and file_sha256(path) != digest):
                yield f'{printable(name)} is not as it was written: its sha256 is another one'
        except (OSError, RuntimeError, ValueError) as err:
            yield f'{printable(name)} cannot be read: {reason_of(err)}'


class FrameStatistics:
    """Statistics of the frames of videos, of the rows that LeRobot samples."""

    def __init__(self, lengths: list[int]) -> None:
        """
        Create statistics without a frame.

        :param lengths: number of rows of each episode.
        """
        self._lengths = lengths
        self._rows: dict[str, int] = {}  # that were added of the present episode
        self._images = ImageStatistics()
        #: Statistics of the episodes that are complete, by feature.
        self.found: dict[str, list[Statistics]] = {}

    def add(self, key: str, frame: Any) -> None:
        """Add the next frame of a feature."""
        found, row = self.found.setdefault(key, []), self._rows.get(key, 0)
        if len(found) == len(self._lengths):
            return
        if not row:
            self._images, self._sampled = ImageStatistics(), {
                *sampled_rows(self._lengths[len(found)]).tolist()}
        if row in self._sampled:
            self._images.add(frame.to_ndarray(format='bgr24'))
        self._rows[key] = row + 1
        if row + 1 == self._lengths[len(found)]:
            found.append(self._images.statistics())
            self._rows[key] = 0


def statistics_problems(reader: SetReader, episodes: list[dict[str, Any]],
                        columns: dict[str, NDArray[Any]], frames: FrameStatistics,
                        ) -> Iterator[str]:
    """
    Yield which statistics of a feature, of the set and of its episodes, are not those of its rows.

    :param columns: (n, d) numbers of all rows by feature.
    """
    total, stored = reader.read_json(STATS), reader.episode_columns('stats/')
    lengths = [one['length'] for one in episodes]
    spans = [(one['dataset_from_index'], one['dataset_to_index']) for one in episodes]
    found = {**frames.found, **{
        key: [numbers_statistics(1 * values[begin:end])
              for begin, end in spans if begin < end] for key, values in columns.items()
        if np.isfinite(values).all() and max(end for _, end in spans) <= len(values)}}
    yield from _other_statistics(reader, total, stored)
    yield from (f'{STATS} has no statistics of {printable(key)}'
                for key, feature in reader.features.items() if not isinstance(total.get(key), dict)
                and (key in columns or feature['dtype'] in ('image', 'video')))
    for key, each in found.items():
        is_image = key in frames.found
        if len(each) < len(episodes):
            continue  # the check of the rows or videos says so
        given = total.get(key)
        if isinstance(given, dict):
            least, most = ({name: call([one[name] for one in each], axis=0) for name in each[0]}
                           for call in (np.min, np.max))
            limits = {name: (least[name], most[name]) for name in QUANTILES if not is_image}
            whole = joined(each)
            limits |= {name: (whole[name],) * 2
                       for name in ('mean', 'std', *(() if is_image else ('min', 'max')))}
            names = [*_wrong(given, limits, is_image, least['min'], most['max'])]
            if not _is_count(given.get('count'), whole['count'], is_image, lengths):
                names.append('count')
            yield from (f'{STATS} has another {name} of {printable(key)} than the rows'
                        for name in names)
        for number, one in enumerate(each):
            rows = {name: values[number] for name in one if len(
                values := stored.get(f'stats/{key}/{name}', [])) == len(episodes)
                and values[number] is not None}
            wrong = [*_wrong(rows, {name: (value, value) for name, value in one.items()
                                    if name != 'count' and name not in (
                                        ('min', 'max', *QUANTILES) if is_image else ())},
                             is_image, one['min'], one['max'])]
            if not _is_count(rows.get('count', one['count'].tolist()), one['count'], is_image,
                             lengths[number:number + 1]):
                wrong.append('count')
            for name in wrong:
                yield (f'the table of episodes has another {name} of {printable(key)} than the '
                       f'rows of episode {number}')


def _other_statistics(reader: SetReader, total: Collection[str], columns: Collection[str],
                      ) -> Iterator[str]:
    """Yield which statistics of the set, or columns with those of episodes, have no feature."""
    names = {*total, *(one.removeprefix('stats/').rpartition('/')[0] for one in columns)}
    yield from (f'there are statistics of {printable(key)}, which {INFO} does not have'
                for key in sorted(names - {*reader.features}))


def _is_count(given: Any, sampled: NDArray[Any], is_image: bool, lengths: list[int]) -> bool:
    """Return whether a count is that of the rows; of images also that of the sampled ones."""
    return given == sampled.tolist() or (is_image and given in (None, [sum(lengths)]))


def _wrong(given: dict[str, Any], expected: dict[str, tuple[Any, Any]], is_image: bool,
           low: Any, high: Any) -> Iterator[str]:
    """
    Yield the names of statistics that are not within limits, or not in their order.

    :param expected: smallest and largest value of each, without the error of a codec.
    """
    has_quantiles = any(name in given for name in QUANTILES)
    values = {}
    for name in ('min', 'max', 'mean', 'std', *(QUANTILES if has_quantiles else ())):
        try:
            values[name] = np.array(given.get(name), np.float64)
        except (TypeError, ValueError, OverflowError):
            values[name] = np.array(np.nan)
        if values[name].shape != np.shape(low) or not np.isfinite(values[name]).all():
            yield name
            return
    spread = 1e-4 * (np.maximum(np.abs(low), np.abs(high)) + 1e-6)
    if is_image:  # a codec may take any noise away
        mean, (least, most) = values['mean'], expected['std']
        expected['std'] = least, np.maximum(most, np.sqrt(np.clip(mean * (1 - mean), 0, None)))
    for name in values:
        least, most = expected.get(name, (-np.inf, np.inf))
        limit = (_IMAGE_STD if name == 'std' else _IMAGE_MEAN) if is_image else (
            spread + _QUANTILE * (high - low) * (name in QUANTILES))
        is_right = (values[name] >= least - limit) & (values[name] <= most + limit)
        if is_image:  # levels from 0 to 1
            is_right &= np.abs(values[name] - 0.5) <= 0.5 + spread
        if not is_right.all():
            yield name
    order = [name for name in _ORDER if name in values]
    for one, two in [*pairwise(order), ('min', 'mean'), ('mean', 'max')]:
        if (values[one] > values[two] + spread).any():
            yield f'order of {one} and {two}'
