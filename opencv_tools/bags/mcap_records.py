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
Records of MCAP files, with limits of the memory.

The readers of the library ``mcap`` load a chunk as often as a message needs it, and believe the
sizes that a file claims. Here a claimed size is compared with the file, and no data are copied.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
import io
import os
import struct
from typing import NamedTuple, TYPE_CHECKING, TypeVar
import zlib

from opencv_tools.bags.compression import decompress
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.mcap_format import (
    CHUNK, CHUNK_CODE, FOOTER, FOOTER_CODE, LENGTH, MAGIC, MESSAGE, RECORD)
from opencv_tools.bags.reading import Damage, MAX_BYTES

if TYPE_CHECKING:
    from mcap.records import Channel, Schema

T = TypeVar('T', 'Channel', 'Schema')

# Function that reads some bytes from an offset; fewer at the end.
Read = Callable[[int, int], memoryview]

#: Bytes of a message record between its opcode and length and its data.
MESSAGE_HEAD_BYTES = MESSAGE.size - RECORD.size
_MAX_DEFINITION = 1 << 20  # bytes of a schema or channel
_LONGEST_NAME = 16  # characters of the name of a compression


def file_reader(file: int) -> Read:
    """Return a function that reads from a file descriptor."""
    return lambda offset, size: memoryview(os.pread(file, size, offset))


@dataclass(frozen=True)
class Record:
    """
    A record of a file or of a chunk.

    :param opcode: kind of the record.
    :param begin: offset of its content.
    :param end: offset behind its content.
    """

    opcode: int
    begin: int
    end: int


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
        begin += RECORD.size
        yield Record(opcode, begin, begin + length)
        begin += length


def summary_start(read: Read, size: int) -> int | None:
    """
    Return the offset of the summary of a file; None if the file does not end with a footer.

    :param size: size of the file in bytes.
    """
    tail = read(max(0, size - FOOTER.size), FOOTER.size)
    if len(tail) < FOOTER.size:
        return None
    code, length, start, _, _, magic = FOOTER.unpack(tail)
    is_footer = (code, length, magic) == (
        FOOTER_CODE, FOOTER.size - RECORD.size - len(MAGIC), MAGIC)
    return int(start) if is_footer else None


class MessageHead(NamedTuple):
    """
    The fields of a message before its data.

    :param channel: number of the channel.
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
    if record.end - record.begin < MESSAGE_HEAD_BYTES:
        return None
    head = read(record.begin - RECORD.size, MESSAGE.size)
    if len(head) < MESSAGE.size:
        return None
    _, _, *fields = MESSAGE.unpack(head)
    return MessageHead(*fields)


def read_definition(kind: type[T], read: Read, record: Record) -> T | None:
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


def flat_records(
    read: Read, begin: int, end: int, sizes: list[int],
) -> Iterator[tuple[Read, Record | Damage]]:
    """
    Yield the records of a part of a file, and those of its chunks instead of chunks.

    A chunk of a few bytes may unpack to millions of empty records. No more of them are read than
    the chunk has bytes in the file, because each record needs time.

    :param begin: offset of the first record.
    :param end: end of the part. A chunk that is cut off there has its whole records.
    :param sizes: list to which the sizes of chunks in memory are added.
    """
    for record in records(read, begin, end):
        is_cut = record.end > end
        if record.opcode != CHUNK_CODE:
            yield read, _damage(record, 'it has no end') if is_cut else record
            continue
        try:
            inner_read, first, last = _open_chunk(read, record, end)
        except BagError as err:
            if not is_cut:
                yield read, _damage(record, str(err))
            continue
        if inner_read is not read:
            sizes.append(last - first)
        for count, inner in enumerate(records(inner_read, first, last)):
            if count > record.end - record.begin:
                yield read, _damage(record, 'it has more records than bytes')
                break
            if inner.end <= last:
                yield inner_read, inner
            elif not is_cut:
                yield read, _damage(record, 'a record in it has no end')


def _damage(record: Record, reason: str) -> Damage:
    return Damage(f'the record at byte {record.begin} cannot be read: {reason}')


def _open_chunk(read: Read, record: Record, end: int) -> tuple[Read, int, int]:
    """
    Return the records of a chunk: a function that reads them, and offsets of begin and end.

    :raises BagError: the chunk cannot be read; the message does not name the file.
    """
    start = record.begin - RECORD.size
    head = read(start, min(CHUNK.size + _LONGEST_NAME + LENGTH.size, record.end - start))
    if len(head) < CHUNK.size:
        raise BagError('its head is cut off')
    *_, size, crc, name_bytes = CHUNK.unpack_from(head)
    name_end = CHUNK.size + name_bytes
    if name_bytes > _LONGEST_NAME or len(head) < name_end + LENGTH.size:
        raise BagError('its head is damaged')
    compression = bytes(head[CHUNK.size:name_end]).decode(errors='replace')
    length, = LENGTH.unpack_from(head, name_end)
    begin = start + name_end + LENGTH.size
    is_cut = record.end > end
    if not compression and is_cut:
        return read, begin, min(begin + length, end)
    if is_cut or begin + length > record.end:
        raise BagError(f'it claims {length} bytes, more than there are')
    if max(size, length) > MAX_BYTES:
        raise BagError(f'it claims {max(size, length)} bytes; more than {MAX_BYTES} are not read')
    if not compression and not crc:
        return read, begin, begin + length
    data = read(begin, length)
    if len(data) < length:
        raise BagError('it is cut off')
    content = decompress(data, compression, size) if compression else data
    if crc and zlib.crc32(content) != crc:
        raise BagError('its checksum is wrong')
    return lambda offset, count: content[offset:offset + count], 0, len(content)
