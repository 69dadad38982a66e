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

"""What an installed package has, where ROS 2 looks for it."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

from ament_index_python.packages import get_package_prefix, get_package_share_directory
from conftest import NodeProcess
from opencv_tools.basic_image_publisher import PARAMETERS as PUBLISHER_PARAMETERS
from opencv_tools.basic_image_subscriber import PARAMETERS as SUBSCRIBER_PARAMETERS
from opencv_tools.ros.parameters import Parameter
import pytest
import yaml


def test_ros2_run_finds_and_runs_the_executables(tmp_path: Path) -> None:
    # What `ros2 run opencv_tools NAME` does: the ament index names the prefix, and the executable
    # is the file of that name in lib/opencv_tools.
    folder = Path(get_package_prefix('opencv_tools'), 'lib', 'opencv_tools')
    assert sorted(path.name for path in folder.iterdir()) == ['img_publisher', 'img_subscriber']
    for path in folder.iterdir():
        assert os.access(path, os.X_OK)
    finished = subprocess.run(
        [folder / 'img_publisher', '--ros-args', '-p', 'source:=pattern', '-p', 'max_frames:=2'],
        cwd=tmp_path, capture_output=True, text=True, timeout=30, check=False)
    assert finished.returncode == 0, finished.stderr
    assert 'Publishing video frame' in finished.stderr


def test_launch_and_config_are_installed() -> None:
    share = Path(get_package_share_directory('opencv_tools'))
    assert (share / 'launch' / 'camera.launch.py').is_file()
    assert (share / 'launch' / 'cameras.launch.py').is_file()
    assert (share / 'config' / 'camera.yaml').is_file()
    assert ElementTree.parse(share / 'package.xml').findtext('name') == 'opencv_tools'


def test_every_parameter_in_the_config_exists_and_is_accepted(
        start: Callable[..., NodeProcess], tmp_path: Path) -> None:
    config = Path(get_package_share_directory('opencv_tools'), 'config', 'camera.yaml')
    nodes = yaml.safe_load(config.read_text())
    assert {name.rpartition('/')[2] for name in nodes} == {'image_publisher', 'image_subscriber'}
    publisher = start('img_publisher', '--ros-args', '--params-file', str(config), '--',
                      source='pattern', max_frames=1)
    subscriber = start('img_subscriber', '--ros-args', '--params-file', str(config), '--',
                       output_dir=tmp_path / 'out', timeout=0.5)
    assert publisher.finish() == 0, publisher.output
    assert subscriber.finish() == 1, subscriber.output
    for process in (publisher, subscriber):
        assert 'unknown parameter' not in process.output


@pytest.mark.parametrize('module', ['basic_image_publisher', 'basic_image_subscriber'])
def test_the_modules_can_be_run(module: str) -> None:
    finished = subprocess.run([sys.executable, '-m', f'opencv_tools.{module}', '--help'],
                              capture_output=True, text=True, timeout=30, check=False)
    assert finished.returncode == 0, finished.stderr
    assert 'parameters [default]:' in finished.stdout


def test_the_tests_that_the_readme_names_exist() -> None:
    tests = Path(__file__).parent
    named = re.findall(r'`((?:camera/)?test_\w+\.py)((?:::\w+)*)',
                       tests.parent.joinpath('README.md').read_text())
    assert len(named) > 20
    for file, path in named:
        source = tests.joinpath(file).read_text()
        for name in filter(None, path.split('::')):
            assert re.search(rf'^ *(def|class) {name}\b', source, re.MULTILINE), (file, name)


@pytest.mark.parametrize('parameter', [*PUBLISHER_PARAMETERS, *SUBSCRIBER_PARAMETERS],
                         ids=lambda parameter: parameter.name)
def test_every_parameter_is_in_the_readme(parameter: Parameter) -> None:
    readme = Path(__file__).parent.parent.joinpath('README.md').read_text()
    assert f'| `{parameter.name}` | `{parameter.default!r}` | {parameter.description}' in readme
