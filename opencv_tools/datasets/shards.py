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

from collections.abc import Sequence
import json
from pathlib import Path
import re

from opencv_tools.base.regular_files import read_regular, replace_file
from opencv_tools.base.text import enumerated, MAX_PATH, printable
from opencv_tools.datasets.errors import DatasetError, reason_of
from opencv_tools.datasets.folders import natural_key, part_folder
from opencv_tools.datasets.part import PART, read_part

_NAME = re.compile(r'shard_(\d{1,7})_of_(\d{1,7})\.json')
_MAX_BYTES = 1 << 28


def write_shard(folder: Path, shard: tuple[int, int], plan: str, bags: Sequence[str]) -> None:
    """
    Write the names of the bags of a shard to its folder.

    :param shard: number of the shard, from 1, and number of all shards.
    :raises DatasetError: the folder has other files.
    :raises OSError: the file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for entry in folder.iterdir():
        is_part = (entry / PART).is_file() or entry.name.startswith('.')
        if not (is_part if entry.is_dir() else _NAME.fullmatch(entry.name)):
            raise DatasetError(f'{printable(folder, MAX_PATH)} has {printable(entry.name)}, which '
                               'is no part of a shard; give a new folder')
    number, count = shard
    content = json.dumps({'plan': plan, 'bags': [*bags]}).encode()
    replace_file(folder / f'shard_{number}_of_{count}.json', content)


def find_parts(folders: Sequence[Path], skip_failed: bool) -> tuple[list[Path], list[str]]:
    """
    Find the parts of the bags that shards have.

    :param skip_failed: whether bags may be missing.
    :returns: folders of the parts, in the natural order of their bags, and sentences about bags
        that are left out.
    :raises DatasetError: a shard or a bag is missing, a bag is there twice, or the shards have
        different options.
    """
    numbers: set[tuple[int, int]] = set()
    plans: set[str] = set()
    found: dict[str, Path] = {}
    missing: list[str] = []
    for folder in folders:
        lists = [(match, path) for path in sorted(folder.glob('shard_*.json'))
                 for match in (_NAME.fullmatch(path.name),) if match]
        if not lists:
            raise DatasetError(f'{printable(folder, MAX_PATH)} is no folder that --shard has '
                               'written')
        for match, path in lists:
            numbers.add((int(match[2]), int(match[1])))
            plan, bags = _read_list(path)
            plans.add(plan)
            for bag in bags:
                if bag in found:
                    raise DatasetError(f'{printable(bag)} is in two shards; run all shards again '
                                       'with the same bags')
                found[bag] = part_folder(folder, bag)
                missing += [] if _has_part(found[bag], plan) else [bag]
    _check_numbers(numbers)
    if len(plans) > 1:
        raise DatasetError('the shards have different options; run all of them with the same')
    shown = enumerated([printable(bag) for bag in missing])
    if missing and not skip_failed:
        raise DatasetError(f'not converted in the shards ({len(missing)}): {shown}; run their '
                           'shards again, or leave them out with --skip-failed')
    parts = [found[bag] for bag in sorted(found, key=natural_key) if bag not in missing]
    if not parts:
        raise DatasetError('the shards have no bag')
    return parts, [f'left out ({len(missing)}): {shown}'] if missing else []


def _has_part(folder: Path, plan: str) -> bool:
    if not (folder / PART).exists():
        return False
    return read_part(folder)['plan'] == plan  # a damaged part is an error


def _check_numbers(numbers: set[tuple[int, int]]) -> None:
    """Check that pairs of the number of shards and that of a shard are complete."""
    counts = sorted({count for count, _ in numbers})
    if len(counts) > 1:
        raise DatasetError(f'there are shards of {counts[0]} and of {counts[1]}; run all shards '
                           'again with one number')
    absent = [str(number) for number in range(1, counts[0] + 1)
              if (counts[0], number) not in numbers]
    if absent:
        raise DatasetError(f'{len(absent)} of {counts[0]} shards are missing: '
                           f'{enumerated(absent)}')


def _read_list(path: Path) -> tuple[str, list[str]]:
    """Return the digest of the plan of a shard, and the names of its bags."""
    try:
        content = json.loads(read_regular(path, _MAX_BYTES))
        plan, bags = content['plan'], content['bags']
    except (OSError, ValueError, TypeError, LookupError, RecursionError) as err:
        raise DatasetError(f'{printable(path, MAX_PATH)} cannot be read: {reason_of(err)}'
                           ) from err
    if not isinstance(plan, str) or not isinstance(bags, list) or not all(
            isinstance(one, str) for one in bags):
        raise DatasetError(f'{printable(path, MAX_PATH)} is no list of bags')
    return plan, bags
