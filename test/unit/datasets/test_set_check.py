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

"""Check of data sets: right ones pass, each single damage is named in a sentence."""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
import re
import shutil
from types import SimpleNamespace
from typing import Any

import av
from dataset_bags import BEGAN, Drive, NANO
from dataset_sets import convert, FRONT, info_of, USUAL
from hypothesis import given, HealthCheck, settings, strategies as st
import numpy as np
from opencv_tools.convert.cli import main
from opencv_tools.datasets import set_reader
from opencv_tools.datasets.check import account_problems, row_problems
from opencv_tools.datasets.check_meta import (
    file_problems, FrameStatistics, info_problems, statistics_problems, task_problems)
from opencv_tools.datasets.check_videos import video_problems
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.set_reader import SetReader
from opencv_tools.datasets.videos import VideoFileWriter
from opencv_tools.image.cdr import image_to_cdr, WireHeader
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.layout import array_to_wire
from played_bags import Entry, write_mcap
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

DATA = 'data/chunk-000/file-000.parquet'
VIDEO = f'videos/{FRONT}/chunk-000/file-000.mp4'
EPISODES = 'meta/episodes/chunk-000/file-000.parquet'
SOURCES = 'meta/opencv_tools/bags.json'
PRINTS = 'meta/opencv_tools/fingerprints.parquet'
Errors = pytest.CaptureFixture[str]
Change = Callable[[Path], object]


def made_of(seconds: float, folder: Path) -> Path:
    """Make a set of two episodes."""
    for name in ('a', 'b'):
        Drive(seconds=seconds).write(folder / f'bags/{name}.mcap')
    assert convert(folder / 'bags', folder / 'set', *USUAL) == 0
    return folder / 'set'


@pytest.fixture(scope='module')
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a set of two episodes of 30 rows."""
    return made_of(1, tmp_path_factory.mktemp('made'))


@pytest.fixture(scope='module')
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a set of two episodes of 3 rows."""
    return made_of(0.1, tmp_path_factory.mktemp('small'))


@pytest.fixture
def copied(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / 'set')


def rewrite(name: str, change: Callable[[Any], Any]) -> Change:
    """Return a damage of a table."""
    return lambda folder: pq.write_table(change(pq.read_table(folder / name)), folder / name)


def cell(column: str, row: int, value: Any) -> Callable[[Any], Any]:
    def change(table: Any) -> Any:
        values = table.column(column).to_pylist()
        values[row] = value
        place = table.column_names.index(column)
        return table.set_column(place, table.schema.field(column), pa.array(
            values, table.schema.field(column).type))
    return change


def change_json(name: str, *keys: str | int, value: Any) -> Change:
    def change(folder: Path) -> None:
        content = inner = json.loads((folder / name).read_text())
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = value
        (folder / name).write_text(json.dumps(content))
    return change


def frames(order: Callable[[list[Any]], list[Any]], fps: int = 30) -> Change:
    """Return a damage of a video: its frames in another order, or at other times."""
    def change(folder: Path) -> None:
        with av.open(str(folder / VIDEO)) as container:
            images = [one.to_ndarray(format='bgr24') for one in container.decode(video=0)]
        writer = VideoFileWriter(folder / VIDEO, fps, 23)
        for number, image in enumerate(order(images)):
            writer.write(number, np.ascontiguousarray(image), number == 0)
        writer.close()
    return change


def swapped(images: list[Any]) -> list[Any]:
    images[10], images[11] = images[11], images[10]
    return images


def text(name: str, content: str) -> Change:
    return lambda folder: (folder / name).write_text(content)


STATS = 'meta/stats.json'
STATE = 'observation.state'


def gray(image: Any) -> Any:
    return np.repeat(image.mean(axis=2, keepdims=True).astype(np.uint8), 3, axis=2)


def stats_of(key: str, name: str, change: Callable[[Any], Any]) -> Change:
    """Return a damage of a statistic of the whole set."""
    def damage(folder: Path) -> None:
        content = json.loads((folder / STATS).read_text())
        content[key][name] = change(np.array(content[key][name])).tolist()
        (folder / STATS).write_text(json.dumps(content))
    return damage


def episode_stats(key: str, name: str, value: Any) -> Change:
    return rewrite(EPISODES, cell(f'stats/{key}/{name}', 1, value))


def feature(*path: str, value: Any) -> Change:
    return change_json('meta/info.json', 'features', *path, value=value)


#: Damages of sets of any origin, without small pictures and checksums.
FOREIGN: dict[str, tuple[Change, str]] = {
    'image mean': (stats_of(FRONT, 'mean', lambda one: one + 0.1), f'another mean of {FRONT}'),
    'image mean of blue': (stats_of(FRONT, 'mean', lambda one: one * [[[1]], [[1]], [[0.8]]]),
                           f'another mean of {FRONT}'),
    'image std': (stats_of(FRONT, 'std', lambda one: one / 2), f'another std of {FRONT}'),
    'image levels': (stats_of(FRONT, 'mean', lambda one: 255 * one), f'another mean of {FRONT}'),
    'image shape': (stats_of(FRONT, 'mean', np.ravel), f'another mean of {FRONT}'),
    'colours exchanged': (stats_of(FRONT, 'mean', lambda one: one[::-1]), f'mean of {FRONT}'),
    'image quantiles': (stats_of(FRONT, 'q01', lambda one: one + 0.9),
                        f'order of q01 and q10 of {FRONT}'),
    'q01': (stats_of(STATE, 'q01', lambda one: one - 5), f'q01 of {STATE}'),
    'q90': (stats_of(STATE, 'q90', lambda one: one * 0.8), f'another q90 of {STATE}'),
    'q99 below q01': (stats_of(STATE, 'q99', lambda one: one - 3), f'q99 of {STATE}'),
    'q50 missing': (lambda folder: (folder / STATS).write_text(json.dumps({
        key: {name: one for name, one in found.items() if key != STATE or name != 'q50'}
        for key, found in json.loads((folder / STATS).read_text()).items()})), f'q50 of {STATE}'),
    'episode mean': (episode_stats(STATE, 'mean', [9.0, 9.0, 9.0]),
                     f'episodes has another mean of {STATE} than the rows of episode 1'),
    'episode max': (episode_stats('action', 'max', [0.0, 0.0, 0.0]), 'another max of action'),
    'episode q10': (episode_stats('action', 'q10', [9.0, 9.0, 2.0]), 'another q10 of action'),
    'episode image': (episode_stats(FRONT, 'mean', [[[0.9]], [[0.9]], [[0.9]]]),
                      f'another mean of {FRONT} than the rows of episode 1'),
    'episode stats missing': (episode_stats(STATE, 'std', None), f'another std of {STATE}'),
    'episode stats dropped': (rewrite(EPISODES, lambda table: table.drop_columns(
        [f'stats/action/{one}' for one in ('min', 'max', 'mean', 'std')])), 'min of action'),
    'task text': (rewrite('meta/tasks.parquet', cell('task', 0, 'place')),
                  'episode 0 has the tasks .*pick.*, but its rows have place'),
    'task of an episode': (rewrite(EPISODES, cell('tasks', 1, ['place'])),
                           'episode 1 has the tasks .*place.*, but its rows have pick'),
    'no task of an episode': (rewrite(EPISODES, cell('tasks', 1, [])), 'episode 1 has the tasks'),
    'two names of three': (feature('action', 'names', value=['a', 'b']),
                           'has 2 names of action for 3 numbers'),
    'name twice': (feature('action', 'names', value=['a', 'b', 'a']), 'a name of action twice'),
    'four names in an object': (feature(STATE, 'names', value={'axes': [*'abcd']}),
                                f'has 4 names of {STATE} for 3 numbers'),
    'rate of a video': (feature(FRONT, 'info', 'video.fps', value=60),
                        'video.fps 60, but it is 30'),
    'rate of 29.97': (feature(FRONT, 'info', 'video.fps', value=29.97), 'video.fps 29.97, but'),
    'codec of a video': (feature(FRONT, 'info', 'video.codec', value='av1'),
                         'video.codec av1, but it is h264'),
    'hevc of a video': (feature(FRONT, 'info', 'video.codec', value='hevc'), 'codec hevc, but it'),
    'height of a video': (feature(FRONT, 'info', 'video.height', value=121), 'video.height 121'),
    'chunks': (change_json('meta/info.json', 'chunks_size', value=0), 'has chunks_size 0, not'),
    'chunks of no number': (change_json('meta/info.json', 'chunks_size', value=None),
                            'has chunks_size None'),
    'data file left over': (lambda folder: shutil.copy(
        folder / DATA, folder / 'data/chunk-000/file-001.parquet'),
        '1 files belong to no episode: data/chunk-000/file-001.parquet'),
    'video file left over': (lambda folder: shutil.copy(
        folder / VIDEO, (folder / VIDEO).with_name('file-007.mp4')), '1 files belong to no'),
    'camera missing': (lambda folder: change_json('meta/info.json', 'features', value={
        key: one for key, one in info_of(folder)['features'].items() if key != FRONT})(folder),
        '1 files belong to no episode: videos/'),
    'image max': (stats_of(FRONT, 'max', lambda one: 2 + 0 * one), f'another max of {FRONT}'),
    'image max by a little': (stats_of(FRONT, 'max', lambda one: 1.004 + 0 * one),
                              f'another max of {FRONT}'),
    'image min': (stats_of(FRONT, 'min', lambda one: -1 + 0 * one), f'another min of {FRONT}'),
    'image q99': (stats_of(FRONT, 'q99', lambda one: 1.5 + 0 * one), f'another q99 of {FRONT}'),
    'image mean below min': (stats_of(FRONT, 'min', lambda one: 0.9 + 0 * one),
                             f'order of min and mean of {FRONT}'),
    'image count': (stats_of(FRONT, 'count', lambda one: one - 1), f'another count of {FRONT}'),
    'episode image max': (episode_stats(FRONT, 'max', [[[1.7]], [[1.0]], [[1.0]]]),
                          f'another max of {FRONT} than the rows of episode 1'),
    'episode count': (episode_stats(STATE, 'count', [29]),
                      f'another count of {STATE} than the rows of episode 1'),
    'episode image count': (episode_stats(FRONT, 'count', [999]),
                            f'another count of {FRONT} than the rows of episode 1'),
    'statistics of no feature': (change_json(STATS, 'force', value={'mean': [0.0]}),
                                 'there are statistics of force, which meta/info.json does not'),
    'statistics of an episode of no feature': (rewrite(EPISODES, lambda table: table.append_column(
        'stats/force/mean', pa.array([[0.0], [0.0]]))), 'there are statistics of force, which'),
    'colours lost': (frames(lambda images: [gray(image) for image in images]),
                     f'another mean of {FRONT}'),
}

#: Damages that only the checksums of an own set tell.
OWN: dict[str, tuple[Change, str]] = {
    'rolled states': (rewrite(DATA, lambda table: table.set_column(
        table.column_names.index(STATE), table.schema.field(STATE), pa.concat_arrays([
            table.column(STATE).combine_chunks().take([*range(1, 30), 0]),
            table.column(STATE).combine_chunks().take([*range(31, 60), 30])]))),
        f'{DATA} is not as it was written'),
    'episode numbers of stamps': (rewrite(DATA, cell('stamp_ns', 3, [1, 2, 3])), DATA),
    'robot': (change_json('meta/info.json', 'robot_type', value='x'),
              'meta/info.json is not as it'),
    'file missing': (lambda folder: (folder / PRINTS).unlink(), 'fingerprints.parquet cannot be'),
}

DAMAGES: dict[str, tuple[Change, str]] = {
    'row removed': (rewrite(DATA, lambda table: pa.concat_tables(
        [table.slice(0, 7), table.slice(8)])), 'row 7 has index 8, not 7'),
    'last row removed': (rewrite(DATA, lambda table: table.slice(0, 59)),
                         'there are 59 rows, but the episodes have 60'),
    'no rows': (rewrite(DATA, lambda table: table.slice(0, 0)), 'there are 0 rows'),
    'nan': (rewrite(DATA, cell('observation.state', 5, [1.0, np.nan, 0.0])),
            '1 values of observation.state that are not finite in rows from 0 on'),
    'null': (rewrite(DATA, cell('timestamp', 5, None)),
             '1 values of timestamp that are not finite'),
    'timestamp': (rewrite(DATA, cell('timestamp', 5, 0.2)),
                  '1 timestamps that are not frame_index / fps'),
    'task number': (rewrite(DATA, cell('task_index', 5, 1)), '1 task numbers without a task'),
    'column': (rewrite(DATA, lambda table: table.drop_columns(['action'])),
               'differ in the columns action'),
    'column twice': (rewrite(DATA, lambda table: table.append_column(
        'action', table.column('action'))), 'has 2 columns action, not one'),
    'column type': (rewrite(DATA, lambda table: table.set_column(
        table.column_names.index('action'), 'action', table.column('action').cast(
            pa.list_(pa.float64(), 3)))), '180 values of action that are float64, not float32'),
    'text in a column': (rewrite(DATA, lambda table: table.set_column(
        table.column_names.index('action'), 'action', pa.array(['a'] * 60))), 'action has'),
    'frames swapped': (frames(swapped), '1 frames show the picture of the row after theirs, the '),
    'frame missing': (frames(lambda images: images[:-1]),
                      'it has 59 frames, but its episodes have 60 rows'),
    'frames shifted': (frames(lambda images: [images[0], *images[:-1]]),
                       'frames show the picture of the row before theirs, the first is '),
    'frame black': (frames(lambda images: [*images[:9], images[9] * 0, *images[10:]]),
                    '1 frames differ from the pictures of the bag, the first is 9'),
    'frame rate': (frames(list, 29), '59 frames are not at k / 30 s'),
    'frame size': (frames(lambda images: [image[:100] for image in images]),
                   'frame 0 has 160x100 pixels, not 160x120'),
    'video cut': (lambda folder: (folder / VIDEO).write_bytes(
        (folder / VIDEO).read_bytes()[:-900]), 'is no video, or is damaged'),
    'no video': (lambda folder: (folder / VIDEO).unlink(), 'file-000.mp4'),
    'video a folder': (lambda folder: ((folder / VIDEO).unlink(), (folder / VIDEO).mkdir()),
                       'file-000.mp4'),
    'prints': (rewrite(PRINTS, lambda table: table.slice(1)), '59 pictures of observation.images'),
    'stats': (change_json('meta/stats.json', 'action', 'mean', value=[1, 2, 3]),
              'stats.json has another mean of action than the rows'),
    'stats huge': (change_json('meta/stats.json', 'action', 'max', value=[10**400] * 3),
                   'has another max of action'),
    'stats missing': (change_json('meta/stats.json', FRONT, value=3),
                      f'has no statistics of {FRONT}'),
    'count': (change_json('meta/stats.json', 'action', 'count', value=[59]), 'another count'),
    'frames': (change_json('meta/info.json', 'total_frames', value=61),
               'has total_frames 61, but the episodes have 60'),
    'tasks': (change_json('meta/info.json', 'total_tasks', value=2), 'has total_tasks 2, but'),
    'episodes': (change_json('meta/info.json', 'total_episodes', value='2'), 'total_episodes 2'),
    'splits': (change_json('meta/info.json', 'splits', value=5), 'has splits 5, but'),
    'fps': (change_json('meta/info.json', 'fps', value=True), 'has fps True, not an integer'),
    'path': (change_json('meta/info.json', 'data_path', value='../set/data.parquet/../../../x'),
             'data_path in meta/info.json is ../set.* not the path of a file in the set'),
    'zero byte': (change_json('meta/info.json', 'video_path', value='a\0b'), 'video_path in '),
    'dtype': (change_json('meta/info.json', 'features', 'action', 'dtype', value='int64'),
              '90 values of action that are float32, not int64'),
    'shape': (change_json('meta/info.json', 'features', 'action', 'shape', value=[2]),
              'action has 90 numbers in 30 rows, but its shape is'),
    'no index': (change_json('meta/info.json', 'features', 'index', 'dtype', value='int8'),
                 'has the feature index of int8'),
    'version': (change_json('meta/info.json', 'codebase_version', value='v2.1'),
                'has codebase_version v2.1, not v3.0'),
    'list': (text('meta/info.json', '[1]'), 'info.json has no object of JSON'),
    'no json': (text('meta/info.json', '{"a'), 'info.json cannot be read'),
    'deep json': (text('meta/stats.json', '[' * 10**5), 'stats.json cannot be read'),
    'episode length': (rewrite(EPISODES, cell('length', 1, 29)), 'has total_frames 60, but'),
    'episode begin': (rewrite(EPISODES, cell(f'videos/{FRONT}/from_timestamp', 1, 1.5)),
                      'episode 1 has from_timestamp 1.5, not 1.0'),
    'episode nan': (rewrite(EPISODES, cell(f'videos/{FRONT}/to_timestamp', 1, np.nan)),
                    'to_timestamp nan'),
    'episode negative': (rewrite(EPISODES, cell('data/file_index', 1, -1)), 'file_index -1'),
    'episode row': (rewrite(EPISODES, cell('dataset_from_index', 0, 7)),
                    'its 60 rows begin at row 7, but there are 60 rows'),
    'episode row below 0': (rewrite(EPISODES, cell('dataset_from_index', 0, -1)),
                            'has dataset_from_index -1'),
    'episode column': (rewrite(EPISODES, lambda table: table.drop_columns(['length'])),
                       'has 0 columns length, not one'),
    'no episodes': (rewrite(EPISODES, lambda table: table.slice(0, 0)), 'has no episode'),
    'not parquet': (text(DATA, 'PAR1 no'), 'file-000.parquet cannot be read'),
    'account': (change_json(SOURCES, 0, 'topics', 'front', 'before', value=7),
                'bags.json has 30 messages of front, but accounts for 37'),
    'negative account': (change_json(SOURCES, 0, 'topics', 'front', 'after', value=-3),
                         'bags.json has -3 for after of front, not an integer from 0 on'),
    'negative repeats': (change_json(SOURCES, 1, 'topics', 'front', 'reused', value=-1),
                         'bags.json has -1 for reused of front, not an integer from 0 on'),
    'used and dropped': (lambda folder: [
        change_json(SOURCES, 0, 'topics', 'front', name, value=value)(folder)
        for name, value in (('used', 0), ('dropped', 30))],
        'bags.json has 0 samples of front in rows and 0 rows that repeat one, but its episodes '
        'have 30 rows'),
    'bag missing': (lambda folder: (folder / SOURCES).write_text(json.dumps(json.loads(
        (folder / SOURCES).read_text())[:1])), 'bags.json has 1 of 2 episodes'),
    'one name of three': (feature('action', 'names', value=['action']),
                          'has 1 names of action for 3 numbers'),
    'no account': (change_json(SOURCES, 1, 'topics', value=[]), 'bags.json has no valid account'),
    'task table': (rewrite('meta/tasks.parquet', cell('task_index', 0, 4)), 'does not number its'),
}


def test_right_set_passes(made: Path, capsys: Errors) -> None:
    assert main(['--check', str(made)]) == 0
    errors = capsys.readouterr().err
    assert 'front: 60 samples used, 0 rows repeat one, 0 dropped, 0 before the first' in errors
    assert errors.endswith(
        f'is complete: 2 episodes, 60 rows, {FRONT}; the pictures are compared with the bags\n')


def test_right_set_of_others_passes(copied: Path, capsys: Errors) -> None:
    shutil.rmtree(copied / 'meta/opencv_tools')
    change_json('meta/info.json', 'splits', value={'test': '0:2'})(copied)
    assert main(['--check', str(copied)]) == 0
    assert 'not compared with their origin, which is unknown' in capsys.readouterr().err


@pytest.mark.parametrize('crf', [0, 51])
def test_pictures_of_any_quality_are_recognised(crf: int, tmp_path: Path) -> None:
    bag = Drive(seconds=1).write(tmp_path / 'a.mcap')
    assert convert(bag, tmp_path / 'set', *USUAL, '--crf', crf) == 0
    assert main(['--check', str(tmp_path / 'set')]) == 0


@pytest.mark.parametrize('name', DAMAGES)
def test_damage_is_named(name: str, copied: Path, capsys: Errors) -> None:
    damage, reason = DAMAGES[name]
    damage(copied)
    assert main(['--check', str(copied)]) == 1
    # rclpy prints errors of tasks of earlier tests, whenever their memory is freed.
    *problems, last = (line for line in capsys.readouterr().err.splitlines()
                       if not line.startswith('The following exception was never retrieved: '))
    assert any(re.search(reason, line) for line in problems), problems
    assert [line for line in problems if not line.startswith('img_convert: error: ')] == []
    assert re.search(r'set has \d+ errors$', last)


@pytest.mark.parametrize('name', FOREIGN)
def test_damage_of_a_foreign_set_is_named(name: str, copied: Path, capsys: Errors) -> None:
    damage, reason = FOREIGN[name]
    shutil.rmtree(copied / 'meta/opencv_tools')
    damage(copied)
    assert main(['--check', str(copied)]) == 1
    problems = capsys.readouterr().err.splitlines()
    assert any(re.search(reason, line) for line in problems), problems


@pytest.mark.parametrize('name', OWN)
def test_damage_of_an_own_set_is_named(name: str, copied: Path, capsys: Errors) -> None:
    damage, reason = OWN[name]
    damage(copied)
    assert main(['--check', str(copied)]) == 1
    assert re.search(reason, capsys.readouterr().err)


@pytest.mark.parametrize('key', [
    (feature('action', 'names', value=['actions'])), feature(STATE, 'names', value=None),
    feature(STATE, 'names', value={'motors': ['a', 'b', 'c']}),
    feature(FRONT, 'info', 'video.codec', value='libx264'), feature(FRONT, 'info', value=None),
    change_json('meta/info.json', 'robot_type', value=None)])
def test_other_right_metadata_pass(key: Change, copied: Path, capsys: Errors) -> None:
    shutil.rmtree(copied / 'meta/opencv_tools')
    key(copied)
    assert main(['--check', str(copied)]) == 0, capsys.readouterr().err


@pytest.mark.parametrize(('shape', 'names'), [
    ([2, 3], ['rows', 'columns']), ([480, 640, 3], ['height', 'width', 'channels']),
    ([8], ['state']), ([2], {'motors': ['a', 'b'], 'units': ['rad', 'm']}), ([7], []), ([7], {})])
def test_names_of_public_sets_pass(shape: list[int], names: Any) -> None:
    reader: Any = SimpleNamespace(info={'chunks_size': 1000}, video_keys=[], features={
        'a': {'dtype': 'float32', 'shape': shape, 'names': names}}, folder=Path('of others'))
    assert [*info_problems(reader, [])] == []


def set_of_pictures(folder: Path, images: list[Any], *words: object) -> Path:
    """Return a set of raw pictures of floats, at 30 Hz."""
    entries = []
    for number, image in enumerate(images):
        wire = array_to_wire(np.clip(image, 0, 255).astype(np.uint8), find_encoding('bgr8'),
                             WireHeader(*divmod(BEGAN + number * NANO // 30, NANO), 'cam'))
        entries.append(Entry(BEGAN + number * NANO // 30, image_to_cdr(wire), '/lamp'))
    bag = write_mcap(folder / 'a.mcap', entries)
    assert convert(bag, folder / 'set', '--image', 'front=/lamp', *words) == 0
    return folder / 'set'


@pytest.mark.parametrize('sigma', [17, 40, 90, 63])
@pytest.mark.parametrize('crf', [23, 40])
def test_noise_that_the_codec_takes_away_is_no_error(
        crf: int, sigma: int, tmp_path: Path, capsys: Errors) -> None:
    noise = np.random.default_rng(7).normal(128, sigma, (96, 128, 3))
    folder = set_of_pictures(
        tmp_path, [np.roll(noise, 3 * number, axis=1) for number in range(20)], '--crf', crf)
    for name in ('meta/opencv_tools/files.json', 'meta/opencv_tools/fingerprints.parquet'):
        (folder / name).unlink()
    capsys.readouterr()
    assert main(['--check', str(folder)]) == 0, capsys.readouterr()


@pytest.mark.parametrize(('height', 'width'), [(7, 5), (48, 64), (240, 320), (31, 33)])
@pytest.mark.parametrize('crf', [23, 37, 44, 51])
def test_pictures_that_the_codec_changes_a_lot_are_no_error(
        crf: int, height: int, width: int, tmp_path: Path, capsys: Errors) -> None:
    noise = np.random.default_rng(5)
    set_of_pictures(tmp_path, [
        noise.integers(0, 256, (height, width, 3)) for _ in range(60)], '--crf', crf)
    capsys.readouterr()
    assert main(['--check', str(tmp_path / 'set')]) == 0, capsys.readouterr()


@pytest.mark.parametrize(('step', 'texture'), [(0.5, 2.0), (1.0, 0.0), (2.0, 0.0), (0.3, 5.0)])
def test_slow_changes_of_light_are_no_error(
        step: float, texture: float, tmp_path: Path, capsys: Errors) -> None:
    noise = np.random.default_rng(3)
    still = noise.integers(60, 120, (120, 160, 3)) if texture else np.full((120, 160, 3), 40)
    set_of_pictures(tmp_path, [
        still + step * number + noise.normal(0, texture, still.shape) for number in range(60)])
    capsys.readouterr()
    assert main(['--check', str(tmp_path / 'set')]) == 0
    assert re.search(r'cannot tell whether \d+ of 60 rows are shifted', capsys.readouterr().err)


def test_video_with_another_checksum_is_an_error(copied: Path, capsys: Errors) -> None:
    path, *_ = copied.glob('videos/**/*.mp4')
    with path.open('ab') as file:
        file.write(b'\0\0\0\x08free')  # an empty box, which all readers ignore
    assert main(['--check', str(copied)]) == 1
    assert f'{path.name} is not as it was written' in capsys.readouterr().err


def test_missing_checksums_are_said(copied: Path, capsys: Errors) -> None:
    (copied / 'meta/opencv_tools/files.json').unlink()
    assert main(['--check', str(copied)]) == 0
    assert 'files.json has no checksum of data/chunk-000/file-000.parquet, meta/' in (
        capsys.readouterr().err)


@pytest.mark.parametrize('name', [
    'meta/stats.json', 'data/chunk-000/file-000.parquet', 'meta/opencv_tools/bags.json', ''])
def test_file_without_checksum_is_said(name: str, copied: Path, capsys: Errors) -> None:
    path = copied / 'meta/opencv_tools/files.json'
    sums = json.loads(path.read_text())
    for one in [name] if name else [*sums]:
        del sums[one]
    path.write_text(json.dumps(sums))
    assert main(['--check', str(copied)]) == 0
    assert f'files.json has no checksum of {name}' in capsys.readouterr().err


def test_large_row_group_is_refused(
        copied: Path, capsys: Errors, monkeypatch: pytest.MonkeyPatch) -> None:
    # Equal numbers need few bytes in the file, but not in memory.
    rewrite(DATA, lambda table: pa.table({name: table.column(name).take(
        [0] * 20_000) for name in table.column_names}))(copied)
    assert (copied / DATA).stat().st_size < 20_000
    monkeypatch.setattr(set_reader, '_MAX_GROUP', 1 << 20)
    assert main(['--check', str(copied)]) == 1
    assert 'has a row group of ' in capsys.readouterr().err


json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-10**30, 10**30) | st.floats() | st.text(max_size=5)
    | st.sampled_from(['v3.0', 'video', 'float32', '../a', '{video_key}', '\0', '\ud800',
                       'a' * 300]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(
        st.sampled_from(['dtype', 'shape', 'index', 'action', 'train', 'é']), inner, max_size=3),
    max_leaves=6)


def problems_of(folder: Path) -> list[str]:
    """Return the problems of a set; no other exception than a DatasetError is allowed."""
    try:
        reader = SetReader(folder)
        episodes = reader.episodes()
        columns: dict[str, Any] = {}
        frames = FrameStatistics([row['length'] for row in episodes])
        reader.on_frame = frames.add
        return [*row_problems(reader, episodes, columns), *info_problems(reader, episodes),
                *account_problems(reader, episodes, []), *file_problems(reader, episodes),
                *task_problems(reader, episodes, columns.get('task_index', np.zeros(0))),
                *video_problems(reader, episodes),
                *statistics_problems(reader, episodes, columns, frames)]
    except DatasetError as err:
        return [str(err)]


@settings(max_examples=60, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_value_in_json_is_too_hostile(small: Path, tmp_path: Path, data: st.DataObject) -> None:
    folder = tmp_path / 'set'
    if not folder.exists():
        shutil.copytree(small, folder)
        (folder / VIDEO).unlink()
    name = data.draw(st.sampled_from(['info', 'info', 'stats']))
    original = json.loads((small / f'meta/{name}.json').read_text())
    content = inner = json.loads(json.dumps(original))
    for _ in range(data.draw(st.integers(0, 3))):
        if isinstance(inner, dict) and inner:
            parent, key = inner, data.draw(st.sampled_from(sorted(inner)))
            inner = inner[key]
    if content is inner:
        content = data.draw(json_values)
    else:
        parent[key] = data.draw(json_values)
    (folder / f'meta/{name}.json').write_text(json.dumps(content))
    problems = problems_of(folder)
    (folder / f'meta/{name}.json').write_text(json.dumps(original))
    assert problems and all('\n' not in line and line.isprintable() for line in problems)


columns = st.sampled_from([
    pa.int64(), pa.float64(), pa.string(), pa.bool_(), pa.list_(pa.float32()), pa.binary(),
    pa.timestamp('ns'), pa.decimal128(5), pa.uint64(), pa.dictionary(pa.int32(), pa.string())])


@settings(max_examples=50, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_table_is_too_hostile(small: Path, tmp_path: Path, data: st.DataObject) -> None:
    folder = tmp_path / 'set'
    if not folder.exists():
        shutil.copytree(small, folder)
    name = data.draw(st.sampled_from([DATA, EPISODES, PRINTS, 'meta/tasks.parquet']))
    table = pq.read_table(small / name)
    column = data.draw(st.sampled_from([
        one for one in table.column_names if not one.startswith('stats/')]))
    kind = data.draw(columns)
    values = data.draw(st.lists(st.sampled_from([None, 0, 1, 7]), min_size=table.num_rows,
                                max_size=table.num_rows))
    forms = {'string': str, 'binary': lambda one: bytes(one), 'bool': bool,
             'list<': lambda one: [float(one)], 'dict': str}
    form = next((call for start, call in forms.items() if str(kind).startswith(start)), int)
    array = pa.array([None if one is None else form(one) for one in values], kind)
    changed = table.set_column(table.column_names.index(column), column, array)
    pq.write_table(changed, folder / name)
    problems = problems_of(folder)
    shutil.copy(small / name, folder / name)
    assert all('\n' not in line and line.isprintable() for line in problems)
    # Only texts of tasks, numbers of the table itself, and the same number 0 may be replaced.
    same = changed
    if pa.types.is_integer(kind) and pa.types.is_integer(table.schema.field(column).type):
        same = changed.cast(table.schema)  # unsigned integers may be the same numbers
    assert problems or same.equals(table) or column.startswith(('task', 'meta/'))


def test_names_of_a_hostile_set_are_printable(copied: Path, capsys: Errors) -> None:
    info = info_of(copied)
    info['features']['\x1b[31m<b>\n'] = {'dtype': 'float32', 'shape': [1], 'names': None}
    (copied / 'meta/info.json').write_text(json.dumps(info))
    assert main(['--check', str(copied)]) == 1
    assert r'\x1b[31m<b>\n' in capsys.readouterr().err
