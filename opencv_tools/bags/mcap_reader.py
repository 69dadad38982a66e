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

"""Reader of MCAP files: by their index, or by the heads of all records without one."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from functools import partial
import heapq
import io
from itertools import chain, islice
import os
from pathlib import Path
import struct
from typing import TYPE_CHECKING

from opencv_tools.bags.errors import BagError, check_mcap
from opencv_tools.bags.mcap_records import (
    CHANNEL_CODE, CHUNK_CODE, DATA_END_CODE, definition, file_reader, flat_records, MAGIC, MESSAGE,
    MESSAGE_CODE, message_head, Read, Record, records, SCHEMA_CODE, summary_start)
from opencv_tools.bags.reading import BagMessage, BagTopic, Damage, MAX_BYTES, MAX_TEXT, Texts
from opencv_tools.base.regular_files import open_regular
from opencv_tools.base.text import MAX_PATH, printable

if TYPE_CHECKING:
    from mcap.records import Channel, McapRecord, Schema

_MAX_SUMMARY = 1 << 24
_MAX_NAME = 1000  # characters of a topic or type
_SPAN_BYTES = 1 << 20


@dataclass(frozen=True)
class Span:
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

    def add_schema(self, schema: Schema) -> None:
        """Add the name and the text of a type for the channels that follow."""
        if schema.id not in self._types:
            self._types[schema.id] = schema.name[:_MAX_NAME], (
                self._texts.keep(schema.data) if schema.encoding == 'ros2msg' else '')

    def add_channel(self, channel: Channel) -> None:
        """Add the topic of a channel, unless its name is too long."""
        if len(channel.topic) <= _MAX_NAME and channel.id not in self.channels:
            type_name, text = self._types.get(channel.schema_id, ('', ''))
            qos = channel.metadata.get('offered_qos_profiles', '')[:MAX_TEXT]
            self.channels[channel.id] = BagTopic(
                channel.topic, type_name, channel.message_encoding[:_MAX_NAME], text,
                self._texts.keep(qos.encode()))


def read_contents(read: Read, size: int) -> Contents:
    """Find the contents of a file of a size in bytes, by its index if that is valid."""
    return _read_index(read, size) or _Scan(read, size).contents


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
        contents.add_schema(schema)
    for channel in channels.values():
        contents.add_channel(channel)
    return contents


def _are_chunks(spans: list[Span], read: Read, size: int) -> bool:
    """Return whether there are parts of a file, which are chunks and do not overlap."""
    ordered = sorted(spans, key=lambda span: span.begin)
    ends = *(span.begin for span in ordered[1:]), size
    return bool(spans) and all(span.end <= end for span, end in zip(ordered, ends)) and all(
        next(records(read, span.begin, span.end), None) == Record(
            CHUNK_CODE, span.begin, span.end) for span in spans)


class _Scan:
    """The contents of a file by the heads of its records."""

    def __init__(self, read: Read, size: int) -> None:
        self.contents = Contents()
        self._read = read
        begin = end = len(MAGIC)
        first_ns: int | None = None  # of the messages since ``begin``
        sizes: list[int] = []
        for record in records(read, end, size):
            is_cut = record.end > size
            if is_cut:
                self.contents.cut_at = end
            if record.opcode == DATA_END_CODE or (is_cut and record.opcode != CHUNK_CODE):
                break
            record_begin, end = end, min(record.end, size)
            for time_ns in self._define_and_count(record_begin, end, sizes):
                first_ns = time_ns if first_ns is None else min(first_ns, time_ns)
            if first_ns is not None and end - begin + sum(sizes) >= _SPAN_BYTES:
                self.contents.spans.append(Span(first_ns, begin, end))
                begin, first_ns, sizes = end, None, []
        else:
            self.contents.cut_at = end
        if first_ns is not None:
            self.contents.spans.append(Span(first_ns, begin, end))

    def _define_and_count(self, begin: int, end: int, sizes: list[int]) -> Iterator[int]:
        """Add the definitions in a part of the file, and yield the times of its items."""
        from mcap.records import Channel, Schema
        contents = self.contents
        for read, record in flat_records(self._read, begin, end, sizes):
            if isinstance(record, Damage):
                yield contents.times[-1] if contents.times else 0  # its span reports it
                continue
            if record.opcode == MESSAGE_CODE:
                head = message_head(read, record)
                if head and head.channel in contents.channels:
                    contents.counts[head.channel] += 1
                    times = *contents.times, head.log_ns
                    contents.times = min(times), max(times)
                    yield head.log_ns
            elif record.opcode == SCHEMA_CODE:
                schema = definition(Schema, read, record)
                if schema is not None:
                    contents.add_schema(schema)
            elif record.opcode == CHANNEL_CODE:
                channel = definition(Channel, read, record)
                if channel is not None:
                    contents.add_channel(channel)


_MAX_SORTED = 100_000  # messages of a span
_ITEM_BYTES = 600  # memory of a sorted message without its data

_Item = tuple[int, 'BagMessage | Damage']  # with its time


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
        waiting = deque(sorted(self._spans, key=lambda span: (span.start_ns, span.begin)))
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
        for read, found in flat_records(self._read, span.begin, span.end, sizes):
            if isinstance(found, Damage):
                yield span.start_ns, Damage(f'{self._name}: {found.reason}')
            elif found.opcode == MESSAGE_CODE:
                head = message_head(read, found)
                if head is not None and head.channel in wanted:
                    begin = found.begin + MESSAGE.size
                    load = partial(self._load, read, begin, found.end - begin)
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
