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
Conversion of one bag to a part of a data set: its rows and its videos.

``convert_bag`` depends only on its arguments, so bags can be converted in any order on any
machine. ``merge`` joins the parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
import json
import os
from pathlib import Path
import shutil
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.datasets.depth import codes_of, DepthImages
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.lerobot import import_pyarrow, plan_features, rows_table
from opencv_tools.datasets.part import bag_state, FINGERPRINT, is_done, PART, ROWS
from opencv_tools.datasets.pictures import fingerprint, luma, row_pictures, with_rows
from opencv_tools.datasets.plan import IMAGES, LEROBOT, Plan, STAMPS
from opencv_tools.datasets.row_values import (
    row_numbers, row_stamps, row_vectors, shortened, shown_rows, topic_accounts, unused_topics)
from opencv_tools.datasets.rows import Rows
from opencv_tools.datasets.sample_files import write_samples
from opencv_tools.datasets.statistics import (
    ImageStatistics, numbers_statistics, sampled_rows, Statistics)
from opencv_tools.datasets.tracks import open_bag, read_recording, Recording
from opencv_tools.datasets.videos import VideoFileWriter


@dataclass(frozen=True)
class WrittenCamera:
    """
    The frames of a camera that were written.

    :param size: width and height in pixels.
    :param samples: (n,) number of the sample that each row shows.
    :param fingerprints: (n, 64) small picture of each row, (n, 256) of depth.
    :param statistics: statistics of each episode.
    :param depth: account of the pixels of depth; empty for colours.
    :param warnings: sentences about pixels that are out of the range.
    """

    size: tuple[int, int]
    samples: NDArray[np.int64]
    fingerprints: NDArray[np.uint8]
    statistics: list[Statistics]
    depth: dict[str, float]
    warnings: list[str]


@dataclass(frozen=True)
class Work:
    """
    What the videos of a bag have in common.

    :param recording: samples of the bag, which several threads may read at the same time.
    :param episodes: rows of each episode.
    :param folder: folder of the videos, which have the names of the cameras.
    :param threads: threads of each encoder.
    :param ended: set when the videos are not needed any more.
    """

    plan: Plan
    recording: Recording
    episodes: Sequence[Rows]
    folder: Path
    threads: int
    ended: Event


def write_video(work: Work, name: str) -> WrittenCamera:
    """
    Write the video of a camera, with all episodes one after the other.

    :raises DatasetError: a picture cannot be used.
    :raises OSError: the file cannot be written.
    """
    plan, episodes = work.plan, work.episodes
    pictures = row_pictures(plan, work.recording, name, episodes)
    shown: list[int] = []
    prints: list[NDArray[np.uint8]] = []
    statistics: list[Statistics] = []
    size = (0, 0)
    codes = codes_of(plan)
    depth = DepthImages(name, codes) if name in plan.depth else None
    writer = VideoFileWriter(work.folder / f'{name}.mp4', plan.fps, plan.crf, work.threads,
                             is_depth=depth is not None)
    try:
        for rows in episodes:
            episode = ImageStatistics(codes.metres if depth else None)
            counted = {*sampled_rows(len(rows.times)).tolist()}
            for row in range(len(rows.times)):
                if work.ended.is_set():
                    raise DatasetError('the conversion has ended')
                sample, picture = next(pictures)
                image: Any = depth.read(picture) if depth else picture.image
                size = picture.size
                is_new = not shown or sample != shown[-1]
                prints.append((depth.points if depth else fingerprint(luma(image)))
                              if is_new else prints[-1])
                if row in counted:
                    episode.add(image)
                writer.write(sample, image, is_first=not row)
                shown.append(sample)
            statistics.append(episode.statistics())
        writer.close()
    except BaseException:
        writer.abandon()
        raise
    finally:
        pictures.close()
    return WrittenCamera(size, np.array(shown), np.array(prints), statistics,
                         depth.account if depth else {}, depth.warnings if depth else [])


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
    recording.warnings.extend(text for one in cameras.values() for text in one.warnings)
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
    depth = {name: camera.depth for name, camera in cameras.items() if camera.depth}
    return {'features': features, 'episodes': described, 'depth': depth}, kept


def _write_videos(plan: Plan, recording: Recording, episodes: list[Rows], folder: Path,
                  threads: int) -> dict[str, WrittenCamera]:
    names = [name for name, _ in plan.images]
    work = Work(plan, recording, episodes, folder, threads, Event())
    with ThreadPoolExecutor(max(1, min(threads, len(names)))) as pool:
        try:
            return dict(zip(names, pool.map(partial(write_video, work), names)))
        finally:
            work.ended.set()  # after an error or Ctrl-C nobody waits for the others


def convert_bag(path: str, plan: Plan, folder: str, name: str, threads: int = 1,
                files: Sequence[Path] = ()) -> None:
    """
    Convert a bag to a part.

    :param plan: plan with the names of all numbers.
    :param folder: folder of the part, which does not exist; it is complete when it appears.
    :param threads: threads for decoding and encoding.
    :param files: files of a recording that was split; empty for those of the path.
    :raises DatasetError: the bag cannot be converted by the plan.
    :raises OSError: a file cannot be read or written.
    """
    target, state = Path(folder), bag_state(Path(path), files)
    if is_done(target, plan, state):
        return
    recording = read_recording(open_bag(Path(path), files), plan)
    target.parent.mkdir(parents=True, exist_ok=True)
    work = target.with_name(f'.{target.name}.{os.urandom(6).hex()}')
    work.mkdir()
    try:
        recording, episodes, (described, kept) = with_rows(
            plan, recording, name, lambda used, rows: (
                write_rows(plan, used, rows, work, threads) if plan.format == LEROBOT else
                write_samples(plan, used, rows, work, name)))
        text = json.dumps({
            'bag': name, 'state': state, 'plan': plan.digest, 'fps': plan.fps,
            'robot_type': plan.robot_type, 'format': plan.format, 'warnings': recording.warnings,
            'topics': topic_accounts(recording, shortened(plan, episodes), kept),
            'unused': unused_topics(recording, plan), **described})
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
