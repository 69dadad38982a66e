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

"""MCAP files of other libraries, whole, cut off and hostile."""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import struct
import sys
from typing import Any
import zlib

from conftest import peak_memory
from hypothesis import given, settings, strategies
import lz4.frame
from mcap.writer import CompressionType, IndexType
import numpy as np
from opencv_tools.bags import reading
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.mcap_reader import McapReader
from opencv_tools.bags.reading import BagMessage, BagTopic, MAX_BYTES
from opencv_tools.bags.schemas import IMAGE
from played_bags import (
    BEGAN_NS, Entry, image_entry, read_all, write_mcap, write_rosbag2, written)
import pytest
import zstandard

MAGIC = b'\x89MCAP0\r\n'
PLAIN = {'compression': CompressionType.NONE}
SMALL_CHUNKS = {**PLAIN, 'chunk_size': 300}
ENTRIES = [image_entry(number, topic=f'/camera_{number % 2}') for number in range(6)]


def record(opcode: int, content: bytes, length: int | None = None) -> bytes:
    return struct.pack('<BQ', opcode, len(content) if length is None else length) + content


def chunk(data: bytes, compression: bytes = b'', size: int | None = None, crc: int = 0,
          length: int | None = None) -> bytes:
    return record(6, struct.pack(
        '<QQQII', 0, 0, len(data) if size is None else size, crc, len(compression)) + compression
        + struct.pack('<Q', len(data) if length is None else length) + data)


def text(value: bytes) -> bytes:
    return struct.pack('<I', len(value)) + value


def message(number: int, data: bytes = b'data') -> bytes:
    return record(5, struct.pack('<HIQQ', 1, number, number, number) + data)


START = MAGIC + record(1, text(b'ros2') + text(b'test')) + record(
    3, struct.pack('<H', 1) + text(IMAGE.encode()) + text(b'ros2msg') + text(b'')) + record(
    4, struct.pack('<HH', 1, 1) + text(b'/a') + text(b'cdr') + text(b''))


@pytest.mark.parametrize('options', [
    *({'compression': compression, 'chunk_size': size} for compression in CompressionType
      for size in (300, 1 << 20)),
    {'use_chunking': False}, {**SMALL_CHUNKS, 'index_types': IndexType.NONE},
    {**SMALL_CHUNKS, 'use_statistics': False}, {**SMALL_CHUNKS, 'repeat_channels': False},
    {**SMALL_CHUNKS, 'enable_crcs': False}], ids=str)
def test_all_messages_are_read(tmp_path: Path, options: dict[str, Any]) -> None:
    path = write_mcap(tmp_path / 'a.mcap', ENTRIES, **options)
    assert read_all(path) == (written(ENTRIES), [])
    reader = McapReader(path)
    assert reader.topics == {BagTopic(f'/camera_{number}', IMAGE): 3 for number in range(2)}
    assert (reader.first_ns, reader.last_ns) == (ENTRIES[0].log_ns, ENTRIES[-1].log_ns)
    reader.close()


def test_one_topic_is_read(tmp_path: Path) -> None:
    reader = McapReader(write_mcap(tmp_path / 'a.mcap', ENTRIES, **SMALL_CHUNKS))
    found = [item.log_ns for item in reader.messages([BagTopic('/camera_1', IMAGE)])]
    assert found == [entry.log_ns for entry in ENTRIES[1::2]]


@pytest.mark.parametrize('options', [
    {'use_chunking': False}, {}, SMALL_CHUNKS, {**SMALL_CHUNKS, 'index_types': IndexType.NONE}],
    ids=str)
def test_messages_come_in_the_order_of_their_times(
        tmp_path: Path, options: dict[str, Any]) -> None:
    order = np.random.default_rng(1).permutation(40)
    entries = [Entry(BEGAN_NS + int(number), bytes([number])) for number in order]
    path = write_mcap(tmp_path / 'a.mcap', entries, **options)
    assert read_all(path) == (written(entries), [])


def test_file_of_rosbags_is_read(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / 'bag', '.mcap', ENTRIES)
    assert read_all(folder / 'bag.mcap') == (written(ENTRIES), [])


def cut_everywhere(path: Path) -> Iterator[tuple[int, list[Any], list[str]]]:
    """Yield each length of a file, and what is read of that part."""
    content, cut = path.read_bytes(), path.with_name('cut.mcap')
    for size in range(len(MAGIC), len(content)):
        cut.write_bytes(content[:size])
        yield size, *read_all(cut)


@pytest.mark.thorough
@pytest.mark.parametrize('options', [
    {**PLAIN, 'chunk_size': 80, 'enable_crcs': False}, {'use_chunking': False}], ids=str)
def test_cut_at_every_byte_keeps_what_is_whole(tmp_path: Path, options: dict[str, Any]) -> None:
    entries = [Entry(BEGAN_NS + number, os.urandom(20)) for number in range(4)]
    path = write_mcap(tmp_path / 'a.mcap', entries, **options)
    content = path.read_bytes()
    ends = [content.index(entry.data) + len(entry.data) for entry in entries]
    end = content.index(b'\x0f\4\0\0\0\0\0\0\0') + 13  # of the data section
    for size, messages, reports in cut_everywhere(path):
        assert messages == written(entries)[:sum(end <= size for end in ends)]
        assert len(reports) == (size < end)
        assert all('cut.mcap has no end: it was cut off' in report for report in reports)


@pytest.mark.thorough
def test_cut_compressed_bag_keeps_its_whole_chunks(tmp_path: Path) -> None:
    entries = [Entry(BEGAN_NS + number, os.urandom(20)) for number in range(6)]
    path = write_mcap(tmp_path / 'a.mcap', entries, chunk_size=80)
    numbers = []
    for _, messages, _ in cut_everywhere(path):
        assert messages == written(entries)[:len(messages)]
        numbers.append(len(messages))
    assert numbers == sorted(numbers)
    assert {*numbers} > {0, 6}


@pytest.mark.parametrize('size', range(len(MAGIC)))
def test_file_shorter_than_its_magic_is_refused(tmp_path: Path, size: int) -> None:
    (tmp_path / 'a.mcap').write_bytes(MAGIC[:size])
    with pytest.raises(BagError, match=r'a\.mcap is not an MCAP file'):
        McapReader(tmp_path / 'a.mcap')


def test_growing_file_is_read_up_to_its_size_at_the_start(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    path.write_bytes(START + message(0))
    reader = McapReader(path)
    with path.open('ab') as file:
        file.write(message(1) + message(2)[:20])
    assert [item.log_ns for item in reader.messages(reader.topics)] == [0]
    assert 'still being written' in reader.warning
    assert [log_ns for _, log_ns, _ in read_all(path)[0]] == [0, 1]


@pytest.mark.parametrize('size', [300, 600, 900])
def test_file_that_shrinks_is_reported(tmp_path: Path, size: int) -> None:
    path = write_mcap(tmp_path / 'a.mcap', ENTRIES, **SMALL_CHUNKS, enable_crcs=False)
    reader = McapReader(path)
    os.truncate(path, size)
    loaded, failures = [], 0
    for item in reader.messages(reader.topics):
        try:
            assert isinstance(item, BagMessage)
            loaded.append(bytes(item.load()))
        except (AssertionError, BagError):
            failures += 1
    assert loaded == [entry.data for entry in ENTRIES][:len(loaded)]
    assert failures and len(loaded) < len(ENTRIES)


ENDLESS = (1 << 64) - 1


@pytest.mark.parametrize(('content', 'numbers', 'reason'), [
    (record(5, b'', ENDLESS), [], 'has no end'),
    (record(0, b'', ENDLESS), [], 'has no end'),
    (bytes(100), [], 'has no end'),
    (record(4, b'\xff' * 40) + record(3, b'\xff' * 40), [], ''),
    (record(5, b'short'), [], ''),
    (record(99, b'unknown'), [], ''),
    (record(5, struct.pack('<HIQQ', 7, 0, 0, 0)), [], ''),  # a channel that does not exist
    (record(6, b'short'), [], 'its head is cut off'),
    (chunk(b'', b'a' * 17), [], 'its head is damaged'),
    (chunk(bytes(1000)), [], 'a record in it has no end'),
    (chunk(message(8), b'rar'), [], "its compression 'rar' is unknown"),
    (chunk(message(8), b'zstd'), [], 'its data cannot be decompressed'),
    (chunk(message(8), b'lz4'), [], 'its data cannot be decompressed'),
    (chunk(message(8), size=1 << 40), [], f'more than {MAX_BYTES} are not read'),
    (chunk(message(8), crc=1), [], 'its checksum is wrong'),
    (chunk(message(8), crc=zlib.crc32(message(8))), [8], ''),
    (chunk(message(8), length=ENDLESS), [], 'more than there are'),
    (chunk(message(8), b'lz4', length=ENDLESS), [], 'more than there are'),
    (chunk(message(8) + record(5, b'', 5000)), [8], 'a record in it has no end'),
    (chunk(chunk(message(8))), [], ''),
    (chunk(zstandard.compress(bytes(1 << 20)), b'zstd', 1000), [], 'another size'),
    (chunk(lz4.frame.compress(bytes(1 << 20)), b'lz4', 1000), [], 'another size'),
    (chunk(zstandard.compress(message(8)), b'zstd', len(message(8)) + 1), [], 'another size'),
])
def test_hostile_record_is_reported_and_the_rest_is_read(
        tmp_path: Path, content: bytes, numbers: list[int], reason: str) -> None:
    path = tmp_path / 'a.mcap'
    path.write_bytes(START + message(1) + content + message(9) + record(15, bytes(4)))
    messages, reports = read_all(path)
    after = [] if reason == 'has no end' else [9]
    assert [log_ns for _, log_ns, _ in messages] == [1, *numbers, *after]
    assert len(reports) == bool(reason) and reason in ''.join(reports)
    assert all(report.startswith('a.mcap') for report in reports)


def test_index_that_contradicts_the_file_is_not_used(tmp_path: Path) -> None:
    content = write_mcap(tmp_path / 'a.mcap', ENTRIES, **SMALL_CHUNKS).read_bytes()
    summary = struct.unpack_from('<Q', content, len(content) - 28)[0]
    index = content.index(b'\x08', summary)  # the first chunk index
    assert content[index + 1:index + 9] == content[content.index(b'\x08', index + 9) + 1:][:8]
    for offset, value in ((25, 1 << 62), (33, 1 << 62), (33, 1 << 20), (25, 0), (33, 0)):
        damaged = bytearray(content)
        struct.pack_into('<Q', damaged, index + offset, value)
        (tmp_path / 'b.mcap').write_bytes(damaged)
        assert read_all(tmp_path / 'b.mcap') == (written(ENTRIES), [])


def test_chunk_inside_of_another_chunk_is_not_read_twice(tmp_path: Path) -> None:
    outer = chunk(message(1) + record(99, chunk(message(2))))
    offset = len(START)
    inner = offset + outer.index(chunk(message(2)))
    indexes = b''.join(record(8, struct.pack('<QQQQ', 1, 2, begin, length) + bytes(12) + text(b'')
                              + bytes(16)) for begin, length in (
        (offset, len(outer)), (inner, len(chunk(message(2))))))
    counts = struct.pack('<HQ', 1, 2)
    statistics = record(11, struct.pack('<QHIIIIQQI', 2, 1, 1, 0, 0, 2, 1, 2, 10) + counts)
    data = START + outer + record(15, bytes(4))
    summary = START[len(MAGIC) + 9 + 16:] + statistics + indexes
    footer = record(2, struct.pack('<QQI', len(data), 0, 0)) + MAGIC
    (tmp_path / 'a.mcap').write_bytes(data + summary + footer)
    messages, reports = read_all(tmp_path / 'a.mcap')
    assert [log_ns for _, log_ns, _ in messages] == [1] and not reports


def test_damaged_chunk_without_index_is_reported_alone(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    path.write_bytes(START + chunk(zstandard.compress(message(1)), b'zstd', 1 << 40))
    messages, reports = read_all(path)
    assert messages == [] and len(reports) == 2
    assert f'more than {MAX_BYTES} are not read' in reports[1]


@pytest.mark.parametrize('data', [record(99, b''), record(5, b''), message(1, b'')], ids=[
    'unknown', 'empty', 'messages'])
def test_chunk_of_more_records_than_bytes(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / 'a.mcap'
    count = 1_000_000
    bomb = chunk(zstandard.compress(data * count), b'zstd', len(data) * count)
    path.write_bytes(START + message(1) + bomb + message(9) + record(15, bytes(4)))
    messages, reports = read_all(path)
    assert len(messages) <= 2 + len(bomb)
    assert [log_ns for _, log_ns, _ in messages][-1] == 9
    assert len(reports) == 1 and 'it has more records than bytes' in reports[0]


any_damage = given(
    positions=strategies.lists(strategies.tuples(
        strategies.integers(0, 5000), strategies.binary(min_size=1, max_size=9)), max_size=6),
    options=strategies.sampled_from([SMALL_CHUNKS, {'use_chunking': False}, {'chunk_size': 300}]))


def check_damaged_bytes_raise_nothing_else_than_bag_errors(
        tmp_path_factory: pytest.TempPathFactory, positions: list[tuple[int, bytes]],
        options: dict[str, Any]) -> None:
    path = tmp_path_factory.getbasetemp() / 'damaged.mcap'
    content = bytearray(write_mcap(path, ENTRIES, **options).read_bytes())
    for position, data in positions:
        position %= len(content)
        content[position:position + len(data)] = data
    path.write_bytes(content)
    try:
        messages, reports = read_all(path)
    except BagError as err:
        assert '\n' not in str(err)
    else:
        assert len(messages) <= 1000
        assert not any('\n' in report for report in reports)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [75, 300])
def test_damaged_bytes_raise_nothing_else_than_bag_errors(
        examples: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    check = any_damage(check_damaged_bytes_raise_nothing_else_than_bag_errors)
    settings(max_examples=examples)(check)(tmp_path_factory=tmp_path_factory)


any_records = given(
    content=strategies.lists(strategies.one_of(
        strategies.binary(max_size=60),
        strategies.builds(record, strategies.integers(0, 16), strategies.binary(max_size=60)),
        strategies.builds(message, strategies.integers(0, 1 << 31)),
        strategies.builds(
            chunk, strategies.binary(max_size=60), strategies.sampled_from([b'', b'lz4', b'zstd']),
            strategies.integers(0, 1 << 63), strategies.integers(0, 9),
            strategies.integers(0, 1 << 63)))))


def check_random_records_raise_nothing(
        tmp_path_factory: pytest.TempPathFactory, content: list[bytes]) -> None:
    path = tmp_path_factory.getbasetemp() / 'random.mcap'
    path.write_bytes(START + b''.join(content) + message(9))
    read_all(path)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [50, 200])
def test_random_records_raise_nothing(
        examples: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    check = any_records(check_random_records_raise_nothing)
    settings(max_examples=examples)(check)(tmp_path_factory=tmp_path_factory)


BOMBS = {
    'chunk': lambda: chunk(zstandard.compress(bytes(4 << 30)), b'zstd', 4 << 30),
    'hidden': lambda: chunk(zstandard.compress(bytes(1 << 30)), b'zstd', 1000),
    'lz4': lambda: chunk(lz4.frame.compress(bytes(1 << 30)), b'lz4', 1 << 27),
    'messages': lambda: chunk(zstandard.compress(message(3, b'') * 1_000_000), b'zstd',
                              1_000_000 * len(message(3, b''))),
    'sorted': lambda: chunk(  # as many bytes in the file as messages
        (data := zstandard.compress(message(3, b'') * 99_000)) + bytes(99_100), b'zstd',
        99_000 * len(message(3, b'')), length=len(data)) * 8,
    'many': lambda: chunk(zstandard.compress(data := message(3, bytes(64 << 20))), b'zstd',
                          len(data)) * 20,
    'zeros': lambda: bytes(1 << 24), 'indexes': lambda: record(7, bytes(1 << 24)) * 8,
    'channels': lambda: b''.join(record(4, struct.pack('<HH', number, 1) + text(
        b'/' + b'a' * 20000) + text(b'cdr') + text(b'')) for number in range(1 << 13))}


def peak_memory_of_loading(path: Path) -> int:
    """Return the peak memory in KB of a process that loads all messages of a bag."""
    script = ('import sys; from pathlib import Path\n'
              'from opencv_tools.bags.mcap_reader import McapReader\n'
              'reader = McapReader(Path(sys.argv[1]))\n'
              'for item in reader.messages(reader.topics):\n'
              '    if hasattr(item, "load"): item.load()\n')
    return peak_memory(script, path)


@pytest.mark.thorough
@pytest.mark.process
@pytest.mark.parametrize('name', BOMBS)
def test_hostile_bag_needs_less_than_400_megabytes(tmp_path: Path, name: str) -> None:
    (tmp_path / 'a.mcap').write_bytes(START + message(1) + BOMBS[name]() + message(9))
    assert peak_memory_of_loading(tmp_path / 'a.mcap') < 400_000


@pytest.mark.thorough
@pytest.mark.process
def test_chunks_with_the_same_times_need_less_than_a_gigabyte(tmp_path: Path) -> None:
    data = bytes(32 << 20)
    entries = [Entry(BEGAN_NS + 1000 * part + number, data)
               for number in range(24) for part in range(2)]
    path = write_mcap(tmp_path / 'a.mcap', entries, chunk_size=len(data) + 100)
    assert peak_memory_of_loading(path) < 900_000


def test_interleaved_chunks_are_merged_within_the_limit_of_the_memory(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entries = [Entry(BEGAN_NS + 10 * part + number, bytes(100))
               for number in range(6) for part in range(2)]
    path = write_mcap(tmp_path / 'a.mcap', entries, chunk_size=150)
    assert read_all(path) == (written(entries), [])
    monkeypatch.setattr('opencv_tools.bags.mcap_reader.MAX_BYTES', 400)
    messages, reports = read_all(path)
    assert messages != written(entries) and sorted(messages) == written(entries)
    assert not reports


@pytest.mark.parametrize('chunk_size', [100, 1 << 30])
def test_long_file_without_index_is_merged_from_its_parts(
        tmp_path: Path, chunk_size: int) -> None:
    numbers = [(number * 7) % 30 for number in range(30)]
    entries = [Entry(BEGAN_NS + number, bytes([number]) * 100_000) for number in numbers]
    path = write_mcap(tmp_path / 'a.mcap', entries, **PLAIN, chunk_size=chunk_size)
    os.truncate(path, path.stat().st_size - 10)
    messages, reports = read_all(path)
    assert (messages, reports) == (written(entries), [])


def test_message_above_the_limit_is_reported_with_its_size(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_mcap(tmp_path / 'a.mcap', ENTRIES, use_chunking=False)
    monkeypatch.setattr('opencv_tools.bags.mcap_reader.MAX_BYTES', 50)
    reader = McapReader(path)
    for item in reader.messages(reader.topics):
        assert isinstance(item, BagMessage)
        with pytest.raises(BagError, match=r'claims [0-9]+ bytes; more than 50 are not read'):
            item.load()
    reader.close()


@pytest.mark.parametrize('name', ['zstd', 'lz4'])
def test_missing_decompressor_is_named_with_its_remedy(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    path = write_mcap(tmp_path / 'a.mcap', ENTRIES, compression=CompressionType(
        {'zstd': CompressionType.ZSTD, 'lz4': CompressionType.LZ4}[name]))
    for module in ('zstandard', 'lz4.frame'):
        monkeypatch.setitem(sys.modules, module, None)
    messages, reports = read_all(path)
    assert messages == [] and len(reports) == 1
    assert f'it needs {name}' in reports[0] and "install it with 'pip install mcap'" in reports[0]


@pytest.mark.parametrize('is_indexed', [True, False])
def test_texts_of_many_topics_are_kept_once(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_indexed: bool) -> None:
    entries = [Entry(number, b'', f'/{number}', 'a_msgs/msg/A', 1000 * 'a', 1000 * 'q')
               for number in range(50)]
    path = write_mcap(tmp_path / 'a.mcap', entries, **(
        {} if is_indexed else {'index_types': IndexType.NONE, 'use_statistics': False}))
    reader = McapReader(path)
    reader.close()
    assert len(reader.topics) == 50
    for kept in ('definition', 'qos'):
        assert len({id(getattr(topic, kept)) for topic in reader.topics}) == 1
        assert len(getattr(next(iter(reader.topics)), kept)) == 1000


def test_limit_of_all_texts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, '_MAX_TEXTS', 2500)
    entries = [Entry(number, b'', f'/{number}', f'a_msgs/msg/A{number}', 1000 * f'{number}')
               for number in range(5)]
    reader = McapReader(write_mcap(tmp_path / 'a.mcap', entries))
    reader.close()
    assert [len(topic.definition) for topic in reader.topics] == [1000, 1000, 0, 0, 0]


@pytest.mark.thorough
@pytest.mark.process
def test_many_topics_with_a_large_type_need_little_memory(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', (Entry(
        number, b'', f'/{number}', 'a_msgs/msg/A', (1 << 18) * '#') for number in range(4000)))
    assert path.stat().st_size < 1_000_000
    assert peak_memory(
        'import sys\nfrom pathlib import Path\n'
        'from opencv_tools.bags.mcap_reader import McapReader\n'
        'McapReader(Path(sys.argv[1]))', path) < 200_000
