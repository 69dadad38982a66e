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
The format of MCAP files: opcodes, and structs and sizes of the records.

Each struct begins with the opcode and the length of its record.
"""

from __future__ import annotations

import struct

MAGIC = b'\x89MCAP0\r\n'

HEADER_CODE, FOOTER_CODE, SCHEMA_CODE, CHANNEL_CODE, MESSAGE_CODE, CHUNK_CODE = range(1, 7)
MESSAGE_INDEX_CODE, CHUNK_INDEX_CODE = 7, 8
STATISTICS_CODE, DATA_END_CODE = 11, 15

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
