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
The format of LeRobot data sets, version 3.0: features, tables and metadata.

Source: ``datasets/utils.py``, ``dataset_writer.py`` and ``dataset_metadata.py`` of LeRobot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import json
from typing import Any

import numpy as np
from opencv_tools.base.remedies import installation
from opencv_tools.datasets.depth import codes_of
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.plan import ACTION, IMAGES, Plan, STAMPS
from opencv_tools.datasets.statistics import Statistics
from opencv_tools.datasets.videos import (
    CODEC, DEPTH_CODEC, DEPTH_PIXELS, KEY_INTERVAL, LOSSLESS, PIXELS, PRESET)

VERSION = 'v3.0'
INFO, STATS, TASKS = 'meta/info.json', 'meta/stats.json', 'meta/tasks.parquet'
_FILE = 'chunk-{chunk_index:03d}/file-{file_index:03d}'
EPISODES_PATH = f'meta/episodes/{_FILE}.parquet'
DATA_PATH = f'data/{_FILE}.parquet'
VIDEO_PATH = f'videos/{{video_key}}/{_FILE}.mp4'
CHUNK_FILES = 1000
DATA_MEGABYTES, VIDEO_MEGABYTES = 100, 200
#: Columns that every data set has, and their types.
DEFAULT_TYPES = {'timestamp': 'float32', 'frame_index': 'int64', 'episode_index': 'int64',
                 'index': 'int64', 'task_index': 'int64'}

Features = dict[str, dict[str, Any]]


def import_pyarrow() -> Any:
    """
    Import pyarrow, which is optional and slow to import.

    :raises DatasetError: it is not installed; the message includes the remedy.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as err:
        raise DatasetError(f'data sets need pyarrow, which cannot be imported ({err}); '
                           f'{installation("pyarrow")}') from err
    return pyarrow


def plan_features(plan: Plan, sizes: Mapping[str, tuple[int, int]]) -> Features:
    """
    Return the features of a data set.

    :param plan: plan with the names of all numbers.
    :param sizes: width and height of the pictures of each camera.
    """
    features: Features = {}
    for key, sources in plan.vectors:
        names = [name if len(sources) == 1 else f'{source}.{name}'
                 for source in sources for name in source.names]
        features[key] = {'dtype': 'float32', 'shape': [len(names)], 'names': names}
    if plan.next_action:
        features[ACTION] = dict(features['observation.state'])
    for name, (width, height) in sizes.items():
        is_even, is_depth = not (width % 2 or height % 2), name in plan.depth
        channels = 1 if is_depth else 3
        settings = {
            'video.codec': DEPTH_CODEC, 'video.pix_fmt': DEPTH_PIXELS, 'depth_unit': 'm',
            'video.extra_options': {'x265-params': LOSSLESS}, **codes_of(plan).info,
        } if is_depth else {'video.codec': CODEC, 'video.crf': plan.crf,
                            'video.pix_fmt': PIXELS if is_even else 'yuv444p'}
        features[IMAGES + name] = {
            'dtype': 'video', 'shape': [height, width, channels],
            'names': ['height', 'width', 'channels'],
            'info': {'video.height': height, 'video.width': width, 'video.fps': plan.fps,
                     'video.channels': channels, 'video.g': KEY_INTERVAL, 'video.preset': PRESET,
                     **settings, 'is_depth_map': is_depth, 'has_audio': False}}
    names = [name for name, _ in plan.images] + [str(source) for source in plan.sources]
    features[STAMPS] = {'dtype': 'int64', 'shape': [len(names)], 'names': names}
    for name, kind in DEFAULT_TYPES.items():
        features[name] = {'dtype': kind, 'shape': [1], 'names': None}
    return features


def row_columns(features: Features) -> list[str]:
    """Return the features that are columns of the rows, in their order: all but videos."""
    return [key for key, feature in features.items() if feature['dtype'] != 'video']


def rows_table(columns: Mapping[str, np.ndarray[Any, Any]], features: Features) -> Any:
    """
    Return a table of Arrow with the rows of an episode, as LeRobot writes it.

    :param columns: (n,) or (n, d) values of each feature that is no video.
    :raises DatasetError: pyarrow is missing.
    """
    pa = import_pyarrow()
    arrays, fields, described = [], [], {}
    for key in row_columns(features):
        size, kind = features[key]['shape'][0], features[key]['dtype']
        value_type = pa.from_numpy_dtype(np.dtype(kind))
        values = np.ascontiguousarray(columns[key], kind)
        flat = pa.array(values.ravel(), value_type)
        value = {'dtype': kind, '_type': 'Value'}
        if size == 1:
            arrays.append(flat)
            described[key] = value
        else:
            arrays.append(pa.FixedSizeListArray.from_arrays(flat, size))
            described[key] = {'feature': value, 'length': size, '_type': 'Sequence'}
        fields.append(pa.field(key, arrays[-1].type))
    described_text = json.dumps({'info': {'features': described}})
    return pa.Table.from_arrays(arrays, schema=pa.schema(
        fields, metadata={'huggingface': described_text}))


def tasks_table(tasks: Sequence[str]) -> Any:
    """Return the table of the tasks, whose text is the index of pandas."""
    pa = import_pyarrow()
    kinds = (('task_index', 'int64', 'int64'), ('task', 'unicode', 'object'))
    pandas = {'index_columns': ['task'], 'column_indexes': [], 'pandas_version': '2.2.3',
              'columns': [{'name': name, 'field_name': name, 'pandas_type': kind,
                           'numpy_type': numpy, 'metadata': None} for name, kind, numpy in kinds]}
    return pa.table({'task_index': pa.array(range(len(tasks)), pa.int64()),
                     'task': pa.array(tasks, pa.string())}).replace_schema_metadata(
                         {'pandas': json.dumps(pandas)})


def info(plan: Mapping[str, Any], features: Features, episodes: int, frames: int, tasks: int,
         ) -> dict[str, Any]:
    """
    Return the content of ``meta/info.json``.

    :param plan: ``fps`` and ``robot_type``.
    """
    has_videos = any(feature['dtype'] == 'video' for feature in features.values())
    return {
        'codebase_version': VERSION, 'robot_type': plan['robot_type'] or None,
        'total_episodes': episodes, 'total_frames': frames, 'total_tasks': tasks,
        'chunks_size': CHUNK_FILES, 'data_files_size_in_mb': DATA_MEGABYTES,
        'video_files_size_in_mb': VIDEO_MEGABYTES, 'fps': plan['fps'],
        'splits': {'train': f'0:{episodes}'}, 'data_path': DATA_PATH,
        'video_path': VIDEO_PATH if has_videos else None, 'features': features}


def flat_statistics(statistics: Mapping[str, Statistics]) -> dict[str, Any]:
    """Return the columns of the statistics in a row of the table of episodes."""
    return {f'stats/{key}/{name}': value.tolist()
            for key, found in statistics.items() for name, value in found.items()}
