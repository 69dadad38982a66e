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

"""A conversion that is killed, interrupted, repeated or changed is complete or absent."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys

from conftest import disk_of
from dataset_bags import Drive
from dataset_sets import (
    content_of, convert, episodes_of, info_of, numbers_of, start_killed, USUAL)
from opencv_tools.convert.cli import main
from opencv_tools.datasets.folders import part_folder
import pytest
from waiting import communicate, join, wait_until, work_of

Errors = pytest.CaptureFixture[str]
MOMENTS = 20


@pytest.fixture
def bags(tmp_path: Path) -> Path:
    for number in range(3):
        Drive(seconds=0.2, first=0).write(tmp_path / f'bags/{number}.mcap')
    return tmp_path / 'bags'


def rests(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob('*set*'))


def words_of(bags: Path, *words: object) -> Sequence[object]:
    return (bags, bags.parent / 'set', '--format', 'lerobot', '--fps', 30, '--jobs', 1, *USUAL,
            *words)


@pytest.mark.thorough
@pytest.mark.process
@pytest.mark.parametrize('has_old', [False, True])
def test_killed_at_any_moment(has_old: bool, bags: Path, tmp_path: Path) -> None:
    target, errors = tmp_path / 'set', tmp_path / 'errors'
    assert convert(bags, tmp_path / 'right', *USUAL) == 0
    if has_old:
        assert convert(bags / '0.mcap', tmp_path / 'old', *USUAL, '--robot', 'old') == 0
    right, old = content_of(tmp_path / 'right'), {}
    words = words_of(bags, '--overwrite')

    def begin() -> None:
        shutil.rmtree(target, ignore_errors=True)
        if has_old:
            shutil.copytree(tmp_path / 'old', target)

    begin()
    old = content_of(target) if has_old else {}
    process = start_killed(words, 0, errors)
    join(process)
    assert process.exitcode == 0 and content_of(target) == right
    events = int(errors.read_text().splitlines()[-1].removeprefix('events: '))
    assert events > 40
    kept = 0
    # The last changes are the replacement of the set, and the removal of the parts.
    moments = {*range(2, events - 12, events // 6), *range(events - 4 * (2 + has_old), events, 3)}
    for event in sorted({*moments, events})[:MOMENTS // 2 + 1]:
        begin()
        process = start_killed(words, event, errors)
        join(process)
        assert process.exitcode == -signal.SIGKILL
        found = content_of(target) if target.exists() else old
        assert found in (old, right), event
        parts = {path: path.stat().st_ino for path in tmp_path.glob('.set.parts/*/part.json')
                 if not path.parent.name.startswith('.')}
        assert main([str(word) for word in words]) == 0
        assert content_of(target) == right, event
        assert rests(tmp_path) == ['set']
        kept += len(parts)
    assert kept


def parts_of(bags: Path) -> dict[str, tuple[int, int]]:
    """Return what tells whether the part of a bag was written again."""
    found = {}
    for number in range(3):
        folder = part_folder(bags.parent / '.set.parts', f'{number}.mcap')
        if folder.exists():
            status = (folder / 'rows.parquet').stat()
            found[str(number)] = status.st_ino, status.st_mtime_ns
    return found


@pytest.mark.parametrize(('form', 'target'), [
    ('set', 'set'), ('set', 'dry'), ('bag', 'copy.mcap'), ('bag', 'pictures/{seq}.png')])
@pytest.mark.parametrize(('bag', 'topic', 'status'), [
    ('a.mcap', '/wrong', 2), ('a.mcap', '/cam0/image_raw/compressed', 0),
    ('absent.mcap', '/cam0/image_raw/compressed', 1)])
def test_status_is_that_of_conversions_to_bags_and_pictures(
        form: str, target: str, bag: str, topic: str, status: int, tmp_path: Path) -> None:
    Drive(seconds=0.2).write(tmp_path / 'a.mcap')
    words = ('--topic', topic) if form == 'bag' else (
        '--format', 'parquet', '--fps', '30', '--image', f'front={topic}', '--state',
        '/joint_states.position', *['--dry-run'] * (target == 'dry'))
    assert main([str(tmp_path / bag), str(tmp_path / target), *words]) == status


@pytest.mark.parametrize('damaged', [1, 3, 4])
def test_messages_that_fail_are_in_the_status(
        damaged: int, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=0.2)
    drive.others = [entry._replace(data=entry.data[:6]) for entry in drive.entries()
                    if entry.topic == '/joint_states'][1:1 + damaged]
    bag = drive.write(tmp_path / 'a.mcap')
    for form, words in (('lerobot', ()), ('parquet', ()), ('webdataset', ('--dry-run',))):
        assert convert(bag, tmp_path / form, *USUAL, *words, form=form) == 1
        assert (tmp_path / form).exists() == (not words)
    for _ in range(2):  # the second run finds the bag converted
        capsys.readouterr()
        assert convert(bag, tmp_path / 'shard', *USUAL, '--shard', '1/1') == 1
        assert f'/shard, {damaged} messages failed; join all' in capsys.readouterr().err
    assert main(['--merge', str(tmp_path / 'shard'), str(tmp_path / 'merged')]) == 1
    assert main(['--check', str(tmp_path / 'merged')]) == 0


def test_next_run_converts_only_what_is_missing(bags: Path, capsys: Errors) -> None:
    words = [str(word) for word in words_of(bags)]
    good = (bags / '1.mcap').read_bytes()
    (bags / '1.mcap').write_bytes(b'no bag')
    assert main(words) == 1
    errors = capsys.readouterr().err
    assert re.search(r'error: 2 of 3, 1.mcap: .*\n', errors)
    assert '1 of 3 bags cannot be converted, so no set is written; remove the causes' in errors
    assert rests(bags.parent) == ['.set.parts']
    first = parts_of(bags)
    assert first.keys() == {'0', '2'}
    (bags / '1.mcap').write_bytes(good)
    Drive(seconds=0.3).write(bags / '2.mcap')  # has changed meanwhile
    (bags / '3.mcap').write_bytes(b'no bag')  # so that the parts are kept
    assert main(words) == 1
    assert '1 of 4 bags are converted already' in capsys.readouterr().err
    second = parts_of(bags)
    assert second['0'] == first['0'] and second['2'] != first['2'] and '1' in second
    # Another plan converts all bags.
    assert main([*words, '--robot', 'arm']) == 1
    assert all(value != second[name] for name, value in parts_of(bags).items())
    assert main([*words, '--robot', 'arm', '--skip-failed']) == 1
    assert rests(bags.parent) == ['set']
    assert [row['length'] for row in episodes_of(bags.parent / 'set')] == [6, 6, 9]
    assert info_of(bags.parent / 'set')['robot_type'] == 'arm'
    assert numbers_of(bags.parent / 'set') == [*range(6), *range(6), *range(9)]


def test_shards_keep_what_they_have(bags: Path, tmp_path: Path, capsys: Errors) -> None:
    for _ in range(2):
        assert convert(bags, tmp_path / 'a', *USUAL, '--shard', '1/2') == 0
    assert '2 of 2 bags are converted already' in capsys.readouterr().err
    assert len([*(tmp_path / 'a').glob('*/part.json')]) == 2
    assert convert(bags, tmp_path / 'b', *USUAL, '--shard', '9/9') == 0
    assert [path.name for path in (tmp_path / 'b').iterdir()] == ['shard_9_of_9.json']


@pytest.mark.parametrize('form', ['lerobot', 'webdataset', 'parquet'])
@pytest.mark.parametrize('size', [2_000, 8_000])
def test_full_disk_is_an_error_and_leaves_nothing(
        size: int, form: str, tmp_path: Path, capsys: Errors) -> None:
    bag = Drive(seconds=1).write(tmp_path / 'a.mcap')
    with disk_of(size):
        status = convert(bag, tmp_path / 'set', *USUAL, form=form)
    errors = capsys.readouterr().err
    assert status == 1, errors
    assert 'File too large' in errors and 'Traceback' not in errors, errors
    assert not (tmp_path / 'set').exists()
    assert convert(bag, tmp_path / 'set', *USUAL, form=form) == 0
    assert rests(tmp_path) == ['set']


def children_of(pid: int) -> set[int]:
    """Return the processes that a process has begun, and theirs."""
    found: set[int] = set()
    for path in Path('/proc').glob('[0-9]*/stat'):
        try:
            parent = int(path.read_text().rpartition(')')[2].split()[1])
        except OSError:
            continue
        if parent == pid:
            found |= {int(path.parent.name), *children_of(int(path.parent.name))}
    return found


def is_running(pid: int) -> bool:
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False


@pytest.mark.quick_cases(1)
@pytest.mark.process
@pytest.mark.parametrize(('end', 'jobs'), [
    (signal.SIGINT, 1), (signal.SIGINT, 2), (signal.SIGTERM, 2), (signal.SIGKILL, 2)])
def test_ended_command_leaves_no_process(end: signal.Signals, jobs: int, tmp_path: Path) -> None:
    for name in 'ab':  # of 5000 rows, which take many seconds
        Drive(seconds=5).write(tmp_path / f'bags/{name}.mcap')
    command = [sys.executable, '-m', 'opencv_tools.convert.cli', tmp_path / 'bags',
               tmp_path / 'set', '--format', 'lerobot', '--fps', '1000', '--jobs', str(jobs),
               *USUAL]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        wait_until(lambda: len([*tmp_path.glob('.set.parts/.*/front.mp4')]) >= jobs,
                   f'{jobs} videos', work=lambda: work_of(process.pid))
        children = children_of(process.pid)
        assert len(children) >= jobs + 1 if jobs > 1 else not children
        process.send_signal(end)
        errors = communicate(process)[1]
    wait_until(lambda: not any(map(is_running, children)), 'the end of the children',
               running=lambda: [*map(is_running, children)])
    if end == signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL
    else:
        assert process.returncode == 1
        assert errors.splitlines() == ['img_convert: interrupted']
    assert not (tmp_path / 'set').exists()
