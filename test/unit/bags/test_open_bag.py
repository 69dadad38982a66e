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

import os
from pathlib import Path
import sys

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


FILES = ('a_0.mcap', 'a_1.mcap', 'a_2.db3', '.part.mcap', 'a.png')


def write_folder(folder: Path, metadata: str | bytes) -> Path:
    for name in FILES:
        (folder / name).touch()
    (folder / 'metadata.yaml').write_bytes(
        metadata if isinstance(metadata, bytes) else metadata.encode())
    return folder


def naming(*names: str) -> str:
    return ('rosbag2_bagfile_information: {topics: [a, {b: [1]}], relative_file_paths: '
            f'[{", ".join(names)}]}}')


@pytest.mark.parametrize(('names', 'warning'), [
    (('a_1.mcap', 'a_2.db3', 'a_0.mcap'), ''),
    (('bag/a_1.mcap', '../a_0.mcap'), 'metadata.yaml does not name 1 files of its folder, '
     'which are not read, such as a_2.db3'),
    (('a_2.db3.zstd',), 'metadata.yaml does not name 2 files of its folder, which are not read, '
     'such as a_0.mcap')])
def test_order_of_the_metadata(tmp_path: Path, names: tuple[str, ...], warning: str) -> None:
    found = bag_files(write_folder(tmp_path, naming(*names)))
    assert found.are_ordered
    assert found.paths == [tmp_path / Path(name.removesuffix('.zstd')).name for name in names]
    assert found.warning.removeprefix(f'{tmp_path}/') == warning


LIST = 'it has no relative_file_paths'
HOSTILE = {
    'empty': (b'', LIST), 'text': (b'hello', LIST),
    'binary': (bytes(range(256)), 'it is not YAML: '),
    'no list': (b'rosbag2_bagfile_information: {relative_file_paths: a_0.mcap}', LIST),
    'no name': (naming(), 'it names no files'),
    'of another place': (b'relative_file_paths: [a_0.mcap]', LIST),
    'missing': (naming('a_9.mcap'), 'it names a_9.mcap which is not in the folder'),
    'twice': (naming('a_0.mcap', 'a_0.mcap'), 'it names a_0.mcap 2 times'),
    'path': (naming('/etc/passwd'), 'it names passwd which is not in the folder'),
    'other kind': (naming('a.png'), 'it names a.png which is not in the folder'),
    'hidden': (naming('.part.mcap'), 'it names .part.mcap which is not in the folder'),
    'escapes': (naming('"a\\e[2Jb"'), r'it names a\x1b[2Jb which'),
    'object': (b'!!python/object/apply:os.system ["touch owned"]', LIST),
    'nested': (b'[' * (1 << 21), LIST), 'mappings': (b'{a: ' * (1 << 19), LIST),
    'long': (b'a: 1\n' + b'# comment\n' * (1 << 18), LIST),
    'many': (b'rosbag2_bagfile_information: {a: [' + b'1,' * (1 << 19) + b']}', LIST),
    'directives': (b''.join(b'%%TAG !%x! x\n' % number for number in range(74_000)),
                   'it has directives of YAML'),
    'directive behind an event': (b'--- a\n...\r%YAML 1.1\n---\n', 'it has directives of YAML'),
    'UTF-16': ('%YAML 1.1\n--- a'.encode('utf-16'), 'it is not YAML: '),
    'laughs': (b'a: &a [x, x]\nb: &b {<<: [*a, *a]}\nc: &c {<<: [*b, *b]}\n', LIST),
}


@pytest.mark.parametrize('name', HOSTILE)
def test_metadata_that_cannot_be_used(
        tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    metadata, reason = HOSTILE[name]
    found = bag_files(write_folder(tmp_path, metadata))
    assert not found.are_ordered
    assert sorted(path.name for path in found.paths) == ['a_0.mcap', 'a_1.mcap', 'a_2.db3']
    assert f'metadata.yaml is not used: {reason}' in found.warning
    assert found.warning.endswith('; the files are read in the order of their names')
    assert found.warning.isprintable() and not (tmp_path / 'owned').exists()


def test_metadata_in_a_pipe(tmp_path: Path) -> None:
    (write_folder(tmp_path, '') / 'metadata.yaml').unlink()
    os.mkfifo(tmp_path / 'metadata.yaml')
    assert 'is a named pipe' in bag_files(tmp_path).warning


@pytest.mark.parametrize(('names', 'reason'), [
    (['metadata.yaml'], r'has no file with the extension \.mcap or \.db3$'),
    (['metadata.yaml', 'a_0.db3.zstd'], "a_0.db3.zstd is compressed; unpack it with 'unzstd'")])
def test_folder_without_readable_files_is_refused(
        tmp_path: Path, names: list[str], reason: str) -> None:
    for name in names:
        (tmp_path / name).touch()
    with pytest.raises(BagError, match=reason):
        bag_files(tmp_path)


@pytest.mark.parametrize('name', ['a.db3.zstd', 'a.mcap.zst', 'A.MCAP.ZSTD'])
def test_packed_bag_is_refused_with_the_remedy(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    assert is_bag(tmp_path / name)
    with pytest.raises(BagError, match="is compressed; unpack it with 'unzstd'"):
        bag_files(tmp_path / name)


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
    monkeypatch.setitem(sys.modules, 'mcap.records', None)
    with pytest.raises(BagError, match="install it with 'pip install mcap'"):
        open_bag_file(tmp_path / 'a.mcap')


def test_folder_without_pyyaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'yaml', None)
    found = bag_files(write_folder(tmp_path, naming('a_1.mcap')))
    assert len(found.paths) == 3 and 'PyYAML cannot be imported' in found.warning
