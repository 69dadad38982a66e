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

"""Folders that appear complete, and names that are hostile."""

from __future__ import annotations

import json
import os
from pathlib import Path
import shutil

from dataset_bags import Drive, jpeg_entry, plain_entry
from dataset_sets import CAMERA, convert, JOINTS_STATE, numbers_of, USUAL
from hypothesis import given, strategies as st
from opencv_tools.convert.cli import main
from opencv_tools.datasets.folders import locked_parts, natural_key, part_folder
import pytest

Errors = pytest.CaptureFixture[str]
letters = st.text(st.characters(exclude_characters='/\0', exclude_categories=['Cs'])
                  | st.sampled_from('._-'), min_size=1, max_size=90)


@given(letters, letters)
def test_part_of_any_bag_has_a_folder_of_its_own(one: str, other: str) -> None:
    folder = part_folder(Path('/parts'), one)
    assert folder.parent == Path('/parts') and len(folder.name) < 100
    # Folders with a . are unfinished ones.
    assert not folder.name.startswith('.') and folder.name.isascii()
    assert (part_folder(Path('/parts'), other) == folder) == (one == other)


def test_natural_order_of_bags() -> None:
    names = ['run10/b', 'run2/x', 'a/10.mcap', 'run10/a', 'b', 'a/2.mcap']
    assert sorted(names, key=natural_key) == [
        'a/2.mcap', 'a/10.mcap', 'b', 'run2/x', 'run10/a', 'run10/b']


HOSTILE = [
    'a\nb.mcap', 'x..\x1b[31m<b>.mcap', 'x' * 10 + '.' + 'y' * 54 + '.mcap', 'n' * 250 + '.mcap',
    '-rf.mcap', "a'; rm.mcap", os.fsdecode(b'\xff\xfe.mcap'), '{video_key}.mcap', 'é.mcap']


@pytest.mark.parametrize('form', ['lerobot', 'webdataset', 'parquet'])
def test_hostile_names_of_bags(form: str, tmp_path: Path, capsys: Errors) -> None:
    bag = Drive(seconds=0.1).write(tmp_path / 'a.mcap')
    (tmp_path / 'bags/..x').mkdir(parents=True)
    for name in HOSTILE:
        shutil.copy(bag, tmp_path / 'bags/..x' / name)
    assert convert(tmp_path / 'bags/..x', tmp_path / 'set', *USUAL, form=form) == 0
    errors = capsys.readouterr().err
    assert all(line.isprintable() for line in errors.splitlines())
    assert len([line for line in errors.splitlines() if '3 rows in 1 episodes' in line]) == 9
    assert sorted(path.name for path in tmp_path.iterdir()) == ['a.mcap', 'bags', 'set']
    assert all(path.name.isascii() for path in (tmp_path / 'set').rglob('*'))
    if form == 'lerobot':
        described = json.loads((tmp_path / 'set/meta/opencv_tools/bags.json').read_text())
        assert {part['bag'] for part in described} == {*HOSTILE}
        assert main(['--check', str(tmp_path / 'set')]) == 0
    else:
        assert len([*(tmp_path / 'set').iterdir()]) == 10


def test_hostile_names_of_topics_and_joints(tmp_path: Path, capsys: Errors) -> None:
    topic = '/<script>\x1b[2J\n'
    drive = Drive(seconds=0.2, others=[
        *(jpeg_entry(number, Drive().picture_ns(number), topic) for number in range(6)),
        plain_entry(Drive().picture_ns(1), 1.0, '/x\x07', 'Float64')])
    bag = drive.write(tmp_path / 'a.mcap')
    assert convert(bag, tmp_path / 'set', '--image', f'front={topic}', *JOINTS_STATE,
                   '--dry-run') == 0
    shown = ''.join(capsys.readouterr())
    assert shown.replace('\n', '').isprintable() and r'/<script>\x1b[2J\n' in shown
    assert not (tmp_path / 'set').exists()
    assert convert(bag, tmp_path / 'set', '--image', f'front={topic}', *JOINTS_STATE) == 0
    assert numbers_of(tmp_path / 'set') == [*range(6)]


@pytest.mark.parametrize(('words', 'reason'), [
    (('--image', '../x=/cam0/image_raw/compressed'), "'../x=/cam0/image_raw/compressed' does not"),
    (('--image', 'a.b=/cam'), 'does not name a camera; give NAME=/topic'),
    (('--image', '=/cam'), 'does not name a camera'),
    (('--image', f'{"a" * 65}=/cam'), 'does not name a camera'),
    (('--image', 'a=/b', '--image', 'a=/c'), "'a' is given twice"),
    (('--vector', 'index=/joint_states.position'), "cannot have the name 'index', which every"),
    (('--state', 'joint_states'), "'joint_states' is not a topic with fields"),
    (('--state', '/a..b'), "'/a..b' is not a topic with fields"),
    (('--state', '/a.b', '--state', '/a.b'), '/a.b is given twice'),
    (('--action', 'next'), '--action next needs --state'),
    (('--image', 'a=/b', '--task', 'a\udcffb'), r"--task 'a\udcffb' is not a printable text"),
    ((), 'nothing is selected: give --image')])
def test_names_of_features_are_checked(
        words: tuple[str, ...], reason: str, tmp_path: Path, capsys: Errors) -> None:
    assert convert(tmp_path, tmp_path / 'set', *words) == 2
    assert reason in capsys.readouterr().err


@pytest.mark.parametrize('target', ['link', 'full', 'file', 'bags/..', '/'])
def test_target_that_must_not_be_replaced(target: str, tmp_path: Path, capsys: Errors) -> None:
    bag = Drive(seconds=0.1).write(tmp_path / 'bags/a.mcap')
    other = tmp_path / 'full'
    other.mkdir()
    (other / 'thesis.tex').write_text('all')
    (tmp_path / 'link').symlink_to(other)
    (tmp_path / 'file').write_text('b')
    assert convert(bag, tmp_path / target, *USUAL, '--overwrite') == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert any(text in error for text in (
        'is not a folder; give a new one', 'has files that are no data set', 'has no name'))
    assert (other / 'thesis.tex').read_text() == 'all' and (tmp_path / 'link').is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ['bags', 'file', 'full', 'link']


def test_a_set_is_replaced_only_with_overwrite(tmp_path: Path, capsys: Errors) -> None:
    bag = Drive(seconds=0.2).write(tmp_path / 'a.mcap')
    target = tmp_path / 'set'
    target.mkdir()  # an empty folder may be replaced
    assert convert(bag, target, *USUAL) == 0
    assert convert(bag, target, *CAMERA) == 2
    assert 'is a data set already; give a new folder, or replace it with --overwrite' in (
        capsys.readouterr().err)
    assert convert(bag, target, *CAMERA, '--overwrite', fps=10) == 0
    assert numbers_of(target) == [0, 3]
    assert sorted(path.name for path in tmp_path.iterdir()) == ['a.mcap', 'set']


def test_only_one_command_writes_a_set(tmp_path: Path, capsys: Errors) -> None:
    bag = Drive(seconds=0.2).write(tmp_path / 'a.mcap')
    assert convert(bag, tmp_path / 'shard', *USUAL, '--shard', '1/1') == 0
    with locked_parts(tmp_path / 'set'):
        assert convert(bag, tmp_path / 'set', *USUAL) == 2
        assert main(['--merge', str(tmp_path / 'shard'), str(tmp_path / 'set')]) == 2
    assert capsys.readouterr().err.count('another img_convert is writing ') == 2
    assert convert(bag, tmp_path / 'set', *USUAL) == 0
    assert not [*tmp_path.glob('.*')]


def test_set_is_restored_after_a_kill_in_the_middle_of_its_replacement(tmp_path: Path) -> None:
    bag = Drive(seconds=0.2).write(tmp_path / 'a.mcap')
    assert convert(bag, tmp_path / 'set', *USUAL) == 0
    (tmp_path / '.set.parts/.new').mkdir(parents=True)
    (tmp_path / 'set').rename(tmp_path / '.set.parts/.replaced')
    assert convert(bag, tmp_path / 'set', *USUAL) == 2  # is a data set already
    assert numbers_of(tmp_path / 'set') == [*range(6)]
    assert sorted(path.name for path in tmp_path.iterdir()) == ['a.mcap', 'set']
