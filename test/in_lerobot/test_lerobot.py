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

"""Data sets that img_convert has written, read by LeRobot and by the library `datasets`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import datasets
import numpy as np
from pyarrow import parquet
import pytest
from reading import (
    aggregate_datasets, aggregate_stats, CAMERAS, compute_episode_stats, expected, FOLDER,
    get_feature_stats, LeRobotDataset, load, number_of, sample_images, StreamingLeRobotDataset)
import torch

SETS = ('first', 'second')
VECTORS = ('observation.state', 'action', 'command', 'lift')
INDICES = ('timestamp', 'frame_index', 'episode_index', 'index', 'task_index')
QUANTILES = {'q01': np.min, 'q10': np.min, 'q50': np.min, 'q90': np.max, 'q99': np.max}
TOLERANCE = 1e-4
DEPTH = 'observation.images.wrist_depth'


def check_item(item: dict[str, Any], row: dict[str, Any]) -> None:
    """Check that an item is a row that was expected."""
    assert item['task'] == row['task']
    for key in ('timestamp', *VECTORS):
        assert np.asarray(item[key]).tolist() == np.float32(row[key]).tolist(), key
    for key in CAMERAS:
        assert item[key].shape == (3, 120, 160)
        assert number_of(item[key]) == row['picture'], (key, row)


@pytest.mark.parametrize('name', SETS)
def test_every_item(name: str) -> None:
    dataset, rows = load(name), expected(name)
    assert len(dataset) == dataset.num_frames == len(rows)
    assert dataset.num_episodes == rows[-1]['episode'] + 1
    assert dataset.meta.robot_type == 'so101'
    for index, row in enumerate(rows):
        item = dataset[index]
        check_item(item, row)
        assert int(item['index']) == index
        assert int(item['episode_index']) == row['episode']
    assert len({row['picture'] for row in rows}) > len(rows) / 3


def test_selected_episodes() -> None:
    dataset = load('first', episodes=[1, 2])
    rows = [row for row in expected('first') if row['episode'] > 0]
    assert len(dataset) == len(rows)
    for item, row in zip((dataset[index] for index in range(len(rows))), rows):
        check_item(item, row)


def test_delta_timestamps() -> None:
    """Items with rows before and after, which are padded at the borders of an episode."""
    steps = (-3, -1, 0, 2)
    deltas = [step / 25 for step in steps]
    dataset = load('first', delta_timestamps=dict.fromkeys(
        (*CAMERAS, 'observation.state', 'action', 'lift'), deltas))
    rows = expected('first')
    for index, row in enumerate(rows):
        if index % 4 and row['episode'] == rows[max(0, index - 3)]['episode']:
            continue  # neither every fourth row nor after the begin of an episode
        item = dataset[index]
        episode = [other for other in rows if other['episode'] == row['episode']]
        first = rows.index(episode[0])
        for place, step in enumerate(steps):
            wanted = min(max(index + step - first, 0), len(episode) - 1)
            is_padded = wanted != index + step - first
            for key in CAMERAS:
                assert bool(item[f'{key}_is_pad'][place]) == is_padded
                assert number_of(item[key][place]) == episode[wanted]['picture']
            for key in ('observation.state', 'action', 'lift'):
                assert np.asarray(item[key][place]).tolist() == np.float32(
                    episode[wanted][key]).tolist()


def test_batches_of_a_loader() -> None:
    dataset, rows = load('second'), expected('second')
    loader = torch.utils.data.DataLoader(dataset, batch_size=8, shuffle=True)
    seen: list[int] = []
    for batch in loader:
        for index, image in zip(batch['index'].tolist(), batch[CAMERAS[0]]):
            assert number_of(image) == rows[index]['picture']
            seen.append(index)
    assert sorted(seen) == list(range(len(rows)))


def test_streaming() -> None:
    """Episodes are read in parts; each row comes once, in any order."""
    dataset = StreamingLeRobotDataset(
        'opencv_tools/first', root=FOLDER / 'first', shuffle=False)
    rows = expected('first')
    seen: list[int] = []
    for item in dataset:
        index = int(item['index'])
        check_item(item, rows[index])
        seen.append(index)
    assert sorted(seen) == list(range(len(rows)))


def test_tasks() -> None:
    meta = load('first').meta
    assert meta.tasks['task_index'].to_dict() == {'pick': 0, 'place': 1}
    assert [meta.episodes[number]['tasks'] for number in range(3)] == [
        ['pick'], ['place'], ['pick']]


def episode_pictures(name: str, number: int) -> list[str]:
    """Return the path of the picture of each row of an episode."""
    rows = [row for row in expected(name) if row['episode'] == number]
    files = sorted((FOLDER / 'pictures' / f'{name}_{number}').glob('*.png'),
                   key=lambda path: int(path.stem))
    return [str(files[row['nth']]) for row in rows]


def picture_statistics(paths: list[str]) -> dict[str, Any]:
    """
    Return the statistics of pictures by LeRobot.

    Its ``compute_episode_stats`` squares bytes, so that the deviation is wrong, often 0. This is
    the same with numbers that have room for their squares.
    """
    found = get_feature_stats(sample_images(paths).astype(np.float64), (0, 2, 3), True)
    return {name: value if name == 'count' else np.squeeze(value / 255, axis=0)
            for name, value in found.items()}


def check_statistics(ours: dict[str, Any], theirs: dict[str, Any], what: object) -> None:
    """Compare statistics of a feature."""
    assert ours.keys() == theirs.keys(), what
    for name, value in theirs.items():
        found = np.array(ours[name])
        if name == 'std' and np.max(np.abs(theirs['mean'])) > 1e12:
            continue  # times: LeRobot subtracts their squares, which leaves nothing
        assert found.shape == np.shape(value), (what, name)
        assert found == pytest.approx(np.array(value), abs=TOLERANCE, rel=TOLERANCE), (what, name)


@pytest.mark.parametrize('name', SETS)
def test_statistics(name: str) -> None:
    """Statistics of episodes, and of the set, are those of LeRobot for the same rows."""
    dataset = load(name)
    meta, theirs = dataset.meta, []
    described = parquet.read_table(FOLDER / name / 'meta' / 'episodes').to_pylist()
    table = dataset.hf_dataset.with_format('numpy')
    features = {key: feature for key, feature in meta.features.items()
                if feature['dtype'] != 'video'}
    for number in range(dataset.num_episodes):
        episode = table.filter(lambda index, wanted=number: index == wanted,
                               input_columns='episode_index')
        data = {key: np.array(episode[key]) for key in features}
        computed = compute_episode_stats(data, features)
        computed[CAMERAS[0]] = picture_statistics(episode_pictures(name, number))
        theirs.append(computed)
        row = described[number]
        for key, values in computed.items():
            ours = {statistic: np.array(row[f'stats/{key}/{statistic}']) for statistic in values}
            check_statistics(ours, values, (number, key))
    total = aggregate_stats(theirs)
    for key in total:  # as newer versions do it; 0.4.4 has the mean of the quantiles
        total[key] |= {quantile: choose([one[key][quantile] for one in theirs], axis=0)
                       for quantile, choose in QUANTILES.items()}
    for key, values in total.items():
        check_statistics(meta.stats[key], values, key)
    assert meta.stats.keys() == {*total, CAMERAS[1]}


def write_by_lerobot(folder: Path, like: Any) -> None:
    """Write the rows of a set by LeRobot."""
    written = LeRobotDataset.create(
        'opencv_tools/theirs', fps=like.fps, root=folder, robot_type=like.meta.robot_type,
        features={key: {**feature, 'shape': tuple(feature['shape'])}
                  for key, feature in like.meta.features.items() if key not in INDICES},
        use_videos=False)
    rows = expected('vectors')
    for index, (row, after) in enumerate(zip(rows, [*rows[1:], {'episode': -1}])):
        item = like[index]
        written.add_frame({
            key: np.asarray(item[key]).reshape(feature['shape'])
            for key, feature in like.meta.features.items() if key not in INDICES
        } | {'task': row['task']})
        if after['episode'] != row['episode']:
            written.save_episode()
    written.finalize()


def test_set_that_lerobot_writes(tmp_path: Path) -> None:
    """The same rows in files of LeRobot have the same types, and both sets can be joined."""
    ours, folder = load('vectors'), tmp_path / 'theirs'
    write_by_lerobot(folder, ours)
    root = FOLDER / 'vectors'
    for name in ('data/chunk-000/file-000.parquet', 'meta/episodes/chunk-000/file-000.parquet'):
        tables = [parquet.read_table(path / name) for path in (root, folder)]
        types = [{field.name: str(field.type).replace('element', 'item')
                  for field in table.schema} for table in tables]
        assert types[0] == types[1], name
        columns = [name for name in types[0] if not name.startswith('stats/')]
        found = [table.select(columns).to_pylist() for table in tables]
        assert found[0] == found[1], name
    loaded = load(str(folder)).meta
    assert ours.meta.tasks['task_index'].to_dict() == loaded.tasks['task_index'].to_dict()
    assert ours.meta.stats.keys() == loaded.stats.keys()
    texts = [json.loads((path / 'meta/info.json').read_text()) for path in (root, folder)]
    assert texts[0].keys() == texts[1].keys()
    for key, value in texts[1].items():
        if key != 'features':
            assert texts[0][key] == value, key
    assert {key: {**feature, 'shape': list(feature['shape'])}
            for key, feature in texts[1]['features'].items()} == texts[0]['features']

    for order in ((root, folder), (folder, root)):
        target = tmp_path / order[0].name
        aggregate_datasets(['opencv_tools/a', 'opencv_tools/b'], 'opencv_tools/joined',
                           roots=list(order), aggr_root=target.with_name(f'{target.name}_joined'))
        both = load(str(tmp_path / f'{order[0].name}_joined'))
        rows = expected('vectors') * 2
        assert len(both) == len(rows)
        for index, row in enumerate(rows):
            assert np.asarray(both[index]['action']).tolist() == np.float32(
                row['action']).tolist()


def test_aggregation(tmp_path: Path) -> None:
    """Two of our sets, joined by LeRobot."""
    aggregate_datasets(
        [f'opencv_tools/{name}' for name in SETS], 'opencv_tools/both',
        roots=[FOLDER / name for name in SETS], aggr_root=tmp_path / 'both')
    dataset = load(str(tmp_path / 'both'))
    rows = [row for name in SETS for row in expected(name)]
    assert len(dataset) == len(rows)
    for index, row in enumerate(rows):
        check_item(dataset[index], row)
    assert sorted(dataset.meta.tasks.index) == ['pick', 'place', 'push']


@pytest.mark.parametrize(('name', 'allowed'), [('depth', 2.3), ('depth_linear', 1.0)])
def test_depth(name: str, allowed: float) -> None:
    """Depths in millimetres differ by less than a step, and have the statistics of the set."""
    dataset, images = load(name), np.load(FOLDER / f'{name}.npy')
    assert len(dataset) == len(images)
    found = np.array([np.asarray(dataset[index][DEPTH]) for index in range(len(images))])
    assert found.shape == (len(images), 1, *images.shape[1:])
    has_depth = images > 0
    assert np.abs(found[:, 0] - images)[has_depth].max() <= allowed
    statistics = dataset.meta.stats[DEPTH]
    for key, value in (('min', found.min()), ('max', found.max()), ('mean', found.mean()),
                       ('std', found.std())):
        assert np.asarray(statistics[key]).ravel() == pytest.approx([value], rel=0.01, abs=1), key


@pytest.mark.parametrize('part', ['data', 'meta/episodes'])
def test_parquet_files(part: str, tmp_path: Path) -> None:
    """The library `datasets` reads the rows and the episodes, with nothing but their files."""
    files = [str(path) for path in sorted((FOLDER / 'first' / part).rglob('*.parquet'))]
    loaded = datasets.load_dataset('parquet', data_files=files, cache_dir=str(tmp_path))['train']
    single = datasets.Dataset.from_parquet(files, cache_dir=str(tmp_path / 'other'))
    rows = expected('first')
    for table in (loaded, single):
        if part == 'data':
            assert len(table) == len(rows)
            assert np.array(table['observation.state']) == pytest.approx(
                np.array([row['observation.state'] for row in rows]), abs=1e-6)
            assert table['lift'][:] == pytest.approx([row['lift'] for row in rows], abs=1e-6)
        else:
            assert table['length'][:] == [
                sum(row['episode'] == number for row in rows) for number in range(3)]
    if part == 'data':
        features = json.loads((FOLDER / 'first/meta/info.json').read_text())['features']
        assert {*loaded.column_names} == {
            key for key, feature in features.items() if feature['dtype'] != 'video'}
