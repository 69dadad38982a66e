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

"""Files of a bag."""

from __future__ import annotations

from pathlib import Path

from opencv_tools.bags.db3_reader import Db3Reader
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.mcap_reader import McapReader
from opencv_tools.bags.open_bag import bag_files, is_bag, open_bag_file
from played_bags import image_entry, write_rosbag2
import pytest


@pytest.mark.parametrize(('name', 'expected'), [
    ('a.mcap', True), ('a.MCAP', True), ('a.db3', True), ('a.bag', True), ('a.mp4', False),
    ('folder', False), ('folder.mcap', False)])
def test_bags_are_recognised_by_their_names(tmp_path: Path, name: str, expected: bool) -> None:
    if name.startswith('folder'):
        (tmp_path / name).mkdir()
    assert is_bag(tmp_path / name) == expected


def test_folder_of_rosbag2_is_recognised_by_its_metadata(tmp_path: Path) -> None:
    (tmp_path / 'metadata.yaml').touch()
    assert is_bag(tmp_path)


def test_files_of_a_folder(tmp_path: Path) -> None:
    for name in ('a_0.mcap', 'a_1.mcap', '.part.mcap', 'metadata.yaml', 'a.png'):
        (tmp_path / name).touch()
    assert sorted(path.name for path in bag_files(tmp_path)) == ['a_0.mcap', 'a_1.mcap']


@pytest.mark.parametrize(('names', 'reason'), [
    (['metadata.yaml'], r'has no file with the extension \.mcap or \.db3$'),
    (['metadata.yaml', 'a_0.db3.zstd'], "a_0.db3.zstd is compressed; unpack it with 'unzstd'")])
def test_folder_without_readable_files_is_refused(
        tmp_path: Path, names: list[str], reason: str) -> None:
    for name in names:
        (tmp_path / name).touch()
    with pytest.raises(BagError, match=reason):
        bag_files(tmp_path)


def test_bag_of_ros_1_is_refused_with_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r'a bag of ROS 1; convert it with .rosbags-convert --src'):
        bag_files(tmp_path / 'a.bag')


@pytest.mark.parametrize(('suffix', 'kind'), [('.mcap', McapReader), ('.db3', Db3Reader)])
def test_reader_follows_from_the_extension(tmp_path: Path, suffix: str, kind: type) -> None:
    folder = write_rosbag2(tmp_path / 'bag', suffix, [image_entry(0)])
    reader = open_bag_file(folder / f'bag{suffix}')
    assert isinstance(reader, kind)
    reader.close()


def test_missing_library_is_named_with_its_remedy(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / 'a.mcap').touch()
    monkeypatch.setitem(__import__('sys').modules, 'mcap.records', None)
    with pytest.raises(BagError, match="install it with 'pip install mcap'"):
        open_bag_file(tmp_path / 'a.mcap')
