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

"""What the shards of a conversion should have, so that a merge misses neither shard nor bag."""

from __future__ import annotations

from collections.abc import Collection, Sequence
import json
from pathlib import Path
import re

from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.folders import natural_key
from opencv_tools.datasets.part import PART, read_part
from opencv_tools.image.text import enumerated, MAX_PATH, printable
from opencv_tools.regular_files import read_regular, replace_file

_NAME = re.compile(r'shard_(\d{1,7})_of_(\d{1,7})\.json')
_MAX_BYTES = 1 << 28


def write_shard(folder: Path, shard: tuple[int, int], bags: Sequence[str]) -> None:
    """
    Write the names of the bags of a shard to its folder.

    :param shard: number of the shard, from 1, and number of all shards.
    :raises OSError: the file cannot be written.
    """
    number, count = shard
    folder.mkdir(parents=True, exist_ok=True)
    replace_file(folder / f'shard_{number}_of_{count}.json', json.dumps([*bags]).encode())


def find_parts(folders: Sequence[Path], skip_failed: bool) -> tuple[list[Path], list[str]]:
    """
    Find the parts in the folders of shards.

    :param skip_failed: whether bags may be missing.
    :returns: folders of the parts, in the natural order of their bags, and sentences about bags
        that are left out.
    :raises DatasetError: a shard or a bag is missing, or a bag is there twice.
    """
    found: dict[str, Path] = {}
    for folder in folders:
        parts = [path.parent for path in folder.glob(f'*/{PART}')
                 if not path.parent.name.startswith('.')]
        if not parts and not [*folder.glob('shard_*.json')]:
            raise DatasetError(f'{printable(folder, MAX_PATH)} has no part of a data set; give '
                               'folders that --shard has written')
        for part in parts:
            bag = read_part(part)['bag']
            if bag in found:
                raise DatasetError(f'{printable(bag)} is in {printable(found[bag].parent)} and in '
                                   f'{printable(folder)}; merge each bag once')
            found[bag] = part
    warnings = _check_shards(folders, found.keys(), skip_failed)
    if not found:
        raise DatasetError('the shards have no bag')
    return [found[bag] for bag in sorted(found, key=natural_key)], warnings


def _check_shards(folders: Sequence[Path], bags: Collection[str], skip_failed: bool) -> list[str]:
    """Check that folders have all shards and, unless ``skip_failed``, all bags."""
    numbers: dict[int, set[int]] = {}
    missing: list[str] = []
    for folder in folders:
        for path in sorted(folder.glob('shard_*_of_*.json')):
            found = _NAME.fullmatch(path.name)
            if found:
                numbers.setdefault(int(found[2]), set()).add(int(found[1]))
                missing += [bag for bag in _read_bags(path) if bag not in bags]
    for count, present in numbers.items():
        absent = [str(number) for number in range(1, count + 1) if number not in present]
        if absent:
            raise DatasetError(f'{len(absent)} of {count} shards are missing: '
                               f'{enumerated(absent)}')
    shown = enumerated([printable(bag) for bag in missing])
    if missing and not skip_failed:
        raise DatasetError(f'{len(missing)} bags of the shards are not converted: {shown}; run '
                           'their shards again, or leave them out with --skip-failed')
    return [f'{len(missing)} bags are left out: {shown}'] if missing else []


def _read_bags(path: Path) -> list[str]:
    try:
        content = json.loads(read_regular(path, _MAX_BYTES))
    except (OSError, ValueError, RecursionError) as err:
        reason = getattr(err, 'strerror', None) or err
        raise DatasetError(f'{printable(path, MAX_PATH)} cannot be read: {printable(reason)}'
                           ) from err
    if not isinstance(content, list) or not all(isinstance(one, str) for one in content):
        raise DatasetError(f'{printable(path, MAX_PATH)} is no list of bags')
    return content
