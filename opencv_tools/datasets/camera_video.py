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

"""The video of a camera of a bag, with what is known only after its pictures are decoded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.pictures import fingerprint, luma, row_pictures
from opencv_tools.datasets.plan import Plan
from opencv_tools.datasets.rows import Rows
from opencv_tools.datasets.statistics import ImageStatistics, sampled_rows, Statistics
from opencv_tools.datasets.tracks import Recording
from opencv_tools.datasets.videos import VideoFileWriter


@dataclass(frozen=True)
class Camera:
    """
    The frames of a camera that were written.

    :param size: width and height in pixels.
    :param samples: (n,) number of the sample that each row shows.
    :param fingerprints: (n, 64) small picture of each row.
    :param statistics: statistics of each episode.
    """

    size: tuple[int, int]
    samples: NDArray[np.int64]
    fingerprints: NDArray[np.uint8]
    statistics: list[Statistics]


@dataclass(frozen=True)
class Work:
    """
    What the videos of a bag have in common.

    :param plan: plan of the conversion.
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


def write_video(work: Work, name: str) -> Camera:
    """
    Write the video of a camera, with all episodes one after the other.

    :param name: name of the camera.
    :raises DatasetError: a picture cannot be used.
    :raises OSError: the file cannot be written.
    """
    plan, episodes = work.plan, work.episodes
    pictures = row_pictures(plan, work.recording, name, episodes)
    shown: list[int] = []
    prints: list[NDArray[np.uint8]] = []
    statistics: list[Statistics] = []
    size = (0, 0)
    writer = VideoFileWriter(work.folder / f'{name}.mp4', plan.fps, plan.crf, work.threads)
    try:
        for rows in episodes:
            episode, counted = ImageStatistics(), {*sampled_rows(len(rows.times)).tolist()}
            for row in range(len(rows.times)):
                if work.ended.is_set():
                    raise DatasetError('the conversion has ended')
                sample, picture = next(pictures)
                image: Any = picture.image
                size = picture.size
                is_new = not shown or sample != shown[-1]
                prints.append(fingerprint(luma(image)) if is_new else prints[-1])
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
    return Camera(size, np.array(shown), np.array(prints), statistics)
