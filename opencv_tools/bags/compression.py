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

"""Decompression of parts of bags, with limits of the memory."""

from __future__ import annotations

import os
from pathlib import Path
import shutil
from typing import Any

from opencv_tools.bags.errors import BagError
from opencv_tools.bags.reading import MAX_BYTES
from opencv_tools.base.regular_files import open_regular
from opencv_tools.base.remedies import installation
from opencv_tools.base.text import MAX_PATH, printable

_MAX_WINDOW = 1 << 27  # bytes of memory; zstd itself allows no more without an option
_PART_BYTES = 1 << 22
_RESERVE_BYTES = 10**9  # of the disk
_ZSTD = b'\x28\xb5\x2f\xfd'  # first bytes of a frame


def decompress(data: memoryview, compression: str, size: int) -> memoryview:
    """
    Return the content of compressed data.

    :param size: claimed size of the content in bytes; no more memory is used.
    :raises BagError: the data are damaged, the content has another size, or a library is missing.
    """
    if compression not in _DECOMPRESSORS:
        raise BagError(f'its compression {printable(compression)!r} is unknown')
    try:
        content = _DECOMPRESSORS[compression](data, size)
    except ImportError as err:
        raise BagError(f'it needs {compression}, which cannot be imported ({err}); '
                       f'{installation("mcap")}') from err
    except (MemoryError, RuntimeError, ValueError) as err:
        raise BagError(f'its data cannot be decompressed: {printable(err)}') from err
    if len(content) != size:
        raise BagError('its data have another size than it claims')
    return memoryview(content)


def decompressed_message(serialized: memoryview) -> memoryview:
    """
    Return a message that rosbag2 has compressed on its own; every other message unchanged.

    :raises BagError: the message cannot be decompressed, or is too large.
    """
    if serialized[:len(_ZSTD)] != _ZSTD:  # the encapsulation of CDR begins with 0
        return serialized
    try:
        import zstandard
        size = zstandard.frame_content_size(serialized)
    except ImportError:
        size = 0
    except zstandard.ZstdError as err:
        raise BagError(f'its data cannot be decompressed: {printable(err)}') from err
    if not 0 <= size <= MAX_BYTES:
        raise BagError(f'its data have an unknown size or more than {MAX_BYTES} bytes, which are '
                       'not read')
    return decompress(serialized, 'zstd', size)


def unpack_file(path: Path, target: Path) -> None:
    """
    Write the content of a file of zstd to a new file, part by part.

    What follows a cut is missing. The disk of the new file keeps 1 GB free.

    :raises BagError: the file is damaged, the disk has no room, or a library is missing.
    :raises OSError: a file cannot be read or written.
    """
    shown = printable(path.name, MAX_PATH)
    try:
        import zstandard
    except ImportError as err:
        raise BagError(f'{shown} needs zstandard, which cannot be imported ({err}); '
                       f'{installation("mcap")}') from err
    try:
        with os.fdopen(open_regular(path), 'rb') as packed, target.open('xb') as file, (
                zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW).stream_reader(
                    packed, read_across_frames=True)) as content:
            while data := content.read(_PART_BYTES):
                if shutil.disk_usage(target.parent).free < _RESERVE_BYTES:
                    raise BagError(f'{shown} does not fit into {target.parent.parent}; set TMPDIR '
                                   "to a folder on a larger disk, or unpack it with 'unzstd'")
                file.write(data)
    except zstandard.ZstdError as err:
        raise BagError(f'{shown} cannot be decompressed: {printable(err)}') from err


def _decompress_lz4(data: memoryview, size: int) -> Any:
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
    decompressor = LZ4FrameDecompressor()
    content = decompressor.decompress(data, max_length=size)
    return content if decompressor.eof else b''


def _decompress_zstd(data: memoryview, size: int) -> Any:
    import zstandard
    try:
        # A size in the data themselves would be allocated, even if it exceeds the limit.
        if zstandard.frame_content_size(data) > size:
            return b''
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    except zstandard.ZstdError as err:
        raise ValueError(err) from err


_DECOMPRESSORS = {'lz4': _decompress_lz4, 'zstd': _decompress_zstd}
