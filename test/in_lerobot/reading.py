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

"""LeRobot, which decodes videos with PyAV."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from lerobot.datasets import streaming_dataset
from lerobot.datasets.aggregate import aggregate_datasets
from lerobot.datasets.compute_stats import (
    aggregate_stats, compute_episode_stats, get_feature_stats, sample_images)
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.streaming_dataset import StreamingLeRobotDataset
from lerobot.datasets.video_utils import decode_video_frames_pyav
import numpy as np
import torch

__all__ = ['CAMERAS', 'FOLDER', 'LeRobotDataset', 'StreamingLeRobotDataset',
           'aggregate_datasets', 'aggregate_stats', 'compute_episode_stats', 'expected',
           'get_feature_stats', 'load', 'number_of', 'sample_images']

FOLDER = Path(os.environ['OPENCV_TOOLS_LEROBOT'])
CAMERAS = ('observation.images.front', 'observation.images.wrist')
_BITS, _CELL = 16, 16


def _decode(path: str, times: list[float], tolerance: float, **_: Any) -> torch.Tensor:
    return decode_video_frames_pyav(path, times, tolerance)


# torchcodec, the decoder of colours of this class, needs the libraries of FFmpeg.
streaming_dataset.decode_video_frames_torchcodec = _decode


def load(name: str, **options: Any) -> LeRobotDataset:
    """Load a set by LeRobot."""
    return LeRobotDataset(f'opencv_tools/{name}', root=FOLDER / name, video_backend='pyav',
                          **options)


def expected(name: str) -> list[dict[str, Any]]:
    """Return what the rows of a set must have."""
    return [row for rows in json.loads((FOLDER / f'{name}.json').read_text()) for row in rows]


def number_of(image: torch.Tensor) -> int:
    """Return the number that is drawn into a picture, of shape (3, h, w) and from 0 to 1."""
    gray = np.asarray(image).mean(axis=0)
    middle = _CELL // 2
    return sum(1 << bit for bit in range(_BITS) if gray[
        bit // 4 * _CELL + middle, bit % 4 * _CELL + middle] > 0.5)
