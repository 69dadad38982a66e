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

"""Single samples in WebDataset and Parquet: the JPEG of the bag, keys, numbers and texts."""

from __future__ import annotations

import json
from pathlib import Path
import tarfile
from typing import Any

import cv2
from dataset_bags import BEGAN, Drive, joint_values, jpeg_entry, NANO, number_of
from dataset_sets import convert, USUAL
import numpy as np
from opencv_tools.convert.cli import main
from opencv_tools.image.cdr import cdr_to_compressed_image
import pyarrow.parquet as pq
import pytest

TOPIC = '/cam0/image_raw/compressed'
Errors = pytest.CaptureFixture[str]


def jpegs(drive: Drive) -> dict[int, bytes]:
    """Return the JPEG of each picture of a bag by its time."""
    images = [cdr_to_compressed_image(entry.data) for entry in drive.entries()
              if entry.topic == TOPIC]
    return {image.header.sec * NANO + image.header.nanosec: bytes(image.data)
            for image in images}


def read_tar(path: Path) -> list[dict[str, bytes]]:
    """Return the samples as the library webdataset groups them: by the name before the first ."""
    found: dict[str, dict[str, bytes]] = {}
    with tarfile.open(path) as archive:
        for member in archive:
            key, _, suffix = member.name.partition('.')
            file = archive.extractfile(member)
            assert file and member.isfile() and suffix not in found.setdefault(key, {})
            found[key][suffix] = file.read()
    assert list(found) == sorted(found)
    return [{'__key__': key.encode(), **files} for key, files in found.items()]


def check_numbers(sample: dict[str, Any], row: int, drive: Drive, action_of: Any) -> None:
    stamp_ns = sample['stamp_ns']['/joint_states.position']
    assert np.allclose(sample['observation.state'], joint_values(stamp_ns), atol=1e-9)
    assert np.allclose(sample['action'], action_of(stamp_ns), atol=1e-9)
    assert (sample['episode'], sample['frame'], sample['task']) == (0, row, 'pick')
    assert sample['timestamp'] == row / 30
    assert sample['stamp_ns']['front'] <= BEGAN + row * NANO // 30


def test_webdataset(tmp_path: Path) -> None:
    drive = Drive(seconds=1, lost=frozenset({7}))
    drive.write(tmp_path / 'bags/sub/a.mcap')
    Drive(seconds=0.5).write(tmp_path / 'bags/b.mcap')
    assert convert(tmp_path / 'bags', tmp_path / 'set', *USUAL, form='webdataset') == 0
    described = json.loads((tmp_path / 'set/bags.json').read_text())
    assert [part['bag'] for part in described] == ['b.mcap', 'sub/a.mcap']
    assert len(list((tmp_path / 'set').glob('*.tar'))) == 2
    samples = read_tar(next((tmp_path / 'set').glob('sub_a.mcap-*.tar')))
    assert len(samples) == 30 == described[1]['episodes'][0]['length']
    pictures = jpegs(drive)
    for row, sample in enumerate(samples):
        assert sample.keys() == {'__key__', 'front.jpg', 'json'}
        values = json.loads(sample['json'])
        assert values['bag'] == 'sub/a.mcap'
        check_numbers(values, row, drive, lambda time_ns: np.multiply(10, joint_values(time_ns)))
        assert sample['front.jpg'] == pictures[values['stamp_ns']['front']]
        assert number_of(cv2.imdecode(np.frombuffer(sample['front.jpg'], np.uint8), 1)) == (
            6 if row == 7 else row)


def test_parquet_with_next_action(tmp_path: Path) -> None:
    drive = Drive(seconds=4)
    drive.write(tmp_path / 'a')  # SQLite
    words = (*USUAL[:4], '--action', 'next', '--task', 'pick')
    assert convert(tmp_path / 'a', tmp_path / 'set', *words, form='parquet') == 0
    rows = pq.read_table(next((tmp_path / 'set').glob('*.parquet'))).to_pylist()
    assert len(rows) == 119  # of more than one row group
    pictures = jpegs(drive)
    for row, sample in enumerate(rows):
        sample['stamp_ns'] = {name.removeprefix('stamp_ns.'): value
                              for name, value in sample.items() if name.startswith('stamp_ns.')}
        following = BEGAN + (row + 1) * NANO // 30
        check_numbers(sample, row, drive, lambda _, following=following: joint_values(
            following - (following - BEGAN) % (NANO // 100)))
        assert sample['observation.images.front'] == pictures[sample['stamp_ns']['front']]


@pytest.mark.parametrize('form', ['webdataset', 'parquet'])
def test_damaged_pictures_and_merged_shards(form: str, tmp_path: Path, capsys: Errors) -> None:
    drive = Drive(seconds=0.5, lost=frozenset({5}))
    bad = jpeg_entry(5, drive.picture_ns(5))
    drive.others = [bad._replace(data=bad.data.replace(b'\xff\xd8', b'\xff\0'))]
    drive.write(tmp_path / 'bags/a.mcap')
    Drive(seconds=0.5).write(tmp_path / 'bags/b.mcap')
    for shard, status in (('1', 1), ('2', 0)):
        assert convert(tmp_path / 'bags', tmp_path / shard, *USUAL, '--shard', f'{shard}/2',
                       form=form) == status
    assert 'front: 1 pictures cannot be decoded' in capsys.readouterr().err
    assert main(['--merge', *(str(tmp_path / one) for one in ('1', '2', 'set'))]) == 1
    assert convert(tmp_path / 'bags', tmp_path / 'whole', *USUAL, form=form) == 1
    assert {path.name: path.read_bytes() for path in (tmp_path / 'set').iterdir()} == {
        path.name: path.read_bytes() for path in (tmp_path / 'whole').iterdir()}
    assert convert(tmp_path / 'bags', tmp_path / '3', *USUAL, '--shard', '2/2', fps=10,
                   form=form) == 0
    assert main(['--merge', *(str(tmp_path / one) for one in ('1', '3', 'bad'))]) == 2
    assert 'the shards have different options; run all of them' in capsys.readouterr().err
    assert not (tmp_path / 'bad').exists()


@pytest.mark.parametrize('shards', [1, 3])
def test_keys_are_unique_over_bags_and_shards(shards: int, tmp_path: Path) -> None:
    bags = [f'{day}/run_{number}.mcap' for day in ('a', 'b') for number in range(3)]
    for bag in [*bags, 'x.y.mcap']:
        Drive(seconds=0.1, jitter_ns=len(bag)).write(tmp_path / 'bags' / bag)
    camera = 'a' * 64
    words = ('--image', f'{camera}={TOPIC}', *USUAL[2:])
    for shard in range(1, shards + 1):
        assert convert(tmp_path / 'bags', tmp_path / f'{shard}', *words, '--shard',
                       f'{shard}/{shards}', form='webdataset') == 0
    assert main(['--merge', *(str(tmp_path / f'{one + 1}') for one in range(shards)),
                 str(tmp_path / 'set')]) == 0
    samples = [sample for path in (tmp_path / 'set').glob('*.tar') for sample in read_tar(path)]
    assert len(samples) == 21 == len({sample['__key__'] for sample in samples})
    assert all(sample.keys() == {'__key__', f'{camera}.jpg', 'json'} for sample in samples)
