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

"""The format of MCAP files: opcodes, structs and sizes of records."""

from __future__ import annotations

import struct
from typing import Any

MAGIC = b'\x89MCAP0\r\n'
MAX_TIME = 2**63 - 1  # larger ones are legal, but some readers have signed times

HEADER_CODE, FOOTER_CODE, SCHEMA_CODE, CHANNEL_CODE, MESSAGE_CODE, CHUNK_CODE = range(1, 7)
MESSAGE_INDEX_CODE, CHUNK_INDEX_CODE = 7, 8
STATISTICS_CODE, DATA_END_CODE = 11, 15

#: Opcode and length of a record.
RECORD = struct.Struct('<BQ')
#: Opcode, length, channel, sequence, log time and publish time of a message record.
MESSAGE = struct.Struct('<BQHIQQ')
#: Opcode, length, first and last time, size, CRC and length of the name of the compression.
CHUNK = struct.Struct('<BQQQQII')
#: Length of the records of a chunk, after the name of the compression.
LENGTH = struct.Struct('<Q')
#: Opcode, length, channel and bytes of the entries of a message index.
MESSAGE_INDEX = struct.Struct('<BQHI')
#: Log time and offset in the chunk of a message.
INDEX_ENTRY = struct.Struct('<QQ')
#: Opcode, length, offsets of the summary and of its groups, CRC; the magic follows.
FOOTER = struct.Struct('<BQQQI8s')

#: Bytes of a chunk without compression before its records.
CHUNK_START_BYTES = CHUNK.size + LENGTH.size
#: Bytes of other records; a count is that of the messages of a channel, in the statistics.
DATA_END_BYTES, CHUNK_INDEX_BYTES, OFFSET_BYTES, STATISTICS_BYTES, COUNT_BYTES = 13, 73, 26, 55, 10
#: Largest number of bytes that a message adds to a file, without its data.
ADDED_BYTES = (CHUNK_START_BYTES + MESSAGE.size + MESSAGE_INDEX.size + INDEX_ENTRY.size
               + CHUNK_INDEX_BYTES + COUNT_BYTES)


def encode_record(record: Any) -> bytes:
    """Return the bytes of a record of the library mcap."""
    from mcap.data_stream import RecordBuilder
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def count_records(records: bytes | bytearray) -> int:
    """Count the records in a buffer."""
    count = position = 0
    while position < len(records):
        position += RECORD.size + RECORD.unpack_from(records, position)[1]
        count += 1
    return count
