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
"""Jobs that the commands do where only a wheel and its extras are installed, without ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path
import re
import subprocess

from waiting import LONGEST_SECONDS

#: Extras of setup.py, and what each includes.
EXTRAS = {
    'images': {'images'}, 'video': {'video'}, 'bags': {'bags'},
    'datasets': {'bags', 'datasets', 'images', 'video'}, 'viewer': {'viewer'},
    'robots': {'robots'}, 'memory': {'memory'},
    'images,bags': {'bags', 'images'}, 'robots,viewer': {'robots', 'viewer'}}
EXTRAS['all'] = set().union(*EXTRAS.values())
#: Libraries that an extra must bring, as opencv_tools_info names them.
BRINGS = {
    'images': ('OpenCV', 'simplejpeg'), 'video': ('PyAV',), 'bags': ('mcap', 'zstandard', 'lz4'),
    'datasets': ('pyarrow',), 'viewer': ('Tornado',), 'robots': ('lxml', 'xacro', 'matplotlib'),
    'memory': ('iceoryx2',)}
MISSING = re.compile(r"(; |, or )install it with [^;]*'pip install |source an installed ROS 2|"
                     'source its setup.bash')
BOARD = 'charuco:8x6:30mm:22mm:5x5_250'


@dataclass(frozen=True)
class Job:
    """
    Commands of a job, one after another in a folder with the inputs of the tests.

    :param needs: extras that the job needs.
    :param files: files that exist afterwards, each with a word that its content begins with.
    """

    needs: Set[str]
    commands: Sequence[str]
    files: Mapping[str, bytes] = field(default_factory=dict)


_SET = '--format lerobot --fps 30 --image front=/cam0/image_raw/compressed --task wave'
_JOINTS = f'{_SET} --state /joint_states.position --action next'
PNG, JPEG = b'\x89PNG', b'\xff\xd8'
JOBS = {
    'pictures': Job(
        {'images'}, ['img_convert pattern:64x48 pictures/{seq}.png --stop 3'],
        {'pictures/2.png': PNG}),
    'clip': Job(
        {'images'}, ['img_convert clip.mp4 frames/{seq}.png --lossy --stop 3'],
        {'frames/2.png': PNG}),
    'video': Job(
        {'images', 'video'}, ['img_convert pattern:64x48 new.mkv --stop 3 --lossy'],
        {'new.mkv': b'\x1aE\xdf\xa3'}),
    'mcap': Job(
        {'images', 'bags'},
        ['img_convert drive.mcap mcap/{seq}.jpg --lossy',
         'img_convert pattern:64x48 new.mcap --stop 3', 'img_convert new.mcap again/{seq}.png'],
        {'mcap/2.jpg': JPEG, 'new.mcap': b'\x89MCAP', 'again/2.png': PNG}),
    'db3': Job(
        {'images'}, ['img_convert drive_db3 db3/{seq}.jpg --lossy'], {'db3/2.jpg': JPEG}),
    'pages of boards': Job(
        {'images'}, [f'img_calibrate --board {BOARD} --board-pdf board.pdf'],
        {'board.pdf': b'%PDF'}),
    'calibration': Job(
        {'images'}, [f'img_calibrate views --board {BOARD} -o camera.yaml'],
        {'camera.yaml': b'image_width: '}),
    'set': Job(
        {'datasets'}, [f'img_convert drive.mcap set {_SET}', 'img_convert --check set'],
        {'set/meta/info.json': b'{'}),
    'set of db3': Job(
        {'datasets'}, [f'img_convert drive_db3 set_db3 {_SET}'],
        {'set_db3/meta/info.json': b'{'}),
    'joints': Job(
        {'datasets'}, [f'img_convert drive.mcap joints {_JOINTS}', 'img_convert --check joints'],
        {'joints/meta/info.json': b'{'}),
    'joints of db3': Job(
        {'datasets'}, [f'img_convert drive_db3 db3_joints {_JOINTS}'],
        {'db3_joints/meta/info.json': b'{'}),
    'robots': Job(
        {'robots'},
        ['urdf_to_sdf urdf/my_arm.urdf -o arm.sdf', 'sdf_to_urdf arm.sdf -o arm.urdf',
         'urdf_to_sdf urdf/my_robot.urdf.xacro -o robot.sdf', 'robot_compare arm.urdf arm.sdf',
         'robot_frames arm.sdf --conventions frames.png'],
        {'arm.urdf': b'<?xml', 'robot.sdf': b'<?xml', 'frames.png': PNG}),
    'page of a robot': Job(
        {'robots'}, ['robot_view urdf/my_arm.urdf --html arm.html'], {'arm.html': b'<!'}),
    'server of a robot': Job({'robots', 'viewer'}, ['robot_view urdf/my_arm.urdf --port 0']),
    'nodes': Job(
        {'ros'},
        ['img_publisher --ros-args -p source:=pattern', 'img_subscriber', 'img_viewer',
         'img_filter --ros-args -p function:=numpy:flip',
         f'img_calibrate --topic /image_raw --board {BOARD} -o live.yaml']),
}


@dataclass(frozen=True)
class Finished:
    """The end of a command."""

    status: int
    stdout: str
    stderr: str


def run(environment: Path, line: str, folder: Path) -> Finished:
    """Run a command of a virtual environment; its process has no environment variables."""
    name, *words = line.split()
    is_server = words[-2:] == ['--port', '0']  # it prints its address and waits
    process = subprocess.Popen(
        [environment / 'bin' / name, *words], env={}, cwd=folder, stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL if is_server else subprocess.PIPE, stderr=subprocess.PIPE,
        text=True)
    if is_server:
        assert process.stderr
        shown = process.stderr.readline()
        if 'Open http' in shown:
            process.terminate()
            process.communicate(timeout=LONGEST_SECONDS)
            return Finished(0, shown, '')
        return Finished(process.wait(LONGEST_SECONDS), '', shown + process.stderr.read())
    stdout, stderr = process.communicate(timeout=LONGEST_SECONDS)
    return Finished(process.returncode, stdout, stderr)


def problems_of(job: Job, environment: Path, extras: set[str], folder: Path) -> list[str]:
    """
    Run a job, and return what is wrong.

    Where an extra is missing, the first command must end with one sentence and its remedy.
    """
    problems = []
    is_complete = job.needs <= extras
    for line in job.commands:
        end = run(environment, line, folder)
        if 'Traceback' in end.stdout + end.stderr:
            problems.append(f'{line}: {end.stderr}')
        elif is_complete and end.status != 0:
            problems.append(f'{line}: status {end.status}: {end.stderr}')
        elif not is_complete:
            last = end.stderr.splitlines()[-1:]
            if end.status not in (1, 2) or not (last and MISSING.search(last[0])):
                problems.append(f'{line}: status {end.status} without a remedy: {end.stderr}')
            if 'ros' not in job.needs:
                return problems
    for name, begin in job.files.items() if is_complete else ():
        path = folder / name
        if not (path.is_file() and path.read_bytes().startswith(begin)):
            problems.append(f'{name} is missing, or does not begin with {begin!r}')
    return problems
