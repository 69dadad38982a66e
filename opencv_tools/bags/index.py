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

"""Records of an MCAP file that are not messages: chunk headers, indexes and the summary."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any
import zlib

from opencv_tools.bags.mcap_records import (
    CHANNEL_CODE, CHUNK, CHUNK_CODE, CHUNK_INDEX_BYTES, CHUNK_INDEX_CODE, COUNT_BYTES,
    DATA_END_BYTES, FOOTER, INDEX_ENTRY_BYTES, MAGIC, MESSAGE, MESSAGE_INDEX, RECORD, SCHEMA_CODE,
    STATISTICS_BYTES, STATISTICS_CODE, SUMMARY_OFFSET_BYTES)

PROFILE = 'ros2'
#: Name at the start of a file, by which ``finish_bag`` recognises the files of this package.
LIBRARY = 'opencv_tools'
#: Size in bytes at which a chunk ends, as in rosbag2. A larger message has a chunk of its own.
CHUNK_BYTES = 786432
MAX_TIME = 2**63 - 1  # larger ones are legal, but some readers have signed times
#: Largest number of bytes that a message adds to a file, without its data.
MESSAGE_BYTES = (CHUNK.size + MESSAGE.size + MESSAGE_INDEX.size + INDEX_ENTRY_BYTES
                 + CHUNK_INDEX_BYTES + COUNT_BYTES)


def encode_record(record: Any) -> bytes:
    """Return the bytes of a record of the library mcap."""
    from mcap.data_stream import RecordBuilder
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


@dataclass
class OpenChunk:
    """
    The chunk at the end of a file, to which messages are added.

    :param size: size of its message records in bytes.
    :param entries: log time and offset in the chunk of each message, by channel.
    """

    offset: int
    size: int = 0
    start_ns: int = MAX_TIME
    end_ns: int = 0
    entries: dict[int, list[tuple[int, int]]] = field(default_factory=dict)

    def extended(self, log_ns: int, record_bytes: int) -> OpenChunk:
        """Return the chunk with another message record at its end, which has no entry yet."""
        return replace(self, size=self.size + record_bytes, start_ns=min(self.start_ns, log_ns),
                       end_ns=max(self.end_ns, log_ns))

    def enter(self, channel_id: int, log_ns: int, record_bytes: int) -> None:
        """Add the entry of the last message record."""
        self.entries.setdefault(channel_id, []).append((log_ns, self.size - record_bytes))

    def header(self) -> bytes:
        """Return the bytes of the chunk record before its messages."""
        return CHUNK.pack(CHUNK_CODE, CHUNK.size - RECORD.size + self.size, self.start_ns,
                          self.end_ns, self.size, 0, 0, self.size)

    def counts(self) -> dict[int, int]:
        """Return the number of messages by channel."""
        return {channel_id: len(entries) for channel_id, entries in self.entries.items()}

    def message_indexes(self) -> tuple[bytes, dict[int, int]]:
        """Return the records that follow the chunk, and the offset of each by channel."""
        from mcap.records import MessageIndex
        records, offsets = b'', {}
        for channel_id, entries in self.entries.items():
            offsets[channel_id] = self.end + len(records)
            records += encode_record(MessageIndex(channel_id=channel_id, records=entries))
        return records, offsets

    @property
    def end(self) -> int:
        """Offset in the file after the last message."""
        return self.offset + CHUNK.size + self.size

    @property
    def index_bytes(self) -> int:
        """Size of the message indexes of the chunk, and of its record in the summary."""
        entries = sum(map(len, self.entries.values()))
        return (CHUNK_INDEX_BYTES + entries * INDEX_ENTRY_BYTES
                + len(self.entries) * (MESSAGE_INDEX.size + COUNT_BYTES))


class BagIndex:
    """The contents of a file for its summary."""

    def __init__(self) -> None:
        #: Number of messages by channel.
        self.counts: dict[int, int] = {}
        self._start_ns, self._end_ns = MAX_TIME, 0
        self._chunk_count = 0
        self._records = {code: bytearray() for code in (
            SCHEMA_CODE, CHANNEL_CODE, STATISTICS_CODE, CHUNK_INDEX_CODE)}

    def add_record(self, code: int, record: bytes) -> None:
        """Add the record of a schema or of a channel, which the summary repeats."""
        self._records[code] += record

    def add_chunk(self, chunk: OpenChunk, offsets: dict[int, int], length: int) -> None:
        """
        Add a chunk that is complete in the file, with its message indexes.

        :param chunk: the chunk; only the number of its entries is used.
        :param offsets: offset of the message index by channel.
        :param length: size of all message indexes in bytes.
        """
        from mcap.records import ChunkIndex
        for channel_id, count in chunk.counts().items():
            self.counts[channel_id] = self.counts.get(channel_id, 0) + count
        self._start_ns = min(self._start_ns, chunk.start_ns)
        self._end_ns = max(self._end_ns, chunk.end_ns)
        self._chunk_count += 1
        self._records[CHUNK_INDEX_CODE] += encode_record(ChunkIndex(
            message_start_time=chunk.start_ns, message_end_time=chunk.end_ns,
            chunk_start_offset=chunk.offset, chunk_length=CHUNK.size + chunk.size,
            message_index_offsets=offsets, message_index_length=length, compression='',
            compressed_size=chunk.size, uncompressed_size=chunk.size))

    @property
    def end_bytes(self) -> int:
        """Size of the bytes that ``end`` returns, of a file with a message in each channel."""
        sizes = [len(records) for records in self._records.values()]
        channels = self._records[CHANNEL_CODE]
        return (DATA_END_BYTES + sum(sizes) + STATISTICS_BYTES + FOOTER.size + len(MAGIC)
                + COUNT_BYTES * count_records(channels)
                + SUMMARY_OFFSET_BYTES * len(self._records))

    def end(self, position: int) -> bytes:
        """
        Return all bytes after the data: the summary and the footer.

        :param position: size of the file before these bytes.
        """
        from mcap.records import DataEnd, Footer, Statistics, SummaryOffset
        has_messages = bool(self.counts)
        self._records[STATISTICS_CODE] = bytearray(encode_record(Statistics(
            message_count=sum(self.counts.values()),
            schema_count=count_records(self._records[SCHEMA_CODE]),
            channel_count=count_records(self._records[CHANNEL_CODE]),
            attachment_count=0, metadata_count=0, chunk_count=self._chunk_count,
            message_start_time=self._start_ns if has_messages else 0,
            message_end_time=self._end_ns, channel_message_counts=self.counts)))
        data_end = encode_record(DataEnd(data_section_crc=0))
        start = offset = position + len(data_end)
        groups = offsets = b''
        for code, records in self._records.items():
            groups += records
            offsets += encode_record(SummaryOffset(
                group_opcode=code, group_start=offset, group_length=len(records)))
            offset += len(records)
        summary = groups + offsets
        footer = Footer(summary_start=start, summary_offset_start=offset, summary_crc=0)
        footer.summary_crc = zlib.crc32(summary + encode_record(footer)[:-4])
        return data_end + summary + encode_record(footer) + MAGIC


def count_records(records: bytes | bytearray) -> int:
    """Count the records in a buffer."""
    count = position = 0
    while position < len(records):
        position += RECORD.size + RECORD.unpack_from(records, position)[1]
        count += 1
    return count
