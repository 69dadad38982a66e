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

"""Writing of a data set from parts or shards, and the account of its topics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from opencv_tools.base.logs import Log
from opencv_tools.base.text import enumerated, MAX_PATH, printable
from opencv_tools.datasets.depth import millimetres
from opencv_tools.datasets.errors import DatasetError, UnreadableError
from opencv_tools.datasets.folders import check_target, locked_parts, replaced_folder
from opencv_tools.datasets.merge import check_alike, MARKS, merge_parts
from opencv_tools.datasets.part import read_part
from opencv_tools.datasets.shards import find_parts


#: Numbers of an account whose sum is the number of messages.
COUNTS = ('used', 'dropped', 'before', 'after', 'failed')


def topic_lines(parts: Sequence[Mapping[str, Any]]) -> list[str]:
    """
    Return a sentence for each topic.

    :param parts: what part.json says of the bags. The median is the largest one of all bags.
    """
    lines = []
    for name in parts[0]['topics']:
        found = [part['topics'][name] for part in parts if name in part['topics']]
        sums = {key: sum(one.get(key, 0) for one in found)
                for key in (*COUNTS, 'messages', 'reused')}
        worst = {key: 1000 * max(one[key] for one in found)
                 for key in ('median_error', 'largest_error')}
        lines.append(
            f'{printable(name)}: {sums["used"]} samples used, {sums["reused"]} rows repeat one, '
            f'{sums["dropped"]} dropped, {sums["before"]} before the first row, {sums["after"]} '
            f'after the last, {sums["failed"]} failed, of {sums["messages"]} messages; from '
            f'sample to row {worst["median_error"]:.1f} ms in the median, '
            f'{worst["largest_error"]:.1f} ms at most')
    unused = sum((Counter(part.get('unused', {})) for part in parts), Counter[str]())
    texts = [f'{printable(name)} ({count} messages)' for name, count in sorted(unused.items())]
    return lines + ([f'not used: {enumerated(texts, 20)}'] if texts else [])


def depth_lines(parts: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a sentence about the pixels of each depth camera; see `topic_lines`."""
    lines = []
    for name in parts[0].get('depth', {}):
        found = [part['depth'][name] for part in parts]
        sums = {key: sum(one[key] for one in found) for key in found[0]}
        worst = max(one['largest_error'] for one in found)
        lines.append(f'{printable(name)}: {sums["none"]} of {sums["pixels"]} pixels have no '
                     f'depth, {sums["nearer"]} are nearer and {sums["farther"]} farther than '
                     f'stored; the largest error of the others is {millimetres(worst)}')
    return lines


def failed_messages(described: Iterable[Mapping[str, Any]]) -> int:
    """Return the number of messages that could not be read or decoded; see `topic_lines`."""
    return sum(one['failed'] for part in described for one in part['topics'].values())


def write_set(parts: Sequence[Path], target: Path, log: Log) -> int:
    """
    Write a set of parts, and log its account.

    :returns: number of messages that failed.
    :raises UnreadableError: a part is damaged, or the parts do not fit each other.
    :raises OSError: a file cannot be read or written.
    """
    try:
        described = [read_part(part) for part in parts]
        check_alike(described)
        with replaced_folder(target) as folder:
            merge_parts(parts, described, folder)
    except DatasetError as err:
        raise UnreadableError(str(err)) from err
    for line in [*topic_lines(described), *depth_lines(described)]:
        log.info(line)
    episodes = [episode for part in described for episode in part['episodes']]
    log.info(f'{printable(target, MAX_PATH)} has {len(episodes)} episodes with '
             f'{sum(episode["length"] for episode in episodes)} rows of {len(parts)} bags')
    return failed_messages(described)


def merge_shards(folders: Sequence[Path], target: Path, *, overwrite: bool, skip_failed: bool,
                 log: Log) -> int:
    """
    Write a set of what shards have written; return what `write_set` returns.

    :raises DatasetError: a shard or a bag is missing, the target cannot be used, or as of
        `write_set`.
    :raises OSError: a file cannot be read or written.
    """
    parts, warnings = find_parts(folders, skip_failed)
    for warning in warnings:
        log.warning(warning)
    with locked_parts(target):
        check_target(target, MARKS, overwrite)
        return write_set(parts, target, log)
