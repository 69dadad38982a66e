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

"""Send a video through both nodes to disk and convert a robot to SDF; compare the results."""

from __future__ import annotations

from contextlib import closing
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
from threading import Thread

import cv2
import numpy as np
from opencv_tools.base.signals import end_at_signals
from opencv_tools.capture.source import open_source

ROOT = Path(__file__).resolve().parent.parent
CLIP = ROOT / 'test' / 'data' / 'big_buck_bunny_720p.mp4'
OUTPUT = ROOT / 'demo'
ROBOT = ROOT / 'urdf' / 'my_robot.urdf.xacro'
SECONDS = 180  # timeout of each process, generous for slow machines
MODULES = {'img_publisher': ['opencv_tools.basic_image_publisher'],
           'img_subscriber': ['opencv_tools.basic_image_subscriber'],
           'robot_compare': ['opencv_tools.robot.cli', 'robot_compare'],
           'urdf_to_sdf': ['opencv_tools.robot.cli', 'urdf_to_sdf']}


def executable(name: str, *words: str) -> list[str]:
    """Return the command line of an executable of this package, installed or not."""
    # A virtual environment has executables next to python, colcon has them where ros2 run looks.
    folders = [Path(sys.executable).parent]
    for prefix in filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(':')):
        folders.append(Path(prefix, 'lib', 'opencv_tools'))
    for folder in folders:
        if os.access(folder / name, os.X_OK):
            return [str(folder / name), *words]
    found = shutil.which(name)
    return [*([found] if found else [sys.executable, '-m', *MODULES[name]]), *words]


class NodeProcess:
    """A node in its own process; its console lines are printed and stored."""

    def __init__(self, name: str, **parameters: object) -> None:
        """Start the node in a namespace that is unique on this machine."""
        assignments = [f'{name}:={value}' for name, value in parameters.items()]
        command = [
            *executable(name), '--ros-args',
            '-r', f'__ns:=/opencv_tools_demo_{os.getpid()}',
            *(word for assignment in assignments for word in ('-p', assignment))]
        environment = dict(os.environ, ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
        self.lines: list[str] = []
        self._process = subprocess.Popen(
            command, env=environment, stderr=subprocess.PIPE, text=True)
        self._reader = Thread(target=self._read)
        self._reader.start()

    def __enter__(self) -> NodeProcess:
        """Return this process."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the node if it is running."""
        self._process.terminate()
        self.wait()

    def wait(self) -> int:
        """Return the exit status; kill a node that exceeds the timeout."""
        try:
            status = self._process.wait(SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            status = self._process.wait()
        self._reader.join()
        return status

    def number(self, pattern: str) -> int:
        """Return a number from the console lines, 0 if it is missing."""
        match = re.search(pattern, '\n'.join(self.lines))
        return int(match[1]) if match else 0

    def _read(self) -> None:
        assert self._process.stderr
        for line in self._process.stderr:
            print(line, end='', flush=True)
            self.lines.append(line)


def convert_robot() -> bool:
    """Convert the robot to SDF and return whether both describe the same robot."""
    model = OUTPUT / 'my_robot.sdf'
    for command in (executable('urdf_to_sdf', str(ROBOT), '-o', str(model)),
                    executable('robot_compare', str(ROBOT), str(model))):
        finished = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS,
                                  check=False)
        if finished.returncode:
            print(finished.stdout + finished.stderr, end='')
            return False
    print(f'{shown(ROBOT)} -> {shown(model)}: {finished.stdout.strip()}')
    return True


def shown(path: Path) -> str:
    """Return a path relative to the root of the package."""
    return str(path.relative_to(ROOT))


def decode(clip: Path) -> list[np.ndarray]:
    """Decode all frames of a video in this process."""
    with closing(open_source(str(clip))) as source:
        return [frame.image for frame in iter(source.read, None)]


def contact_sheet(files: list[Path]) -> np.ndarray:
    """Return twelve of the written files as one image, four in a row."""
    picked = [files[index * len(files) // 12] for index in range(12)]
    tiles = [cv2.resize(cv2.imread(str(file)), (320, 180), interpolation=cv2.INTER_AREA)
             for file in picked]
    return np.vstack([np.hstack(tiles[row:row + 4]) for row in (0, 4, 8)])


def main() -> int:
    """Run the demo; return 0 if all frames and the robot are unchanged."""
    frames = decode(CLIP)
    folder = OUTPUT / 'frames'
    shutil.rmtree(OUTPUT, ignore_errors=True)
    OUTPUT.mkdir(exist_ok=True)
    with (NodeProcess('img_subscriber', output_dir=folder, max_frames=len(frames),
                      on_overflow='block', timeout=60.0) as subscriber,
          NodeProcess('img_publisher', source=CLIP, publish_rate=0.0,
                      wait_for_subscribers=1) as publisher):
        statuses = [publisher.wait(), subscriber.wait()]

    published = publisher.number(r'Published (\d+) frames')
    received = subscriber.number(r'Received (\d+) frames')
    files = sorted(folder.glob('*.png'))
    identical = sum(np.array_equal(cv2.imread(str(file)), frame)
                    for file, frame in zip(files, frames))
    same_robot = convert_robot()
    if files:
        sheet = OUTPUT / 'contact_sheet.png'
        cv2.imwrite(str(sheet), contact_sheet(files))
        equal = 'each' if identical == len(files) else f'{identical} of them'
        print(f'{len(frames)} frames of {shown(CLIP)} -> two processes -> {len(files)} PNG files '
              f'in {shown(folder)}, {equal} equal to the clip as this process decodes it; '
              f'look at {shown(sheet)}')
    scripts = '.venv/bin/' if Path('.venv').is_dir() else ''
    print(f'to see images in a browser: {scripts}img_publisher --ros-args -p source:=pattern & '
          f'{scripts}img_viewer, then open http://localhost:8080/')
    print(f'published {published}, received {received}, written {len(files)}, '
          f'pixel-identical {identical}')
    counts = {published, received, len(files), identical}
    return 0 if statuses == [0, 0] and same_robot and counts == {len(frames)} else 1


if __name__ == '__main__':
    sys.exit(end_at_signals(main))
