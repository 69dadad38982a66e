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

"""Records of MCAP files, whose claimed sizes are compared with the file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
import io
import os
import struct
from typing import Any, NamedTuple, TYPE_CHECKING
import zlib

from opencv_tools.bags.compression import decompress
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.reading import MAX_BYTES

if TYPE_CHECKING:
    from mcap.records import Channel, Metadata, Schema

MAGIC = b'\x89MCAP0\r\n'
HEADER_CODE, FOOTER_CODE, SCHEMA_CODE, CHANNEL_CODE, MESSAGE_CODE, CHUNK_CODE = range(1, 7)
MESSAGE_INDEX_CODE, CHUNK_INDEX_CODE, ATTACHMENT_CODE = 7, 8, 9
STATISTICS_CODE, METADATA_CODE, METADATA_INDEX_CODE, DATA_END_CODE = 11, 12, 13, 15
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

_MAX_DEFINITION = 1 << 20  # bytes of a schema, channel or metadata record
_LONGEST_NAME = 16  # characters of the name of a compression
_CUT = 'its chunk is cut off'  # not reported, because the file has a warning


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


def definition(read: Read, record: Record) -> Channel | Metadata | Schema | None:
    """Return the channel, schema or metadata in a record; None if damaged or too large."""
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError
    from mcap.records import Channel, Metadata, Schema
    if record.size > _MAX_DEFINITION:
        return None
    content = ReadDataStream(io.BytesIO(read(record.begin, record.size)[RECORD.size:]))
    try:
        kind: Any = {CHANNEL_CODE: Channel, METADATA_CODE: Metadata, SCHEMA_CODE: Schema}
        found: Channel | Metadata | Schema = kind[record.opcode].read(content)
    except (McapError, ValueError, struct.error):
        return None
    return found


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
