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

"""A bag becomes another bag with all of its topics, byte for byte."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
import re
from typing import Any

from bag_readers import metadata_of
from dataset_bags import (
    BEGAN, Drive, joints_entry, jpeg_entry, NANO, plain_entry, with_definitions)
from mcap.reader import make_reader
from mcap.writer import Writer
from opencv_tools.convert.cli import main
from played_bags import Entry, write_mcap, write_rosbag2
import pytest
from rosbags.highlevel import AnyReader
import zstandard

Errors = pytest.CaptureFixture[str]
TIME = '{sec: 9223372036, nsec: 854775807}'
LATCHED = f"""\
- history: keep_last
  depth: 1
  reliability: reliable
  durability: transient_local
  deadline: {TIME}
  lifespan: {TIME}
  liveliness: automatic
  liveliness_lease_duration: {TIME}
  avoid_ros_namespace_conventions: false
"""
FRAMES = '/cam0/image_raw/compressed'


def entries(seconds: float = 1.0, topics: int = 40) -> list[Entry]:
    """Return the messages of a robot with many topics, two of them cameras."""
    drive = Drive(seconds=seconds, topics=(FRAMES, '/cam1'))
    drive.others = [
        plain_entry(BEGAN + step * NANO // 7, float(step), f'/level_{number}', 'Float64')
        for step in range(round(7 * seconds)) for number in range(topics - 5)]
    drive.others.append(plain_entry(
        BEGAN - NANO, 'robot', '/robot_description', 'String')._replace(qos=LATCHED))
    return with_definitions(drive.entries())


def contents(path: Path) -> list[tuple[Any, ...]]:
    """Return all that the library mcap reads of the messages of a bag."""
    with path.open('rb') as file:
        return sorted((
            channel.topic, message.log_time, message.publish_time, message.sequence, message.data,
            schema.name, schema.encoding, schema.data, channel.message_encoding,
            channel.metadata.get('offered_qos_profiles', ''))
            for schema, channel, message in make_reader(file).iter_messages() if schema)


def read_by_rosbags(*paths: Path) -> list[tuple[str, int, bytes]]:
    with AnyReader([*paths]) as reader:
        return sorted((connection.topic, time_ns, bytes(data))
                      for connection, time_ns, data in reader.messages())


def test_bag_of_40_topics(tmp_path: Path, capsys: Errors) -> None:
    source, target = write_mcap(tmp_path / 'a.mcap', entries()), tmp_path / 'b.mcap'
    assert main([str(source), str(target)]) == 0
    assert contents(target) == contents(source)
    assert read_by_rosbags(target) == read_by_rosbags(source)
    counts = Counter(entry.topic for entry in entries())
    assert len(counts) == 40
    errors = capsys.readouterr().err
    assert f'Copied {counts.total() - 30} messages of 39 other topics, 0 failed' in errors
    assert 'left out' not in errors


@pytest.mark.parametrize('suffix', ['.mcap', '.db3'])
def test_folder_of_rosbag2(suffix: str, tmp_path: Path) -> None:
    source = write_rosbag2(tmp_path / 'a', suffix, [
        entry._replace(definition='') for entry in entries(0.4, 9)])
    assert main([str(source), str(tmp_path / 'b.mcap')]) == 0
    assert read_by_rosbags(tmp_path / 'b.mcap') == read_by_rosbags(source)


def test_split_bag_is_joined(tmp_path: Path) -> None:
    whole = entries(0.9, 7)
    for part in range(3):
        write_mcap(tmp_path / f'd_{part}.mcap', whole[part::3] if part > 9 else whole[
            part * len(whole) // 3:(part + 1) * len(whole) // 3])
    assert main([str(tmp_path / 'd_*.mcap'), str(tmp_path / 'join.mcap')]) == 0
    expected = sorted((entry.topic, entry.log_ns, entry.data) for entry in whole)
    assert read_by_rosbags(tmp_path / 'join.mcap') == expected


@pytest.mark.parametrize('count', [0, 1, 3, 200])
@pytest.mark.parametrize('suffix', ['.mcap', '.mcap.zstd'])
def test_metadata_records_are_copied(count: int, suffix: str, tmp_path: Path) -> None:
    account = ('opencv_tools', {'account': '{"/a": {"written": 1}}'})
    records = [(f'name {number}', {'key': 'x' * number, 'ü': ''}) for number in range(count)]
    records += [account] * bool(count)
    for part, entry in enumerate(entries(0.2, 6)):
        source = write_mcap(tmp_path / f'd_{part}.mcap', [entry], metadata=[
            ('opencv_tools', {'recording': 'abc'}), *records])
        if suffix == '.mcap.zstd':
            (tmp_path / f'{source.name}.zstd').write_bytes(
                zstandard.compress(source.read_bytes()))
            source.unlink()
    assert main([str(tmp_path / f'd_*{suffix}'), str(tmp_path / 'join.mcap'), '--topic',
                 FRAMES]) == 0
    found = metadata_of(tmp_path / 'join.mcap')
    assert [one for one in found if one != account] == [
        ('opencv_tools', {'recording': 'abc'}), *records[:-1]]
    assert found.count(account) == (part + 1) * bool(count)
    assert main([str(tmp_path / 'join.mcap'), str(tmp_path / 'again.mcap'), '--topic',
                 FRAMES]) == 0
    assert metadata_of(tmp_path / 'again.mcap') == found
    for number, part in enumerate((('--start', '1'), ('--stop', '2'), ('--every', '2'),
                                   ('--topics', '/joint_states'))):
        copy = tmp_path / f'part_{number}.mcap'
        assert main([str(tmp_path / 'join.mcap'), str(copy), '--topic', FRAMES, *part]) == 0
        assert metadata_of(copy) == [one for one in found if one != account]


def test_topics_are_chosen_and_the_others_are_named(tmp_path: Path, capsys: Errors) -> None:
    source, target = write_mcap(tmp_path / 'a.mcap', entries()), tmp_path / 'b.mcap'
    assert main([str(source), str(target), '--topics', '/level_1*,/joint_states']) == 0
    found = {topic for topic, *_ in contents(target)}
    assert found == {FRAMES, '/joint_states', '/level_1', *(f'/level_1{one}' for one in range(10))}
    errors = capsys.readouterr().err
    assert '/arm/command (101 of 101), /cam1 (30 of 30), ' in errors
    assert '/robot_description (1 of 1)' not in errors  # one of those beyond the first twenty
    assert ' and 7 more' in errors


def test_part_of_a_bag_has_the_topics_of_its_time(tmp_path: Path, capsys: Errors) -> None:
    source, target = write_mcap(tmp_path / 'a.mcap', entries()), tmp_path / 'b.mcap'
    assert main([str(source), str(target), '--topic', FRAMES, '--start', '5', '--stop', '15']) == 0
    found = contents(target)
    frames = [time_ns for topic, time_ns, *_ in found if topic == FRAMES]
    assert len(frames) == 10
    expected = [one for one in contents(source) if one[0] == '/robot_description' or (
        frames[0] <= one[1] <= frames[-1])]
    assert found == expected
    assert '/joint_states (71 of 101)' in capsys.readouterr().err


def test_messages_that_cannot_be_copied_are_failures(tmp_path: Path, capsys: Errors) -> None:
    other = jpeg_entry(0, BEGAN)._replace(topic='/other', encoding='json')
    source = write_mcap(tmp_path / 'a.mcap', [*entries(0.2, 6), other], use_chunking=False)
    data = bytearray(source.read_bytes())
    source.write_bytes(data)
    assert main([str(source), str(tmp_path / 'b.mcap')]) == 0
    assert 'left out, with numbers of messages: /other (1 of 1)' in capsys.readouterr().err
    joints = [entry._replace(type_name='a_msgs/msg/Own', definition='') if entry.topic == (
        '/joint_states') else entry for entry in entries(0.2, 6)]
    source = write_mcap(tmp_path / 'c.mcap', joints)
    assert main([str(source), str(tmp_path / 'd.mcap')]) == 0
    assert contents(tmp_path / 'd.mcap') == contents(source)
    assert joints_entry(BEGAN, [0.0, 2.0, 0.0]).data in [one[4] for one in contents(source)]


@pytest.mark.parametrize('target', ['b.mcap', 'a_{seq:04d}.jpg'])
@pytest.mark.parametrize('damaged', [1, 4, 8, 3])
def test_images_of_damaged_chunks_count_as_failed(
        damaged: int, target: str, tmp_path: Path, capsys: Errors) -> None:
    images = [entry for entry in entries(3.0, 7) if entry.topic == FRAMES]
    source = write_mcap(tmp_path / 'a.mcap', images, chunk_size=20_000)
    content = bytearray(source.read_bytes())
    with source.open('rb') as file:
        summary = make_reader(file).get_summary()
    assert summary
    chunks = summary.chunk_indexes[1:1 + damaged]
    for chunk in chunks:
        content[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 255
    source.write_bytes(content)
    assert main([str(source), str(tmp_path / target)]) == 1
    found = re.search(r'Converted (\d+) frames.*, (\d+) failed', capsys.readouterr().err)
    assert found and int(found[1]) < len(images) - damaged
    assert int(found[1]) + int(found[2]) == len(images)


@pytest.mark.parametrize(('source', 'target', 'wrong'), [
    ('a.mcap', 'b.mp4', 'b.mp4'), ('a.mcap', '{seq}.png', '{seq}.png'),
    ('pattern:64x48', 'b.mcap', 'pattern:64x48')])
def test_topics_of_what_is_no_bag_are_an_error(
        source: str, target: str, wrong: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: Errors) -> None:
    monkeypatch.chdir(tmp_path)
    write_mcap(tmp_path / 'a.mcap', [one for one in entries(0.4, 3) if one.topic == FRAMES])
    assert main([source, target, '--stop', '2', '--topics', '/joint_states']) == 2
    assert f'beside its frames, but {wrong} is no bag' in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ['a.mcap']


@pytest.mark.parametrize(('topics', 'wrong'), [
    ('/joint_state', '/joint_state'), ('/level_1*,/levels', '/levels'), ('x*,*', 'x*'),
    ('/joint_states,/level_?9', '/level_?9')])
def test_topics_that_the_bag_has_not_are_an_error(
        topics: str, wrong: str, tmp_path: Path, capsys: Errors) -> None:
    source = write_mcap(tmp_path / 'a.mcap', entries(0.4, 12))
    assert main([str(source), str(tmp_path / 'b.mcap'), '--topics', topics]) == 2
    assert not (tmp_path / 'b.mcap').exists()
    assert f"--topics has '{wrong}', but the bag has no such topic; it has /arm/command" in (
        capsys.readouterr().err)


@pytest.mark.parametrize('use_statistics', [True, False])
@pytest.mark.parametrize('count', [0, 1, 5, 70])
def test_other_definitions_are_copied_and_attachments_named(
        count: int, use_statistics: bool, tmp_path: Path, capsys: Errors) -> None:
    source, target = tmp_path / 'a.mcap', tmp_path / 'b.mcap'
    with source.open('wb') as file:
        writer = Writer(file, use_statistics=use_statistics)
        writer.start('ros2', 'test')
        for number in range(count):
            writer.add_attachment(1, 2, f'{number}.yaml', 'text/yaml', b'hello')
        schemas = [('sensor_msgs/msg/CompressedImage', 'ros2msg', b''),
                   ('my_pkg/msg/Odd', 'ros2idl', b'module my_pkg {};'), ('my_pkg/msg/O', 'x', b'')]
        channels = [writer.register_channel(topic, 'cdr', writer.register_schema(*schema), {})
                    for topic, schema in zip((FRAMES, '/idl', '/x'), schemas)]
        for number in range(9):
            entry = jpeg_entry(number, BEGAN + number)
            writer.add_message(channels[0], entry.log_ns, entry.data, entry.log_ns)
            writer.add_message(channels[1 + number % 2], entry.log_ns, b'zz', entry.log_ns)
        writer.finish()
    assert main([str(source), str(target)]) == 0
    found = {topic: (name, encoding, data) for topic, *_, name, encoding, data, _, _ in contents(
        target)}
    assert [found[topic] for topic in ('/idl', '/x')] == schemas[1:]
    errors = capsys.readouterr().err
    assert (f'left out: {count} attachments of the bag' in errors) == (count > 0)
