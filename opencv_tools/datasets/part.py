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

"""A part of a data set: what one bag becomes, in a folder that is complete or absent."""

from __future__ import annotations

from collections.abc import Sequence
import json
from pathlib import Path
from typing import Any

from opencv_tools.base.regular_files import read_regular
from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.datasets.errors import DatasetError, reason_of
from opencv_tools.datasets.plan import FORMATS, Plan

PART, ROWS = 'part.json', 'rows.parquet'
FINGERPRINT = 'fingerprint.'
_MAX_PART = 1 << 28  # bytes of part.json
_KINDS = {'bag': str, 'plan': str, 'state': list, 'fps': int, 'robot_type': str, 'format': str,
          'warnings': list, 'topics': dict, 'features': dict, 'episodes': list}


def bag_state(path: Path, files: Sequence[Path] = ()) -> list[list[Any]]:
    """
    Return names, sizes and times of the files of a bag, by which a changed bag is recognised.

    :raises OSError: a file cannot be read.
    """
    files = files or (sorted(path.iterdir()) if path.is_dir() else [path])
    return [[file.name, status.st_size, status.st_mtime_ns]
            for file in files for status in (file.stat(),)]


def is_done(folder: Path, plan: Plan, state: list[list[Any]]) -> bool:
    """Return whether a folder is the part of a bag that has not changed since."""
    try:
        described = read_part(folder)
    except DatasetError:
        return False
    return described['plan'] == plan.digest and described['state'] == state


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
        raise DatasetError(f'{printable(folder, MAX_PATH)} is no part of a data set: '
                           f'{reason_of(err)}') from err
    return content
