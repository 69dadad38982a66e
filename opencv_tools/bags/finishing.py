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
Finishing of bags whose recorder was killed, or whose end did not fit on the disk.

A bag is finished in place, because a copy could need as much space again. Each step leaves a file
that can be finished again.
"""

from __future__ import annotations

import os
from pathlib import Path
import struct

from opencv_tools.bags.errors import BagError, check_mcap
from opencv_tools.bags.index import BagIndex, CHUNK_BYTES, LIBRARY, OpenChunk, PROFILE
from opencv_tools.bags.mcap_format import (
    CHANNEL_CODE, CHUNK, CHUNK_CODE, CHUNK_START_BYTES, DATA_END_CODE, encode_record, HEADER_CODE,
    INDEX_ENTRY, LENGTH, MAGIC, MESSAGE_CODE, MESSAGE_INDEX, MESSAGE_INDEX_CODE, RECORD,
    SCHEMA_CODE)
from opencv_tools.bags.mcap_records import (
    file_reader, message_head, MESSAGE_HEAD_BYTES, read_definition, Record, records, summary_start)
from opencv_tools.image.cdr import COMPRESSED_IMAGE, IMAGE
from opencv_tools.image.text import printable
from opencv_tools.regular_files import is_same_file, open_regular, try_lock

_BLOCK = 1 << 20
_MAX_RECORD = 1 << 19  # bytes of a record that is neither a chunk nor a message
_MAX_RECORDS = 1000  # schemas and channels
_NAMES = (PROFILE.encode(), LIBRARY.encode())


def finish_bag(path: Path) -> int | None:
    """
    Write the missing end of a bag of this package, unless its recording still runs.

    :param path: path of the bag.
    :returns: number of images in the bag; None if it is not a bag of this package, or if it is
        being written.
    :raises BagError: a record in the middle is damaged, or the library mcap is not installed; the
        bag is not changed.
    :raises OSError: the bag cannot be read or written; no message is lost.
    """
    file = open_regular(path, os.O_RDWR, follow=False)
    try:
        if not _has_own_header(file) or not try_lock(file) or not is_same_file(file, path):
            return None
        check_mcap()
        scan = _Scan(file, path)
        scan.read()
        frames = scan.frame_count()
        if not scan.is_finished:
            _write_end(file, scan)
        return frames
    finally:
        os.close(file)


def has_footer(path: Path) -> bool:
    """
    Return whether a file ends with the footer of a bag.

    :raises OSError: the file cannot be read.
    """
    file = open_regular(path, follow=False)
    try:
        return summary_start(file_reader(file), os.fstat(file).st_size) is not None
    finally:
        os.close(file)


def _has_own_header(file: int) -> bool:
    """Return whether a file begins like those of ``BagWriter``."""
    start = os.pread(file, 256, 0)
    position = len(MAGIC) + RECORD.size
    try:
        code, _ = RECORD.unpack_from(start, len(MAGIC))
        for name in _NAMES:
            length, = struct.unpack_from('<I', start, position)
            position += 4
            if not start[position:position + length].startswith(name):
                return False
            position += length
    except struct.error:
        return False
    return start.startswith(MAGIC) and bool(code == HEADER_CODE) and position <= len(start)


def _write_end(file: int, scan: _Scan) -> None:
    """Remove what follows the complete messages, and write the indexes and the summary."""
    os.ftruncate(file, scan.end)
    end, chunk = b'', scan.chunk
    if chunk:
        os.pwrite(file, chunk.header(), chunk.offset)
        end, offsets = chunk.message_indexes()
        scan.index.add_chunk(chunk, chunk.counts(), offsets, len(end))
    end += scan.index.end(scan.end + len(end))
    position = scan.end
    while end:
        written = os.pwrite(file, end, position)
        position, end = position + written, end[written:]


class _Scan:
    """
    The records of a bag of this package, without the data of messages.

    The index has the schemas, the channels and the chunks that are followed by their message
    indexes. ``chunk`` is the last chunk if they are missing. ``end`` is the offset after the
    complete messages and indexes.
    """

    def __init__(self, file: int, path: Path) -> None:
        self.index = BagIndex()
        self.chunk: OpenChunk | None = None
        self.end = len(MAGIC)
        self.is_finished = False
        self.image_channels: set[int] = set()
        self._read = file_reader(file)
        self._name = printable(path.name)
        self._size = os.fstat(file).st_size
        self._image_schemas: set[int] = set()
        self._channels: set[int] = set()
        self._record_count = 0
        self._index_offsets: dict[int, int] = {}

    def read(self) -> None:
        """
        Read the records up to the summary, or up to the first one that is cut off.

        :raises BagError: a record is not one that ``BagWriter`` writes there.
        """
        for record in records(self._read, self.end, self._size):
            if not self._take(record):
                break
        if self.chunk:
            self.end = self.chunk.end  # without incomplete message indexes

    def frame_count(self) -> int:
        """Return the number of images."""
        counts = self.chunk.counts() if self.chunk else {}
        return sum(self.index.counts.get(channel_id, 0) + counts.get(channel_id, 0)
                   for channel_id in self.image_channels)

    def _take(self, record: Record) -> bool:
        """Take the next record; return whether it is complete and another one may follow."""
        if not record.opcode:
            return self._is_end(record)
        if record.opcode == CHUNK_CODE and not self.chunk:
            return self._take_chunk(record)
        if record.opcode == MESSAGE_CODE and self.chunk and not self._index_offsets:
            # The recorder was killed before it wrote the longer header of the chunk.
            return self._take_message(self.chunk, record, record.end)
        is_long = record.end - record.begin > _MAX_RECORD
        if record.end > self._size and not is_long:
            return False
        if record.opcode == MESSAGE_INDEX_CODE and self.chunk:
            self._take_message_index(self.chunk, record)
        elif record.opcode in (SCHEMA_CODE, CHANNEL_CODE) and not (self.chunk or is_long):
            self._take_definition(record)
        elif record.opcode == DATA_END_CODE and not self.chunk:
            self.is_finished = summary_start(self._read, self._size) is not None
            return False
        elif record.opcode != HEADER_CODE or self.end != len(MAGIC):
            raise self._damaged()
        self.end = record.end
        return True

    def _take_chunk(self, record: Record) -> bool:
        """Take a chunk, of which the file may have only the first messages."""
        start = self._read(self.end, CHUNK_START_BYTES)
        if len(start) < CHUNK_START_BYTES:
            return False
        _, length, _, _, size, crc, compression = CHUNK.unpack_from(start)
        data_bytes, = LENGTH.unpack_from(start, CHUNK.size)
        if crc or compression or not (
                size == data_bytes == length - CHUNK_START_BYTES + RECORD.size):
            raise self._damaged()
        self.chunk, self._index_offsets = OpenChunk(self.end), {}
        self.end = self.chunk.end
        for message in records(self._read, self.end, record.end):
            if not self._take_message(self.chunk, message, record.end):
                break
        is_complete = self.end == record.end
        if not self.chunk.size:
            self.end, self.chunk = self.chunk.offset, None
        return is_complete

    def _take_message(self, chunk: OpenChunk, record: Record, limit: int) -> bool:
        """Take a message of the chunk, without its data."""
        if record.begin + MESSAGE_HEAD_BYTES > self._size:
            return False
        if not record.opcode:
            return self._is_end(record)
        head = message_head(self._read, record)
        size = record.end - self.end
        if (head is None or record.opcode != MESSAGE_CODE or record.end > limit
                or head.channel not in self._channels
                or (chunk.size and chunk.size + size > CHUNK_BYTES)):
            raise self._damaged()
        if record.end > self._size:
            return False
        self.chunk = chunk.extended(head.log_ns, size)
        self.chunk.enter(head.channel, head.log_ns, size)
        self.end = record.end
        return True

    def _take_message_index(self, chunk: OpenChunk, record: Record) -> None:
        """Take the index of a channel; that of the last channel ends the chunk."""
        start = bytes(self._read(self.end, MESSAGE_INDEX.size)).ljust(MESSAGE_INDEX.size, b'\0')
        _, length, channel_id, entry_bytes = MESSAGE_INDEX.unpack(start)
        entries = chunk.entries.get(channel_id, ())
        if not length - 6 == entry_bytes == INDEX_ENTRY.size * len(entries) > 0:
            raise self._damaged()
        self._index_offsets[channel_id] = self.end
        if len(self._index_offsets) == len(chunk.entries):
            self.index.add_chunk(
                chunk, chunk.counts(), self._index_offsets, record.end - chunk.end)
            self.chunk = None

    def _take_definition(self, record: Record) -> None:
        """Take a schema or a channel, which the summary repeats."""
        from mcap.records import Channel, Schema
        found: Channel | Schema | None = (
            read_definition(Schema, self._read, record) if record.opcode == SCHEMA_CODE
            else read_definition(Channel, self._read, record))
        content = bytes(self._read(self.end, record.end - self.end))
        self._record_count += 1
        if (found is None or self._record_count > _MAX_RECORDS
                or encode_record(found) != content):
            raise self._damaged()
        if isinstance(found, Channel):
            self._channels.add(found.id)
            if found.schema_id in self._image_schemas:
                self.image_channels.add(found.id)
        elif found.name in (IMAGE, COMPRESSED_IMAGE):
            self._image_schemas.add(found.id)
        self.index.add_record(record.opcode, content)

    def _is_end(self, record: Record) -> bool:
        """Return False at zeros up to the end of the file, which a power cut can leave."""
        position = self.end
        while record.begin <= self._size and (block := self._read(position, _BLOCK)):
            if bytes(block).strip(b'\0'):
                raise self._damaged()
            position += len(block)
        return False

    def _damaged(self) -> BagError:
        return BagError(f'the bag {self._name} is damaged at byte {self.end}; it was not changed')
