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
import sqlite3
import sys
import tempfile
from tempfile import gettempdir

from opencv_tools.bags import compression
from opencv_tools.bags.db3_reader import Db3Reader
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.mcap_reader import McapReader
from opencv_tools.bags.open_bag import Bag, bag_files, is_bag, open_bag_file, recordings
from opencv_tools.bags.reading import BagMessage
from played_bags import image_entry, write_mcap, write_rosbag2
import pytest
import zstandard


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


def test_folder_without_readable_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / 'metadata.yaml').touch()
    with pytest.raises(BagError, match=r'has no file with the extension \.mcap or \.db3$'):
        bag_files(tmp_path)


def pack(path: Path, suffix: str = '.zstd', frames: int = 1) -> Path:
    """Replace a file by a packed one, of one or several frames of zstd."""
    data = path.read_bytes()
    size = -(-len(data) // frames)
    packed = path.with_name(path.name + suffix)
    packed.write_bytes(b''.join(
        zstandard.compress(data[begin:begin + size]) for begin in range(0, len(data), size)))
    path.unlink()
    return packed


def messages_of(path: Path) -> list[tuple[str, int, bytes]]:
    """Return all messages of a bag; assert that no temporary file is left."""
    bag = Bag(path)
    assert not bag.warnings
    found = [(item.topic.name, item.log_ns, bytes(item.load()))
             for item in bag.messages(bag.topics) if isinstance(item, BagMessage)]
    bag.close()
    assert not [*Path(gettempdir()).glob('opencv_tools-*')]
    return found


@pytest.mark.parametrize(('suffix', 'frames'), [('.zstd', 1), ('.zst', 3), ('.ZSTD', 2)])
@pytest.mark.parametrize('kind', ['.mcap', '.db3'])
def test_packed_file(kind: str, suffix: str, frames: int, tmp_path: Path,
                     monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    entries = [*map(image_entry, range(7)), image_entry(2, topic='/other')]
    folder = write_rosbag2(tmp_path / 'bag', kind, entries)
    path, = folder.glob(f'*{kind}')
    expected = messages_of(path)
    assert len(expected) == 8
    packed = pack(path, suffix, frames)
    assert is_bag(packed)
    assert messages_of(packed) == expected
    # compression_mode FILE: metadata.yaml has one of both names.
    assert messages_of(folder) == expected
    metadata = folder / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace(path.name, packed.name))
    assert messages_of(folder) == expected
    path.write_bytes(zstandard.ZstdDecompressor().stream_reader(
        packed.read_bytes(), read_across_frames=True).read())
    packed.write_bytes(b'damaged')  # the file itself is there as well
    assert messages_of(folder) == expected


def test_packed_files_of_a_split_follow_each_other(tmp_path: Path) -> None:
    for part in range(3):
        pack(write_mcap(tmp_path / f'd_{part}.mcap', map(image_entry, range(
            7 * part, 7 * part + 7))))
    files = sorted(tmp_path.iterdir())
    assert len({*Bag(tmp_path / 'd_*', files).topics}) == 1
    assert recordings(files) == [files]
    assert recordings([files[0], files[2]]) == [[files[0]], [files[2]]]


def write_files(folder: Path, names: dict[str, int], recording: str = 'a') -> list[Path]:
    """Write files of two images each, by the number of the first one."""
    records = [('opencv_tools', {'recording': recording})] if recording else []
    return [write_mcap(folder / name, map(image_entry, (first, first + 1)), metadata=records)
            for name, first in names.items()]


@pytest.mark.parametrize('recording', ['a', ''])
@pytest.mark.parametrize(('missing', 'warnings'), [
    ([5], ['1 file is missing between d_4.mcap and d_6.mcap']),
    ([2, 3, 9], ['2 files are missing between d_1.mcap and d_4.mcap',
                 '1 file is missing between d_8.mcap and d_10.mcap']),
    ([0, 1, 11], []), ([], [])])
def test_missing_numbers_of_a_recording(
        tmp_path: Path, missing: list[int], warnings: list[str], recording: str) -> None:
    files = write_files(tmp_path, {f'd_{number}.mcap': 2 * number for number in range(12)
                                   if number not in missing}, recording)
    assert Bag(tmp_path / 'd_*', files).warnings == (warnings if recording else [])


def test_file_between_others_that_is_no_part_of_the_bag(tmp_path: Path) -> None:
    whole = write_files(tmp_path, {f'd_{number}.mcap': 2 * number for number in range(5)})
    files = [whole[0], whole[2], whole[4]]
    write_files(tmp_path, {'d_1.mcap': 2}, 'b')  # another recording
    (tmp_path / 'd_1.txt').touch()
    (tmp_path / 'd_3.txt').touch()
    pack(whole[3])  # as a pattern for .mcap leaves it out
    assert Bag(tmp_path / 'd_*.mcap', files).warnings == [
        '1 file is missing between d_2.mcap and d_4.mcap']
    assert Bag(tmp_path / 'd_*', whole[:3]).warnings == []  # of two recordings
    (tmp_path / 'other').mkdir()
    assert Bag(tmp_path / '*/d_*', [whole[0], *write_files(
        tmp_path / 'other', {'d_5.mcap': 10})]).warnings == []


def test_renamed_file_of_a_recording(tmp_path: Path) -> None:
    files = write_files(tmp_path, {f'd_{number}.mcap': 2 * number for number in range(3)})
    other = files[1].rename(tmp_path / 'other.mcap')
    assert Bag(tmp_path / '*.mcap', [files[0], files[2], other]).warnings == [
        '1 file is missing between d_0.mcap and d_2.mcap',
        'other.mcap is read after d_2.mcap, but begins 0.080 s before it']
    write_files(tmp_path, {'d_2.mcap': 4}, '')
    assert Bag(tmp_path / '*.mcap', [files[0], files[2], other]).warnings == []


@pytest.mark.parametrize(('data', 'reason'), [
    (b'no zstd at all', 'a.mcap.zstd cannot be decompressed: '),
    (b'', 'a.mcap.zstd is not an MCAP file'),
    (zstandard.compress(b'hello'), 'is not an MCAP file')])
def test_packed_file_that_is_damaged(data: bytes, reason: str, tmp_path: Path) -> None:
    (tmp_path / 'a.mcap.zstd').write_bytes(data)
    with pytest.raises(BagError, match=reason):
        Bag(tmp_path / 'a.mcap.zstd')


def test_packed_file_that_is_cut_off(tmp_path: Path) -> None:
    path = pack(write_mcap(tmp_path / 'a.mcap', [
        image_entry(one % 250) for one in range(9000)], use_chunking=False))
    path.write_bytes(path.read_bytes()[:path.stat().st_size // 2])
    assert 'a.mcap.zstd has no end' in Bag(path).warnings[0]


def test_packed_file_larger_than_the_disk(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = pack(write_mcap(tmp_path / 'a.mcap', map(image_entry, range(2))))
    monkeypatch.setattr(compression, '_RESERVE_BYTES', 1 << 60)
    with pytest.raises(BagError, match=r'does not fit into .*; set TMPDIR to a folder'):
        Bag(path)


@pytest.mark.parametrize('kind', ['.mcap', '.db3'])
def test_type_names_of_dashing(kind: str, tmp_path: Path) -> None:
    if kind == '.mcap':
        path = write_mcap(tmp_path / 'a.mcap', [
            image_entry(1)._replace(type_name='sensor_msgs/Image')])
    else:
        path, = write_rosbag2(tmp_path / 'a', kind, [image_entry(1)]).glob('*.db3')
        with sqlite3.connect(path) as database:
            database.execute("UPDATE topics SET type = 'sensor_msgs/Image'")
    topic, = Bag(path).topics
    assert topic.type_name == 'sensor_msgs/msg/Image' and topic.has_images


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
