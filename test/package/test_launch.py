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

"""Launch files, started by ``ros2 launch`` where it is installed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import os
from pathlib import Path
import shutil
import sys

from conftest import call_service, NodeProcess
import launch_file
import pytest
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

# ros2launch is not on PyPI. launch_file.py reads the same files without it.
ROS2 = shutil.which('ros2')
Launch = Callable[..., NodeProcess]


@pytest.fixture
def launch(prefix: Path, tmp_path: Path) -> Iterator[Launch]:
    """Return a function that starts an installed launch file with arguments."""
    processes: list[NodeProcess] = []
    folders = (str(prefix / 'lib' / 'opencv_tools'), os.environ['PATH'])

    def _launch(name: str, **arguments: object) -> NodeProcess:
        file = str(prefix / 'share' / 'opencv_tools' / 'launch' / name)
        program = [ROS2, 'launch'] if ROS2 else [sys.executable, launch_file.__file__]
        words = [f'{argument}:={value}' for argument, value in arguments.items()]
        processes.append(NodeProcess(
            [*program, file, *words], tmp_path / f'launch_{len(processes)}.log',
            {**os.environ, 'PATH': os.pathsep.join(folders), 'PYTHONUNBUFFERED': '1'}))
        return processes[-1]

    yield _launch
    for process in processes:
        process.kill()


def end(process: NodeProcess) -> str:
    """End a launch by Ctrl-C and return its output."""
    process.interrupt()
    process.finish()
    assert 'process has died' not in process.output, process.output
    return process.output


def test_publisher_and_recorder(launch: Launch, tmp_path: Path) -> None:
    process = launch('camera.launch.py', source='pattern', output_dir=tmp_path / 'out')
    process.wait_for('Receiving video frame')
    end(process)
    assert [*(tmp_path / 'out').glob('*.png')]


def test_publisher_without_recorder(launch: Launch, node: Node, tmp_path: Path) -> None:
    given = {'source': 'pattern', 'width': 80, 'height': 60, 'publish_rate': 50.0}
    process = launch('camera.launch.py', record='false', namespace='front', **given)
    process.wait_for('Publishing video frame')
    answer = call_service(node, GetParameters, '/front/image_publisher/get_parameters',
                          GetParameters.Request(names=[*given]))
    assert [parameter_value_to_python(value) for value in answer.values] == [*given.values()]
    assert 'image_subscriber' not in end(process)
    assert not (tmp_path / 'frames').exists()


def test_publisher_and_viewer(launch: Launch) -> None:
    process = launch('camera.launch.py', source='pattern', record='false', viewer='true')
    # Port 8080 may belong to another test. Both sentences follow the check of the parameters.
    process.wait_until(lambda output: 'in a browser' in output or 'port 8080' in output)
    process.wait_for('Publishing video frame')
    assert 'but none for this node' not in process.output
    process.interrupt()
    process.finish()


def test_params_file_of_the_viewer_only(launch: Launch, tmp_path: Path) -> None:
    file = tmp_path / 'viewer.yaml'
    file.write_text('image_viewer:\n  ros__parameters:\n    port: 0\n')
    process = launch('camera.launch.py', source='pattern', record='false', viewer='true',
                     params_file=file)
    process.wait_for('in a browser')
    process.wait_for('Publishing video frame')
    assert ':8080' not in end(process)


def test_params_file_of_another_node(launch: Launch, tmp_path: Path) -> None:
    file = tmp_path / 'other.yaml'
    file.write_text('other_node:\n  ros__parameters:\n    port: 0\n')
    process = launch('camera.launch.py', source='pattern', params_file=file)
    process.finish()
    assert process.output.count('but none for this node') == 2, process.output


def test_publishers_of_several_cameras(launch: Launch) -> None:
    process = launch('cameras.launch.py', cameras='front=pattern rear=pattern:64x48')
    process.wait_until(lambda output: all(
        f'[{name}.image_publisher]: Publishing video frame' in output
        for name in ('front', 'rear')))
    end(process)
