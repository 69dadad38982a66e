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
MCAP files: their contents, and a reader with limits of time and memory.

The readers of the library ``mcap`` load a chunk as often as a message needs it, and believe the
sizes that a file claims. Here a claimed size is compared with the file, and no data are copied.
"""

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
from typing import NamedTuple, TYPE_CHECKING

from opencv_tools.bags.errors import BagError, check_mcap
from opencv_tools.bags.mcap_records import (
    ATTACHMENT_CODE, CHANNEL_CODE, CHUNK_CODE, DATA_END_CODE, definition, file_reader, MAGIC,
    MESSAGE, MESSAGE_CODE, message_head, METADATA_CODE, Part, Read, Record, records, scan,
    SCHEMA_CODE, summary_start)
from opencv_tools.bags.reading import (
    BagMessage, BagTopic, Damage, MAX_BYTES, MAX_TEXT, ROS2MSG, Texts)
from opencv_tools.base.regular_files import open_regular
from opencv_tools.base.text import MAX_PATH, printable

if TYPE_CHECKING:
    from mcap.records import Channel, McapRecord, Metadata, Schema

_MAX_SUMMARY = 1 << 24
_MAX_METADATA = 1 << 20  # bytes of all metadata records
_MAX_NAME = 1000  # characters of a topic or type
_SPAN_BYTES = 1 << 20
_MAX_SORTED = 100_000  # messages of a span
_ITEM_BYTES = 600  # memory of a sorted message without its data

_Item = tuple[int, 'BagMessage | Damage']  # with its time


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
    :param metadata: name and contents of each metadata record.
    :param attachments: number of files in it, which are not read.
    :param unread: number of metadata records that are too large or damaged.
    :param cut_at: offset of the end of the last whole record, if the file has no end.
    """

    channels: dict[int, BagTopic] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    spans: list[Span] = field(default_factory=list)
    times: tuple[int, ...] = ()
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    attachments: int = 0
    unread: int = 0
    cut_at: int | None = None
    _metadata_bytes: int = 0
    _types: dict[int, tuple[str, str, str]] = field(default_factory=dict)
    _texts: Texts = field(default_factory=Texts)

    def define(self, found: Channel | Metadata | Schema) -> None:
        """Add the topic of a channel, unless its name is too long, a type or metadata."""
        from mcap.records import Channel, Metadata
        if isinstance(found, Metadata):
            self.metadata.append((found.name, found.metadata))
        elif isinstance(found, Channel):
            if len(found.topic) <= _MAX_NAME and found.id not in self.channels:
                type_name, encoding, text = self._types.get(found.schema_id, ('', '', ''))
                is_usual = encoding in ('', ROS2MSG)
                qos = found.metadata.get('offered_qos_profiles', '')[:MAX_TEXT]
                self.channels[found.id] = BagTopic(
                    found.topic, type_name, found.message_encoding[:_MAX_NAME],
                    text if encoding == ROS2MSG else '',
                    self._texts.keep(qos.encode()), found.metadata.get(
                        'topic_type_hash', '')[:_MAX_NAME],
                    () if is_usual else (encoding, text))
        elif found.id not in self._types:
            self._types[found.id] = (
                found.name[:_MAX_NAME], found.encoding[:_MAX_NAME], self._texts.keep(found.data))

    def add_metadata(self, read: Read, record: Record) -> None:
        """Add a metadata record, unless all together are too large."""
        self._metadata_bytes += record.size
        found = definition(read, record) if self._metadata_bytes <= _MAX_METADATA else None
        if found is None:
            self.unread += 1
        else:
            self.define(found)

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
        elif record.opcode == ATTACHMENT_CODE:
            self.attachments += 1
        elif record.opcode == METADATA_CODE:
            self.add_metadata(part.read, record)
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
    from mcap.records import Channel, ChunkIndex, MetadataIndex, Schema, Statistics
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
        times=(statistics.message_start_time, statistics.message_end_time),
        attachments=statistics.attachment_count)
    for schema in schemas.values():
        contents.define(schema)
    for channel in channels.values():
        contents.define(channel)
    for index in found:
        if isinstance(index, MetadataIndex):
            record = next(records(read, index.offset, size), None)
            if record and record.opcode == METADATA_CODE and record.end <= size:
                contents.add_metadata(read, record)
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
        self.metadata = contents.metadata
        self.attachments = contents.attachments
        self.warning = (
            f'{self._name} has no end: it was cut off, is damaged or is still being written; it '
            f'is read up to byte {contents.cut_at}' if contents.cut_at is not None else
            f'{contents.unread} metadata records of {self._name} cannot be read'
            if contents.unread else '')

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
        # A chunk has at most as many records as bytes.
        for place, part in enumerate(scan(self._read, span.begin, span.end, sizes), span.begin):
            found = part.record
            if part.damage:
                yield span.start_ns, Damage(f'{self._name}: {part.damage}')
            elif found.opcode == MESSAGE_CODE and not part.reason:
                head = message_head(part.read, found)
                if head is not None and head.channel in wanted:
                    begin = found.begin + MESSAGE.size
                    load = partial(self._load, part.read, begin, found.end - begin)
                    yield head.log_ns, BagMessage(
                        wanted[head.channel], head.log_ns, load, head.publish_ns, head.sequence,
                        place)

    def _load(self, read: Read, begin: int, size: int) -> memoryview:
        if size > MAX_BYTES:
            raise BagError(f'{self._name}: a message claims {size} bytes; more than {MAX_BYTES} '
                           'are not read')
        data = read(begin, size)
        if len(data) < size:
            raise BagError(f'{self._name} has become shorter')
        return data
