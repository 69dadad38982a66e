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

"""
MCAP files: their records, their contents, and a reader with limits of time and memory.

The readers of the library ``mcap`` load a chunk as often as a message needs it, and believe the
sizes that a file claims. Here a claimed size is compared with the file, and no data are copied.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from functools import partial
import heapq
import io
from itertools import chain, islice
import os
from pathlib import Path
import struct
from typing import NamedTuple, TYPE_CHECKING
import zlib

from opencv_tools.bags.compression import decompress
from opencv_tools.bags.errors import BagError, check_mcap
from opencv_tools.bags.reading import BagMessage, BagTopic, Damage, MAX_BYTES, MAX_TEXT, Texts
from opencv_tools.base.regular_files import open_regular
from opencv_tools.base.text import MAX_PATH, printable

if TYPE_CHECKING:
    from mcap.records import Channel, McapRecord, Schema

MAGIC = b'\x89MCAP0\r\n'
HEADER_CODE, FOOTER_CODE, SCHEMA_CODE, CHANNEL_CODE, MESSAGE_CODE, CHUNK_CODE = range(1, 7)
MESSAGE_INDEX_CODE, CHUNK_INDEX_CODE = 7, 8
STATISTICS_CODE, DATA_END_CODE = 11, 15
#: Opcode and length of the content.
RECORD = struct.Struct('<BQ')
#: Channel, sequence, log time and publish time, before the data of the message.
MESSAGE = struct.Struct('<BQHIQQ')
#: First and last time, size, CRC, length of the name of the compression, which stands before the
#: last field if it is not empty, and size of the data.
CHUNK = struct.Struct('<BQQQQIIQ')
#: Channel and size of the entries, which follow.
MESSAGE_INDEX = struct.Struct('<BQHI')
#: Offsets of the summary and of its own offsets, and CRC.
FOOTER = struct.Struct('<BQQQI')

# Sizes in bytes. A chunk index has an offset, and the statistics have a count, of each channel.
DATA_END_BYTES = 13
INDEX_ENTRY_BYTES = 16
CHUNK_INDEX_BYTES = 73
STATISTICS_BYTES = 55
COUNT_BYTES = 10
SUMMARY_OFFSET_BYTES = 26

# Function that reads some bytes from an offset; fewer at the end.
Read = Callable[[int, int], memoryview]

_MAX_DEFINITION = 1 << 20  # bytes of a schema or channel
_LONGEST_NAME = 16  # characters of the name of a compression
_MAX_SUMMARY = 1 << 24
_MAX_NAME = 1000  # characters of a topic or type
_SPAN_BYTES = 1 << 20
_MAX_SORTED = 100_000  # messages of a span
_ITEM_BYTES = 600  # memory of a sorted message without its data
_CUT = 'its chunk is cut off'  # not reported, because the file has a warning

_Item = tuple[int, 'BagMessage | Damage']  # with its time


def file_reader(file: int) -> Read:
    """Return a function that reads from a file descriptor."""
    return lambda offset, size: memoryview(os.pread(file, size, offset))


@dataclass(frozen=True)
class Record:
    """A record of a file or of a chunk."""

    opcode: int
    begin: int
    end: int

    @property
    def size(self) -> int:
        """Size in bytes with opcode and length, as the record claims it."""
        return self.end - self.begin


def records(read: Read, begin: int, end: int) -> Iterator[Record]:
    """
    Yield the records between two offsets; only their heads are read.

    :param read: function that reads the data.
    :param begin: offset of the first record.
    :param end: end of the data. The last record ends behind it if it is cut off or damaged.
    """
    while begin < end:
        head = read(begin, min(RECORD.size, end - begin))
        opcode, length = RECORD.unpack(head) if len(head) == RECORD.size else (0, 0)
        if not opcode:  # no record has the opcode 0
            length = end
        record = Record(opcode, begin, begin + RECORD.size + length)
        yield record
        begin = record.end


class MessageHead(NamedTuple):
    """
    The fields of a message before its data.

    :param sequence: number of the message from its publisher.
    :param log_ns: time of reception in nanoseconds.
    :param publish_ns: time of publication in nanoseconds.
    """

    channel: int
    sequence: int
    log_ns: int
    publish_ns: int


def message_head(read: Read, record: Record) -> MessageHead | None:
    """Return the head of a message; None if the record is too short."""
    head = read(record.begin, min(MESSAGE.size, record.size))
    return MessageHead(*MESSAGE.unpack(head)[2:]) if len(head) == MESSAGE.size else None


def definition(read: Read, record: Record) -> Channel | Schema | None:
    """Return the channel or schema in a record; None if it is damaged or too large."""
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError
    from mcap.records import Channel, Schema
    if record.size > _MAX_DEFINITION:
        return None
    content = ReadDataStream(io.BytesIO(read(record.begin, record.size)[RECORD.size:]))
    try:
        return (Channel if record.opcode == CHANNEL_CODE else Schema).read(content)
    except (McapError, ValueError, struct.error):
        return None


def summary_start(read: Read, size: int) -> int | None:
    """Return the offset that the footer of a file of a size has; None if it has no footer."""
    tail_bytes = FOOTER.size + len(MAGIC)
    tail = read(max(0, size - tail_bytes), tail_bytes)
    if len(tail) < tail_bytes or tail[FOOTER.size:] != MAGIC:
        return None
    opcode, length, start, _, _ = FOOTER.unpack_from(tail)
    return start if (opcode, length) == (FOOTER_CODE, FOOTER.size - RECORD.size) else None


class Part(NamedTuple):
    """
    A record and its place.

    :param read: function that reads the record.
    :param chunk: the chunk that contains the record; None for a record of the file itself.
    :param reason: why the record, or its chunk, cannot be read; '' if it can be.
    """

    read: Read
    record: Record
    chunk: Record | None = None
    reason: str = ''

    @property
    def damage(self) -> str:
        """Sentence about a part that cannot be read and is not only cut off; else ''."""
        if self.reason in ('', _CUT):
            return ''
        begin = (self.chunk or self.record).begin + RECORD.size
        return f'the record at byte {begin} cannot be read: {self.reason}'


def scan(
    read: Read, begin: int, end: int, sizes: list[int], limit: int = MAX_BYTES,
) -> Iterator[Part]:
    """
    Yield the records of a part of a file, and after each chunk its records.

    A chunk of a few bytes may unpack to millions of empty records. No more of them are read than
    the chunk has bytes in the file, because each record needs time.

    :param read: function that reads the file.
    :param begin: offset of the first record.
    :param end: end of the part. A chunk that is cut off there has its whole records.
    :param sizes: list to which the sizes of chunks in memory are added.
    :param limit: largest size in bytes of a chunk that is read.
    """
    for record in records(read, begin, end):
        is_cut = record.end > end
        if record.opcode != CHUNK_CODE:
            yield Part(read, record, reason='it has no end' if is_cut else '')
            continue
        yield Part(read, record)
        try:
            inner_read, first, last = _open_chunk(read, record, end, limit)
        except BagError as err:
            yield Part(read, record, record, _CUT if is_cut else str(err))
            continue
        if inner_read is not read:
            sizes.append(last - first)
        for count, inner in enumerate(records(inner_read, first, last)):
            if count >= record.size:
                yield Part(read, record, record, 'it has more records than bytes')
                break
            yield Part(inner_read, inner, record, '' if inner.end <= last else _CUT if is_cut
                       else 'a record in it has no end')


def _open_chunk(read: Read, record: Record, end: int, limit: int) -> tuple[Read, int, int]:
    """
    Return the records of a chunk: a function that reads them, and offsets of begin and end.

    :raises BagError: the chunk cannot be read; the message does not name the file.
    """
    head = read(record.begin, min(CHUNK.size + _LONGEST_NAME, record.size))
    if len(head) < CHUNK.size:
        raise BagError('its head is cut off')
    *_, size, crc, name_bytes, _ = CHUNK.unpack_from(head)
    begin = CHUNK.size + name_bytes
    if name_bytes > _LONGEST_NAME or len(head) < begin:
        raise BagError('its head is damaged')
    compression = bytes(head[CHUNK.size - 8:begin - 8]).decode(errors='replace')
    length = int.from_bytes(head[begin - 8:begin], 'little')
    begin += record.begin
    is_cut = record.end > end
    if not compression and is_cut:
        return read, begin, min(begin + length, end)
    if is_cut or begin + length > record.end:
        raise BagError(f'it claims {length} bytes, more than there are')
    if max(size, length) > limit:
        raise BagError(f'it claims {max(size, length)} bytes; more than {limit} are not read')
    if not compression and not crc:
        return read, begin, begin + length
    data = read(begin, length)
    if len(data) < length:
        raise BagError('it is cut off')
    content = decompress(data, compression, size) if compression else data
    if crc and zlib.crc32(content) != crc:
        raise BagError('its checksum is wrong')
    return lambda offset, count: content[offset:offset + count], 0, len(content)


class Span(NamedTuple):
    """
    A part of a file with whole records.

    :param start_ns: time of its first message in nanoseconds.
    :param begin: offset of its first record.
    :param end: offset behind its last record.
    """

    start_ns: int
    begin: int
    end: int


@dataclass
class Contents:
    """
    The contents of a file.

    :param channels: topic of each channel.
    :param counts: number of messages of each channel.
    :param spans: parts of the file with messages.
    :param times: times of the first and last message; empty without messages.
    :param cut_at: offset of the end of the last whole record, if the file has no end.
    """

    channels: dict[int, BagTopic] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    spans: list[Span] = field(default_factory=list)
    times: tuple[int, ...] = ()
    cut_at: int | None = None
    _types: dict[int, tuple[str, str]] = field(default_factory=dict)
    _texts: Texts = field(default_factory=Texts)

    def define(self, found: Channel | Schema) -> None:
        """Add the topic of a channel, unless its name is too long, or a type for channels."""
        from mcap.records import Channel
        if isinstance(found, Channel):
            if len(found.topic) <= _MAX_NAME and found.id not in self.channels:
                type_name, text = self._types.get(found.schema_id, ('', ''))
                qos = found.metadata.get('offered_qos_profiles', '')[:MAX_TEXT]
                self.channels[found.id] = BagTopic(
                    found.topic, type_name, found.message_encoding[:_MAX_NAME], text,
                    self._texts.keep(qos.encode()), found.metadata.get(
                        'topic_type_hash', '')[:_MAX_NAME])
        elif found.id not in self._types:
            self._types[found.id] = found.name[:_MAX_NAME], (
                self._texts.keep(found.data) if found.encoding == 'ros2msg' else '')

    def add(self, part: Part) -> int | None:
        """Add a part of the file; return the time of a message or of a damaged part."""
        record = part.record
        if part.reason:  # the span reports it
            return max(self.times, default=0) if part.damage else None
        if record.opcode == MESSAGE_CODE:
            head = message_head(part.read, record)
            if head and head.channel in self.channels:
                self.counts[head.channel] += 1
                times = *self.times, head.log_ns
                self.times = min(times), max(times)
                return head.log_ns
        elif record.opcode in (SCHEMA_CODE, CHANNEL_CODE):
            found = definition(part.read, record)
            if found is not None:
                self.define(found)
        return None


def read_contents(read: Read, size: int) -> Contents:
    """Find the contents of a file of a size in bytes, by its index if that is valid."""
    return _read_index(read, size) or _scan_contents(read, size)


def _read_index(read: Read, size: int) -> Contents | None:
    """Read the summary of a file; return None if there is none with a valid index."""
    from mcap.exceptions import McapError
    from mcap.stream_reader import StreamReader
    start = summary_start(read, size)
    if not start or not 0 < size - start <= _MAX_SUMMARY:
        return None
    summary = io.BytesIO(read(start, size - start))
    try:
        found = list(StreamReader(summary, skip_magic=True, emit_chunks=True).records)
    except (McapError, OverflowError, ValueError, struct.error):
        return None
    return _use_index(found, read, size)


def _use_index(found: list[McapRecord], read: Read, size: int) -> Contents | None:
    """Return the contents in a summary; None if it is incomplete or contradicts the file."""
    from mcap.records import Channel, ChunkIndex, Schema, Statistics
    statistics = next((record for record in found if isinstance(record, Statistics)), None)
    schemas = {record.id: record for record in found if isinstance(record, Schema)}
    channels = {record.id: record for record in found if isinstance(record, Channel)}
    spans = [Span(record.message_start_time, record.chunk_start_offset,
                  record.chunk_start_offset + record.chunk_length)
             for record in found if isinstance(record, ChunkIndex)]
    if (not statistics or not _are_chunks(spans, read, size)
            or not statistics.channel_message_counts.keys() <= channels.keys()
            or not {channel.schema_id for channel in channels.values()} <= {0, *schemas}):
        return None
    contents = Contents(
        counts=Counter(statistics.channel_message_counts), spans=spans,
        times=(statistics.message_start_time, statistics.message_end_time))
    for schema in schemas.values():
        contents.define(schema)
    for channel in channels.values():
        contents.define(channel)
    return contents


def _are_chunks(spans: list[Span], read: Read, size: int) -> bool:
    """Return whether there are parts of a file, which are chunks and do not overlap."""
    ordered = sorted(spans, key=lambda span: span.begin)
    ends = *(span.begin for span in ordered[1:]), size
    return bool(spans) and all(span.end <= end for span, end in zip(ordered, ends)) and all(
        next(records(read, span.begin, span.end), None) == Record(
            CHUNK_CODE, span.begin, span.end) for span in spans)


def _scan_contents(read: Read, size: int) -> Contents:
    """Return the contents of a file by the heads of its records."""
    contents = Contents()
    begin = end = len(MAGIC)
    first_ns: int | None = None  # of the messages since ``begin``
    sizes: list[int] = []
    for part in scan(read, begin, size, sizes):
        record = part.record
        if not part.chunk:
            if first_ns is not None and end - begin + sum(sizes) >= _SPAN_BYTES:
                contents.spans.append(Span(first_ns, begin, end))
                begin, first_ns = end, None
                sizes.clear()
            is_cut = record.end > size
            if is_cut:
                contents.cut_at = end
            if record.opcode == DATA_END_CODE or (is_cut and record.opcode != CHUNK_CODE):
                break
            end = min(record.end, size)
        time_ns = contents.add(part)
        if time_ns is not None:
            first_ns = time_ns if first_ns is None else min(first_ns, time_ns)
    else:
        contents.cut_at = end
    if first_ns is not None:
        contents.spans.append(Span(first_ns, begin, end))
    return contents


class McapReader:
    """A bag in MCAP."""

    def __init__(self, path: Path) -> None:
        """
        Open a file and find its topics.

        A file without a valid index is read once from its begin to its end.

        :raises BagError: the file is no MCAP file, or the library ``mcap`` is missing.
        :raises OSError: the file cannot be read.
        """
        check_mcap()
        self._name = printable(path.name, MAX_PATH)
        self._file = open_regular(path)
        self._read = file_reader(self._file)
        try:
            if self._read(0, len(MAGIC)) != MAGIC:
                raise BagError(f'{self._name} is not an MCAP file')
            contents = read_contents(self._read, os.fstat(self._file).st_size)
        except BaseException:
            self.close()
            raise
        self._spans, self._channels = contents.spans, contents.channels
        self.first_ns, self.last_ns = contents.times or (0, 0)
        self.topics = dict.fromkeys(contents.channels.values(), 0)
        for channel, topic in contents.channels.items():
            self.topics[topic] += contents.counts[channel]
        self.warning = '' if contents.cut_at is None else (
            f'{self._name} has no end: it was cut off, is damaged or is still being written; it '
            f'is read up to byte {contents.cut_at}')

    def close(self) -> None:
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def messages(self, topics: Collection[BagTopic]) -> Iterator[BagMessage | Damage]:
        wanted = {channel: topic for channel, topic in self._channels.items() if topic in topics}
        waiting = deque(sorted(self._spans))
        # Parts of the file whose times overlap, by the time of their next message, and the sizes
        # of their chunks and sorted messages in memory.
        opened: list[tuple[int, int, BagMessage | Damage, Iterator[_Item], list[int]]] = []
        while waiting or opened:
            while waiting and (not opened or (waiting[0].start_ns <= opened[0][0] and sum(
                    chain.from_iterable(part[-1] for part in opened)) <= MAX_BYTES)):
                span, sizes = waiting.popleft(), list[int]()
                items = self._span_items(span, wanted, sizes)
                for time_ns, item in islice(items, 1):
                    heapq.heappush(opened, (time_ns, span.begin, item, items, sizes))
            if opened:
                _, begin, item, items, sizes = opened[0]
                yield item
                following = next(items, None)
                if following is None:
                    heapq.heappop(opened)
                else:
                    heapq.heapreplace(opened, (following[0], begin, following[1], items, sizes))

    def _span_items(
        self, span: Span, wanted: dict[int, BagTopic], sizes: list[int],
    ) -> Iterator[_Item]:
        """Yield the messages of a span in the order of their times, unless there are too many."""
        items = self._unsorted_items(span, wanted, sizes)
        ordered = sorted(islice(items, _MAX_SORTED), key=lambda item: item[0])
        sizes.append(len(ordered) * _ITEM_BYTES)
        yield from ordered
        yield from items

    def _unsorted_items(
        self, span: Span, wanted: dict[int, BagTopic], sizes: list[int],
    ) -> Iterator[_Item]:
        for part in scan(self._read, span.begin, span.end, sizes):
            found = part.record
            if part.damage:
                yield span.start_ns, Damage(f'{self._name}: {part.damage}')
            elif found.opcode == MESSAGE_CODE and not part.reason:
                head = message_head(part.read, found)
                if head is not None and head.channel in wanted:
                    begin = found.begin + MESSAGE.size
                    load = partial(self._load, part.read, begin, found.end - begin)
                    yield head.log_ns, BagMessage(
                        wanted[head.channel], head.log_ns, load, head.publish_ns, head.sequence)

    def _load(self, read: Read, begin: int, size: int) -> memoryview:
        if size > MAX_BYTES:
            raise BagError(f'{self._name}: a message claims {size} bytes; more than {MAX_BYTES} '
                           'are not read')
        data = read(begin, size)
        if len(data) < size:
            raise BagError(f'{self._name} has become shorter')
        return data
