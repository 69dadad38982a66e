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

from collections import Counter
import os
from pathlib import Path
import struct
from typing import NamedTuple

from opencv_tools.bags.account import (
    account_record, has_account, REPEATED, repeated_counts, WRITTEN)
from opencv_tools.bags.errors import BagError, check_mcap
from opencv_tools.bags.mcap_records import (
    CHANNEL_CODE, CHUNK, CHUNK_CODE, DATA_END_CODE, definition, file_reader, HEADER_CODE,
    INDEX_ENTRY_BYTES, MAGIC, MESSAGE, MESSAGE_CODE, message_head, MESSAGE_INDEX,
    MESSAGE_INDEX_CODE, METADATA_CODE, Read, RECORD, Record, scan, SCHEMA_CODE, summary_start)
from opencv_tools.bags.writing import (
    BagIndex, CHUNK_BYTES, encode_record, LIBRARY, OpenChunk, PROFILE)
from opencv_tools.base.regular_files import is_same_file, open_regular, try_lock
from opencv_tools.base.text import printable
from opencv_tools.image.cdr import COMPRESSED_IMAGE, IMAGE
from opencv_tools.video.messages import VIDEO_TOPICS

_BLOCK = 1 << 20
_MAX_RECORD = 1 << 20  # bytes of a record that is neither a chunk nor a message
_MAX_DEFINITIONS = 1000  # schemas and channels
# Magic, opcode and length of the header, and two texts with their lengths.
_START = struct.Struct(f'<{len(MAGIC)}sBQI{len(PROFILE)}sI{len(LIBRARY)}s')
_OWN_START = MAGIC, HEADER_CODE, len(PROFILE), PROFILE.encode(), LIBRARY.encode()


def finish_bag(path: Path) -> int | None:
    """Finish a bag as `finish_and_count` does, and return the number of its images."""
    counts = finish_and_count(path)
    return counts and counts.images


class Counts(NamedTuple):
    """Number of images, and of all messages."""

    images: int
    messages: int


def finish_and_count(path: Path) -> Counts | None:
    """
    Write the missing end of a bag of this package, unless its recording still runs.

    :returns: number of messages in the bag; None if it is not a bag of this package, or if it is
        being written.
    :raises BagError: a record in the middle is damaged, or the library mcap is not installed; the
        bag is not changed.
    :raises OSError: the bag cannot be read or written; no message is lost.
    """
    file = open_regular(path, os.O_RDWR, follow=False)
    try:
        read = file_reader(file)
        if (not _has_own_header(read, os.fstat(file).st_size) or not try_lock(file)
                or not is_same_file(file, path)):
            return None
        check_mcap()
        bag = _OwnBag(read, os.fstat(file).st_size, printable(path.name))
        bag.read()
        counts = bag.message_counts()
        if not bag.is_finished:
            _write_end(file, bag)
        return counts
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


def _has_own_header(read: Read, size: int) -> bool:
    """Return whether a file begins like those of ``BagWriter``, with a whole header."""
    start = read(0, _START.size)
    if len(start) < _START.size:
        return False
    *found, length, profile_bytes, profile, library_bytes, library = _START.unpack(start)
    return ((*found, profile_bytes, profile, library) == _OWN_START
            and length == 8 + profile_bytes + library_bytes
            and len(MAGIC) + RECORD.size + length <= size)


def _write_end(file: int, bag: _OwnBag) -> None:
    """Remove what follows the complete messages, and write indexes, account and summary."""
    os.ftruncate(file, bag.end)
    end, chunk, account = b'', bag.chunk, bag.account()
    if chunk:
        os.pwrite(file, chunk.header(), chunk.offset)
        end, offsets = chunk.message_indexes()
        bag.index.add_chunk(chunk, offsets, len(end))
    if not has_account(bag.metadata):
        end += bag.index.add_metadata(
            [account_record(account, is_known=False)], bag.end + len(end))
    end += bag.index.end(bag.end + len(end))
    position = bag.end
    while end:
        written = os.pwrite(file, end, position)
        position, end = position + written, end[written:]


class _OwnBag:
    """
    The records of a bag of this package, without the data of messages.

    The index has the schemas, the channels and the chunks that are followed by their message
    indexes. ``chunk`` is the last chunk if they are missing. ``end`` is the offset after the
    complete messages and indexes.
    """

    def __init__(self, read: Read, size: int, name: str) -> None:
        self.index = BagIndex()
        self.chunk: OpenChunk | None = None
        self.end = len(MAGIC)
        self.is_finished = False
        self._read = read
        self._size = size
        self._name = name
        self._image_schemas: set[int] = set()
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self._topics: dict[int, str] = {}
        self._channels: dict[int, bool] = {}  # whether the messages are images
        self._definition_count = 0
        self._index_offsets: dict[int, int] = {}

    def read(self) -> None:
        """
        Read the records up to the summary, or up to the first one that is cut off.

        :raises BagError: a record is not one that ``BagWriter`` writes there.
        """
        for part in scan(self._read, self.end, self._size, [], limit=self._size):
            record = part.record
            if part.chunk:
                is_complete = self._add_message(record, part.chunk.end)
            elif is_complete := self._add(record):
                self.end = record.end
            if not is_complete:
                break
        if self.chunk and self.chunk.size:
            self.end = self.chunk.end  # without incomplete message indexes
        elif self.chunk:
            self.end, self.chunk = self.chunk.offset, None

    def account(self) -> dict[str, dict[str, int]]:
        """Return how many messages of each topic were written, without those that are repeated."""
        counts, repeated = Counter[str](), repeated_counts(self.metadata)
        for channel, count in self._all_counts().items():
            counts[self._topics[channel]] += count
        return {topic: {WRITTEN: max(0, count - repeated.get(topic, 0)),
                        REPEATED: min(count, repeated.get(topic, 0))}
                for topic, count in counts.items()}

    def _all_counts(self) -> Counter[int]:
        counts = Counter(self.index.counts)
        counts.update(self.chunk.counts() if self.chunk else {})
        return counts

    def message_counts(self) -> Counts:
        counts = self._all_counts()
        return Counts(sum(counts[channel] for channel, is_image in self._channels.items()
                          if is_image), counts.total())

    def _add(self, record: Record) -> bool:
        """Add a record; return whether it is complete and another one may follow."""
        code = record.opcode
        if code == CHUNK_CODE and not self.chunk:
            return self._add_chunk(record)
        if code == MESSAGE_CODE and self.chunk and not self._index_offsets:
            # The recorder was killed before it wrote the longer header of the chunk.
            return self._add_message(record, record.end)
        if not code:
            return self._skip_zeros(record)
        if record.end > self._size and record.size <= _MAX_RECORD:
            return False
        if code == MESSAGE_INDEX_CODE and self.chunk:
            self._add_message_index(self.chunk, record)
        elif (code in (SCHEMA_CODE, CHANNEL_CODE, METADATA_CODE) and not self.chunk
                and record.size <= _MAX_RECORD):
            self._add_definition(record)
        elif code == DATA_END_CODE and not self.chunk:
            self.is_finished = summary_start(self._read, self._size) is not None
            return False
        elif code != HEADER_CODE or record.begin != len(MAGIC):
            raise self._damaged(record)
        return True

    def _add_chunk(self, record: Record) -> bool:
        """Add a chunk without its messages, of which the file may have only the first ones."""
        start = self._read(record.begin, CHUNK.size)
        if len(start) < CHUNK.size:
            return False
        *_, size, crc, name_bytes, data_bytes = CHUNK.unpack(start)
        if crc or name_bytes or not 0 < size == data_bytes == record.size - CHUNK.size:
            raise self._damaged(record)
        self.chunk, self._index_offsets = OpenChunk(record.begin), {}
        return True

    def _add_message(self, record: Record, limit: int) -> bool:
        """Add a message of the chunk; return whether it is complete."""
        if not record.opcode:
            return self._skip_zeros(record)
        if self._size - record.begin < MESSAGE.size:
            return False
        chunk, head = self.chunk, message_head(self._read, record)
        if (not chunk or not head or record.opcode != MESSAGE_CODE or record.end > limit
                or head.channel not in self._channels
                or (chunk.size and chunk.size + record.size > CHUNK_BYTES)):
            raise self._damaged(record)
        if record.end > self._size:
            return False
        self.chunk = chunk.extended(head.log_ns, record.size)
        self.chunk.enter(head.channel, head.log_ns, record.size)
        return True

    def _add_message_index(self, chunk: OpenChunk, record: Record) -> None:
        """Add the index of a channel; that of the last channel ends the chunk."""
        start = bytes(self._read(record.begin, MESSAGE_INDEX.size)).ljust(
            MESSAGE_INDEX.size, b'\0')
        *_, channel_id, entry_bytes = MESSAGE_INDEX.unpack(start)
        entries = chunk.entries.get(channel_id, ())
        if not (record.size - MESSAGE_INDEX.size == entry_bytes
                == INDEX_ENTRY_BYTES * len(entries) > 0):
            raise self._damaged(record)
        self._index_offsets[channel_id] = record.begin
        if len(self._index_offsets) == len(chunk.entries):
            self.index.add_chunk(chunk, self._index_offsets, record.end - chunk.end)
            self.chunk = None

    def _add_definition(self, record: Record) -> None:
        from mcap.records import Channel, Metadata
        data = bytes(self._read(record.begin, record.size))
        found = definition(self._read, record)
        self._definition_count += 1
        if (not found or self._definition_count > _MAX_DEFINITIONS
                or encode_record(found) != data):
            raise self._damaged(record)
        if isinstance(found, Metadata):
            self.metadata.append((found.name, found.metadata))
            self.index.add_metadata(self.metadata[-1:], record.begin)
            return
        if isinstance(found, Channel):
            self._topics[found.id] = found.topic
            self._channels[found.id] = (found.schema_id in self._image_schemas
                                        or self._channels.get(found.id, False))
        elif found.name in (IMAGE, COMPRESSED_IMAGE, *VIDEO_TOPICS):
            self._image_schemas.add(found.id)
        self.index.add_record(record.opcode, data)

    def _skip_zeros(self, record: Record) -> bool:
        """Return False at zeros up to the end of the file, which a power cut can leave."""
        position = record.begin
        if self._size - position < RECORD.size:  # the opcode is not known
            return False
        while block := self._read(position, _BLOCK):
            if bytes(block).strip(b'\0'):
                raise self._damaged(record)
            position += len(block)
        return False

    def _damaged(self, record: Record) -> BagError:
        return BagError(
            f'the bag {self._name} is damaged at byte {record.begin}; it was not changed')
