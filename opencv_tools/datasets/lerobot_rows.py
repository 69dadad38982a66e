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

"""The rows and videos of a bag for a LeRobot data set."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from opencv_tools.datasets.camera_video import Camera, Work, write_video
from opencv_tools.datasets.lerobot import import_pyarrow, plan_features, rows_table
from opencv_tools.datasets.part import FINGERPRINT, ROWS
from opencv_tools.datasets.plan import IMAGES, Plan, STAMPS
from opencv_tools.datasets.row_values import (
    row_numbers, row_stamps, row_vectors, shortened, shown_rows)
from opencv_tools.datasets.rows import Rows
from opencv_tools.datasets.statistics import numbers_statistics
from opencv_tools.datasets.tracks import Recording


def write_rows(plan: Plan, recording: Recording, episodes: list[Rows], folder: Path, threads: int,
               ) -> tuple[dict[str, Any], list[Rows]]:
    """
    Write the rows and the videos of a bag.

    :param episodes: all rows; with ``next_action`` the last one of each is only an action.
    :param folder: folder of the part.
    :param threads: threads for decoding and encoding.
    :returns: what part.json says of them, and the rows with the samples that are shown.
    :raises DatasetError: a picture or a number cannot be used.
    :raises OSError: a file cannot be written.
    """
    wanted = shortened(plan, episodes)
    cameras = _write_videos(plan, recording, wanted, folder, threads)
    kept = shown_rows(wanted, {name: camera.samples for name, camera in cameras.items()},
                      recording.warnings)
    features = plan_features(plan, {
        name: camera.size for name, camera in cameras.items()})
    pa = import_pyarrow()
    vectors = row_vectors(plan, recording, episodes)
    tables, described = [], []
    begin = 0
    for number, rows in enumerate(kept):
        count = len(rows.times)
        columns = {**{key: values[number].astype(np.float32)
                      for key, values in vectors.items()},
                   **row_numbers(rows, number, plan.fps),
                   STAMPS: row_stamps(recording, rows)}
        statistics = {key: numbers_statistics(values.reshape(count, -1))
                      for key, values in columns.items()}
        statistics |= {IMAGES + name: camera.statistics[number]
                       for name, camera in cameras.items()}
        as_lists = {key: {name: value.tolist() for name, value in found.items()}
                    for key, found in statistics.items()}
        described.append({'length': count, 'task': rows.task or plan.task,
                          'statistics': as_lists})
        table = rows_table(columns, features)
        for name, camera in cameras.items():
            prints = camera.fingerprints[begin:begin + count]
            table = table.append_column(FINGERPRINT + name, pa.array(
                [one.tobytes() for one in prints], pa.binary(prints.shape[1])))
        tables.append(table)
        begin += count
    pa.parquet.write_table(pa.concat_tables(tables), folder / ROWS)
    return {'features': features, 'episodes': described}, kept


def _write_videos(plan: Plan, recording: Recording, episodes: list[Rows], folder: Path,
                  threads: int) -> dict[str, Camera]:
    names = [name for name, _ in plan.images]
    work = Work(plan, recording, episodes, folder, threads, Event())
    with ThreadPoolExecutor(max(1, min(threads, len(names)))) as pool:
        try:
            return dict(zip(names, pool.map(partial(write_video, work), names)))
        finally:
            work.ended.set()  # after an error or Ctrl-C nobody waits for the others
