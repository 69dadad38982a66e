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

"""The size of a JPEG, and a check for truncated data, without decoding."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
import re
import struct
from typing import NamedTuple

import numpy as np
from opencv_tools.image.errors import JpegError

#: Markers: start of image, start of scan, end of image.
JPEG_SOI, JPEG_SOS, JPEG_EOI = b'\xff\xd8', b'\xff\xda', b'\xff\xd9'

# Start-of-frame markers SOF0 to SOF15, without DHT, JPG and DAC, which lie between them.
_SOF = frozenset(b'\xc0\xc1\xc2\xc3\xc5\xc6\xc7\xc9\xca\xcb\xcd\xce\xcf')
_SEQUENTIAL, _PROGRESSIVE = frozenset((0xc0, 0xc1)), 0xc2
# Second bytes of markers.
_DHT, _SOI, _EOI, _SOS = 0xc4, 0xd8, 0xd9, 0xda
_RESTARTS = range(0xd0, 0xd8)
_STANDALONE = frozenset((0x01, *_RESTARTS))
# A marker as libjpeg finds it. libjpeg skips all bytes before a marker.
_MARKER = re.compile(rb'\xff+([\x01-\xfe])')
# For each byte after 0xff, whether the two end the data of a scan. A stuffed zero, a restart
# marker and a fill byte do not.
_ENDS_A_SCAN = np.ones(256, np.bool_)
_ENDS_A_SCAN[[0x00, *_RESTARTS, 0xff]] = False
_CHUNK_BYTES = 65_536  # bytes of a scan that are searched at once
_MAX_SEGMENTS = 1000  # largest number of segments before the size, and again after it
_MAX_CODE_BITS = 16  # longest code of a Huffman table in bits
# Bytes that decode to many different blocks and contain no marker.
_EXTRA_DATA = bytes(range(0x11, 0xff)) * 8


class _Frame(NamedTuple):
    """The frame header of a JPEG."""

    marker: int  # second byte of the marker
    width: int
    height: int
    sampling: dict[int, tuple[int, int]]  # horizontal and vertical factor, by component


class _Data(NamedTuple):
    """The entropy-coded data of a scan."""

    end: int  # offset after the data
    size: int  # bytes without the stuffed zero bytes


class _Segment(NamedTuple):
    """A segment of a JPEG; a scan segment is followed by its data."""

    marker: int  # second byte of the marker
    start: int  # offset of the content, after the length
    end: int  # offset after the content
    data: _Data | None = None


@dataclass
class _ScanState:
    """The state of the check of a JPEG after some of its segments."""

    frame: _Frame | None = None
    data: _Data | None = None  # of the last scan
    seen: set[int] = field(default_factory=set)  # components of the scans so far
    shortest: dict[int, int] = field(default_factory=dict)  # fewest bits of a symbol, by table


def jpeg_size(jpeg: bytes) -> tuple[int, int]:
    """
    Read the width and height of a JPEG.

    :returns: width and height in pixels.
    :raises JpegError: the JPEG has no valid frame header.
    """
    frame = _find_frame(jpeg)
    return frame.width, frame.height


def jpeg_components(jpeg: bytes) -> int:
    """
    Read the number of components of a JPEG: 1 for gray, 3 for colours.

    :raises JpegError: the JPEG has no valid frame header.
    """
    return len(_find_frame(jpeg).sampling)


def _find_frame(jpeg: bytes) -> _Frame:
    """Read the frame header of a JPEG, and nothing after it."""
    try:
        for segment in _segments(jpeg):
            if segment.marker in _SOF:
                return _read_frame(segment.marker, jpeg[segment.start:segment.end])
    except struct.error:
        pass
    raise JpegError('a picture without a size')


def jpeg_segment(jpeg: bytes, marker: int, prefix: bytes) -> bytes:
    """
    Return the content of the first segment before the scans that begins with some bytes.

    :param marker: second byte of the marker.
    :param prefix: the bytes, which the result lacks.
    :returns: the content; b'' if there is no such segment.
    """
    with suppress(JpegError, struct.error):
        for segment in _segments(jpeg) if jpeg.startswith(JPEG_SOI) else ():
            if segment.marker == marker and jpeg.startswith(prefix, segment.start, segment.end):
                return jpeg[segment.start + len(prefix):segment.end]
            if segment.marker == _SOS:
                break
    return b''


def check_jpeg(jpeg: bytes) -> int:
    """
    Check that a JPEG is complete, as far as that is possible without decoding.

    The segments are read, and the bits of each scan are counted. A scan is truncated when it has
    fewer bits than its blocks need with the shortest codes of their Huffman tables.

    :returns: offset after the data of the last scan.
    :raises JpegError: a header, a scan or the end is missing, or a scan is too short.
    """
    found = _ScanState()
    try:
        for segment in _segments(jpeg, 2 * _MAX_SEGMENTS):
            content = jpeg[segment.start:segment.end]
            if segment.marker in _SOF:
                found.frame = _read_frame(segment.marker, content)
            elif segment.marker == _DHT:
                _read_tables(content, found.shortest)
            elif segment.data:
                _read_scan(content, segment.data, found)
    except (struct.error, KeyError) as err:
        raise JpegError('a JPEG picture that is damaged') from err
    if found.frame is None or found.data is None:
        raise JpegError('a picture without a size' if found.frame is None else
                        'a JPEG picture without pixels')
    if found.seen != found.frame.sampling.keys():
        raise JpegError('a JPEG picture whose end is missing')
    return found.data.end


def with_extra_data(jpeg: bytes, scan_end: int) -> bytes:
    """
    Return a JPEG with meaningless data after its last scan.

    A decoder ignores these data if the last scan is complete. Otherwise it decodes them to
    pixels. The two JPEGs then differ when decoded, which shows that the first one is truncated.

    :param scan_end: return value of ``check_jpeg`` for this JPEG.
    """
    complete, rest = jpeg[:scan_end], jpeg[scan_end:]
    # The number of the last restart marker, or 7 if there is none.
    _, last = max((complete.rfind(bytes((0xff, marker))), number)
                  for number, marker in enumerate(_RESTARTS))
    restart = bytes((0xff, _RESTARTS[(last + 1) % len(_RESTARTS)]))
    return b''.join((complete, _EXTRA_DATA, restart, _EXTRA_DATA, rest))


def _segments(jpeg: bytes, most: int = _MAX_SEGMENTS) -> Iterator[_Segment]:
    """
    Yield the segments of a JPEG up to its end marker.

    :param most: largest number of markers to read.
    :raises JpegError: there are more markers, or the end marker is missing.
    :raises struct.error: a segment is damaged.
    """
    position = len(JPEG_SOI)
    for _ in range(most):
        found = _MARKER.search(jpeg, position)
        if not found:
            raise JpegError('a JPEG picture whose end is missing')
        marker, position = found[1][0], found.end()
        if marker == _EOI:
            return
        if marker == _SOI:
            raise struct.error('a second beginning')
        if marker in _STANDALONE:
            continue
        length = struct.unpack_from('>H', jpeg, position)[0]
        start, end = position + 2, position + length
        if length < 2 or end > len(jpeg):
            raise struct.error('a segment that is longer than the rest')
        data = _read_data(jpeg, end) if marker == _SOS else None
        position = data.end if data else end
        yield _Segment(marker, start, end, data)
    raise JpegError('a picture without a size')


def _read_data(jpeg: bytes, start: int) -> _Data:
    """
    Return where the data of a scan end, and their size.

    :raises JpegError: no marker follows the data.
    """
    data = np.frombuffer(jpeg, np.uint8)
    stuffed = 0
    for begin in range(start, len(data), _CHUNK_BYTES):
        block = data[begin:begin + _CHUNK_BYTES + 1]
        positions = np.flatnonzero(block[:-1] == 0xff)
        following = block[1:][positions]
        markers = np.flatnonzero(_ENDS_A_SCAN[following])
        if markers.size:
            stuffed += np.count_nonzero(following[:markers[0]] == 0)
            end = begin + int(positions[markers[0]])
            while end > start and jpeg[end - 1] == 0xff:  # fill bytes before the marker
                end -= 1
            return _Data(end, end - start - stuffed)
        stuffed += np.count_nonzero(following == 0)
    raise JpegError('a JPEG picture whose end is missing')


def _read_frame(marker: int, content: bytes) -> _Frame:
    _, height, width, count = struct.unpack_from('>BHHB', content)
    sampling = {}
    for number, both, _ in struct.iter_unpack('BBB', content[6:]):
        sampling[number] = both >> 4, both & 15
        if not (both >> 4 and both & 15):
            raise struct.error('a component without pixels')
    if len(sampling) != count or not (count and width and height):
        raise struct.error('no size')
    return _Frame(marker, width, height, sampling)


def _read_tables(content: bytes, shortest: dict[int, int]) -> None:
    """Read the fewest bits of a symbol and of the number after it, for each table of a DHT."""
    position = 0
    while position < len(content):
        table, *counts = struct.unpack_from('17B', content, position)
        position += 1 + _MAX_CODE_BITS
        symbols = content[position:position + sum(counts)]
        if len(symbols) != sum(counts):
            raise struct.error('a table that breaks off')
        position += len(symbols)
        lengths = [length for length, count in enumerate(counts, 1) for _ in range(count)]
        shortest[table] = min(
            (length + (symbol & 15) for length, symbol in zip(lengths, symbols)), default=0)


def _read_scan(content: bytes, data: _Data, found: _ScanState) -> None:
    """Check the length of a scan, and add the scan to the state."""
    count, = struct.unpack_from('B', content)
    if found.frame is None or not count or len(content) != 4 + 2 * count:
        raise struct.error('a scan without a frame')
    selectors = [*struct.iter_unpack('BB', content[1:-3])]
    first, _, approximation = content[-3:]
    found.data = data
    found.seen.update(number for number, _ in selectors)
    has_ac = found.frame.marker in _SEQUENTIAL
    if not has_ac and (found.frame.marker != _PROGRESSIVE or first or approximation >> 4):
        return  # in other scans one bit can stand for many blocks
    bits = 0
    for number, tables in selectors:
        block = found.shortest.get(tables >> 4, 0)
        if has_ac:
            block += found.shortest.get(0x10 | tables & 15, 0)
        bits += _blocks(found.frame, number, count > 1) * block
    if 8 * data.size < bits:
        raise JpegError('a JPEG picture whose end is missing')


def _blocks(frame: _Frame, component: int, is_interleaved: bool) -> int:
    """Return the number of 8x8 blocks of a component; interleaved scans have whole units."""
    across, down = frame.sampling[component]
    most_across = max(sampling[0] for sampling in frame.sampling.values())
    most_down = max(sampling[1] for sampling in frame.sampling.values())
    if is_interleaved:
        units = -(-frame.width // (8 * most_across)) * -(-frame.height // (8 * most_down))
        return units * across * down
    width, height = -(-frame.width * across // most_across), -(-frame.height * down // most_down)
    return -(-width // 8) * -(-height // 8)
