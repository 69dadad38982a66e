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

"""Contents of the installed package."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

from ament_index_python.packages import get_package_share_directory
from conftest import NodeProcess
import pytest
from waiting import LONGEST_SECONDS
import yaml


EXECUTABLES = ['img_calibrate', 'img_convert', 'img_filter', 'img_publisher', 'img_subscriber',
               'img_viewer', 'opencv_tools_info', 'robot_compare', 'robot_frames', 'robot_view',
               'sdf_to_urdf', 'urdf_to_sdf']


@pytest.fixture
def share(prefix: Path) -> Path:
    """Return the folder of launch files, configurations and robots that colcon has installed."""
    folder = Path(get_package_share_directory('opencv_tools'))
    assert folder == prefix / 'share' / 'opencv_tools'
    return folder


@pytest.mark.quick_cases(2)
@pytest.mark.process
@pytest.mark.parametrize('name', EXECUTABLES)
def test_executables_stand_beside_python(name: str) -> None:
    # The pip of Debian 12 put them elsewhere, because setup.cfg says where colcon puts them.
    if not Path(sys.prefix, 'installed').exists():
        pytest.skip('this python is none that make has set up; ros2 run finds the executables')
    finished = subprocess.run([Path(sys.executable).parent / name, '--help'],
                              capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, finished.stderr
    assert finished.stdout.startswith(f'usage: {name} ')


def test_executables_of_the_nodes_run(prefix: Path, tmp_path: Path) -> None:
    folder = prefix / 'lib' / 'opencv_tools'
    assert sorted(path.name for path in folder.iterdir()) == EXECUTABLES
    for path in folder.iterdir():
        assert os.access(path, os.X_OK)
    finished = subprocess.run(
        [folder / 'img_publisher', '--ros-args', '-p', 'source:=pattern', '-p', 'max_frames:=2'],
        cwd=tmp_path, capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, finished.stderr
    assert 'Publishing video frame' in finished.stderr


def test_executables_for_robots_run(prefix: Path, share: Path,
                                    tmp_path: Path) -> None:
    urdf, sdf = share / 'urdf' / 'my_robot.urdf', share / 'sdf' / 'my_robot' / 'model.sdf'
    for command, *arguments in (
            ('urdf_to_sdf', urdf, '-o', tmp_path / 'my_robot.sdf'),
            ('urdf_to_sdf', urdf.with_suffix('.urdf.xacro'), '-o', tmp_path / 'xacro.sdf'),
            ('sdf_to_urdf', sdf, '-o', tmp_path / 'my_robot.urdf'),
            ('robot_compare', tmp_path / 'my_robot.sdf', tmp_path / 'my_robot.urdf'),
            ('robot_compare', tmp_path / 'xacro.sdf', sdf),
            ('robot_frames', tmp_path / 'my_robot.urdf')):
        finished = subprocess.run([prefix / 'lib' / 'opencv_tools' / command, *arguments],
                                  capture_output=True, text=True,
                                  timeout=LONGEST_SECONDS, check=False)
        assert finished.returncode == 0, (command, finished.stdout, finished.stderr)
        assert 'Traceback' not in finished.stderr
    assert 'base_footprint' in finished.stdout


def test_gazebo_model_paths_are_exported(share: Path) -> None:
    # What ros_gz_sim does with <gazebo_ros gazebo_model_path>: ${prefix} is the share folder.
    paths = [Path(export.attrib['gazebo_model_path'].replace('${prefix}', str(share)))
             for export in ElementTree.parse(share / 'package.xml').iter('gazebo_ros')]
    model = ElementTree.parse(share / 'sdf' / 'my_robot' / 'model.sdf')
    uri = model.findtext('.//mesh/uri', '').removeprefix('model://')
    assert any((path / uri).is_file() for path in paths)
    for robot in ('my_robot', 'my_arm'):
        assert any((path / robot / 'model.config').is_file() for path in paths)


def test_data_files_are_installed(share: Path) -> None:
    for file in ('urdf/my_robot.urdf.xacro', 'urdf/my_robot.urdf', 'urdf/my_arm.urdf',
                 'sdf/my_robot/model.sdf', 'sdf/my_robot/model.config',
                 'sdf/my_arm/model.sdf', 'sdf/my_arm/model.config',
                 'meshes/my_robot/robot_base.stl'):
        assert (share / file).is_file(), file
    assert (share / 'launch' / 'camera.launch.py').is_file()
    assert (share / 'launch' / 'cameras.launch.py').is_file()
    assert (share / 'config' / 'camera.yaml').is_file()
    assert ElementTree.parse(share / 'package.xml').findtext('name') == 'opencv_tools'


def test_config_files_have_valid_parameters(
        share: Path, start: Callable[..., NodeProcess], tmp_path: Path) -> None:
    config = share / 'config' / 'camera.yaml'
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


@pytest.mark.process
@pytest.mark.parametrize('command', ['robot_compare', 'robot_frames', 'robot_view', 'sdf_to_urdf',
                                     'urdf_to_sdf'])
def test_robot_commands_run_as_a_module(command: str) -> None:
    finished = subprocess.run(
        [sys.executable, '-m', 'opencv_tools.robot.cli', command, '--help'],
        capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, finished.stderr
    assert finished.stdout.startswith(f'usage: {command} ')


@pytest.mark.process
@pytest.mark.parametrize('module', ['basic_image_publisher', 'basic_image_subscriber'])
def test_nodes_run_as_modules(module: str) -> None:
    finished = subprocess.run([sys.executable, '-m', f'opencv_tools.{module}', '--help'],
                              capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, finished.stderr
    assert 'parameters, with type' in finished.stdout


def project_texts() -> dict[Path, str]:
    """Return the texts of the project that are written by hand."""
    root = Path(__file__).parents[2]
    folders = ('.ci', '.github', 'config', 'docs', 'examples', 'launch', 'opencv_tools',
               'requirements', 'test')
    paths = [path for path in root.iterdir() if path.is_file()]
    for folder in folders:
        paths += [path for path in (root / folder).rglob('*') if path.suffix in (
            '.html', '.js', '.md', '.py', '.rst', '.txt', '.yaml', '.yml', '')]
    return {path.relative_to(root): path.read_text(errors='replace')
            for path in paths if path.is_file()}


def test_no_installation_from_pypi_under_our_name() -> None:
    # PyPI has a project of another author under this name.
    texts = project_texts()
    assert len(texts) > 300
    wrong = re.compile(r"""install [^\n]*["' ]opencv[-_.]tools\b|^opencv[-_.]tools\b *[=<>~\[]""")
    assert {str(path): found[0] for path, text in texts.items()
            if path.parts[0] != 'test' and (found := wrong.search(text))} == {}


def test_one_text_for_missing_libraries() -> None:
    texts = project_texts()
    assert [str(path) for path, text in texts.items()
            if path.parts[0] == 'opencv_tools' and 'pip install' in text] == [
                'opencv_tools/base/remedies.py']


def test_names_in_pages_about_the_code() -> None:
    root = Path(__file__).parents[2]
    page = ''.join(root.joinpath('docs', name).read_text()
                   for name in ('architecture.md', 'data_ways.md'))
    paths = re.findall(r'`((?:\w+/)+(?:\w+\.py)?)`', page)
    assert len(paths) > 30
    assert [path for path in paths if not (root / 'opencv_tools' / path).exists()
            and not (root / path).exists()] == []
    steps = re.findall(r'`(?:(\w+)\.)?(\w+)` \(`([\w/]+\.py)`\)', page)
    assert len(steps) > 15
    for owner, name, path in steps:
        source = root.joinpath('opencv_tools', path).read_text()
        for word in filter(None, (owner, name)):
            definition = rf'^ *((async )?def|class) {word}\b'
            assert re.search(definition, source, re.MULTILINE), (path, word)
