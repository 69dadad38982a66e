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
A part of a data set: what one bag becomes, in a folder that is complete or absent.

``convert_bag`` depends only on its arguments, so bags can be converted in any order on any
machine. ``merge`` joins the parts.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
import json
import os
from pathlib import Path
import shutil
from threading import Event
from typing import Any

import numpy as np
from opencv_tools.bags.bag import Bag
from opencv_tools.datasets.camera_video import Camera, Work, write_video
from opencv_tools.datasets.episodes import episodes_of
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.lerobot import import_pyarrow, plan_features, rows_table
from opencv_tools.datasets.plan import FORMATS, IMAGES, LEROBOT, Plan, STAMPS
from opencv_tools.datasets.row_values import (
    row_numbers, row_stamps, row_vectors, shortened, shown_rows)
from opencv_tools.datasets.rows import match, Rows
from opencv_tools.datasets.statistics import numbers_statistics
from opencv_tools.datasets.tracks import open_bag, read_recording, Recording
from opencv_tools.image.text import MAX_PATH, printable
from opencv_tools.regular_files import read_regular

PART, ROWS = 'part.json', 'rows.parquet'
FINGERPRINT = 'fingerprint.'
_MAX_PART = 1 << 28  # bytes of part.json
_KINDS = {'bag': str, 'plan': str, 'state': list, 'fps': int, 'robot_type': str, 'format': str,
          'warnings': list, 'topics': dict, 'features': dict, 'episodes': list}


def bag_state(path: Path) -> list[list[Any]]:
    """
    Return names, sizes and times of the files of a bag, by which a changed bag is recognised.

    :raises OSError: a file cannot be read.
    """
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return [[file.name, status.st_size, status.st_mtime_ns]
            for file in files for status in (file.stat(),)]


def convert_bag(path: str, plan: Plan, folder: str, name: str, threads: int = 1) -> None:
    """
    Convert a bag to a part.

    :param path: path of the bag.
    :param plan: plan with the names of all numbers.
    :param folder: folder of the part, which does not exist; it is complete when it appears.
    :param name: name of the bag in the data set.
    :param threads: threads for decoding and encoding.
    :raises DatasetError: the bag cannot be converted by the plan.
    :raises OSError: a file cannot be read or written.
    """
    target, state = Path(folder), bag_state(Path(path))
    if is_done(target, plan, state):
        return
    bag = open_bag(Path(path))
    recording = read_recording(bag, plan)
    episodes = episodes_of(recording, plan, name)
    target.parent.mkdir(parents=True, exist_ok=True)
    work = target.with_name(f'.{target.name}.{os.urandom(6).hex()}')
    work.mkdir()
    try:
        if plan.format == LEROBOT:
            content = _Content(plan, bag, recording, episodes, work, threads)
            described, kept = content.write_lerobot(), content.episodes
        else:
            from opencv_tools.datasets.sample_files import write_samples
            described, kept = write_samples(plan, bag, recording, episodes, work, name)
        text = json.dumps({
            'bag': name, 'state': state, 'plan': plan.digest, 'fps': plan.fps,
            'robot_type': plan.robot_type, 'format': plan.format, 'warnings': recording.warnings,
            'topics': {key: asdict(match(track.times, kept, key))
                       for key, track in recording.tracks.items()}, **described})
        (work / PART).write_text(text)
        _publish(work, target, plan, state)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _publish(work: Path, target: Path, plan: Plan, state: list[list[Any]]) -> None:
    """Rename a complete part; another process may have written the same one meanwhile."""
    try:
        if target.is_dir() and not is_done(target, plan, state):
            shutil.rmtree(target)  # of another plan, or of a bag that has changed
        work.rename(target)
    except OSError:
        if not is_done(target, plan, state):
            raise


def is_done(folder: Path, plan: Plan, state: list[list[Any]]) -> bool:
    """Return whether a folder is the part of a bag that has not changed since."""
    try:
        described = read_part(folder)
    except DatasetError:
        return False
    return described['plan'] == plan.digest and described['state'] == state


class _Content:
    """A part while it is written."""

    def __init__(self, plan: Plan, bag: Bag, recording: Recording, episodes: list[Rows],
                 folder: Path, threads: int) -> None:
        self._plan, self._bag, self._recording = plan, bag, recording
        self.episodes = shortened(plan, episodes)
        self._whole = episodes  # with the last state, which is only an action
        self._folder, self._threads = folder, threads

    def write_lerobot(self) -> dict[str, Any]:
        """Write the rows and the videos; return what part.json says of them."""
        cameras = self._write_videos()
        self.episodes = shown_rows(
            self.episodes, {name: camera.samples for name, camera in cameras.items()},
            self._recording.warnings)
        features = plan_features(self._plan, {
            name: camera.size for name, camera in cameras.items()})
        pa = import_pyarrow()
        vectors = row_vectors(self._plan, self._recording, self._whole)
        tables, described = [], []
        begin = 0
        for number, rows in enumerate(self.episodes):
            count = len(rows.times)
            columns = {**{key: values[number].astype(np.float32)
                          for key, values in vectors.items()},
                       **row_numbers(rows, number, self._plan.fps),
                       STAMPS: row_stamps(self._recording, rows)}
            statistics = {key: numbers_statistics(values.reshape(count, -1))
                          for key, values in columns.items()}
            statistics |= {IMAGES + name: camera.statistics[number]
                           for name, camera in cameras.items()}
            as_lists = {key: {name: value.tolist() for name, value in found.items()}
                        for key, found in statistics.items()}
            described.append({'length': count, 'task': rows.task or self._plan.task,
                              'statistics': as_lists})
            table = rows_table(columns, features)
            for name, camera in cameras.items():
                prints = camera.fingerprints[begin:begin + count]
                table = table.append_column(FINGERPRINT + name, pa.array(
                    [one.tobytes() for one in prints], pa.binary(prints.shape[1])))
            tables.append(table)
            begin += count
        pa.parquet.write_table(pa.concat_tables(tables), self._folder / ROWS)
        return {'features': features, 'episodes': described}

    def _write_videos(self) -> dict[str, Camera]:
        names = [name for name, _ in self._plan.images]
        work = Work(self._plan, self._bag, self.episodes, self._folder, self._threads, Event())
        with ThreadPoolExecutor(max(1, min(self._threads, len(names)))) as pool:
            try:
                return dict(zip(names, pool.map(lambda name: write_video(
                    work, name, self._recording.tracks[name]), names)))
            finally:
                work.ended.set()  # after an error or Ctrl-C nobody waits for the others


def read_part(folder: Path) -> dict[str, Any]:
    """
    Read the description of a part.

    :raises DatasetError: the folder is no part.
    """
    try:
        content: dict[str, Any] = json.loads(read_regular(folder / PART, _MAX_PART))
        wrong = [name for name, kind in _KINDS.items() if not isinstance(content[name], kind)]
        if wrong or content['format'] not in FORMATS:
            raise DatasetError(f'{PART} has no valid {(wrong or ["format"])[0]}')
        if not content['episodes'] or not all(
                isinstance(one['length'], int) and isinstance(one['task'], str)
                for one in content['episodes']):
            raise DatasetError(f'{PART} has no valid episodes')
    except (OSError, ValueError, TypeError, LookupError, RecursionError) as err:
        reason = printable(getattr(err, 'strerror', None) or err)
        raise DatasetError(f'{printable(folder, MAX_PATH)} is no part of a data set: {reason}'
                           ) from err
    return content
