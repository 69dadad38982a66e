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

"""Check of the videos of a data set: number, times, sizes and pictures of their frames."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.merge import FINGERPRINTS
from opencv_tools.datasets.part import FINGERPRINT
from opencv_tools.datasets.pictures import fingerprint
from opencv_tools.datasets.plan import IMAGES
from opencv_tools.datasets.set_reader import MAX_TIME_ERROR, SetReader, values_of
from opencv_tools.datasets.videos import frame_luma, video_frames
from opencv_tools.image.text import printable

_MAX_LEVELS = 12.0  # largest difference of the small pictures of a frame, on average
_SHIFT_LEVELS = 0.5  # by which the picture of another row must fit better


def video_problems(reader: SetReader, episodes: list[dict[str, Any]]) -> Iterator[str]:
    """
    Yield what is wrong with the videos.

    :raises DatasetError: a file cannot be read.
    """
    for key in reader.video_keys:
        prints = _fingerprints(reader, key, episodes[-1]['dataset_to_index'])
        columns = [f'videos/{key}/{name}' for name in ('chunk_index', 'file_index')]
        for (chunk, number), rows in groupby(episodes, itemgetter(*columns)):
            path = reader.file_path('video_path', chunk, number, key)
            shown = printable(path.relative_to(reader.folder))
            try:
                yield from (f'{shown}: {problem}' for problem in _file_problems(
                    reader, key, path, list(rows), prints))
            except DatasetError as err:
                yield f'{shown}: {err}'


def has_fingerprints(reader: SetReader) -> bool:
    """Return whether the pictures of a set can be compared with those of the bags."""
    return (reader.folder / FINGERPRINTS).is_file()


def _fingerprints(reader: SetReader, key: str, rows: int) -> NDArray[np.uint8] | None:
    """Return the small picture of each row as the bag had it, (n, 64); None if unknown."""
    if not has_fingerprints(reader):
        return None
    column = FINGERPRINT + key.removeprefix(IMAGES)
    found: list[bytes] = []
    for table in reader.tables(reader.folder / FINGERPRINTS, [column]):
        found += values_of(table, column)
    if len(found) != rows or not all(isinstance(one, bytes) and len(one) == 64 for one in found):
        raise DatasetError(f'{FINGERPRINTS} has {len(found)} pictures of {printable(key)}, but '
                           f'there are {rows} rows')
    return np.frombuffer(b''.join(found), np.uint8).reshape(rows, -1)


def _file_problems(reader: SetReader, key: str, path: Any, episodes: list[dict[str, Any]],
                   prints: NDArray[np.uint8] | None) -> Iterator[str]:
    expected = sum(row['length'] for row in episodes)
    begin = 0
    for row in episodes:
        for name, frame in (('from', begin), ('to', begin + row['length'])):
            found = row[f'videos/{key}/{name}_timestamp']
            if not abs(found - frame / reader.fps) <= MAX_TIME_ERROR:
                yield (f'episode {row["episode_index"]} has {name}_timestamp {found}, not '
                       f'{frame / reader.fps}')
        begin += row['length']
    count, late = 0, 0
    seen: list[NDArray[np.uint8]] = []
    height, width, *_ = reader.features[key]['shape']
    for time, frame in video_frames(path):
        if (frame.width, frame.height) != (width, height):
            yield f'frame {count} has {frame.width}x{frame.height} pixels, not {width}x{height}'
            return
        late += abs(float(time) - count / reader.fps) > MAX_TIME_ERROR
        count += 1
        if prints is not None and count <= expected:
            seen.append(fingerprint(frame_luma(frame)))
    if late:
        yield f'{late} frames are not at k / {reader.fps} s'
    if count != expected:
        yield f'it has {count} frames, but its episodes have {expected} rows'
    elif prints is not None:
        first = episodes[0]['dataset_from_index']
        yield from _picture_problems(np.array(seen), prints[first:first + expected])


def _picture_problems(seen: NDArray[np.uint8], expected: NDArray[np.uint8]) -> Iterator[str]:
    """Yield which frames do not show the pictures of the bag, or show those of another row."""
    errors = np.abs(seen.astype(int) - expected).mean(axis=1)
    bad = np.flatnonzero(errors > _MAX_LEVELS)
    if len(bad):
        yield f'{len(bad)} frames differ from the pictures of the bag, the first is {bad[0]}'
    for shift, name in ((-1, 'after'), (1, 'before')):
        moved = np.abs(seen.astype(int) - np.roll(expected, shift, axis=0)).mean(axis=1)
        moved[-1 if shift < 0 else 0] = np.inf
        wrong = np.flatnonzero(moved + _SHIFT_LEVELS < errors)
        if len(wrong):
            yield (f'{len(wrong)} frames show the picture of the row {name} theirs, the first is '
                   f'{wrong[0]}')
