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

"""Reader of MCAP files: by their index, or record by record if they have none."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import partial
import heapq
import io
from itertools import chain, islice
import os
from pathlib import Path
import struct
from typing import TYPE_CHECKING, TypeVar

from opencv_tools.bags.errors import BagError, check_mcap
from opencv_tools.bags.index import (
    CHANNEL_CODE, CHUNK_CODE, DATA_END_CODE, FOOTER_CODE, MAGIC, MESSAGE_CODE, SCHEMA_CODE)
from opencv_tools.bags.mcap_records import (
    file_reader, message_head, open_chunk, Read, Record, records)
from opencv_tools.bags.reading import BagMessage, BagTopic, Damage, MAX_BYTES
from opencv_tools.image.text import MAX_PATH, printable
from opencv_tools.regular_files import open_regular

if TYPE_CHECKING:
    from mcap.records import Channel, McapRecord, Schema

T = TypeVar('T', 'Channel', 'Schema')

_FOOTER = struct.Struct('<BQQQI8s')  # opcode, length, offsets of the summary, CRC and magic
_FOOTER_START = FOOTER_CODE, 20  # opcode and length
_MAX_SUMMARY = 1 << 24
_MAX_DEFINITION = 1 << 20  # bytes of a schema or channel
_MAX_NAME = 1000  # characters of a topic or type
_SPAN_BYTES = 1 << 20
_MAX_SORTED = 100_000  # messages of a span

_Item = tuple[int, 'BagMessage | Damage']  # with its time


@dataclass(frozen=True)
class _Span:
    """A part of the file with whole records, and the time of its first message."""

    start_ns: int
    begin: int
    end: int
    is_chunk: bool = False


class McapReader:
    """
    A bag in MCAP.

    The index is that of the file. A file without a valid index is read once from its begin to its
    end, to find the topics.
    """

    def __init__(self, path: Path) -> None:
        """
        Open a file and find its topics.

        :param path: path of the file.
        :raises BagError: the file is no MCAP file, or the library ``mcap`` is missing.
        :raises OSError: the file cannot be read.
        """
        check_mcap()
        self.topics: dict[BagTopic, int] = {}
        self.first_ns = self.last_ns = 0
        self.warning = ''
        self._name = printable(path.name, MAX_PATH)
        self._channels: dict[int, BagTopic] = {}
        self._schemas: dict[int, str] = {}
        self._spans: list[_Span] = []
        self._file = open_regular(path)
        self._read = file_reader(self._file)
        try:
            self._size = os.fstat(self._file).st_size
            if self._read(0, len(MAGIC)) != MAGIC:
                raise BagError(f'{self._name} is not an MCAP file')
            if not self._read_index():
                self._scan()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def messages(self, topics: Collection[BagTopic]) -> Iterator[BagMessage | Damage]:
        wanted = {channel: topic for channel, topic in self._channels.items() if topic in topics}
        waiting = deque(sorted(self._spans, key=lambda span: (span.start_ns, span.begin)))
        # Parts of the file whose times overlap, by the time of their next message, and the sizes
        # of their chunks in memory.
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
        self, span: _Span, wanted: dict[int, BagTopic], sizes: list[int],
    ) -> Iterator[_Item]:
        """Yield the messages of a span in the order of their times, unless there are too many."""
        items = self._unsorted_items(span, wanted, sizes)
        yield from sorted(islice(items, _MAX_SORTED), key=lambda item: item[0])
        yield from items

    def _unsorted_items(
        self, span: _Span, wanted: dict[int, BagTopic], sizes: list[int],
    ) -> Iterator[_Item]:
        if span.is_chunk:
            record = next(records(self._read, span.begin, span.end))
            if (record.opcode, record.end) != (CHUNK_CODE, span.end):
                yield span.start_ns, self._damage(span.begin, 'the index names it as a chunk')
                return
        for read, found in self._flat_records(span.begin, span.end, sizes):
            if isinstance(found, Damage):
                yield span.start_ns, found
            elif found.opcode == MESSAGE_CODE:
                head = message_head(read, found)
                if head is not None and head[0] in wanted:
                    channel, log_ns, begin = head
                    load = partial(self._load, read, begin, found.end - begin)
                    yield log_ns, BagMessage(wanted[channel], log_ns, load)

    def _load(self, read: Read, begin: int, size: int) -> memoryview:
        if size > MAX_BYTES:
            raise BagError(f'{self._name}: a message claims {size} bytes; more than {MAX_BYTES} '
                           'are not read')
        data = read(begin, size)
        if len(data) < size:
            raise BagError(f'{self._name} has become shorter')
        return data

    def _flat_records(
        self, begin: int, end: int, sizes: list[int],
    ) -> Iterator[tuple[Read, Record | Damage]]:
        """
        Yield the records of a part of the file, and those of its chunks instead of chunks.

        The sizes of chunks in memory are added to a list.
        """
        for record in records(self._read, begin, end):
            if record.opcode != CHUNK_CODE:
                yield self._read, (record if record.end <= end else self._damage(record.begin))
                continue
            try:
                read, first, last = open_chunk(self._read, record, end)
            except BagError as err:
                if record.end <= end:  # else the end of the file is reported
                    yield self._read, self._damage(record.begin, str(err))
                continue
            if read is not self._read:
                sizes.append(last - first)
            for inner in records(read, first, last):
                if inner.end <= last:
                    yield read, inner
                elif record.end <= end:
                    yield read, self._damage(record.begin, 'a record in it has no end')

    def _damage(self, begin: int, reason: str = 'it has no end') -> Damage:
        return Damage(f'{self._name}: the record at byte {begin} cannot be read: {reason}')

    def _read_index(self) -> bool:
        """Read the summary of a file; return False if there is none with an index."""
        from mcap.exceptions import McapError
        from mcap.stream_reader import StreamReader
        tail = self._read(max(0, self._size - _FOOTER.size), _FOOTER.size)
        if len(tail) < _FOOTER.size:
            return False
        *footer, start, _, _, magic = _FOOTER.unpack(tail)
        end = self._size - _FOOTER.size
        if (*footer,) != _FOOTER_START or magic != MAGIC or not 0 < end - start <= _MAX_SUMMARY:
            return False
        summary = io.BytesIO(self._read(start, self._size - start))
        try:
            found = list(StreamReader(summary, skip_magic=True, emit_chunks=True).records)
        except (McapError, OverflowError, ValueError, struct.error):
            return False
        return self._use_index(found)

    def _use_index(self, found: list[McapRecord]) -> bool:
        """Use the records of a summary; return False if they are incomplete or contradictory."""
        from mcap.records import Channel, ChunkIndex, Schema, Statistics
        statistics = next((record for record in found if isinstance(record, Statistics)), None)
        schemas = {record.id: record.name for record in found if isinstance(record, Schema)}
        channels = {record.id: record for record in found if isinstance(record, Channel)}
        chunks = [record for record in found if isinstance(record, ChunkIndex)]
        chunks.sort(key=lambda chunk: chunk.chunk_start_offset)
        ends = [chunk.chunk_start_offset + chunk.chunk_length for chunk in chunks]
        is_complete = (
            statistics is not None and bool(chunks or not statistics.message_count)
            and statistics.channel_message_counts.keys() <= channels.keys()
            and {0, *schemas} >= {channel.schema_id for channel in channels.values()}
            and all(end <= chunk.chunk_start_offset for end, chunk in zip(ends, chunks[1:]))
            and max(ends, default=0) <= self._size)
        if statistics is None or not is_complete:
            return False
        self._schemas = schemas
        for record in channels.values():
            self._add_channel(record)
        for channel, topic in self._channels.items():
            self.topics[topic] += statistics.channel_message_counts.get(channel, 0)
        self._spans = [_Span(chunk.message_start_time, chunk.chunk_start_offset, end, True)
                       for chunk, end in zip(chunks, ends)]
        self.first_ns, self.last_ns = statistics.message_start_time, statistics.message_end_time
        return True

    def _scan(self) -> None:
        """Read the heads of all records to find the topics and the times of the messages."""
        begin = end = len(MAGIC)
        first_ns: int | None = None  # of the messages since ``begin``
        sizes: list[int] = []
        for record in records(self._read, end, self._size):
            is_cut = record.end > self._size
            if is_cut:
                self._warn_of_end(end)
            if record.opcode == DATA_END_CODE or (is_cut and record.opcode != CHUNK_CODE):
                break
            record_begin, end = end, min(record.end, self._size)
            for time_ns in self._define_and_count(record_begin, end, sizes):
                first_ns = time_ns if first_ns is None else min(first_ns, time_ns)
            if first_ns is not None and end - begin + sum(sizes) >= _SPAN_BYTES:
                self._spans.append(_Span(first_ns, begin, end))
                begin, first_ns, sizes = end, None, []
        else:
            self._warn_of_end(end)
        if first_ns is not None:
            self._spans.append(_Span(first_ns, begin, end))

    def _warn_of_end(self, end: int) -> None:
        self.warning = (
            f'{self._name} has no end: it was cut off, is damaged or is still being written; it '
            f'is read up to byte {end}')

    def _define_and_count(self, begin: int, end: int, sizes: list[int]) -> Iterator[int]:
        """Store the definitions in a part of the file, and yield the times of its messages."""
        from mcap.records import Channel, Schema
        for read, record in self._flat_records(begin, end, sizes):
            if isinstance(record, Damage):
                continue
            if record.opcode == MESSAGE_CODE:
                head = message_head(read, record)
                topic = self._channels.get(head[0]) if head else None
                if head and topic:
                    self.topics[topic] += 1
                    self.first_ns = min(self.first_ns or head[1], head[1])
                    self.last_ns = max(self.last_ns, head[1])
                    yield head[1]
            elif record.opcode == SCHEMA_CODE:
                schema = _definition(Schema, read, record)
                if schema is not None:
                    self._schemas[schema.id] = schema.name[:_MAX_NAME]
            elif record.opcode == CHANNEL_CODE:
                channel = _definition(Channel, read, record)
                if channel is not None:
                    self._add_channel(channel)

    def _add_channel(self, channel: Channel) -> None:
        if len(channel.topic) <= _MAX_NAME:
            topic = BagTopic(channel.topic, self._schemas.get(channel.schema_id, ''),
                             channel.message_encoding[:_MAX_NAME])
            self._channels.setdefault(channel.id, topic)
            self.topics.setdefault(topic, 0)


def _definition(kind: type[T], read: Read, record: Record) -> T | None:
    """Return the schema or channel in a record; None if it is damaged or too large."""
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError
    size = record.end - record.begin
    if size > _MAX_DEFINITION:
        return None
    try:
        return kind.read(ReadDataStream(io.BytesIO(read(record.begin, size))))
    except (McapError, ValueError, struct.error):
        return None
