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

"""Episodes by events, tables and gaps, and the action that is the next state."""

from __future__ import annotations

from collections import Counter
import json
from pathlib import Path
import re

import av
from dataset_bags import BEGAN, Drive, joints_entry, NANO, plain_entry
from dataset_sets import (
    CAMERA, check_rows, convert, episodes_of, frames_of, FRONT, JOINTS_STATE, numbers_of, rows_of,
    stamps_of, tasks_of, USUAL)
import numpy as np
from opencv_tools.convert.cli import main
import pytest

S = NANO
Errors = pytest.CaptureFixture[str]


def spans(folder: Path, first_ns: int = BEGAN) -> list[tuple[int, int]]:
    """Return the number of the first frame of each episode, and its length."""
    numbers = check_rows(folder, Drive().picture_ns)
    return [(numbers[row['dataset_from_index']], row['length']) for row in episodes_of(folder)]


def made(folder: Path, drive: Drive, *words: object, status: int = 0) -> Path:
    assert convert(drive.write(folder / 'bag.mcap'), folder / 'set', *words) == status
    assert not status or not (folder / 'set').exists()
    assert status or main(['--check', str(folder / 'set')]) == 0
    return folder / 'set'


def flags(*edges: tuple[float, object], kind: str = 'Bool') -> list[object]:
    # Its stamps would be 1 to 5 ms before the log: that is what the clock of the others has.
    return [plain_entry(BEGAN + round(seconds * S) + 1_000_000, value, '/run', kind)
            for seconds, value in edges]


def test_edges_of_a_bool_are_the_borders_of_episodes(tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(others=flags((0.1, False), (0.5, True), (0.6, True), (1.0, False), (1.5, True),
                               (1.502, False), (1.8, True)))
    folder = made(tmp_path, drive, *USUAL, '--episodes', '/run')
    # The clock of the samples is 1 ms behind the log for two of three topics: 0.5 s is frame 15.
    assert spans(folder) == [(15, 15), (45, 1), (54, 6)]
    assert set(tasks_of(folder)) == {'pick'}
    assert stamps_of(folder, 'front')[0] == BEGAN + S // 2
    assert rows_of(folder)['frame_index'].tolist() == [*range(15), 0, *range(6)]
    # Each episode begins with a key frame, so that none needs frames of the one before.
    with av.open(str(folder / f'videos/{FRONT}/chunk-000/file-000.mp4')) as container:
        is_key = [packet.is_keyframe for packet in container.demux(video=0) if packet.size]
    assert all(is_key[row['dataset_from_index']] for row in episodes_of(folder))


def test_texts_are_tasks(tmp_path: Path) -> None:
    drive = Drive(others=flags((0.0, 'pick'), (0.5, 'place'), (0.9, 'place'), (1.0, ''),
                               (1.5, 'pick'), kind='String'))
    folder = made(tmp_path, drive, *CAMERA, *JOINTS_STATE, '--episodes', '/run.data')
    assert [(row['tasks'], row['length']) for row in episodes_of(folder)] == [
        (['pick'], 15), (['place'], 15), (['pick'], 15)]
    assert tasks_of(folder) == ['pick'] * 15 + ['place'] * 15 + ['pick'] * 15
    assert rows_of(folder)['task_index'].tolist() == [0] * 15 + [1] * 15 + [0] * 15


@pytest.mark.parametrize(('entries', 'source', 'reason'), [
    (flags((0.1, False)), '/run', 'no episode begins: the value of --episodes is never other'),
    ([], '/run', 'there is no topic /run; there is '),
    (flags((0.1, True)), '/joint_states.position', 'is not one number or text; name a field'),
    (flags((5.0, True)), '/run', 'no row has all topics')])
def test_events_without_episodes_are_an_error(
        entries: list[object], source: str, reason: str, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(others=entries)  # type: ignore[arg-type]
    made(tmp_path, drive, *USUAL, '--episodes', source, status=1)
    assert reason in capsys.readouterr().err


def test_events_with_stamps_that_are_zero_are_an_error(tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(others=[joints_entry(0, [one], ['a'], '/grip', BEGAN + one * S // 2)
                          for one in range(4)])
    made(tmp_path, drive, *USUAL, '--episodes', '/grip.position.0', status=1)
    assert re.search('4 stamps of /grip.position.0 .* are zero; use --clock log',
                     capsys.readouterr().err)


def test_table_of_episodes(tmp_path: Path) -> None:
    # Seconds count from the first message of the bag. Lines may have any order.
    table = tmp_path / 'a.csv'
    table.write_text('\ufeffstart,end,bag,task\n1.0,1.5,,"pick, place"\n0.2,0.4,bag.mcap,\n',
                     encoding='utf-8')
    folder = made(tmp_path, Drive(), *USUAL, '--episodes', table)
    assert [row['length'] for row in episodes_of(folder)] == [6, 15]
    assert [row['tasks'] for row in episodes_of(folder)] == [['pick'], ['pick, place']]
    assert abs(stamps_of(folder, 'front')[0] - BEGAN - S // 5) < S // 30


@pytest.mark.parametrize(('text', 'reason'), [
    ('start,end\n', 'a.csv has no episodes'),
    ('', 'a.csv has the columns ; give start, end'),
    ('start,end,tusk\n0,1,a\n', 'a.csv has the columns start, end, tusk; give start, end and'),
    ('start,end\n0,1\n1,x\n', 'a.csv, line 3: start and end must be numbers of seconds'),
    ('start,end\n0\n', 'a.csv, line 2: start and end must be numbers'),
    ('start,end,task\n0,1,pick, place\n', 'a.csv, line 2 has more fields than columns'),
    ('start,end\n1,1\n', 'a.csv, line 2: start 1 is not before end 1'),
    ('start,end\n-1,1\n', 'line 2: start -1 is not before end 1'),
    ('start,end\nnan,1\n', 'line 2: start nan is not before end 1'),
    ('start,end\n0,1e300\n', 'start 0 is not before end 1e\\+300, both from 0 to 1e\\+08 s'),
    ('start,end\n0,1\n0.5,2\n', 'two episodes of bag.mcap overlap at 0.500 s'),
    ('start,end,bag\n0,1,bag.mcap\n0,1,bug.mcap\n', "has the bag 'bug.mcap'; there is bag.mcap"),
    ('start,end\n50,60\n', 'no row has all topics'),
    ('start,end\n0,1\0\n', 'a.csv'),
    (b'start,end\n\xff,1\n', 'a.csv is not a table in CSV')])
def test_bad_table_is_an_error(
        text: str | bytes, reason: str, tmp_path: Path, capsys: Errors) -> None:
    table = tmp_path / 'a.csv'
    table.write_bytes(text if isinstance(text, bytes) else text.encode())
    bag = Drive(seconds=1).write(tmp_path / 'bag.mcap')
    assert convert(bag, tmp_path / 'set', *USUAL, '--episodes', table) in (1, 2)
    errors = capsys.readouterr().err
    assert re.search(f'img_convert: error: .*{reason}', errors), errors
    assert not (tmp_path / 'set').exists()


@pytest.mark.parametrize('gap', ['fail', 'split'])
def test_gap_fails_or_splits(gap: str, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(lost=frozenset(range(20, 40)))
    folder = made(tmp_path, drive, *USUAL, '--max-gap', '0.1', '--on-gap', gap,
                  status=int(gap == 'fail'))
    errors = capsys.readouterr().err
    if gap == 'fail':
        assert re.search(r'front has no sample for 0.667 s, 1\.3\d* s after the begin; at most '
                         '0.1 s are allowed: use a larger --max-gap, or --on-gap split', errors)
        return
    # Up to 0.1 s the last picture is repeated.
    assert spans(folder) == [(0, 23), (40, 20)]
    assert check_rows(folder, drive.picture_ns)[18:24] == [18, 19, 19, 19, 19, 40]
    assert 'warning: bag.mcap: 17 rows of the episode at ' in errors


def test_next_action_is_the_state_of_the_next_row(tmp_path: Path) -> None:
    words = (*CAMERA, *JOINTS_STATE)
    drive = Drive(others=flags((0.5, True), (1.0, False), (1.5, True), (1.53, False)))
    whole = made(tmp_path / 'a', drive, *words, '--episodes', '/run')
    states = rows_of(whole)['observation.state']
    # An episode of one row has no next one.
    assert [row['length'] for row in episodes_of(whole)] == [15, 1]
    folder = made(tmp_path / 'b', drive, *words, '--episodes', '/run', '--action', 'next')
    assert [row['length'] for row in episodes_of(folder)] == [14]
    rows = rows_of(folder)
    assert np.array_equal(rows['observation.state'], states[:14])
    assert np.array_equal(rows['action'], states[1:15])
    assert len(frames_of(folder, FRONT)) == 14


def test_topics_without_common_time_are_an_error(tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=0.5, others=[plain_entry(BEGAN + 2 * S, 1.0, '/late', 'Float64')])
    made(tmp_path, drive, *CAMERA, '--state', '/late', '--clock', 'log', status=1)
    assert 'front ends 1.528 s before /late begins, so no time has all topics' in (
        capsys.readouterr().err)


ENDED = {'dies': Drive(lost=frozenset(range(15, 60))), 'begins late': Drive(first=50),
         'dies at 0.4 s': Drive(seconds=3, lost=frozenset(range(12, 90)))}


@pytest.mark.parametrize(('name', 'text'), [
    ('dies', r'the last 1\.533 s'), ('begins late', r'the first 1\.667 s'),
    ('dies at 0.4 s', r'the last 2\.633 s')])
def test_camera_that_dies_or_begins_late_is_an_error(
        name: str, text: str, tmp_path: Path, capsys: Errors) -> None:
    made(tmp_path, ENDED[name], *USUAL, status=1)
    errors = capsys.readouterr().err
    assert re.search(f'front has no sample for {text} of the other topics; at most 1 s are '
                     'allowed: leave this time out with --ends shorten', errors), errors


@pytest.mark.parametrize(('name', 'words', 'numbers'), [
    ('dies', ('--ends', 'shorten'), [*range(15)]),
    ('dies', ('--on-gap', 'split'), [*range(15), *[14] * 30]),  # as in the middle
    ('dies', ('--on-gap', 'split', '--max-gap', '0.2'), [*range(15), *[14] * 6]),
    ('dies', ('--max-gap', '10'), [*range(15), *[14] * 46]),
    ('begins late', ('--ends', 'shorten'), [*range(50, 60)]),
    ('begins late', ('--on-gap', 'split'), [*range(50, 60)]),
    ('begins late', ('--max-gap', '2'), [*range(50, 60)]),
    ('dies at 0.4 s', ('--ends', 'shorten', '--max-gap', '0.5'), [*range(12)])])
def test_ends_without_a_topic_are_said(
        name: str, words: tuple[str, ...], numbers: list[int], tmp_path: Path, capsys: Errors,
        ) -> None:
    drive = ENDED[name]
    folder = tmp_path / 'set'
    assert convert(drive.write(tmp_path / 'bag.mcap'), folder, *USUAL, *words) == 0
    assert numbers_of(folder) == numbers
    errors = capsys.readouterr().err
    which = 'first' if name == 'begins late' else 'last'
    assert f'warning: bag.mcap: front has no sample for the {which} ' in errors
    check_accounts(folder, drive)


@pytest.mark.parametrize(('edges', 'seconds', 'words'), [
    ((0.0, 0.9, 1.5), 3.0, ('--max-gap', '100')), ((0.0,), 2.5, ('--max-gap', '2.6')),
    ((0.0, 0.25, 0.4), 1.25, ())])
def test_topic_that_is_published_on_change_lasts_to_the_end(
        edges: tuple[float, ...], seconds: float, words: tuple[str, ...], tmp_path: Path) -> None:
    grip = [joints_entry(BEGAN + round(one * S), [one], ['grip'], '/gripper') for one in edges]
    drive = Drive(seconds=seconds, others=grip)
    folder = made(tmp_path, drive, *CAMERA, '--state', '/gripper.position', *words)
    rows = rows_of(folder)['observation.state'].ravel()
    times = np.arange(len(rows)) / 30
    assert len(rows) == round(30 * seconds)
    assert np.allclose(rows, [max(edge for edge in edges if edge <= time + 1e-6)
                              for time in times])
    check_accounts(folder, drive)


def test_episode_within_the_time_of_all_topics_is_complete(tmp_path: Path, capsys: Errors) -> None:
    (tmp_path / 'a.csv').write_text('start,end\n0.1,0.4\n')
    made(tmp_path, ENDED['dies'], *USUAL, '--episodes', tmp_path / 'a.csv')
    assert 'warning' not in capsys.readouterr().err


def check_accounts(folder: Path, drive: Drive) -> None:
    """Check that the account of each topic is the number of its messages in the bag."""
    part, = json.loads((folder / 'meta/opencv_tools/bags.json').read_text())
    counts = Counter(entry.topic for entry in drive.entries())
    names = {'front': CAMERA[1].partition('=')[2]}
    for name, one in part['topics'].items():
        topic = names.get(name, name.rpartition('.')[0])
        assert one['messages'] == counts.pop(topic) == sum(
            one[key] for key in ('used', 'dropped', 'before', 'after', 'failed')), name
    assert part['unused'] == counts
