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

from dataset_bags import BEGAN, Drive, joint_values, NANO  # noqa: E402
from opencv_tools.convert.cli import main as img_convert  # noqa: E402

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


def convert(*words: object) -> None:
    """Run img_convert, which must succeed."""
    status = img_convert([str(word) for word in words])
    if status:
        sys.exit(f'img_convert {" ".join(map(str, words))} ended with {status}')


def write_set(folder: Path, name: str) -> None:
    """Write the bags of a set, the pictures of its first camera, and the set of a shard a bag."""
    shards = []
    for number, bag in enumerate(SETS[name]):
        path = bag.drive.write(folder / f'{name}_{number}.mcap')
        if bag.drive.topics:
            pictures = folder / 'pictures' / f'{name}_{number}'
            pictures.mkdir(parents=True)
            convert(path, pictures / '{seq}.png', '--topic', CAMERAS['front'])
        shards.append(folder / f'shard_{name}_{number}')
        convert(path, shards[-1], *VECTORS, *(IMAGES if bag.drive.topics else ()),
                '--task', bag.task, '--shard', '1/1')
    convert('--merge', *shards, folder / name)
    (folder / f'{name}.json').write_text(json.dumps(
        [expected_rows(number, bag) for number, bag in enumerate(SETS[name])]))


def expected_rows(number: int, bag: Bag) -> list[dict[str, object]]:
    """Return what the rows of an episode must have, by the definition of its bag."""
    drive = bag.drive
    pictures = [(drive.picture_ns(picture), picture) for picture in range(
        drive.first, round(drive.seconds * 30)) if picture not in drive.lost] if (
            drive.topics) else []
    step = NANO // 100
    begin, end = BEGAN, BEGAN + round(drive.seconds * 100) * step
    if pictures:
        begin, end = max(begin, pictures[0][0]), min(end, pictures[-1][0])
    rows: list[dict[str, object]] = []
    for time in range(begin, end + 1, NANO // FPS):
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


def main() -> int:
    """Return the exit status of pytest."""
    python, *arguments = sys.argv[1:]
    python = str(Path(python).absolute())
    with tempfile.TemporaryDirectory() as folder:
        for name in SETS:
            write_set(Path(folder), name)
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
