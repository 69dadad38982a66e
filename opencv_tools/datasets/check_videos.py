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

"""Check of the videos of a LeRobot data set: frames, times, pictures, and depth in metres."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.datasets.depth import depth_points, DepthCodes, millimetres
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.lerobot import INFO
from opencv_tools.datasets.merge import FINGERPRINTS
from opencv_tools.datasets.part import FINGERPRINT
from opencv_tools.datasets.pictures import fingerprint
from opencv_tools.datasets.plan import IMAGES
from opencv_tools.datasets.set_reader import MAX_TIME_ERROR, SetReader, values_of
from opencv_tools.datasets.videos import (
    frame_codes, frame_luma, frame_step, video_frames)

_MAX_LEVELS = 12.0  # largest difference of the small pictures of a frame, on average
_MAX_CODES = 0.5  # the same of depth, which has no losses
_ROUNDING = 1.01  # of numbers with 32 bits
_CLEAR_LEVELS = 2.0  # by which two rows must differ, because H.264 rounds the levels
# Largest error of a part of the small pictures, in steps of the quantisation of a pixel; blocks
# of more pixels have a smaller error.
_MAX_STEPS, _BLOCK_SIDE = 0.6, 4
_SHIFT_LEVELS = 0.5  # by which the picture of another row must fit better


class DepthFrames:
    """The frames of the videos of a depth camera, read back in metres."""

    def __init__(self, codes: DepthCodes) -> None:
        self._codes = codes
        self._counts = np.zeros(codes.last + 1, np.int64)
        self._error: float | None = None

    def points(self, frame: Any) -> NDArray[np.uint16]:
        """Count the codes of a frame; return 64 of them."""
        codes = np.minimum(frame_codes(frame), self._codes.last)
        self._counts += np.bincount(codes.ravel(), minlength=len(self._counts))
        return depth_points(codes)

    def expected(self, depth: NDArray[np.float32], seen: NDArray[np.uint16],
                 ) -> NDArray[np.uint16]:
        """Return the codes of the depths that the bag had; note the errors of those there are."""
        error = float(self._codes.errors(depth, seen).max())
        self._error = max(error, self._error or 0.0)
        return self._codes.codes(depth)

    @property
    def problem(self) -> str:
        """Sentence about an error above what the steps allow; '' without one."""
        allowed = self._codes.largest_error
        return '' if (self._error or 0.0) <= _ROUNDING * allowed else (
            f'its depths differ from those of the bag by up to {millimetres(self._error or 0)}, '
            f'but the steps of {INFO} allow {millimetres(allowed)}')

    @property
    def description(self) -> str:
        """Depths of all frames in metres, and their largest error."""
        metres, used = self._codes.metres, np.flatnonzero(self._counts[1:]) + 1
        steps = millimetres(self._codes.largest_error)
        return (f'depth of {metres[used[0]]:.3f} to {metres[used[-1]]:.3f} m' if len(used) else
                'no depth') + (
            f', {self._counts[0]} of {self._counts.sum()} pixels without; ' + (
                f'its steps allow errors of {steps}' if self._error is None else
                f'the largest error of quantisation is {millimetres(self._error)} at 64 points '
                f'of each row, and the steps allow {steps}'))


def video_problems(reader: SetReader, episodes: list[dict[str, Any]],
                   depths: dict[str, DepthFrames] | None = None) -> Iterator[str]:
    """
    Yield what is wrong with the videos.

    :param depths: dictionary to which the frames of depth are added by the name of the feature.
    :raises DatasetError: a file cannot be read.
    """
    for key in reader.video_keys:
        try:
            codes = DepthCodes.of_feature(reader.features[key])
        except DatasetError as err:
            yield f'{INFO}, {printable(key)}: {err}'
            continue
        wrong = _wrong_facts(reader.features[key], bool(codes), has_fingerprints(reader))
        yield from (f'{INFO}, {printable(key)}: it has {text}' for text in wrong)
        if wrong:
            continue
        depth = DepthFrames(codes) if codes else None
        if depth and depths is not None:
            depths[key] = depth
        prints = _fingerprints(reader, key, episodes[-1]['dataset_to_index'],
                               np.float32 if depth else np.uint8)
        columns = [f'videos/{key}/{name}' for name in ('chunk_index', 'file_index')]
        for (chunk, number), rows in groupby(episodes, itemgetter(*columns)):
            path = reader.file_path('video_path', chunk, number, key)
            shown = printable(path.relative_to(reader.folder))
            try:
                yield from (f'{shown}: {problem}' for problem in _file_problems(
                    reader, key, path, list(rows), prints, depth))
            except DatasetError as err:
                yield f'{shown}: {err}'


def _wrong_facts(feature: dict[str, Any], is_depth: bool, is_ours: bool) -> list[str]:
    """Return which facts of a feature contradict each other."""
    info, (height, width, channels) = _info_of(feature), feature['shape']
    expected = {'height': height, 'width': width, 'channels': channels}
    wrong = [f'video.{name} {printable(info[f"video.{name}"])}, but the shape {feature["shape"]}'
             for name, size in expected.items() if info.get(f'video.{name}', size) != size]
    if channels != (1 if is_depth else 3):
        wrong.append(f'{channels} channels, but is_depth_map {str(is_depth).lower()}')
    if is_depth and is_ours and info.get('depth_unit', 'm') != 'm':
        wrong.append(f'depth_unit {info["depth_unit"]}, but statistics in m')
    return wrong


def _info_of(feature: dict[str, Any]) -> dict[str, Any]:
    info = feature.get('info')
    return info if isinstance(info, dict) else {}


def has_fingerprints(reader: SetReader) -> bool:
    """Return whether the pictures of a set can be compared with those of the bags."""
    return (reader.folder / FINGERPRINTS).is_file()


def _fingerprints(reader: SetReader, key: str, rows: int, kind: type[np.generic],
                  ) -> NDArray[Any] | None:
    """Return the small picture of each row as the bag had it, (n, 64); None if unknown."""
    size = 64 * np.dtype(kind).itemsize
    if not has_fingerprints(reader):
        return None
    column = FINGERPRINT + key.removeprefix(IMAGES)
    found: list[bytes] = []
    for table in reader.tables(reader.folder / FINGERPRINTS, [column]):
        found += values_of(table, column)
    if len(found) != rows or not all(isinstance(one, bytes) and len(one) == size for one in found):
        raise DatasetError(f'{FINGERPRINTS} has {len(found)} pictures of {printable(key)}, but '
                           f'there are {rows} rows')
    return np.frombuffer(b''.join(found), kind).reshape(rows, -1)


def _file_problems(reader: SetReader, key: str, path: Any, episodes: list[dict[str, Any]],
                   prints: NDArray[Any] | None, depth: DepthFrames | None) -> Iterator[str]:
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
    seen: list[NDArray[Any]] = []
    steps: list[float] = []
    height, width, *_ = reader.features[key]['shape']
    for time, frame in video_frames(path):
        if (frame.width, frame.height) != (width, height):
            yield f'frame {count} has {frame.width}x{frame.height} pixels, not {width}x{height}'
            return
        late += abs(float(time) - count / reader.fps) > MAX_TIME_ERROR
        count += 1
        points = depth.points(frame) if depth else None
        if not depth:
            reader.on_frame(key, frame)
        if prints is not None and count <= expected:
            seen.append(fingerprint(frame_luma(frame)) if points is None else points)
            steps.append(0.0 if depth else frame_step(frame))
    if late:
        yield f'{late} frames are not at k / {reader.fps} s'
    if count != expected:
        yield f'it has {count} frames, but its episodes have {expected} rows'
    elif prints is not None:
        first = episodes[0]['dataset_from_index']
        if first > len(prints) - expected:
            yield f'its {expected} rows begin at row {first}, but there are {len(prints)} rows'
        else:
            found, wanted = np.array(seen), prints[first:first + expected]
            side = min(max(1.0, (height * width / wanted.shape[1]) ** 0.5), _BLOCK_SIDE)
            unclear = yield from _picture_problems(
                found, depth.expected(wanted, found) if depth else wanted,
                _MAX_CODES if depth else _MAX_LEVELS, np.array(steps) * _MAX_STEPS / side)
            if unclear:
                reader.notes.append(
                    f'{printable(key)}: cannot tell whether {unclear} of {count} rows are shifted,'
                    ' because the codec changes them by more than the next row differs')
            if depth and depth.problem:
                yield depth.problem


def _picture_problems(seen: NDArray[Any], expected: NDArray[Any], limit: float,
                      explained: NDArray[np.float64]) -> Generator[str, None, int]:
    """
    Yield which frames do not show the pictures of the bag, or show those of another row.

    :param explained: error of each frame that its quantisation explains.
    :returns: number of rows that differ from both next ones by less than the error of the codec.
    """
    errors = np.abs(seen.astype(int) - expected).mean(axis=1)
    bad = np.flatnonzero(errors > np.maximum(limit, explained))
    if len(bad):
        yield f'{len(bad)} frames differ from the pictures of the bag, the first is {bad[0]}'
    unclear = np.full(len(errors), limit > 1)  # codes have no losses
    for shift, name in ((-1, 'after'), (1, 'before')):
        moved = np.abs(seen.astype(int) - np.roll(expected, shift, axis=0)).mean(axis=1)
        moved[-1 if shift < 0 else 0] = np.inf
        steps = np.abs(expected - np.roll(expected.astype(int), shift, axis=0)).mean(axis=1)
        is_clear = steps > np.maximum(explained, max(
            _CLEAR_LEVELS, _SHIFT_LEVELS + np.median(np.minimum(errors, moved))))
        unclear &= ~is_clear
        wrong = np.flatnonzero((moved + _SHIFT_LEVELS < errors) & is_clear)
        if len(wrong):
            yield (f'{len(wrong)} frames show the picture of the row {name} theirs, the first is '
                   f'{wrong[0]}')
    return int(np.count_nonzero(unclear))
