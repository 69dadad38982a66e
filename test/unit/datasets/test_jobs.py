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

"""Bags of a source, and their conversion by processes, one of which is killed."""

from __future__ import annotations

from multiprocessing import forkserver
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
from threading import Event

from dataset_bags import BEGAN, Drive, NANO, with_definitions
from dataset_sets import (
    CAMERA, check_rows, convert, episodes_of, JOINTS_STATE, numbers_of, USUAL)
from opencv_tools.convert.cli import main
from opencv_tools.datasets import bag_conversion
from opencv_tools.datasets.bag_conversion import Work, write_video, WrittenCamera
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.jobs import convert_here, find_jobs
from opencv_tools.datasets.part import read_part
from opencv_tools.datasets.plan import NumbersSource, Plan, STATE
from played_bags import write_mcap
import pytest
from waiting import LONGEST_SECONDS, status_of, wait_until

PLAN = Plan(fps=30, images=(('front', '/cam0/image_raw/compressed'),), vectors=(
    (STATE, (NumbersSource('/joint_states', ('position',), ('shoulder', 'elbow', 'wrist')),)),))
Errors = pytest.CaptureFixture[str]


def names(source: object, folder: Path) -> list[str]:
    return [job.name for job in find_jobs(str(source), folder / 'parts')]


def test_bags_of_a_file_a_folder_and_a_pattern(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = Drive(seconds=0.1).write(tmp_path / 'run2.mcap')
    Drive(seconds=0.1).write(tmp_path / 'day/run10')  # SQLite, a folder of rosbag2
    for name in ('run10.mcap', 'day/x[1].mcap', '.hidden/y.mcap', '.z.mcap'):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(bag, tmp_path / name)
    (tmp_path / 'link').symlink_to(tmp_path)
    assert names(bag, tmp_path) == ['run2.mcap']
    assert names(tmp_path / 'day/run10', tmp_path) == ['run10']
    assert names(tmp_path, tmp_path) == ['day/run10', 'day/x[1].mcap', 'run2.mcap', 'run10.mcap']
    assert names(tmp_path / 'run*', tmp_path) == ['run2.mcap', 'run10.mcap']
    # A folder of rosbag2 and its file are one bag.
    assert names(tmp_path / 'day/**', tmp_path) == ['run10', 'x[1].mcap']
    assert names(tmp_path / 'day/x[1].mcap', tmp_path) == ['x[1].mcap']
    monkeypatch.setenv('HOME', str(tmp_path))
    assert names('~/run2.mcap', tmp_path) == ['run2.mcap']
    for source in ('~nobody-here/a', tmp_path / 'no*', tmp_path / '.hidden/no'):
        with pytest.raises(DatasetError, match='is no bag, and has none: give a file'):
            names(source, tmp_path)


def workers() -> list[int]:
    """Return the processes of the server that begins workers."""
    server = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
    children = Path(f'/proc/{server}/task/{server}/children').read_text().split()
    return [int(pid) for pid in children]


@pytest.mark.thorough
@pytest.mark.process
def test_killed_worker_costs_no_bag(tmp_path: Path) -> None:
    drive = Drive(seconds=1)
    for number in range(5):
        drive.write(tmp_path / f'bags/{number}.mcap')
    jobs = find_jobs(str(tmp_path / 'bags'), tmp_path / 'parts')
    found = []
    for job, error in convert_here(jobs, PLAN, 2):
        found.append((job.name, error))
        if len(found) == 1:
            os.kill(workers()[-1], signal.SIGKILL)
    assert sorted(found) == [(job.name, '') for job in jobs]
    assert {read_part(job.folder)['episodes'][0]['length'] for job in jobs} == {30}


@pytest.mark.process
def test_bag_that_kills_its_worker_costs_only_this_bag(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(3):
        Drive(seconds=5 if number == 1 else 0.1).write(tmp_path / f'bags/{number}.mcap')
    jobs = find_jobs(str(tmp_path / 'bags'), tmp_path / 'parts')
    found = {}
    for job, error in convert_here(jobs, Plan(**{**vars(PLAN), 'fps': 1000}), 2):
        found[job.name] = error
        if len(found) < 3 and '1.mcap' not in found:
            wait_until(lambda: [*tmp_path.glob('parts/.1.mcap-*/front.mp4')], 'the second video')
            for pid in workers():
                os.kill(pid, signal.SIGKILL)
    assert found['0.mcap'] == found['2.mcap'] == ''
    assert found['1.mcap'] in ('', 'its process was killed, perhaps for want of memory')


@pytest.mark.process
def test_processes_write_the_same_set(tmp_path: Path, capsys: Errors) -> None:
    for number in range(3):
        Drive(seconds=0.2).write(tmp_path / f'bags/{number}.mcap')
    (tmp_path / 'bags/1b.mcap').write_bytes(b'no bag')
    assert convert(tmp_path / 'bags', tmp_path / 'set', *USUAL, '--jobs', 2, '--skip-failed') == 1
    errors = capsys.readouterr().err
    assert errors.count('img_convert: error: ') == 1 and '1b.mcap: ' in errors
    assert main(['--check', str(tmp_path / 'set')]) == 0
    assert numbers_of(tmp_path / 'set') == [*range(6)] * 3


def test_dry_run_lists_all_topics_and_writes_nothing(tmp_path: Path, capsys: Errors) -> None:
    for name in 'ab':
        Drive(seconds=1, lost=frozenset({3})).write(tmp_path / f'bags/{name}.mcap')
    (tmp_path / 'bags/c.mcap').write_bytes(b'no bag')
    before = sorted(tmp_path.rglob('*'))
    assert convert(tmp_path / 'bags', tmp_path / 'set', *CAMERA, *JOINTS_STATE, '--action', 'next',
                   '--dry-run') == 1
    shown, errors = capsys.readouterr()
    assert sorted(tmp_path.rglob('*')) == before
    assert 'error: c.mcap: ' in errors
    assert shown.startswith("""\
a.mcap: 29 rows in 1 episodes
  /arm/command (sensor_msgs/msg/JointState, 101): not used
  /cam0/image_raw/compressed (sensor_msgs/msg/CompressedImage, 29): observation.images.front
  /joint_states (sensor_msgs/msg/JointState, 101): observation.state (shoulder, elbow, wrist)
  action: the state of the next row
  front: 28 samples used, 1 rows repeat one, 0 dropped, 0 before the first row, 1 after the last, \
0 failed, of 29 messages; from sample to row 0.0 ms in the median, 33.3 ms at most
""")


@pytest.mark.parametrize(('end', 'text'), [
    (DatasetError('it fails'), 'a.mcap: it fails'), (KeyboardInterrupt(), 'interrupted')])
def test_videos_end_when_one_of_them_fails_or_the_command_ends(
        end: BaseException, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: Errors) -> None:
    bag = Drive(seconds=0.2).write(tmp_path / 'a.mcap')
    ended, begun = [], Event()

    def fail_or_wait(work: Work, name: str) -> WrittenCamera:
        if name == 'front':
            wait_until(begun.is_set)
            raise end
        begun.set()
        ended.append(wait_until(work.ended.is_set))
        with pytest.raises(DatasetError, match='the conversion has ended'):
            write_video(work, name)
        ended.append(True)
        raise DatasetError('it has ended')

    monkeypatch.setattr(bag_conversion, 'write_video', fail_or_wait)
    assert convert(bag, tmp_path / 'set', *CAMERA, '--image', 'b=/cam0/image_raw/compressed',
                   '--jobs', 2) == 1
    assert ended == [True, True]
    assert text in capsys.readouterr().err


def test_pattern_with_the_extension_of_a_bag(tmp_path: Path) -> None:
    for name in ('b1', 'b2', 'c'):
        Drive(seconds=0.1).write(tmp_path / f'in/{name}.mcap')
    (tmp_path / 'in/far').symlink_to(tmp_path / 'in')  # leads back
    parts = tmp_path / 'parts'
    assert [job.name for job in find_jobs(str(tmp_path / 'in/b*.mcap'), parts)] == [
        'b1.mcap', 'b2.mcap']
    assert [job.name for job in find_jobs(str(tmp_path / 'in'), parts)] == [
        'b1.mcap', 'b2.mcap', 'c.mcap']


@pytest.mark.process
def test_worker_ends_at_sigterm_and_not_at_ctrl_c() -> None:
    code = ('import time; from opencv_tools.datasets.jobs import _begin; _begin(); '
            f'print(flush=True); time.sleep({LONGEST_SECONDS})')
    with subprocess.Popen([sys.executable, '-c', code], stdout=subprocess.PIPE) as worker:
        assert worker.stdout and worker.stdout.readline()
        worker.send_signal(signal.SIGINT)
        worker.send_signal(signal.SIGTERM)  # a pool ends its processes so
        assert status_of(worker) == -signal.SIGTERM


def split(folder: Path, drive: Drive, borders: list[float], pause: float = 0.0,
          recording: str = '') -> None:
    """Write a recording in numbered files, with a pause between two of them."""
    records = [('opencv_tools', {'recording': recording})] if recording else []
    ends = [BEGAN + round(one * NANO) for one in borders]
    for number, (begin, end) in enumerate(zip([0, *ends], [*ends, 1 << 62])):
        moved = round(number * pause * NANO)
        write_mcap(folder / f'd_{number + 9}.mcap', with_definitions([
            entry._replace(log_ns=entry.log_ns + moved) for entry in drive.entries()
            if begin <= entry.log_ns < end]), metadata=records)


@pytest.mark.parametrize('borders', [[0.5], [0.31, 0.73], [0.1, 0.15, 0.2, 1.4]])
@pytest.mark.parametrize('source', ['', 'd_*.mcap'])
def test_numbered_files_of_a_recording_are_one_bag(
        source: str, borders: list[float], tmp_path: Path, capsys: Errors) -> None:
    (tmp_path / 'ring').mkdir()
    drive = Drive(seconds=1.7)
    split(tmp_path / 'ring', drive, borders)
    assert convert(tmp_path / 'ring' / source, tmp_path / 'set', *USUAL) == 0
    assert [row['length'] for row in episodes_of(tmp_path / 'set')] == [51]
    assert check_rows(tmp_path / 'set', drive.picture_ns) == [*range(51)]
    assert f'd_9.mcap to d_{9 + len(borders)}.mcap are one recording' in capsys.readouterr().err
    assert main(['--check', str(tmp_path / 'set')]) == 0
    (tmp_path / 'whole').mkdir()
    drive.write(tmp_path / 'whole/d_9.mcap')
    assert convert(tmp_path / 'whole', tmp_path / 'other', *USUAL) == 0
    assert (tmp_path / 'set/data/chunk-000/file-000.parquet').read_bytes() == (
        tmp_path / 'other/data/chunk-000/file-000.parquet').read_bytes()


@pytest.mark.parametrize('pause', [0.0, 3.0, 1000.0, 77.7])
def test_files_of_a_recording_are_known_by_its_identifier(pause: float, tmp_path: Path) -> None:
    """Each second of two recordings is a file of one folder, with and without pauses."""
    entries, begin = Drive(seconds=6).entries(), BEGAN
    for second in range(6):
        records = [('opencv_tools', {'recording': 'ab'[second in (2, 3, 5)]})]
        part = [entry._replace(log_ns=entry.log_ns + round(second * pause * NANO))
                for entry in entries if begin <= entry.log_ns < begin + NANO]
        write_mcap(tmp_path / f'd_{second}.mcap', with_definitions(part), metadata=records)
        begin += NANO
    assert [(job.name, [path.name for path in job.files]) for job in find_jobs(
        str(tmp_path), tmp_path)] == [
            ('d_0.mcap', ['d_0.mcap', 'd_1.mcap', 'd_4.mcap']),
            ('d_2.mcap', ['d_2.mcap', 'd_3.mcap', 'd_5.mcap'])]
    (tmp_path / 'd_6.mcap').write_bytes((tmp_path / 'd_5.mcap').read_bytes())  # a copy
    assert len(find_jobs(str(tmp_path), tmp_path)) == 3


@pytest.mark.parametrize(('borders', 'deleted', 'missing'), [
    ([0.5, 1.0], ('d_10',), '1 file is missing between d_9.mcap and d_11.mcap'),
    ([0.3, 0.6, 0.9, 1.2, 1.5], ('d_11', 'd_12', 'd_13'),
     '3 files are missing between d_10.mcap and d_14.mcap'),
    ([0.5, 1.0], ('d_9',), ''), ([0.5, 1.0], ('d_11',), '')])  # as a ring, and cannot be known
def test_missing_file_of_a_recording_is_said(
        borders: list[float], deleted: tuple[str, ...], missing: str, tmp_path: Path,
        capsys: Errors) -> None:
    split(tmp_path, Drive(seconds=1.7), borders, recording='a')
    for name in deleted:
        (tmp_path / f'{name}.mcap').unlink()
    for words in ('--on-gap', 'split'), (), ('--dry-run',):
        status = convert(tmp_path, tmp_path / 'set', *USUAL, '--max-gap', '0.2', '--overwrite',
                         *words)
        assert status == (bool(missing) and 'split' not in words)
        printed = ''.join(capsys.readouterr())
        assert missing in printed and printed.count(' missing between ') == bool(missing)


def test_numbered_files_with_a_pause_are_recordings_of_their_own(tmp_path: Path) -> None:
    split(tmp_path, Drive(seconds=1), [0.5], pause=1.2)
    assert names(tmp_path, tmp_path) == ['d_9.mcap', 'd_10.mcap']
    split(tmp_path, Drive(seconds=1), [0.5], pause=0.9)
    assert names(tmp_path, tmp_path) == ['d_9.mcap']
    (tmp_path / 'd_9.mcap').rename(tmp_path / 'd_8.mcap')
    assert names(tmp_path, tmp_path) == ['d_8.mcap', 'd_10.mcap']
