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

"""Bags, read by other readers: bits, times, chunks, sizes and full disks."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
from pathlib import Path

from bag_readers import decode, read_by_all, read_indexed, read_streaming, Stored
from conftest import disk_of
from mcap.reader import SeekingReader
from mcap.stream_reader import StreamReader
import numpy as np
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.schemas import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE
from opencv_tools.bags.writing import BagChannel, BagWriter
from opencv_tools.base.arguments import package_version
from opencv_tools.image.cdr import (
    message_to_cdr_parts, WireCompressedImage, WireHeader, WireImage, WireMessage)
from opencv_tools.image.encodings import ENCODINGS
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

NANO = 10**9
CHANNEL = BagChannel(topic='/video_frames', type_name=IMAGE)
COMPRESSED = BagChannel(topic='/video_frames/compressed', type_name=COMPRESSED_IMAGE)
INFO = BagChannel(topic='/camera_info', type_name=CAMERA_INFO)


def image(number: int, data_bytes: int = 12, encoding: str = 'mono8') -> WireImage:
    data = np.random.default_rng(number).integers(0, 256, data_bytes, np.uint8)
    return WireImage(
        header=WireHeader(-number, number, 'camera'), height=1, width=data_bytes,
        encoding=encoding, is_bigendian=False, step=data_bytes, data=data)


def put(writer: BagWriter, message: WireMessage, log_ns: int = NANO,
        channel: BagChannel = CHANNEL) -> Stored:
    parts = message_to_cdr_parts(message)
    writer.write(channel, parts, log_ns=log_ns, publish_ns=5, sequence=7)
    return Stored(channel.topic, log_ns, b''.join(parts))


def padded(encoding: str, is_bigendian: bool, padding: int) -> WireImage:
    """Return an image of random bytes whose rows have padding, which is recorded too."""
    found = ENCODINGS[encoding]
    height, width = 4, 6
    step = width * found.pixel_bytes + padding * found.pixel_bytes
    data = np.random.default_rng(1).integers(0, 256, found.rows(height) * step, np.uint8)
    return WireImage(header=WireHeader(1, 2, 'camera'), height=height, width=width,
                     encoding=encoding, is_bigendian=is_bigendian, step=step, data=data)


def test_every_encoding_bit_for_bit(tmp_path: Path) -> None:
    messages = [padded(encoding, is_bigendian, padding) for encoding in ENCODINGS
                for is_bigendian in (False, True) for padding in (0, 3)]
    messages.append(image(3, encoding='my_own'))
    writer = BagWriter(tmp_path / 'a.mcap')
    stored = [put(writer, message, NANO + number) for number, message in enumerate(messages)]
    writer.close()
    assert read_by_all(tmp_path / 'a.mcap') == stored
    for decoded, message, entry in zip(decode(tmp_path / 'a.mcap'), messages, stored):
        assert (decoded.encoding, decoded.step, decoded.is_bigendian, decoded.width) == (
            message.encoding, message.step, message.is_bigendian, message.width)
        assert bytes(decoded.data) == bytes(message.data)
        by_rclpy = deserialize_message(entry.data, Image)
        assert by_rclpy.data.tobytes() == bytes(message.data)
        assert len(serialize_message(by_rclpy)) == len(entry.data)


def test_topics_of_all_types(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / 'a.mcap')
    jpeg = WireCompressedImage(header=WireHeader(3, 4, 'camera'), format='jpeg', data=b'abc')
    info = CameraInfo(width=7, d=[1.0, 2.0])
    info.header.frame_id = 'camera'
    stored = [put(writer, image(1)), put(writer, jpeg, channel=COMPRESSED)]
    writer.write(INFO, [serialize_message(info)], log_ns=NANO, publish_ns=0)
    writer.close()
    assert read_by_all(tmp_path / 'a.mcap')[:2] == stored
    _, compressed, camera_info = decode(tmp_path / 'a.mcap')
    assert (compressed.format, bytes(compressed.data)) == ('jpeg', b'abc')
    assert deserialize_message(stored[1].data, CompressedImage).format == 'jpeg'
    assert (camera_info.width, list(camera_info.d), camera_info.header.frame_id) == (
        7, [1.0, 2.0], 'camera')


def test_metadata_of_file_channels_and_messages(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / 'a.mcap')
    channel = BagChannel(topic='/a', type_name=IMAGE, qos='- history: 1\n', type_hash='RIHS01_0')
    put(writer, image(1), 2 * NANO, channel)
    put(writer, image(2), -5, channel)
    writer.write(channel, [b'\0\1\0\0'], log_ns=2**70, publish_ns=-1, sequence=2**32 + 3)
    writer.close()
    with (tmp_path / 'a.mcap').open('rb') as file:
        reader = SeekingReader(file)
        header, summary = reader.get_header(), reader.get_summary()
        messages = [message for *_, message in reader.iter_messages(log_time_order=False)]
    assert header.profile == 'ros2' and header.library == f'opencv_tools {package_version()}'
    assert summary.channels[1].metadata == {
        'offered_qos_profiles': '- history: 1\n', 'topic_type_hash': 'RIHS01_0'}
    assert summary.channels[1].message_encoding == 'cdr'
    assert (summary.schemas[1].name, summary.schemas[1].encoding) == (IMAGE, 'ros2msg')
    statistics = summary.statistics
    assert (statistics.message_start_time, statistics.message_end_time) == (0, 2**63 - 1)
    assert [(message.log_time, message.publish_time, message.sequence) for message in messages] \
        == [(2 * NANO, 5, 7), (0, 5, 7), (2**63 - 1, 0, 3)]


def test_schema_and_channel_precede_the_first_chunk(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / 'a.mcap')
    put(writer, image(1))
    put(writer, image(2), channel=COMPRESSED)
    writer.close()
    with (tmp_path / 'a.mcap').open('rb') as file:
        names = [type(record).__name__ for record in StreamReader(file, emit_chunks=True).records]
    assert names[:10] == ['Header', 'Schema', 'Channel', 'Chunk', 'MessageIndex', 'Schema',
                          'Channel', 'Chunk', 'MessageIndex', 'DataEnd']


@pytest.mark.parametrize(('messages', 'expected'), [
    ([(400_000, 0), (300_000, 0), (300_000, 0)], [2, 1]),
    ([(800_000, 0), (800_000, 0), (10, 0), (800_000, 0)], [1, 1, 1, 1]),
    ([(10, 0), (10, 499_999_999), (10, 500_000_000), (10, 999_999_999)], [2, 2]),
    ([(10, 900_000_000), (10, 0)], [1, 1])])
def test_end_of_a_chunk(
        tmp_path: Path, messages: list[tuple[int, int]], expected: list[int]) -> None:
    writer = BagWriter(tmp_path / 'a.mcap')
    stored = [put(writer, image(number, size), NANO + log_ns)
              for number, (size, log_ns) in enumerate(messages)]
    writer.close()
    assert sorted(read_by_all(tmp_path / 'a.mcap'), key=str) == sorted(stored, key=str)
    counts: list[int] = []
    with (tmp_path / 'a.mcap').open('rb') as file:
        for record in StreamReader(file, emit_chunks=True).records:
            if type(record).__name__ == 'MessageIndex':
                counts.append(len(record.records))
    assert counts == expected


def test_every_message_is_in_the_file_at_once(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / 'a.mcap')
    stored = []
    for number in range(5):
        stored.append(put(writer, image(number, 300_000)))
        found = []
        with (tmp_path / 'a.mcap').open('rb') as file, pytest.raises(Exception):  # noqa: B017
            for record in StreamReader(file).records:
                if type(record).__name__ == 'Message':
                    found.append(record.data)
        assert found == [entry.data for entry in stored]
    writer.close()


def test_size_and_digest(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / 'a.mcap')
    for number in range(12):
        put(writer, image(number, 900_000 if number % 5 == 0 else 3_000), NANO + number * 10**8,
            COMPRESSED if number == 7 else CHANNEL)
    writer.close()
    content = (tmp_path / 'a.mcap').read_bytes()
    assert writer.size == len(content)
    assert writer.sha256 == hashlib.sha256(content).hexdigest()


@pytest.mark.parametrize('count', [1, 2, 9])
def test_size_of_the_closed_file_is_known_before(tmp_path: Path, count: int) -> None:
    writer = BagWriter(tmp_path / 'a.mcap')
    for number in range(count):
        message = image(number, 700_000)
        channel = (CHANNEL, COMPRESSED)[number % 2]
        known = writer.size_with(channel, sum(map(len, message_to_cdr_parts(message))))
        put(writer, message, NANO, channel)
    writer.close()
    assert writer.size == known == (tmp_path / 'a.mcap').stat().st_size


def test_bag_without_messages(tmp_path: Path) -> None:
    BagWriter(tmp_path / 'a.mcap').close()
    assert read_indexed(tmp_path / 'a.mcap') == read_streaming(tmp_path / 'a.mcap') == []


def test_existing_file_is_not_changed(tmp_path: Path) -> None:
    (tmp_path / 'a.mcap').write_text('mine')
    with pytest.raises(FileExistsError):
        BagWriter(tmp_path / 'a.mcap')
    assert (tmp_path / 'a.mcap').read_text() == 'mine'


def test_file_is_locked_while_it_is_written(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / 'a.mcap')
    with (tmp_path / 'a.mcap').open('rb') as file:
        with pytest.raises(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        writer.close()
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_full_disk_loses_only_the_messages_that_do_not_fit(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    writer = BagWriter(path)
    stored = [put(writer, image(number, 10_000)) for number in range(3)]
    with disk_of(60_000):
        for size in (40_000, 900_000, 40_000):
            with pytest.raises(OSError, match=os.strerror(errno.EFBIG)):
                put(writer, image(9, size))
            assert path.stat().st_size == writer.size < 40_000
        stored.append(put(writer, image(4, 10_000)))
    stored += [put(writer, image(number, size), 2 * NANO)
               for number, size in ((5, 900_000), (6, 10_000))]
    writer.close()
    assert read_by_all(path) == stored
    assert writer.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_disk_that_is_full_after_a_long_message(tmp_path: Path) -> None:
    first = BagWriter(tmp_path / 'first.mcap')
    put(first, image(0, 900_000))
    size = first.size
    first.close()
    writer = BagWriter(tmp_path / 'a.mcap')
    with disk_of(size - 5):  # without room for the index of the message
        stored = [put(writer, image(0, 900_000))]
    stored.append(put(writer, image(1)))
    writer.close()
    assert read_by_all(tmp_path / 'a.mcap') == stored


def test_file_that_cannot_be_begun_is_removed(tmp_path: Path) -> None:
    with disk_of(10), pytest.raises(OSError, match=os.strerror(errno.EFBIG)):
        BagWriter(tmp_path / 'a.mcap')
    assert not list(tmp_path.iterdir())


def test_missing_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__('sys').modules, 'mcap.records', None)
    with pytest.raises(BagError, match=r"^bags need the library mcap, .* with 'pip install mcap'"):
        BagWriter(tmp_path / 'a.mcap')
    assert not list(tmp_path.iterdir())


def test_written_pages_are_freed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part, freed = 1 << 12, []
    monkeypatch.setattr('opencv_tools.bags.writing._PART_BYTES', part)
    monkeypatch.setattr(os, 'posix_fadvise', lambda file, start, size, advice: freed.append(
        (start, size, advice)))
    writer = BagWriter(tmp_path / 'a.mcap')
    stored = [put(writer, image(number, part)) for number in range(10)]
    size = writer.size
    writer._pages.submit(int).result()  # all earlier calls have ended
    writer.close()
    assert read_indexed(tmp_path / 'a.mcap') == stored
    starts = [start for start, *_ in freed]
    assert [*dict.fromkeys(starts)] == [part * number for number in range(len({*starts}))]
    # The first call starts the writing. The second one frees the pages, except for the last ones.
    assert starts.count(0) == 2 and starts.count(max(starts)) == 1 and max(starts) < size
    assert {entry[1:] for entry in freed} == {(part, os.POSIX_FADV_DONTNEED)}


def test_two_definitions_of_a_type(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / 'a.mcap')
    for topic, definition in (('/a', 'int8 a'), ('/b', 'int8 b'), ('/c', 'int8 a')):
        writer.write(BagChannel(topic=topic, type_name='my_msgs/msg/A', definition=definition),
                     [b'\0\1\0\0\7'], log_ns=NANO, publish_ns=0)
    writer.close()
    with (tmp_path / 'a.mcap').open('rb') as file:
        summary = SeekingReader(file).get_summary()
    assert {channel.topic: summary.schemas[channel.schema_id].data.decode()
            for channel in summary.channels.values()} == {
        '/a': 'int8 a', '/b': 'int8 b', '/c': 'int8 a'}
    assert len(summary.schemas) == 2


def test_message_without_a_byte(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / 'a.mcap')
    writer.write(CHANNEL, [np.empty(0, np.uint8)], log_ns=NANO, publish_ns=0)
    writer.close()
    assert [stored.data for stored in read_streaming(tmp_path / 'a.mcap')] == [b'']
