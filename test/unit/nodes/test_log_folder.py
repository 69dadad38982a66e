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


"""The folder for the log of ROS if the default folder is not writable."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import tempfile

from conftest import NodeProcess
from opencv_tools.nodes.run_node import replace_log_folder
import pytest

VARIABLES = ('ROS_LOG_DIR', 'ROS_HOME', 'HOME')

# Without these capabilities, file modes apply to root too.
WITHOUT_OVERRIDE = () if os.geteuid() else (
    'setpriv', '--bounding-set=-dac_override,-dac_read_search')


@pytest.fixture(autouse=True)
def _clean_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / 'temporary').mkdir()
    (tmp_path / 'file').touch()
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path / 'temporary'))
    monkeypatch.setenv('TMPDIR', str(tmp_path / 'temporary'))
    for variable in VARIABLES:
        monkeypatch.delenv(variable, raising=False)


@pytest.mark.parametrize(('settings', 'folder'), [
    ({'HOME': 'home'}, 'home/.ros/log'), ({'HOME': 'home', 'ROS_HOME': 'ros'}, 'ros/log'),
    ({'HOME': 'file', 'ROS_LOG_DIR': 'log'}, 'log'), ({'HOME': 'home', 'ROS_LOG_DIR': ''},
                                                      'home/.ros/log')])
def test_writable_default_folder(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path, settings: dict[str, str],
        folder: str) -> None:
    for variable, name in settings.items():
        monkeypatch.setenv(variable, name and str(tmp_path / name))
    before = dict(os.environ)
    assert replace_log_folder() == ''
    assert dict(os.environ) == before
    assert (tmp_path / folder).is_dir()
    assert not list((tmp_path / 'temporary').iterdir())


@pytest.mark.parametrize(('variable', 'words'), [
    ('', 'there is no home directory, HOME is unset'), ('HOME', 'file/.ros/log cannot be written'),
    ('ROS_HOME', 'file/log cannot be written'), ('ROS_LOG_DIR', 'file cannot be written')])
def test_temporary_folder(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path, variable: str, words: str) -> None:
    monkeypatch.setenv('ROS_LOG_DIR', '')
    if variable:
        monkeypatch.setenv(variable, str(tmp_path / 'file'))
    sentence = replace_log_folder()
    assert words in sentence
    (folder,) = (tmp_path / 'temporary').iterdir()
    assert os.environ['ROS_LOG_DIR'] == str(folder)
    assert str(folder) in sentence
    assert replace_log_folder() == ''


def test_no_change_without_a_temporary_folder(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path / 'none'))
    assert replace_log_folder() == ''
    assert 'ROS_LOG_DIR' not in os.environ


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('name', ['img_publisher', 'img_subscriber'])
def test_node_in_an_unwritable_home(
        start: Callable[..., NodeProcess], monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
        name: str) -> None:
    home, folder = tmp_path / 'home', tmp_path / 'folder'
    home.mkdir()
    folder.mkdir()
    home.chmod(0o500)
    monkeypatch.setenv('HOME', str(home))
    forbid = ('sh', '-c', 'cd "$1" && chmod 0 . && shift && exec "$@"', 'sh', str(folder))
    parameters = {'img_publisher': {'source': 'pattern', 'max_frames': 1},
                  'img_subscriber': {'output_dir': tmp_path / 'out', 'timeout': 0.1}}[name]
    process = start(name, within=(*forbid, *WITHOUT_OVERRIDE), **parameters)
    try:
        assert process.finish() == (0 if name == 'img_publisher' else 1), process.output
    finally:
        folder.chmod(0o700)
        home.chmod(0o700)
    assert process.output.count(f'{home}/.ros/log cannot be written: ROS logs are written') == 1
    assert not list(home.iterdir())
