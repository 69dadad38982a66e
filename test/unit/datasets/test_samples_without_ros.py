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

"""Bags with numbers become data sets where nothing of ROS is installed."""

from __future__ import annotations

import os
from pathlib import Path
import sqlite3
import subprocess
import sys

from ament_index_python import get_packages_with_prefixes
from dataset_bags import BEGAN, Drive, NANO, with_definitions
from dataset_sets import CAMERA, JOINTS_STATE, rows_of
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import read_definition
from played_bags import Entry, write_mcap, write_rosbag2
import pytest
from waiting import LONGEST_SECONDS

GRIPPER = """\
builtin_interfaces/Time stamp
uint8 CLOSED=1
Finger[2] fingers
================================================================================
MSG: own_msgs/Finger
float64 width 0.5
"""
MAIN = 'from opencv_tools.convert.cli import main\nsys.exit(main(sys.argv[1:]))'


def run(script: str, *words: object) -> str:
    """Run a script in a process that has no module and no folder of ROS; return its output."""
    packages = sorted({*get_packages_with_prefixes(), 'rclpy', 'rosidl_adapter', 'rosbags'}
                      - {'opencv_tools'})
    assert {'ament_index_python', 'sensor_msgs', 'builtin_interfaces'} <= {*packages}
    environment = {name: value for name, value in os.environ.items()
                   if name not in ('AMENT_PREFIX_PATH', 'PYTHONPATH', 'ROS_DISTRO')}
    finished = subprocess.run(
        [sys.executable, '-c', f'import sys\nsys.prefix = ""\n'
         f'sys.modules.update(dict.fromkeys({packages}))\n{script}', *map(str, words)],
        capture_output=True, text=True, env=environment, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, finished.stderr
    return finished.stdout


def entries() -> list[Entry]:
    """Return pictures and joints, and messages of a type that is nowhere installed."""
    codec = MessageCodec(read_definition('own_msgs/Gripper', GRIPPER))
    grippers = []
    for step in range(51):
        sec, nanosec = divmod(BEGAN + step * NANO // 100, NANO)
        data = codec.write({'stamp': {'sec': sec, 'nanosec': nanosec},
                            'fingers': [{'width': step / 100}, {}]})
        grippers.append(Entry(BEGAN + step * NANO // 100, data, '/gripper',
                              'own_msgs/msg/Gripper', definition=GRIPPER))
    return sorted([*with_definitions(Drive(seconds=0.5).entries()), *grippers],
                  key=lambda entry: entry.log_ns)


@pytest.mark.process
@pytest.mark.parametrize('suffix', ['.mcap', '.db3'])
def test_state_of_joints_and_of_a_type_that_is_nowhere_installed(
        suffix: str, tmp_path: Path) -> None:
    bag = (write_mcap(tmp_path / 'a.mcap', entries()) if suffix == '.mcap' else
           write_rosbag2(tmp_path / 'bag', suffix, entries()) / 'bag.db3')
    for number, state in enumerate((JOINTS_STATE, ('--state', '/gripper.fingers.0.width'))):
        folder = tmp_path / f'set{number}'
        run(MAIN, bag, folder, '--format', 'lerobot', '--fps', 30, '--jobs', 1, *CAMERA, *state,
            '--action', 'next', '--task', 'x')
        states = rows_of(folder)['observation.state'].reshape(-1, (3, 1)[number])
        assert len(states) > 10
        assert states[:3, 0] == pytest.approx([0, 1 / 30, 2 / 30], abs=0.011)


@pytest.mark.process
def test_old_bag_without_definitions(tmp_path: Path) -> None:
    path = write_rosbag2(tmp_path / 'bag', '.db3', Drive(seconds=0.5).entries()) / 'bag.db3'
    with sqlite3.connect(path) as database:
        database.execute('DROP TABLE message_definitions')
    database.close()
    run(MAIN, path, tmp_path / 'set', '--format', 'lerobot', '--fps', 30, '--jobs', 1, *CAMERA,
        *JOINTS_STATE, '--action', 'next', '--task', 'x')
    assert rows_of(tmp_path / 'set')['observation.state'].shape[1] == 3


@pytest.mark.process
def test_definitions_of_this_package() -> None:
    script = ('from opencv_tools.message_types.definition import read_definition\n'
              'for name in sys.argv[1:]: print(*read_definition(name).types)')
    found = run(script, 'tf2_msgs/msg/TFMessage', 'sensor_msgs/PointCloud2', 'nav_msgs/Odometry')
    assert found.splitlines()[0] == (
        'tf2_msgs/msg/TFMessage geometry_msgs/msg/TransformStamped std_msgs/msg/Header '
        'builtin_interfaces/msg/Time geometry_msgs/msg/Transform geometry_msgs/msg/Vector3 '
        'geometry_msgs/msg/Quaternion')
