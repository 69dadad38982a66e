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

"""Files of a LeRobot data set, of this package or any other; none of them is trusted."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
import json
import math
import os
from pathlib import Path
import re
from typing import Any, TypeGuard

from opencv_tools.base.regular_files import open_regular, read_regular
from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.datasets.errors import DatasetError, reason_of
from opencv_tools.datasets.lerobot import DEFAULT_TYPES, import_pyarrow, INFO

#: Largest difference of times in seconds, as in LeRobot.
MAX_TIME_ERROR = 1e-4
_MAX_JSON = 1 << 28  # bytes
_MAX_GROUP = 1 << 31  # bytes of a row group in memory
_MAX_ROWS = 1 << 40  # of a set
_MOST = 1 << 20  # numbers of a feature
_WIDTH = 8  # bytes of a number
_PLACE = re.compile(r'\{(video_key|chunk_index:03d|file_index:03d)\}')


class SetReader:
    """Reader of the files of a data set."""

    def __init__(self, folder: Path) -> None:
        """
        Read ``info.json``.

        :raises DatasetError: the folder is no data set of version 3.
        """
        self.folder = folder
        if not (folder / INFO).exists():
            raise DatasetError(f'{printable(folder, MAX_PATH)} is no LeRobot data set, which has '
                               f'{INFO}; only these are checked')
        self.info: dict[str, Any] = self.read_json(INFO)
        version = self.info.get('codebase_version')
        if not isinstance(version, str) or not version.startswith('v3.'):
            raise DatasetError(f'{INFO} has codebase_version {printable(version)}, not v3.0; '
                               'LeRobot converts older data sets')
        features = self.info.get('features')
        if not isinstance(features, dict):
            raise DatasetError(f'{INFO} has no object features')
        for name, feature in features.items():
            _check_feature(name, feature)
        for name, kind in DEFAULT_TYPES.items():
            found = features.get(name, {'dtype': 'missing', 'shape': [1]})
            if found['dtype'] != kind or found['shape'] != [1]:
                raise DatasetError(f'{INFO} has the feature {name} of {printable(found["dtype"])} '
                                   f'and {printable(found["shape"])}, not of {kind} and [1]')
        #: Features by name; each has a dtype and a valid shape.
        self.features: dict[str, dict[str, Any]] = features
        fps = self.info.get('fps')
        if not _is_integer(fps) or not 0 < fps <= 1000:
            raise DatasetError(f'{INFO} has fps {printable(fps)}, not an integer from 1 to 1000')
        #: Rows of a second.
        self.fps: int = fps
        #: Sentences about what cannot be checked.
        self.notes: list[str] = []
        #: Called with the feature and each frame of a video that belongs to a row, in order.
        self.on_frame: Callable[[str, Any], object] = lambda key, frame: None

    def read_json(self, name: str, kind: type = dict) -> Any:
        """
        Read a file of JSON.

        :param kind: type of its content, dict or list.
        :raises DatasetError: it is missing or invalid.
        """
        try:
            content = json.loads(read_regular(self.folder / name, _MAX_JSON))
        except (OSError, ValueError, RecursionError) as err:
            raise DatasetError(f'{name} cannot be read: {reason_of(err)}') from err
        if not isinstance(content, kind):
            raise DatasetError(f'{name} has no object of JSON')
        return content

    def file_path(self, template: str, chunk: int, number: int, key: str = '') -> Path:
        """
        Return the path of a file in the set.

        :param template: name in ``info.json``, such as ``data_path``.
        :raises DatasetError: the path is missing, or outside of the set.
        """
        text = self.info.get(template)
        values = {'video_key': key, 'chunk_index:03d': f'{chunk:03d}',
                  'file_index:03d': f'{number:03d}'}
        name = _PLACE.sub(lambda found: values[found[1]], text) if isinstance(text, str) else ''
        path = self.folder / name
        try:
            is_inside = path.resolve().is_relative_to(self.folder.resolve())
        except (OSError, RuntimeError, ValueError):  # such as a zero byte, or links in a circle
            is_inside = False
        if not name or '{' in name or not is_inside:
            raise DatasetError(f'{template} in {INFO} is {printable(text)}, which is not the path '
                               'of a file in the set')
        return path

    def tables(self, path: Path, columns: Collection[str] | None = None) -> Iterator[Any]:
        """
        Yield the row groups of a Parquet file.

        :param columns: names of the columns that are read; None for all.
        :raises DatasetError: the file cannot be read, has not each column once, or a row group is
            too large.
        """
        pa = import_pyarrow()
        shown = printable(path.relative_to(self.folder), MAX_PATH)
        try:
            with os.fdopen(open_regular(path), 'rb') as opened:
                file = pa.parquet.ParquetFile(opened)
                names = file.schema_arrow.names
                wanted = names if columns is None else [*columns]
                wrong = next((name for name in wanted if names.count(name) != 1), None)
                if wrong is not None:
                    raise DatasetError(f'{shown} has {names.count(wrong)} columns '
                                       f'{printable(wrong)}, not one')
                for number in range(file.num_row_groups):
                    _check_size(file.metadata.row_group(number), {*wanted}, shown)
                    yield file.read_row_group(number, wanted)
        except (OSError, ValueError, pa.ArrowException) as err:
            if isinstance(err, DatasetError):
                raise
            raise DatasetError(f'{shown} cannot be read: {reason_of(err)}') from err

    def episodes(self) -> list[dict[str, Any]]:
        """
        Return the numbers in the rows of the table of episodes, without statistics.

        :raises DatasetError: the table is missing or invalid.
        """
        integers = ['episode_index', 'length', 'dataset_from_index', 'dataset_to_index',
                    'data/chunk_index', 'data/file_index', *(
                        f'videos/{key}/{name}' for key in self.video_keys
                        for name in ('chunk_index', 'file_index'))]
        times = [f'videos/{key}/{name}' for key in self.video_keys
                 for name in ('from_timestamp', 'to_timestamp')]
        found: list[dict[str, Any]] = []
        for path in sorted((self.folder / 'meta/episodes').glob('chunk-*/file-*.parquet')):
            for table in self.tables(path, [*integers, *times]):
                columns = {name: values_of(table, name) for name in table.column_names}
                found += [dict(zip(columns, row)) for row in zip(*columns.values())]
        for row in found:
            wrong = [name for name in integers
                     if not _is_integer(row[name]) or not 0 <= row[name] < _MAX_ROWS]
            wrong += [name for name in times
                      if not isinstance(row[name], float) or not math.isfinite(row[name])]
            if wrong:
                raise DatasetError(f'the table of episodes has {printable(wrong[0])} '
                                   f'{printable(row[wrong[0]])}')
        if not found:
            raise DatasetError('meta/episodes has no episode')
        return found

    def episode_columns(self, prefix: str) -> dict[str, list[Any]]:
        """
        Return the columns of the table of episodes whose names begin with a text.

        :raises DatasetError: the table cannot be read.
        """
        found: dict[str, list[Any]] = {}
        for path in sorted((self.folder / 'meta/episodes').glob('chunk-*/file-*.parquet')):
            for table in self.tables(path):
                for name in table.column_names:
                    if name.startswith(prefix):
                        found.setdefault(name, []).extend(values_of(table, name))
        return found

    @property
    def video_keys(self) -> list[str]:
        """Names of the features that are videos."""
        return [key for key, one in self.features.items() if one['dtype'] == 'video']


def _is_integer(value: Any) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool)


def _check_feature(name: str, feature: Any) -> None:
    """
    Check that a feature has a dtype and a shape.

    :raises DatasetError: it has not.
    """
    is_object = isinstance(feature, dict)
    kind, shape = (feature.get('dtype'), feature.get('shape')) if is_object else (None, None)
    if not isinstance(kind, str) or not isinstance(shape, list) or not all(
            _is_integer(one) and 0 < one <= _MOST for one in shape):
        raise DatasetError(f'{INFO} has no valid dtype and shape of {printable(name)}')
    if kind == 'video' and len(shape) != 3:
        raise DatasetError(f'{INFO} has the shape {printable(shape)} of {printable(name)}, not '
                           'height, width and channels')
    if kind != 'video' and (len(shape) > 8 or math.prod(shape) > _MOST):
        raise DatasetError(f'{INFO} has a shape of more than {_MOST} numbers of {printable(name)}')


def _check_size(group: Any, columns: Collection[str], shown: str) -> None:
    """
    Check what a row group needs in memory, also if its bytes repeat few values.

    :raises DatasetError: it is too large.
    """
    size = 0
    for number in range(group.num_columns):
        column = group.column(number)
        if any(column.path_in_schema.startswith(name) for name in columns):
            size += max(column.total_uncompressed_size, column.num_values * _WIDTH)
    if size > _MAX_GROUP or group.num_rows * _WIDTH > _MAX_GROUP:
        raise DatasetError(f'{shown} has a row group of {size} bytes, at most {_MAX_GROUP} are '
                           'read')


def values_of(table: Any, name: str) -> list[Any]:
    """
    Return the values of a column.

    :raises DatasetError: they have a type that Python does not have.
    """
    pa = import_pyarrow()
    try:
        values: list[Any] = table.column(name).to_pylist()
    except (ValueError, OverflowError, pa.ArrowException) as err:
        raise DatasetError(f'{printable(name)} cannot be read: {printable(err)}') from err
    return values
