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

"""
Run the tests with LeRobot: python run.py PYTHON [arguments of pytest].

LeRobot and this package need different versions of the same libraries. This script runs in the
environment of this package and writes data sets. The tests run with PYTHON, which has LeRobot,
and import nothing of this package.
"""

from __future__ import annotations

from dataclasses import dataclass
import itertools
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile

PROJECT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(PROJECT), str(PROJECT / 'test' / 'support')]

from dataset_bags import BEGAN, Drive, joint_values, NANO, with_definitions  # noqa: E402
import numpy as np  # noqa: E402
from opencv_tools.convert.cli import main as img_convert  # noqa: E402
from opencv_tools.image.cdr import image_to_cdr, WireHeader  # noqa: E402
from opencv_tools.image.encodings import find_encoding  # noqa: E402
from opencv_tools.image.layout import array_to_wire  # noqa: E402
from played_bags import Entry, write_mcap  # noqa: E402
from pyarrow import parquet  # noqa: E402

FPS = 25
CAMERAS = {'front': '/cam0/image_raw/compressed', 'wrist': '/cam1/image_raw/compressed'}
VECTORS = ('--format', 'lerobot', '--fps', FPS, '--state', '/joint_states.position',
           '--action', 'next', '--vector', 'command=/arm/command.position',
           '--vector', 'lift=/joint_states.position.1', '--robot', 'so101')
IMAGES = tuple(word for name, topic in CAMERAS.items() for word in ('--image', f'{name}={topic}'))
TOPICS = tuple(CAMERAS.values())


@dataclass(frozen=True)
class Bag:
    """A bag and its task."""

    drive: Drive
    task: str


#: Bags of each set. Episodes of very different lengths, lost and late pictures.
SETS = {
    'first': (Bag(Drive(seconds=2.0, topics=TOPICS), 'pick'),
              Bag(Drive(seconds=5.0, topics=TOPICS, lost=frozenset((5, 6, 7, 31)),
                        jitter_ns=4_000_000), 'place'),
              Bag(Drive(seconds=0.7, topics=TOPICS), 'pick')),
    'second': (Bag(Drive(seconds=1.0, topics=TOPICS, first=4), 'push'),
               Bag(Drive(seconds=1.5, topics=TOPICS), 'pick')),
    'vectors': (Bag(Drive(seconds=1.0, topics=()), 'pick'),
                Bag(Drive(seconds=2.0, topics=()), 'push')),
}
#: Options of the sets of depth.
DEPTHS = {'depth': (), 'depth_linear': ('--depth-range', '0:4', '--depth-scale', 'linear')}


def convert(*words: object) -> None:
    """Run img_convert, which must succeed."""
    status = img_convert([str(word) for word in words])
    if status:
        sys.exit(f'img_convert {" ".join(map(str, words))} ended with {status}')


def write_set(folder: Path, name: str) -> None:
    """Write the bags of a set, the pictures of its first camera, and the set of a shard a bag."""
    bags, shards = folder / f'bags_{name}', []
    bags.mkdir()
    table = folder / f'{name}.csv'
    table.write_text('bag,start,end,task\n' + ''.join(
        f'{name}_{number}.mcap,0,100,{bag.task}\n' for number, bag in enumerate(SETS[name])))
    for number, bag in enumerate(SETS[name]):
        path = bag.drive.write(bags / f'{name}_{number}.mcap')
        if bag.drive.topics:
            pictures = folder / 'pictures' / f'{name}_{number}'
            pictures.mkdir(parents=True)
            convert(path, pictures / '{seq}.png', '--topic', CAMERAS['front'])
    images = IMAGES if SETS[name][0].drive.topics else ()
    for number in range(1, len(SETS[name]) + 1):
        shards.append(folder / f'shard_{name}_{number}')
        convert(bags, shards[-1], *VECTORS, *images, '--episodes', table,
                '--shard', f'{number}/{len(SETS[name])}')
    convert('--merge', *shards, folder / name)
    table = parquet.read_table(folder / name / 'data', columns=['episode_index', 'stamp_ns'])
    stamps: list[list[list[int]]] = [[] for _ in SETS[name]]
    for episode, shown in zip(*table.to_pydict().values()):
        stamps[episode].append(shown)
    (folder / f'{name}.json').write_text(json.dumps(
        [expected_rows(number, bag, stamps[number]) for number, bag in enumerate(SETS[name])]))


def expected_rows(number: int, bag: Bag, stamps: list[list[int]]) -> list[dict[str, object]]:
    """
    Return what the rows of an episode must have, by the definition of its bag.

    :param stamps: times of the samples of each row. The conversion chooses the time of the first
        row within a period; the earliest one that is not before its samples has the same samples.
    """
    drive = bag.drive
    pictures = [(drive.picture_ns(picture), picture) for picture in range(
        drive.first, round(drive.seconds * 30)) if picture not in drive.lost] if (
            drive.topics) else []
    step = NANO // 100
    begin, end = BEGAN, BEGAN + round(drive.seconds * 100) * step
    if pictures:
        begin, end = max(begin, pictures[0][0]), min(end, pictures[-1][0])
    period = NANO // FPS
    first = max(max(shown) - row * period for row, shown in enumerate(stamps))
    times = [first + row * period for row in range(len(stamps) + 1)]  # with the last action
    assert begin <= first < begin + period
    assert end - 2 * period < times[-1] <= end + 1000
    rows: list[dict[str, object]] = []
    for time in times:
        shown = [picture for time_ns, picture in pictures if time_ns <= time]
        joints = joint_values(BEGAN + (time - BEGAN) // step * step)
        rows.append({
            'episode': number, 'task': bag.task, 'timestamp': len(rows) / FPS,
            'picture': shown[-1] if shown else None, 'nth': len(shown) - 1,
            'observation.state': joints, 'command': [10 * joint for joint in joints],
            'lift': joints[1]})
    for row, after in itertools.pairwise(rows):
        row['action'] = after['observation.state']
    return rows[:-1]


def write_depth(folder: Path, name: str) -> None:
    """Write two bags of depth, a set of them, and the depths in millimetres of its rows."""
    rows, columns = np.mgrid[:48, :64]
    for episode, count in enumerate((9, 40)):
        entries = []
        for number in range(count):
            image = (400 + 11 * rows + 40 * columns + 7 * number).astype(np.uint16)
            image[:3, :4] = 0
            time = BEGAN + number * NANO // 30
            header = WireHeader(*divmod(time, NANO), '')
            wire = array_to_wire(image, find_encoding('16UC1'), header)
            entries.append(Entry(time, image_to_cdr(wire), '/depth'))
        write_mcap(folder / f'bags_{name}' / f'{name}_{episode}.mcap', with_definitions(entries))
    convert(folder / f'bags_{name}', folder / name, '--format', 'lerobot', '--fps', 30,
            '--depth', 'wrist=/depth', *DEPTHS[name])
    stamps = parquet.read_table(folder / name / 'data')['stamp_ns'].to_pylist()
    numbers = [round((stamp - BEGAN) * 30 / NANO) for stamp in stamps]
    assert len(numbers) == 49
    images = [np.where((rows < 3) & (columns < 4), 0, 400 + 11 * rows + 40 * columns + 7 * number)
              for number in numbers]
    np.save(folder / f'{name}.npy', images)


def main() -> int:
    """Return the exit status of pytest."""
    python, *arguments = sys.argv[1:]
    python = str(Path(python).absolute())
    with tempfile.TemporaryDirectory() as folder:
        for name in SETS:
            write_set(Path(folder), name)
        for name in DEPTHS:
            (Path(folder) / f'bags_{name}').mkdir()
            write_depth(Path(folder), name)
        environment = {key: value for key, value in os.environ.items()
                       if key not in ('PYTHONPATH', 'LD_LIBRARY_PATH', 'VIRTUAL_ENV')}
        environment.update(
            OPENCV_TOOLS_LEROBOT=folder, HF_HUB_OFFLINE='1', HF_DATASETS_OFFLINE='1',
            OMP_NUM_THREADS='1', HF_HOME=str(Path(folder) / 'home'))
        return subprocess.run(
            [python, '-m', 'pytest', '--quiet', '-c', os.devnull, '--noconftest',
             f'--rootdir={Path(__file__).parent}', '-p', 'no:cacheprovider',
             str(Path(__file__).parent), *arguments],
            cwd=Path(__file__).parent, env=environment, check=False).returncode


if __name__ == '__main__':
    sys.exit(main())
