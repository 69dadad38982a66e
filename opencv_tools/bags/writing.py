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
Writing of bags: MCAP files as rosbag2 writes them, with the records of the library mcap.

Each message is in the file when ``write`` returns, and the length of its chunk includes it.
Therefore a file that was cut off has all messages but the last, and a file can be read while it is
written. The pixels go to the file from their own memory, without a copy.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
import hashlib
import os
from pathlib import Path
from typing import Any
import zlib

from opencv_tools.bags.account import Metadata
from opencv_tools.bags.errors import check_mcap
from opencv_tools.bags.mcap_records import (
    CHANNEL_CODE, CHUNK, CHUNK_CODE, CHUNK_INDEX_BYTES, CHUNK_INDEX_CODE, COUNT_BYTES,
    DATA_END_BYTES, FOOTER, INDEX_ENTRY_BYTES, MAGIC, MESSAGE, MESSAGE_CODE, MESSAGE_INDEX,
    METADATA_INDEX_CODE, RECORD, SCHEMA_CODE, STATISTICS_BYTES, STATISTICS_CODE,
    SUMMARY_OFFSET_BYTES)
from opencv_tools.bags.reading import ROS2MSG
from opencv_tools.bags.schemas import MESSAGE_DEFINITIONS
from opencv_tools.base.arguments import package_version
from opencv_tools.base.regular_files import try_lock, write_buffer

__all__ = ['BAG_SUFFIX', 'BagChannel', 'BagWriter', 'CHUNK_NS']

BAG_SUFFIX = '.mcap'
# Bytes after which the pages of the file are written to the disk, and number of such parts after
# which they are freed. Else a recording fills the memory, and new pages cost more than old ones.
_PART_BYTES = 1 << 25
_PARTS_IN_MEMORY = 4
#: Time between the first and the last message of a chunk in nanoseconds.
CHUNK_NS = 500_000_000
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
            SCHEMA_CODE, CHANNEL_CODE, STATISTICS_CODE, CHUNK_INDEX_CODE, METADATA_INDEX_CODE)}

    def add_record(self, code: int, record: bytes) -> None:
        """Add the record of a schema or of a channel, which the summary repeats."""
        self._records[code] += record

    def add_metadata(self, metadata: Iterable[Metadata], offset: int) -> bytes:
        """Add metadata records at an offset of the file, and return their bytes."""
        from mcap import records
        data = b''
        for name, values in metadata:
            record = encode_record(records.Metadata(name=name, metadata=dict(values)))
            self._records[METADATA_INDEX_CODE] += encode_record(records.MetadataIndex(
                offset=offset + len(data), length=len(record), name=name))
            data += record
        return data

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
                + SUMMARY_OFFSET_BYTES * (
                    len(self._records) - (not self._records[METADATA_INDEX_CODE])))

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
            attachment_count=0, chunk_count=self._chunk_count,
            metadata_count=count_records(self._records[METADATA_INDEX_CODE]),
            message_start_time=self._start_ns if has_messages else 0,
            message_end_time=self._end_ns, channel_message_counts=self.counts)))
        data_end = encode_record(DataEnd(data_section_crc=0))
        start = offset = position + len(data_end)
        groups = offsets = b''
        for code, records in self._records.items():
            groups += records
            offsets += encode_record(SummaryOffset(
                group_opcode=code, group_start=offset, group_length=len(records))) if (
                    records) else b''
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


@dataclass(frozen=True, kw_only=True)
class BagChannel:
    """
    A topic in a bag.

    :param qos: text of ``offered_qos_text``; '' if unknown.
    :param type_hash: hash of the type, such as ``RIHS01_...``; '' if unknown.
    :param definition: text of the type, with those that it contains; '' for that of
        ``MESSAGE_DEFINITIONS``.
    :param schema_encoding: encoding of that text.
    """

    topic: str
    type_name: str
    qos: str = ''
    type_hash: str = ''
    definition: str = ''
    schema_encoding: str = ROS2MSG

    @property
    def schema(self) -> tuple[str, str, str]:
        """Name of the type, its text, and the encoding of the text."""
        return (self.type_name, self.definition or MESSAGE_DEFINITIONS.get(self.type_name, ''),
                self.schema_encoding)


class BagWriter:
    """A new bag; used by one thread at a time."""

    def __init__(self, path: Path, metadata: Sequence[Metadata] = ()) -> None:
        """
        Create the file and lock it until it is closed.

        :param path: path of the file, usually with the extension ``.mcap``.
        :param metadata: metadata records at the begin of the file.
        :raises BagError: the library mcap is not installed.
        :raises FileExistsError: the file exists; it is not changed.
        :raises OSError: the file cannot be written.
        """
        check_mcap()
        from mcap.records import Header
        self.size = 0  # bytes that are written and complete
        self._path = path
        self._index = BagIndex()
        self._schema_ids: dict[tuple[str, str, str], int] = {}
        self._channel_ids: dict[BagChannel, int] = {}
        self._chunk: OpenChunk | None = None
        self._unhashed: list[Any] = []  # buffers of the messages of the open chunk
        self._digest = hashlib.sha256()
        self._parts = 0  # whose pages are being written
        self._pages: ThreadPoolExecutor | None = None  # the call waits for a slow disk
        self._file = path.open('xb', buffering=0)
        self._status = os.fstat(self._file.fileno())
        try:
            try_lock(self._file.fileno())
            header = Header(profile=PROFILE, library=f'{LIBRARY} {package_version()}')
            self._append(MAGIC + encode_record(header))
            self._append(self._index.add_metadata(metadata, self.size))
        except BaseException:
            self._file.close()
            path.unlink(missing_ok=True)
            raise

    @property
    def sha256(self) -> str:
        """SHA-256 digest of a closed file, in hexadecimal digits."""
        return self._digest.hexdigest()

    def size_with(self, channel: BagChannel | None, data_bytes: int) -> int:
        """Return the largest size in bytes that the closed file has with another message."""
        missing = self._missing_records(channel) if channel else []
        added = sum(2 * len(record) for _, record in missing) + bool(missing) * COUNT_BYTES
        indexes = self._index.end_bytes + (self._chunk.index_bytes if self._chunk else 0)
        return self.size + indexes + added + MESSAGE_BYTES + data_bytes

    def is_at_path(self) -> bool:
        """Return whether the file is still at its path, or that cannot be determined."""
        try:
            return os.path.samestat(self._status, self._path.lstat())
        except FileNotFoundError:
            return False
        except OSError:  # the folder cannot be read now
            return True

    def write(
        self, channel: BagChannel, parts: Sequence[Any], *, log_ns: int, publish_ns: int,
        sequence: int = 0,
    ) -> None:
        """
        Write a message; it is in the file when this method returns.

        :param channel: topic of the message, which is added to the bag before its first message.
        :param parts: contiguous buffers with the CDR of the message, in order. They must not
            change until the next call.
        :param log_ns: time of reception in nanoseconds of the system clock.
        :param publish_ns: time of publication in nanoseconds of the system clock.
        :param sequence: number of the message from its publisher; 0 if unknown.
        :raises OSError: the file cannot be written; it has all earlier messages.
        """
        self._add_channel(channel)
        channel_id = self._channel_ids[channel]
        size = sum(memoryview(part).nbytes for part in parts)
        log_ns, publish_ns = _time(log_ns), _time(publish_ns)
        head = MESSAGE.pack(
            MESSAGE_CODE, MESSAGE.size - RECORD.size + size, channel_id, sequence % 2**32, log_ns,
            publish_ns)
        size += len(head)
        if self._chunk and (self._chunk.size + size > CHUNK_BYTES
                            or abs(log_ns - self._chunk.start_ns) >= CHUNK_NS):
            self._end_chunk()
        if self._chunk:
            self._write_at(self._chunk.end, head, *parts)
            # The longer header follows, because a message that is cut off must be after the chunk.
            chunk = self._chunk.extended(log_ns, size)
            self._write_at(chunk.offset, chunk.header())
        else:
            chunk = OpenChunk(self.size).extended(log_ns, size)
            self._write_at(chunk.offset, chunk.header() + head, *parts)
        chunk.enter(channel_id, log_ns, size)
        self._chunk = chunk
        self.size = chunk.end
        is_long = chunk.size >= CHUNK_BYTES
        # The memory of the pixels may be used again, so those of short messages are copied.
        self._unhashed += head, *(parts if is_long else map(bytes, parts))
        self._free_pages()
        if is_long:
            with suppress(OSError):  # the next message ends the chunk, or its error is raised
                self._end_chunk()

    def close(self, metadata: Sequence[Metadata] = ()) -> None:
        """
        Write the summary and close the file.

        :param metadata: metadata records before the summary.
        :raises OSError: both cannot be written; the file has all messages, and
            ``finish_bag`` can finish it.
        """
        if self._file.closed:
            return
        try:
            self._end_chunk()
            records = self._index.add_metadata(metadata, self.size)
            self._append(records + self._index.end(self.size + len(records)))
        finally:
            if self._pages:
                self._pages.shutdown(wait=True, cancel_futures=True)
            self._file.close()

    def _free_pages(self) -> None:
        """Write the pages of the next part of the file to the disk, and free those before."""
        if self.size < (self._parts + 1) * _PART_BYTES:
            return
        self._pages = self._pages or ThreadPoolExecutor(1, 'pages')
        for part in (self._parts, self._parts - _PARTS_IN_MEMORY):
            if part >= 0:
                self._pages.submit(
                    os.posix_fadvise, self._file.fileno(), part * _PART_BYTES, _PART_BYTES,
                    os.POSIX_FADV_DONTNEED)
        self._parts += 1

    def _missing_records(self, channel: BagChannel) -> list[tuple[int, bytes]]:
        """Return the code and the bytes of the schema and the channel that the file has not."""
        if channel in self._channel_ids:
            return []
        from mcap.records import Channel, Schema
        records = []
        schema_id = self._schema_ids.get(channel.schema, len(self._schema_ids) + 1)
        if channel.schema not in self._schema_ids:
            type_name, text, encoding = channel.schema
            records.append((SCHEMA_CODE, encode_record(Schema(
                id=schema_id, name=type_name, encoding=encoding, data=text.encode()))))
        records.append((CHANNEL_CODE, encode_record(Channel(
            id=len(self._channel_ids) + 1, schema_id=schema_id, topic=channel.topic,
            message_encoding='cdr', metadata={
                'offered_qos_profiles': channel.qos, 'topic_type_hash': channel.type_hash}))))
        return records

    def _add_channel(self, channel: BagChannel) -> None:
        for code, record in self._missing_records(channel):
            self._end_chunk()
            self._append(record)
            self._index.add_record(code, record)
            ids: dict[Any, int] = self._schema_ids if code == SCHEMA_CODE else self._channel_ids
            ids[channel.schema if code == SCHEMA_CODE else channel] = len(ids) + 1

    def _end_chunk(self) -> None:
        """Write the message indexes of the open chunk, if any."""
        chunk = self._chunk
        if chunk is None:
            return
        indexes, offsets = chunk.message_indexes()
        self._write_at(self.size, indexes)
        for part in (chunk.header(), *self._unhashed, indexes):
            self._digest.update(part)
        self.size += len(indexes)
        self._index.add_chunk(chunk, offsets, len(indexes))
        self._chunk = None
        self._unhashed.clear()

    def _append(self, data: bytes) -> None:
        """Write bytes at the end of the file."""
        self._write_at(self.size, data)
        self._digest.update(data)
        self.size += len(data)

    def _write_at(self, offset: int, *parts: Any) -> None:
        """Write buffers; if not all can be written, cut the file after its last whole record."""
        try:
            self._file.seek(offset)
            for part in parts:
                write_buffer(self._file, part)
        except OSError:
            with suppress(OSError):
                self._file.truncate(self.size)
            raise


def _time(nanoseconds: int) -> int:
    return min(max(0, nanoseconds), MAX_TIME)
