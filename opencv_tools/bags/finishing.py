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

from io import BytesIO
import os
from pathlib import Path
import struct
from typing import Any

from opencv_tools.bags.errors import BagError, check_mcap
from opencv_tools.bags.index import (
    BagIndex, CHANNEL_CODE, CHUNK, CHUNK_BYTES, CHUNK_CODE, DATA_END_CODE, encode_record,
    FOOTER_CODE, HEADER_CODE, LIBRARY, MAGIC, MESSAGE, MESSAGE_CODE, MESSAGE_INDEX_CODE,
    OpenChunk, PROFILE, RECORD, SCHEMA_CODE,
)
from opencv_tools.image.text import printable
from opencv_tools.image.types import COMPRESSED_IMAGE, IMAGE
from opencv_tools.regular_files import is_same_file, open_regular, try_lock

_BLOCK = 1 << 20
_MAX_RECORD = 1 << 19  # bytes of a record that is neither a chunk nor a message
_MAX_RECORDS = 1000  # schemas and channels
_FOOTER_BYTES = 29
# Magic, opcode and length of the header, and two texts with their lengths.
_START = struct.Struct(f'<{len(MAGIC)}sBQI{len(PROFILE)}sI{len(LIBRARY)}s')
_OWN_START = MAGIC, HEADER_CODE, PROFILE.encode(), LIBRARY.encode()


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

    :param path: path of the file.
    :raises OSError: the file cannot be read.
    """
    file = open_regular(path, follow=False)
    try:
        return _has_footer(file, os.fstat(file).st_size)
    finally:
        os.close(file)


def _has_footer(file: int, size: int) -> bool:
    end = os.pread(file, _FOOTER_BYTES + len(MAGIC), max(0, size - _FOOTER_BYTES - len(MAGIC)))
    return end[:1] == bytes((FOOTER_CODE,)) and end.endswith(MAGIC)


def _has_own_header(file: int) -> bool:
    """Return whether a file begins like those of ``BagWriter``, with a whole header."""
    start = os.pread(file, _START.size, 0)
    if len(start) < _START.size:
        return False
    *found, length, _, profile, _, library = _START.unpack(start)
    return ((*found, profile, library) == _OWN_START
            and len(MAGIC) + RECORD.size + length <= os.fstat(file).st_size)


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
        self._file = file
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
        while self._read_record():
            pass
        if self.chunk:
            self.end = self.chunk.end  # without incomplete message indexes

    def frame_count(self) -> int:
        """Return the number of images."""
        counts = self.chunk.counts() if self.chunk else {}
        return sum(self.index.counts.get(channel_id, 0) + counts.get(channel_id, 0)
                   for channel_id in self.image_channels)

    def _read_record(self) -> bool:
        """Read the next record; return whether it is complete and another one may follow."""
        start = os.pread(self._file, RECORD.size, self.end)
        if len(start) < RECORD.size:
            return False
        code, length = RECORD.unpack(start)
        end = self.end + RECORD.size + length
        if not code:
            return self._skip_zeros()
        if code == CHUNK_CODE and not self.chunk:
            return self._read_chunk(end)
        if code == MESSAGE_CODE and self.chunk and not self._index_offsets:
            # The recorder was killed before it wrote the longer header of the chunk.
            return self._read_message(end)
        if end > self._size and length <= _MAX_RECORD:
            return False
        if code == MESSAGE_INDEX_CODE and self.chunk:
            self._read_message_index(self.chunk, length)
        elif code in (SCHEMA_CODE, CHANNEL_CODE) and not self.chunk and length <= _MAX_RECORD:
            self._read_text(code, end)
        elif code == DATA_END_CODE and not self.chunk:
            self.is_finished = _has_footer(self._file, self._size)
            return False
        elif code != HEADER_CODE or self.end != len(MAGIC):
            raise self._damaged()
        self.end = end
        return True

    def _read_chunk(self, end: int) -> bool:
        """Read a chunk, of which the file may have only the first messages."""
        start = os.pread(self._file, CHUNK.size, self.end)
        if len(start) < CHUNK.size:
            return False
        _, length, _, _, size, crc, compression, data_bytes = CHUNK.unpack(start)
        if (crc or compression
                or not 0 < size == data_bytes == length - CHUNK.size + RECORD.size):
            raise self._damaged()
        self.chunk, self._index_offsets = OpenChunk(self.end), {}
        self.end = self.chunk.end
        while self.end < end and self._read_message(end):
            pass
        is_complete = self.end == end
        if not self.chunk.size:
            self.end, self.chunk = self.chunk.offset, None
        return is_complete

    def _read_message(self, limit: int) -> bool:
        """Read a message of the chunk, without its data."""
        start = os.pread(self._file, MESSAGE.size, self.end)
        if len(start) < MESSAGE.size:
            return False
        if not start[0]:
            return self._skip_zeros()
        code, length, channel_id, _, log_ns, _ = MESSAGE.unpack(start)
        size = RECORD.size + length
        chunk = self.chunk
        if (not chunk or code != MESSAGE_CODE or size < MESSAGE.size or self.end + size > limit
                or channel_id not in self._channels
                or (chunk.size and chunk.size + size > CHUNK_BYTES)):
            raise self._damaged()
        if self.end + size > self._size:
            return False
        self.chunk = chunk.extended(log_ns, size)
        self.chunk.enter(channel_id, log_ns, size)
        self.end += size
        return True

    def _read_message_index(self, chunk: OpenChunk, length: int) -> None:
        """Read which channel an index is of; the index of the last channel ends the chunk."""
        channel_id, entry_bytes = struct.unpack(
            '<HI', os.pread(self._file, 6, self.end + RECORD.size).ljust(6, b'\0'))
        entries = chunk.entries.get(channel_id, ())
        if not length - 6 == entry_bytes == 16 * len(entries) > 0:
            raise self._damaged()
        self._index_offsets[channel_id] = self.end
        if len(self._index_offsets) == len(chunk.entries):
            self.index.add_chunk(chunk, chunk.counts(), self._index_offsets,
                                 self.end + RECORD.size + length - chunk.end)
            self.chunk = None

    def _read_text(self, code: int, end: int) -> None:
        """Read a schema or a channel."""
        from mcap.data_stream import ReadDataStream
        from mcap.records import Channel, Schema
        record = os.pread(self._file, end - self.end, self.end)
        kind: Any = Channel if code == CHANNEL_CODE else Schema
        try:
            found = kind.read(ReadDataStream(BytesIO(record[RECORD.size:])))
        except Exception as err:  # noqa: B902 - the library has no error of its own for it
            raise self._damaged() from err
        self._record_count += 1
        if self._record_count > _MAX_RECORDS or encode_record(found) != record:
            raise self._damaged()
        if code == SCHEMA_CODE and found.name in (IMAGE, COMPRESSED_IMAGE):
            self._image_schemas.add(found.id)
        elif code == CHANNEL_CODE:
            self._channels.add(found.id)
            if found.schema_id in self._image_schemas:
                self.image_channels.add(found.id)
        self.index.add_record(code, record)

    def _skip_zeros(self) -> bool:
        """Return False at zeros up to the end of the file, which a power cut can leave."""
        position = self.end
        while block := os.pread(self._file, _BLOCK, position):
            if block.strip(b'\0'):
                raise self._damaged()
            position += len(block)
        return False

    def _damaged(self) -> BagError:
        return BagError(f'the bag {self._name} is damaged at byte {self.end}; it was not changed')
