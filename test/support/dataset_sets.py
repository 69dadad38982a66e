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

"""Data sets of the command, and what is read back from them by other libraries."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import json
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
import os
from pathlib import Path
import signal
import sys
from typing import Any

import av
from dataset_bags import joint_values, NANO, number_of
import numpy as np
from opencv_tools.convert.cli import main
import pyarrow.parquet as pq

FRONT = 'observation.images.front'
CAMERA = ('--image', 'front=/cam0/image_raw/compressed')
JOINTS_STATE = ('--state', '/joint_states.position')
USUAL = (*CAMERA, *JOINTS_STATE, '--action', '/arm/command.position', '--task', 'pick')


def convert(source: object, target: object, *words: object, fps: int = 30,
            form: str = 'lerobot') -> int:
    """Run the command in this process, with one worker unless ``--jobs`` says otherwise."""
    jobs = () if '--jobs' in words else ('--jobs', '1')
    return main([str(word) for word in (
        source, target, '--format', form, '--fps', fps, *jobs, *words)])


def rows_of(folder: Path) -> dict[str, np.ndarray]:
    """Return the columns of all rows of a set, (n,) or (n, d)."""
    found: dict[str, list[Any]] = {}
    for path in sorted(folder.glob('data/*/*.parquet')):
        for name, values in pq.read_table(path).to_pydict().items():
            found.setdefault(name, []).extend(values)
    return {name: np.array(values) for name, values in found.items()}


def episodes_of(folder: Path) -> list[dict[str, Any]]:
    """Return the rows of the table of episodes of a set."""
    rows: list[dict[str, Any]] = pq.read_table(folder / 'meta/episodes').to_pylist()
    return rows


def info_of(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / 'meta/info.json').read_text())
    return content


def tasks_of(folder: Path) -> list[str]:
    """Return the text of the task of each row."""
    table = pq.read_table(folder / 'meta/tasks.parquet').to_pydict()
    texts = dict(zip(table['task_index'], table['task']))
    return [texts[number] for number in rows_of(folder)['task_index'].tolist()]


def frames_of(folder: Path, key: str = FRONT) -> list[tuple[float, np.ndarray]]:
    """Return the time and the picture in BGR of each frame of the videos of a camera."""
    found = []
    for path in sorted(folder.glob(f'videos/{key}/*/*.mp4')):
        with av.open(str(path)) as container:
            found += [(float(frame.pts * frame.time_base), frame.to_ndarray(format='bgr24'))
                      for frame in container.decode(video=0)]
    return found


def numbers_of(folder: Path, key: str = FRONT) -> list[int]:
    """Return the numbers in the frames of a camera."""
    return [number_of(image) for _, image in frames_of(folder, key)]


def stamps_of(folder: Path, name: str) -> list[int]:
    """Return the times of the samples of a camera or of a source of numbers in each row."""
    return _stamps(info_of(folder), rows_of(folder), name)


def _stamps(info: dict[str, Any], rows: dict[str, np.ndarray], name: str) -> list[int]:
    names = info['features']['stamp_ns']['names']
    stamps: list[int] = rows['stamp_ns'].reshape(-1, len(names))[:, names.index(name)].tolist()
    return stamps


def check_rows(folder: Path, picture_ns: Callable[[int], int]) -> list[int]:
    """
    Compare each row of a set with the functions that its bag was made of.

    :param picture_ns: time of a picture by its number.
    :returns: number in the frame of each row.
    """
    info, rows, frames = info_of(folder), rows_of(folder), frames_of(folder)
    numbers = [number_of(image) for _, image in frames]
    grids = np.array(_stamps(info, rows, 'front'))
    assert len(numbers) == len(rows['index']) > 0
    assert rows['index'].tolist() == list(range(len(numbers)))
    assert [picture_ns(number) for number in numbers] == grids.tolist()
    joint_ns = _stamps(info, rows, '/joint_states.position')
    assert np.allclose(rows['observation.state'], [joint_values(one) for one in joint_ns],
                       atol=1e-5)
    for episode in episodes_of(folder):
        part = slice(episode['dataset_from_index'], episode['dataset_to_index'])
        assert rows['frame_index'][part].tolist() == list(range(episode['length']))
        begin = episode[f'videos/{FRONT}/from_timestamp']
        times = [time for time, _ in frames[part]]
        assert np.allclose(np.array(times) - begin, rows['timestamp'][part], atol=1e-4)
        assert np.allclose(rows['timestamp'][part],
                           rows['frame_index'][part] / info['fps'], atol=1e-5)
        grid = grids[part]
        ages = grid[0] + rows['frame_index'][part] * NANO // info['fps'] - grid
        assert np.abs(ages).max() < NANO
    return numbers


def content_of(folder: Path) -> dict[str, bytes]:
    """Return the content of all files of a set."""
    return {str(path.relative_to(folder)): path.read_bytes()
            for path in sorted(folder.rglob('*')) if path.is_file()}


def _killed_at(words: Sequence[str], event: int, errors: str) -> None:
    """Run the command, and kill this process before its N-th change of a file."""
    os.dup2(os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
    count = 0

    def audit(name: str, arguments: tuple[Any, ...]) -> None:
        nonlocal count
        is_write = name == 'open' and isinstance(arguments[2], int) and arguments[2] & (
            os.O_WRONLY | os.O_RDWR)
        if is_write or name in ('os.mkdir', 'os.rename', 'os.remove', 'os.rmdir'):
            count += 1
            if count == event:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(audit)
    status = main(words)
    os.write(2, f'events: {count}\n'.encode())
    os._exit(status)


def start_killed(words: Sequence[object], event: int, errors: Path) -> BaseProcess:
    """
    Run the command in a process that kills itself before its N-th change of a file.

    :param event: number of the change, from 1; 0 for none.
    :param errors: file for standard error, whose last line has the number of changes.
    """
    context = get_context('forkserver')
    context.set_forkserver_preload(['dataset_sets', 'opencv_tools.datasets.bag_conversion'])
    process = context.Process(target=_killed_at, args=(
        [str(word) for word in words], event, str(errors)))
    process.start()
    return process
