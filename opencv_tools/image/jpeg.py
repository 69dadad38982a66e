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

"""JPEG as far as its markers tell: the size, and whether its data can be all of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
import re
import struct
from typing import NamedTuple

import numpy as np
from opencv_tools.image.errors import ImageError

BEGINS, ENDS = b'\xff\xd8', b'\xff\xd9'

# Those that begin a frame; three in their row mean something else.
_FRAMES = frozenset(range(0xc0, 0xd0)) - {0xc4, 0xc8, 0xcc}
_SEQUENTIAL, _PROGRESSIVE = frozenset((0xc0, 0xc1)), 0xc2
_TABLES, _BEGIN, _END, _SCAN = 0xc4, 0xd8, 0xd9, 0xda
_STANDALONE = frozenset((0x01, *range(0xd0, 0xd8)))
# What libjpeg takes for a marker: it passes over what stands before one.
_MARKER = re.compile(rb'\xff+([\x01-\xfe])')
# Of the bytes behind 0xff: what ends the data of a scan, neither stuffed, a restart nor filling.
_ENDS_A_SCAN = np.ones(256, np.bool_)
_ENDS_A_SCAN[[0x00, *range(0xd0, 0xd8), 0xff]] = False
_BLOCK = 1 << 16  # bytes that are searched at once
_MAX_SEGMENTS = 1000  # before the size, and as many behind it
_LENGTHS = 16  # of codes, in bits
# Bits that decode to blocks of many kinds, and are no marker.
_RUBBISH = bytes(range(0x11, 0xff)) * 8


class JpegError(ImageError):
    """A JPEG that is not a whole one; the message says why."""


@dataclass(frozen=True)
class _Frame:
    """Size and components: horizontal and vertical sampling by the component's number."""

    marker: int
    width: int
    height: int
    sampling: dict[int, tuple[int, int]]


class _Segment(NamedTuple):
    """What follows a marker; behind that of a scan stand its data."""

    marker: int
    start: int  # of the content, behind its length
    end: int
    data_end: int = 0
    stuffed: int = 0  # bytes among the data that follow an 0xff which is no marker


@dataclass
class _Scans:
    """What the scans of a JPEG have shown so far."""

    frame: _Frame | None = None
    ends: int = 0  # of the last scan's data
    seen: set[int] = field(default_factory=set)  # components
    shortest: dict[int, int] = field(default_factory=dict)  # bits of a symbol, by table


def jpeg_size(jpeg: bytes) -> tuple[int, int]:
    """
    Read the width and height of a JPEG.

    :raises JpegError: it has none.
    """
    frame = _find_frame(jpeg)
    return frame.width, frame.height


def jpeg_components(jpeg: bytes) -> int:
    """
    Read how many components the picture in a JPEG has: 1 for gray, 3 for colours.

    :raises JpegError: it has no header.
    """
    return len(_find_frame(jpeg).sampling)


def _find_frame(jpeg: bytes) -> _Frame:
    """
    Read the header of the picture, and no more.

    :raises JpegError: it has none.
    """
    try:
        for segment in _segments(jpeg):
            if segment.marker in _FRAMES:
                return _read_frame(segment.marker, jpeg[segment.start:segment.end])
    except struct.error:
        pass
    raise JpegError('a picture without a size')


def check_jpeg(jpeg: bytes) -> int:
    """
    Check that the markers of a JPEG are those of a whole one.

    Between them stand the bits of the pixels, which are counted: a scan is broken off when it has
    fewer than its blocks take at least, each with the shortest codes of its tables.

    :returns: where the data of its last scan end.
    :raises JpegError: it lacks a header, a scan or its end, or a scan is too short.
    """
    found = _Scans()
    try:
        for segment in _segments(jpeg, 2 * _MAX_SEGMENTS):
            content = jpeg[segment.start:segment.end]
            if segment.marker in _FRAMES:
                found.frame = _read_frame(segment.marker, content)
            elif segment.marker == _TABLES:
                _read_tables(content, found.shortest)
            elif segment.marker == _SCAN:
                _read_scan(content, segment, found)
    except (struct.error, KeyError) as err:
        raise JpegError('a JPEG picture that is damaged') from err
    if found.frame is None or not found.seen:
        raise JpegError('a picture without a size' if found.frame is None else
                        'a JPEG picture without pixels')
    if found.seen != found.frame.sampling.keys():
        raise JpegError('a JPEG picture whose end is missing')
    return found.ends


def with_more_pixels(jpeg: bytes, scan_end: int) -> bytes:
    """
    Put rubbish behind the last scan of a JPEG.

    A decoder that has all pixels does not look at it. One that lacks some takes it for them.

    :param jpeg: the picture.
    :param scan_end: what ``check_jpeg`` returned.
    :returns: another picture.
    """
    following = (_restarts(jpeg[:scan_end]) + 1) % 8
    restart = bytes((0xff, 0xd0 + following))
    return b''.join((jpeg[:scan_end], _RUBBISH, restart, _RUBBISH, jpeg[scan_end:]))


def _restarts(scan: bytes) -> int:
    """Find the number of the last restart marker, -1 for none."""
    last = max((scan.rfind(bytes((0xff, 0xd0 + number))), number) for number in range(8))
    return last[1] if last[0] >= 0 else -1


def _segments(jpeg: bytes, most: int = _MAX_SEGMENTS) -> Iterator[_Segment]:
    """
    Yield the segments up to the end.

    :raises JpegError: there are too many, or the end is missing.
    """
    position = len(BEGINS)
    for _ in range(most):
        found = _MARKER.search(jpeg, position)
        if not found:
            raise JpegError('a JPEG picture whose end is missing')
        marker, position = found[1][0], found.end()
        if marker == _END:
            return
        if marker == _BEGIN:
            raise struct.error('a second beginning')
        if marker in _STANDALONE:
            continue
        length = struct.unpack_from('>H', jpeg, position)[0]
        start, end = position + 2, position + length
        if length < 2 or end > len(jpeg):
            raise struct.error('a segment that is longer than the rest')
        if marker == _SCAN:
            position, stuffed = _read_data(jpeg, end)
            yield _Segment(marker, start, end, position, stuffed)
        else:
            position = end
            yield _Segment(marker, start, end)
    raise JpegError('a picture without a size')


def _read_data(jpeg: bytes, start: int) -> tuple[int, int]:
    """
    Find the end of the data of a scan.

    :returns: where the marker behind them begins, and how many bytes are stuffed.
    :raises JpegError: there is no marker behind them.
    """
    data = np.frombuffer(jpeg, np.uint8)
    stuffed = 0
    for begin in range(start, len(data) - 1, _BLOCK):
        block = data[begin:begin + _BLOCK + 1]
        positions = np.flatnonzero(block[:-1] == 0xff)
        following = block[1:][positions]
        markers = np.flatnonzero(_ENDS_A_SCAN[following])
        if markers.size:
            stuffed += np.count_nonzero(following[:markers[0]] == 0)
            end = begin + int(positions[markers[0]])
            while end > start and jpeg[end - 1] == 0xff:  # filling before the marker
                end -= 1
            return end, stuffed
        stuffed += np.count_nonzero(following == 0)
    raise JpegError('a JPEG picture whose end is missing')


def _read_frame(marker: int, content: bytes) -> _Frame:
    _, height, width, count = struct.unpack_from('>BHHB', content)
    sampling = {}
    for number, both, _ in struct.iter_unpack('BBB', content[6:6 + 3 * count]):
        sampling[number] = both >> 4, both & 15
        if not (both >> 4 and both & 15):
            raise struct.error('a component without pixels')
    if len(sampling) != count or not (count and width and height):
        raise struct.error('no size')
    return _Frame(marker, width, height, sampling)


def _read_tables(content: bytes, shortest: dict[int, int]) -> None:
    """Find the fewest bits of a symbol with the number that follows it, for each table."""
    position = 0
    while position < len(content):
        table, *counts = struct.unpack_from('17B', content, position)
        position += 1 + _LENGTHS
        symbols = content[position:position + sum(counts)]
        if len(symbols) != sum(counts):
            raise struct.error('a table that breaks off')
        position += len(symbols)
        lengths = [length for length, count in enumerate(counts, 1) for _ in range(count)]
        shortest[table] = min(
            (length + (symbol & 15) for length, symbol in zip(lengths, symbols)), default=0)


def _read_scan(content: bytes, segment: _Segment, found: _Scans) -> None:
    """
    Take account of a scan.

    :raises JpegError: it is too short for its blocks.
    """
    count, = struct.unpack_from('B', content)
    selectors = [*struct.iter_unpack('BB', content[1:1 + 2 * count])]
    first, _, approximation = struct.unpack_from('BBB', content, 1 + 2 * count)
    if found.frame is None or not count or len(content) != 4 + 2 * count:
        raise struct.error('a scan without a frame')
    found.ends = segment.data_end
    found.seen.update(number for number, _ in selectors)
    has_ac = found.frame.marker in _SEQUENTIAL
    if not has_ac and (found.frame.marker != _PROGRESSIVE or first or approximation >> 4):
        return  # many blocks may share a bit
    bits = 0
    for number, tables in selectors:
        block = found.shortest.get(tables >> 4, 0)
        if has_ac:
            block += found.shortest.get(0x10 | tables & 15, 0)
        bits += _blocks(found.frame, number, count > 1) * block
    if 8 * (segment.data_end - segment.end - segment.stuffed) < bits:
        raise JpegError('a JPEG picture whose end is missing')


def _blocks(frame: _Frame, component: int, is_interleaved: bool) -> int:
    """Count the blocks of 8x8 that a scan has of a component."""
    across, down = frame.sampling[component]
    most_across = max(sampling[0] for sampling in frame.sampling.values())
    most_down = max(sampling[1] for sampling in frame.sampling.values())
    if is_interleaved:
        units = -(-frame.width // (8 * most_across)) * -(-frame.height // (8 * most_down))
        return units * across * down
    width, height = -(-frame.width * across // most_across), -(-frame.height * down // most_down)
    return -(-width // 8) * -(-height // 8)
