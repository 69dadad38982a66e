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

"""Contents of MCAP files: by their index, or by the heads of all records if they have none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
import io
import struct
from typing import TYPE_CHECKING

from opencv_tools.bags.mcap_format import (
    CHANNEL_CODE, CHUNK_CODE, DATA_END_CODE, MAGIC, MESSAGE_CODE, SCHEMA_CODE)
from opencv_tools.bags.mcap_records import (
    definition, flat_records, message_head, Read, Record, records, summary_start)
from opencv_tools.bags.reading import BagTopic, Damage, MAX_TEXT, Texts

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
