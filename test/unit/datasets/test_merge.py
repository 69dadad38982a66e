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

"""Merge of parts: equal to one run apart from the borders of files, or refused."""

from __future__ import annotations

from collections.abc import Iterator
import json
from pathlib import Path
import shutil
from typing import Any

from dataset_bags import Drive, jpeg_entry, plain_entry
from dataset_sets import (
    check_rows, convert, episodes_of, frames_of, info_of, numbers_of, rows_of, tasks_of, USUAL)
import numpy as np
from opencv_tools.convert.cli import main
from opencv_tools.datasets import merge
from opencv_tools.datasets.statistics import joined
import pytest

Errors = pytest.CaptureFixture[str]


def write_fleet(folder: Path, count: int) -> None:
    """Write bags of 2 to 4 rows, each with the next four pictures."""
    for number in range(count):
        events = [plain_entry(Drive().picture_ns(0) - 1, f'task {number % 3}', '/task', 'String')]
        first = number * 4
        drive = Drive(seconds=(first + 2 + number % 3) / 30, first=first, others=events)
        entries = [entry for entry in drive.entries() if entry.topic == '/task'
                   or entry.log_ns >= drive.picture_ns(first) - 20_000_000]
        drive.entries = lambda entries=entries: entries  # type: ignore[method-assign]
        drive.write(folder / f'{number % 7}/run{number}.mcap')


def shards(folder: Path, count: int) -> Iterator[Path]:
    for shard in range(1, count + 1):
        words = (*USUAL, '--episodes', '/task', '--shard', f'{shard}/{count}')
        assert convert(folder / 'bags', folder / f'shard_{shard}', *words) == 0
        yield folder / f'shard_{shard}'


def without_files(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return rows of the table of episodes without the places in files."""
    return [{name: value for name, value in row.items() if not name.endswith(
        ('_index', '_timestamp')) or name in ('episode_index', 'dataset_from_index',
                                              'dataset_to_index')} for row in rows]


def check_equal(one: Path, other: Path) -> None:
    first, second = rows_of(one), rows_of(other)
    assert first.keys() == second.keys()
    assert all(np.array_equal(first[name], second[name]) for name in first)
    assert without_files(episodes_of(one)) == without_files(episodes_of(other))
    assert tasks_of(one) == tasks_of(other)
    assert (one / 'meta/stats.json').read_bytes() == (other / 'meta/stats.json').read_bytes()
    assert info_of(one) == info_of(other)
    pictures = [frames_of(one), frames_of(other)]
    assert all(np.array_equal(left[1], right[1]) for left, right in zip(*pictures, strict=True))


@pytest.mark.parametrize('count', [12, pytest.param(100, marks=pytest.mark.thorough)])
def test_shards_are_equal_to_one_run(
        count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_fleet(tmp_path / 'bags', count)
    assert convert(tmp_path / 'bags', tmp_path / 'whole', *USUAL, '--episodes', '/task') == 0
    parts = [*shards(tmp_path, count)]
    # The order of the arguments does not matter.
    words = ['--merge', *map(str, reversed(parts)), str(tmp_path / 'set')]
    assert main(words) == 0
    check_equal(tmp_path / 'whole', tmp_path / 'set')
    assert main(['--check', str(tmp_path / 'set')]) == 0
    # Bags are in the natural order of their names: 0/run7 before 0/run14 before 1/run1.
    described = json.loads((tmp_path / 'set/meta/opencv_tools/bags.json').read_text())
    order = [int(part['bag'].partition('run')[2].removesuffix('.mcap')) for part in described]
    assert order == sorted(range(count), key=lambda number: (number % 7, number))
    lengths = [2 + number % 3 for number in order]
    assert [row['length'] for row in episodes_of(tmp_path / 'set')] == lengths
    assert numbers_of(tmp_path / 'set') == [
        number * 4 + row for number, length in zip(order, lengths) for row in range(length)]
    assert check_rows(tmp_path / 'set', Drive().picture_ns)
    assert tasks_of(tmp_path / 'set') == [
        f'task {number % 3}' for number, length in zip(order, lengths) for _ in range(length)]
    check_statistics(tmp_path / 'set')
    # Files of a limited size.
    monkeypatch.setattr(merge, 'DATA_MEGABYTES', 0.0005)
    monkeypatch.setattr(merge, 'VIDEO_MEGABYTES', 0.007)
    monkeypatch.setattr(merge, 'CHUNK_FILES', 3)
    monkeypatch.setattr('opencv_tools.datasets.merge._MEGABYTE', 1 << 20)
    assert main([*words, '--overwrite']) == 0
    assert main(['--check', str(tmp_path / 'set')]) == 0
    check_equal(tmp_path / 'whole', tmp_path / 'set')
    for kind in ('data', 'videos'):
        files = sorted(path.relative_to(tmp_path / 'set') for path in (
            tmp_path / 'set' / kind).rglob('file-*'))
        assert len(files) >= 4 and {path.name[:8] for path in files} == {
            'file-000', 'file-001', 'file-002'}
        assert all((tmp_path / 'set' / path).stat().st_size < 120_000 for path in files)


def check_statistics(folder: Path) -> None:
    """Compare the statistics of a set with its rows, and with those of its episodes."""
    found = json.loads((folder / 'meta/stats.json').read_text())
    rows = rows_of(folder)
    for key, values in rows.items():
        columns = values.reshape(len(values), -1).astype(float)
        for name in ('min', 'max', 'mean', 'std'):
            assert np.allclose(found[key][name], getattr(columns, name)(axis=0), rtol=1e-5,
                               atol=1e-5 if key != 'stamp_ns' else 1e4), (key, name)
        assert found[key]['count'] == [len(values)]
    for key, one in found.items():
        each = [{name: np.array(row[f'stats/{key}/{name}']) for name in one}
                for row in episodes_of(folder)]
        assert all(np.allclose(one[name], value) for name, value in joined(each).items())


def test_parts_with_another_feature_are_refused(tmp_path: Path, capsys: Errors) -> None:
    Drive(seconds=0.2).write(tmp_path / 'bags/a.mcap')
    other = Drive(seconds=0.2, topics=())
    other.others = [jpeg_entry(number, other.picture_ns(number), width=176) for number in range(6)]
    other.write(tmp_path / 'bags/b.mcap')
    assert convert(tmp_path / 'bags', tmp_path / 'set', *USUAL) == 1
    assert 'observation.images.front of b.mcap is ' in capsys.readouterr().err
    assert not (tmp_path / 'set').exists()


def test_shards_of_other_options_or_numbers_are_refused(tmp_path: Path, capsys: Errors) -> None:
    for name in 'ab':
        Drive(seconds=0.2).write(tmp_path / f'bags/{name}.mcap')
    for folder, words in (('1', ('--shard', '1/2')), ('2', ('--shard', '2/2', '--crf', 30)),
                          ('3', ('--shard', '2/3'))):
        assert convert(tmp_path / 'bags', tmp_path / folder, *USUAL, *words) == 0
    for second, reason in (('2', 'the shards have different options; run all of them with'),
                           ('3', 'there are shards of 2 and of 3; run all shards again')):
        assert main(['--merge', *(str(tmp_path / one) for one in ('1', second, 'set'))]) == 2
        assert reason in capsys.readouterr().err
        assert sorted(path.name for path in tmp_path.glob('*set*')) == []


def test_bag_that_is_deleted_leaves_its_shard(tmp_path: Path) -> None:
    for name in 'ab':
        Drive(seconds=0.2).write(tmp_path / f'bags/{name}.mcap')
    for _ in range(2):
        assert convert(tmp_path / 'bags', tmp_path / 'shard', *USUAL, '--shard', '1/1') == 0
        (tmp_path / 'bags/b.mcap').unlink(missing_ok=True)
    assert main(['--merge', str(tmp_path / 'shard'), str(tmp_path / 'set')]) == 0
    assert len(episodes_of(tmp_path / 'set')) == 1


def test_shard_is_not_written_among_other_files(tmp_path: Path, capsys: Errors) -> None:
    bag = Drive(seconds=0.2).write(tmp_path / 'bags/a.mcap')
    assert convert(bag, tmp_path / 'bags', *USUAL, '--shard', '1/1') == 2
    assert 'has a.mcap, which is no part of a shard; give a new folder' in capsys.readouterr().err


@pytest.fixture
def part(tmp_path: Path) -> Path:
    """Return the folder of a part in the shard a."""
    bag = Drive(seconds=0.2).write(tmp_path / 'a.mcap')
    assert convert(bag, tmp_path / 'a', *USUAL, '--shard', '1/1') == 0
    return next((tmp_path / 'a').glob('a.mcap-*'))


@pytest.mark.parametrize(('name', 'content', 'reason'), [
    ('part.json', b'{"bag": 5}', 'is no part of a data set: '),
    ('part.json', b'[' * 100_000, 'is no part of a data set: '),
    ('part.json', b'5', 'is no part of a data set: '),
    ('rows.parquet', b'PAR1', 'rows.parquet is damaged'),
    ('rows.parquet', None, 'rows.parquet'),
    ('front.mp4', b'no', 'front.mp4 is no video'),
    ('front.mp4', None, 'front.mp4')])
def test_damaged_part_is_an_error(
        name: str, content: bytes | None, reason: str, part: Path, capsys: Errors) -> None:
    (part / name).unlink()
    if content is not None:
        (part / name).write_bytes(content)
    target = part.parents[1] / 'set'
    assert main(['--merge', str(part.parent), str(target)]) in (1, 2)
    errors = capsys.readouterr().err
    assert reason in errors and 'Traceback' not in errors and not target.exists()


def test_bag_of_two_shards_and_folder_without_parts_are_errors(
        part: Path, tmp_path: Path, capsys: Errors) -> None:
    shutil.copytree(tmp_path / 'a', tmp_path / 'b')
    words = ['--merge', *(str(tmp_path / one) for one in ('a', 'b', 'set'))]
    assert main(words) == 2
    assert 'a.mcap is in two shards; run all shards again' in capsys.readouterr().err
    shutil.rmtree(tmp_path / 'b')
    assert main(words) == 2
    assert '/b is no folder that --shard has written' in capsys.readouterr().err


def test_missing_shards_and_bags_are_named(tmp_path: Path, capsys: Errors) -> None:
    for number in range(4):
        Drive(seconds=0.2).write(tmp_path / f'bags/{number}.mcap')
    (tmp_path / 'bags/2.mcap').write_bytes(b'no bag')
    for shard, status in ((1, 1), (2, 0)):
        assert convert(tmp_path / 'bags', tmp_path / f'{shard}', *USUAL, '--shard',
                       f'{shard}/2') == status
    capsys.readouterr()
    target = str(tmp_path / 'set')
    assert main(['--merge', str(tmp_path / '2'), target]) == 2
    assert '1 of 2 shards are missing: 1\n' in capsys.readouterr().err
    words = ['--merge', str(tmp_path / '1'), str(tmp_path / '2'), target]
    assert main(words) == 2
    assert 'not converted in the shards (1): 2.mcap; run their shards again' in (
        capsys.readouterr().err)
    assert main([*words, '--skip-failed']) == 0
    assert 'warning: left out (1): 2.mcap' in capsys.readouterr().err
    assert numbers_of(tmp_path / 'set') == [*range(6)] * 3
    for content in (b'{"a": 1}', b'[1]', b'[' * 100_000):
        (tmp_path / '1/shard_1_of_2.json').write_bytes(content)
        assert main([*words, '--overwrite']) == 2
        assert 'shard_1_of_2.json ' in capsys.readouterr().err
