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

"""Finishing of bags that were cut off anywhere, and of damaged ones."""

from __future__ import annotations

import errno
import os
from pathlib import Path
import random

from bag_readers import read_by_all, read_by_rosbags, read_indexed, Stored
from conftest import disk_of
from hypothesis import given, settings, strategies as st
import numpy as np
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.finishing import finish_bag, has_footer
from opencv_tools.bags.mcap_records import CHUNK, CHUNK_CODE, MESSAGE, MESSAGE_CODE, RECORD
from opencv_tools.bags.schemas import CAMERA_INFO, IMAGE
from opencv_tools.bags.writing import BagChannel, BagWriter
from opencv_tools.image.cdr import message_to_cdr_parts, WireHeader, WireImage
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo

NANO = 10**9
CHANNEL = BagChannel(topic='/video_frames', type_name=IMAGE)
INFO = BagChannel(topic='/camera_info', type_name=CAMERA_INFO)
HEADER_BYTES = 47  # with the name of the package, without its version


def put(writer: BagWriter, number: int, data_bytes: int = 8, seconds: float = 0.0) -> Stored:
    data = np.full(data_bytes, number, np.uint8)
    message = WireImage(header=WireHeader(number, 0, 'camera'), height=1, width=data_bytes,
                        encoding='mono8', is_bigendian=False, step=data_bytes, data=data)
    parts = message_to_cdr_parts(message)
    log_ns = NANO + round(seconds * NANO)
    writer.write(CHANNEL, parts, log_ns=log_ns, publish_ns=log_ns, sequence=number)
    return Stored(CHANNEL.topic, log_ns, b''.join(parts))


def small_bag(path: Path) -> list[Stored]:
    """Write three chunks with five images and a camera_info."""
    writer = BagWriter(path)
    stored = [put(writer, number, seconds=number / 4) for number in range(5)]
    info = serialize_message(CameraInfo(width=3))
    writer.write(INFO, [info], log_ns=2 * NANO, publish_ns=0)
    writer.close()
    return [*stored, Stored(INFO.topic, 2 * NANO, info)]


@pytest.mark.thorough
def test_cut_at_every_byte(tmp_path: Path) -> None:
    path = tmp_path / 'cut.mcap'
    stored = small_bag(path)
    content = path.read_bytes()
    whole = 0
    read: dict[bytes, list[Stored]] = {}
    for size in range(len(content) + 1):
        path.write_bytes(content[:size])
        frames = finish_bag(path)
        if frames is None:
            assert size < HEADER_BYTES + 20 and not whole
            assert path.read_bytes() == content[:size]
            continue
        finished = path.read_bytes()
        if finished not in read:
            read[finished] = read_by_all(path)
        found = read[finished]
        assert found == stored[:len(found)]
        assert frames == sum(entry.topic == CHANNEL.topic for entry in found)
        # Every message whose last byte is there is found.
        assert all(entry in found for entry in stored if entry.data in content[:size])
        assert len(found) >= whole
        whole = len(found)
        assert finish_bag(path) == frames and path.read_bytes() == finished
    assert whole == len(stored) and path.read_bytes() == content


def test_last_message_behind_the_chunk_is_kept(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    writer = BagWriter(path)
    stored = [put(writer, 0)]
    before = path.read_bytes()
    stored.append(put(writer, 1))
    after = path.read_bytes()
    writer.close()
    # The writer adds the message first, then it writes the longer header of the chunk.
    path.write_bytes(before + after[len(before):])
    assert finish_bag(path) == 2
    assert read_indexed(path) == read_by_rosbags(path) == stored


def test_zeros_after_a_power_cut(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    stored = small_bag(path)
    content = path.read_bytes()
    for size in range(HEADER_BYTES + 50, len(content) - 1, 23):
        path.write_bytes(content[:size] + bytes(5000))
        try:
            finish_bag(path)
        except BagError:  # zeros in the middle of a record can be a wrong length
            assert path.read_bytes() == content[:size] + bytes(5000)
        else:
            found = read_indexed(path)
            assert len(found) >= len([entry for entry in stored if entry.data in content[:size]])


def test_bag_of_large_frames(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    writer = BagWriter(path)
    stored = [put(writer, number, 800_000) for number in range(3)]
    content = path.read_bytes()
    writer.close()
    for size, count in ((len(content), 3), (len(content) - 100_000, 2), (900_000, 1)):
        path.write_bytes(content[:size])
        assert finish_bag(path) == count
        assert read_indexed(path) == read_by_rosbags(path) == stored[:count]


def test_bag_that_is_being_written_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    writer = BagWriter(path)
    put(writer, 1)
    content = path.read_bytes()
    assert finish_bag(path) is None and path.read_bytes() == content
    writer.close()
    assert finish_bag(path) == 1


@pytest.mark.parametrize('change', [
    lambda content: content.replace(b'opencv_tools', b'Opencv_tools'),
    lambda content: content.replace(b'ros2', b'ros1'),
    lambda content: content.replace(b'\4\0\0\0ros2', b'\5\0\0\0ros2'),
    lambda content: b'M' + content[1:],
    lambda content: b'', lambda content: b'text' * 100])
def test_files_of_others_are_left_alone(tmp_path: Path, change: object) -> None:
    path = tmp_path / 'a.mcap'
    small_bag(path)
    content = change(path.read_bytes()[:-9])  # type: ignore[operator]
    path.write_bytes(content)
    assert finish_bag(path) is None and path.read_bytes() == content


def test_link_is_not_followed(tmp_path: Path) -> None:
    small_bag(tmp_path / 'a.mcap')
    (tmp_path / 'b.mcap').symlink_to(tmp_path / 'a.mcap')
    with pytest.raises(OSError, match='symbolic link'):
        finish_bag(tmp_path / 'b.mcap')


def test_damage_in_the_middle_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    small_bag(path)
    content = path.read_bytes()[:-50]
    chunk = content.index(b'\x06', content.index(b'RIHS') if b'RIHS' in content else 500)
    for position in (chunk + 1, chunk + 25, chunk + 45):
        damaged = bytearray(content)
        damaged[position] ^= 0x55
        path.write_bytes(damaged)
        with pytest.raises(BagError, match=r'^the bag a\.mcap is damaged at byte \d+; it was not'):
            finish_bag(path)
        assert path.read_bytes() == damaged


def test_empty_chunk(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    BagWriter(path).close()
    content = path.read_bytes()
    content = content[:content.index(b'\x0f\4\0\0\0')] + CHUNK.pack(
        CHUNK_CODE, CHUNK.size - RECORD.size, 0, 0, 0, 0, 0, 0)
    path.write_bytes(content)
    with pytest.raises(BagError, match='is damaged at byte'):
        finish_bag(path)
    assert path.read_bytes() == content


def test_header_that_claims_more_than_the_file_has(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    small_bag(path)
    content = bytearray(path.read_bytes()[:-50])
    content[9:17] = (1 << 20).to_bytes(8, 'little')
    path.write_bytes(content)
    assert finish_bag(path) is None and path.read_bytes() == content


def test_other_record_in_an_unfinished_chunk(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    writer = BagWriter(path)
    stored = [put(writer, number) for number in range(2)]
    content = bytearray(path.read_bytes())
    writer.close()
    first = len(content) - 2 * len(stored[0].data) - 2 * MESSAGE.size
    assert content[first] == MESSAGE_CODE
    content[first + MESSAGE.size + len(stored[0].data)] = 3  # of a schema
    path.write_bytes(content)
    with pytest.raises(BagError, match='is damaged at byte'):
        finish_bag(path)
    assert path.read_bytes() == content


def test_full_disk_leaves_a_bag_that_can_be_finished(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    stored = small_bag(path)
    path.write_bytes(path.read_bytes()[:-100])
    size = path.stat().st_size - 900
    with disk_of(size), pytest.raises(OSError, match=os.strerror(errno.EFBIG)):
        finish_bag(path)
    assert not has_footer(path)
    assert finish_bag(path) == 5 and has_footer(path)
    assert read_indexed(path) == stored


any_bag = given(st.data())


def check_hostile_bags(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    path = tmp_path_factory.mktemp('bags') / 'a.mcap'
    small_bag(path)
    content = bytearray(path.read_bytes())
    positions = st.integers(HEADER_BYTES, len(content) - 1)
    for _ in range(data.draw(st.integers(1, 4))):
        position = data.draw(positions)
        replacement = data.draw(st.sampled_from(
            (b'\xff' * 8, b'\0' * 8, b'\x06', b'\x05', b'\x40')))
        content[position:position + len(replacement)] = replacement
    content = content[:data.draw(positions)]
    path.write_bytes(content)
    try:
        frames = finish_bag(path)
    except BagError:
        assert path.read_bytes() == content
    else:
        assert frames is None or 0 <= frames <= 5


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [60, 300])
def test_hostile_bags(examples: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    settings(max_examples=examples)(any_bag(check_hostile_bags))(tmp_path_factory=tmp_path_factory)


def test_file_of_many_small_messages_needs_little_memory(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    writer = BagWriter(path)
    put(writer, 1)
    content = path.read_bytes()
    writer.close()
    chunk = content.index(b'\x06', 400)
    message = content[chunk + 49:]
    count = 786432 // len(message) + 2
    size = count * len(message)
    header = bytearray(content[chunk:chunk + 49])
    for offset, value in ((1, size + 40), (25, size), (41, size)):
        header[offset:offset + 8] = value.to_bytes(8, 'little')
    path.write_bytes(content[:chunk] + header + message * count)
    with pytest.raises(BagError, match='is damaged'):
        finish_bag(path)


def test_random_cuts_of_a_long_bag(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    chosen = random.Random(21)
    writer = BagWriter(path)
    stored = [put(writer, number % 200, chosen.choice((10, 5_000, 790_000)), number / 10)
              for number in range(60)]
    writer.close()
    content = path.read_bytes()
    for _ in range(8):
        size = chosen.randrange(HEADER_BYTES + 20, len(content))
        path.write_bytes(content[:size])
        frames = finish_bag(path)
        assert read_indexed(path) == stored[:frames]
        end = content.find(stored[frames].data) if frames < len(stored) else size + 1
        assert end + (len(stored[frames].data) if frames < len(stored) else 0) > size
