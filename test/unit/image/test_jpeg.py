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

"""Truncated JPEG: detected where the check is certain, and complete JPEG passes."""

from __future__ import annotations

from collections.abc import Sequence
import struct

import cv2
import numpy as np
from opencv_tools.image.errors import CodecError, JpegError
from opencv_tools.image.jpeg import (
    check_jpeg, jpeg_components, jpeg_segment, jpeg_size, with_extra_data)
from opencv_tools.image_codecs import decode_image
import pytest

BEGINS, ENDS = b'\xff\xd8', b'\xff\xd9'
NO_END = 'a JPEG picture whose end is missing'
NO_SIZE = 'a picture without a size'
DAMAGED = 'a JPEG picture that is damaged'
# The value that libjpeg writes for missing pixels.
FILLING = 128


def photo(height: int = 96, width: int = 128, channels: int = 3) -> np.ndarray:
    """Return an image with as much variation as a photo."""
    random = np.random.default_rng(5).integers(0, 256, (height, width, channels), np.uint8)
    blurred = cv2.GaussianBlur(random, (9, 9), 2)
    return blurred.reshape(random.shape[:2 if channels == 1 else 3])


def encoded(image: np.ndarray, *options: int) -> bytes:
    done, data = cv2.imencode('.jpg', image, options)
    assert done
    return data.tobytes()


def broken_off(jpeg: bytes, part: float) -> bytes:
    """Return a JPEG with a part of the data of its last scan, and with an end marker."""
    begin = jpeg.rfind(b'\xff\xda') + 14
    return jpeg[:begin + int(part * (len(jpeg) - begin))].rstrip(b'\xff') + ENDS


OPTIONS = {
    'baseline': (), 'optimized': (cv2.IMWRITE_JPEG_OPTIMIZE, 1),
    'restarts': (cv2.IMWRITE_JPEG_RST_INTERVAL, 4),
    'progressive': (cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
}


@pytest.mark.parametrize('kind', OPTIONS)
@pytest.mark.parametrize('image', [
    photo(), photo(channels=1), photo(17, 9), photo(1, 1), np.full((64, 64, 3), FILLING, np.uint8),
    np.full((33, 65), FILLING, np.uint8), np.zeros((480, 640, 3), np.uint8)],
    ids=['photo', 'mono', 'odd', 'one', 'gray', 'gray mono', 'black'])
def test_complete_jpeg_passes(image: np.ndarray, kind: str) -> None:
    jpeg = encoded(image, *OPTIONS[kind])
    assert jpeg_size(jpeg) == (image.shape[1], image.shape[0])
    assert jpeg_components(jpeg) == (1 if image.ndim == 2 else 3)
    assert jpeg[check_jpeg(jpeg):].startswith(ENDS)
    assert np.array_equal(decode_image(jpeg), cv2.imdecode(
        np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED))


@pytest.mark.parametrize('kind', ['baseline', 'optimized', 'restarts'])
@pytest.mark.parametrize('part', [0.0, 1 / 3, 0.97])
@pytest.mark.parametrize(('channels', 'upright'), [(1, True), (3, False)])
def test_truncated_scan_is_refused(kind: str, part: float, channels: int, upright: bool) -> None:
    jpeg = encoded(photo(channels=channels), *OPTIONS[kind])
    with pytest.raises(CodecError, match=r'whose end is missing$'):
        decode_image(broken_off(jpeg, part), upright)


def test_scan_truncated_at_any_restart_interval_is_refused() -> None:
    jpeg = encoded(photo(), *OPTIONS['restarts'])
    begin = jpeg.rfind(b'\xff\xda')
    ends = [place for place in range(begin, len(jpeg) - 2)
            if jpeg[place] == 0xff and 0xd0 <= jpeg[place + 1] <= 0xd7]
    assert len(ends) > 8
    for place in ends:
        for data in (jpeg[:place] + ENDS, jpeg[:place + 2] + ENDS):
            with pytest.raises(CodecError, match=r'whose end is missing$'):
                decode_image(data)


@pytest.mark.parametrize('kind', ['baseline', 'optimized', 'restarts', 'progressive'])
def test_scan_with_too_few_bits_is_refused_before_decoding(kind: str) -> None:
    jpeg = encoded(photo(480, 640), *OPTIONS[kind])
    begin = jpeg.find(b'\xff\xda') + 14
    with pytest.raises(JpegError, match=r'whose end is missing$'):
        check_jpeg(jpeg[:begin] + bytes(20) + ENDS)


def test_component_without_a_scan_is_refused() -> None:
    jpeg = encoded(photo())
    first = jpeg.find(b'\xff\xda')
    one = jpeg[:first] + b'\xff\xda\0\x08\1\1\0\0\x3f\0' + jpeg[first + 14:]
    with pytest.raises(JpegError, match=r'whose end is missing$'):
        check_jpeg(one)


@pytest.mark.parametrize(('old', 'new'), [
    (b'\xff\xc0\0\x11', b'\xff\xc0\0\x10'), (b'\xff\xda\0\x0c', b'\xff\xda\0\x0e'),
    (b'\xff\xda\0\x0c\3', b'\xff\xda\0\x0c\2'), (b'\xff\xc4\0\x1f', b'\xff\xc4\0\x18'),
    (b'\xff\xda\0\x0c\3\1', b'\xff\xda\0\x0c\3\7'), (b'\xff\xda', b'\xff\xd8')])
def test_damaged_segments_are_refused(old: bytes, new: bytes) -> None:
    jpeg = encoded(photo())
    check_jpeg(jpeg)
    damaged = jpeg.replace(old, new, 1)
    assert damaged != jpeg
    with pytest.raises(JpegError):
        check_jpeg(damaged)


def test_bytes_before_a_marker_are_skipped_like_libjpeg() -> None:
    jpeg = encoded(photo())
    padded = jpeg[:2] + b'\xff\xff\xff' + jpeg[2:-2] + b'\xff\xff' + ENDS
    assert jpeg_size(padded) == (128, 96)
    assert np.array_equal(decode_image(padded), decode_image(jpeg))


def segment(marker: int, content: bytes = b'') -> bytes:
    return struct.pack('>BBH', 0xff, marker, 2 + len(content)) + content


def frame(*sampling: int, size: tuple[int, int] = (8, 8), marker: int = 0xc0) -> bytes:
    """Return a frame header; its components are numbered from 1."""
    return segment(marker, struct.pack('>BHHB', 8, size[1], size[0], len(sampling)) + b''.join(
        bytes((number, both, 0)) for number, both in enumerate(sampling, 1)))


def table(number: int, *codes: tuple[int, int]) -> bytes:
    """Return the content of a segment of tables from the bits and the symbol of each code."""
    counts = [sum(bits == length for bits, _ in codes) for length in range(1, 17)]
    return bytes((number, *counts, *(symbol for _, symbol in codes)))


def scan(*components: int, data: bytes = b'', tables: int = 0, first: int = 0,
         approximation: int = 0) -> bytes:
    selectors = [value for number in components for value in (number, tables)]
    return segment(0xda, bytes((len(components), *selectors, first, 63, approximation))) + data


def jpeg_of(*parts: bytes) -> bytes:
    return b''.join((BEGINS, *parts, ENDS))


def error_of(jpeg: bytes) -> str:
    with pytest.raises(JpegError) as caught:
        check_jpeg(jpeg)
    return str(caught.value)


def size_error_of(jpeg: bytes) -> str:
    with pytest.raises(JpegError) as caught:
        jpeg_size(jpeg)
    return str(caught.value)


# With this table, each block of a sequential scan has at least one byte.
BYTE_CODE = segment(0xc4, table(0, (8, 0)))


def check_least(data_bytes: int, *before: bytes, **options: int) -> None:
    """Check the number of bytes that a scan of the only component needs."""
    complete = jpeg_of(*before, scan(1, data=bytes(data_bytes), **options))
    assert check_jpeg(complete) == len(complete) - 2
    assert error_of(
        jpeg_of(*before, scan(1, data=bytes(data_bytes - 1), **options))) == NO_END


@pytest.mark.parametrize(('size', 'sampling', 'scans'), [
    ((16, 8), [0x11], {(1,): 2}), ((17, 9), [0x11], {(1,): 6}), ((17, 9), [0x22], {(1,): 6}),
    ((17, 9), [0x22, 0x11, 0x11], {(1, 2, 3): 12}),
    ((33, 16), [0x22, 0x11, 0x11], {(1, 2, 3): 18}),
    ((33, 17), [0x22, 0x11, 0x11], {(1,): 15, (2,): 6, (3,): 6}),
    ((17, 9), [0x22, 0x11, 0x11], {(1,): 6, (2, 3): 4}),
    ((33, 72), [0x21, 0x11], {(1,): 45, (2,): 27}),
    ((72, 33), [0x12, 0x11], {(1,): 45, (2,): 27}),
    ((25, 8), [0x31, 0x21], {(1,): 4, (2,): 3}), ((25, 8), [0x31, 0x21], {(1, 2): 10}),
    ((8, 25), [0x13, 0x12], {(1,): 4, (2,): 3}), ((8, 25), [0x13, 0x12], {(1, 2): 10})])
def test_number_of_blocks_in_scans(
        size: tuple[int, int], sampling: Sequence[int],
        scans: dict[tuple[int, ...], int]) -> None:
    """In T.81, A.2: whole units in interleaved scans, otherwise blocks with pixels."""
    def with_lengths(lengths: dict[tuple[int, ...], int]) -> bytes:
        return jpeg_of(frame(*sampling, size=size), BYTE_CODE, *(
            scan(*components, data=bytes(length)) for components, length in lengths.items()))

    jpeg = with_lengths(scans)
    assert check_jpeg(jpeg) == len(jpeg) - 2
    for components, blocks in scans.items():
        assert error_of(with_lengths({**scans, components: blocks - 1})) == NO_END


@pytest.mark.parametrize(('tables', 'least'), [
    (table(0, (8, 0)), 1), (table(0, (1, 0)), 1), (table(0, (9, 0)), 2), (table(0, (16, 1)), 3),
    (table(0, (3, 5)), 1), (table(0, (3, 6)), 2), (table(0, (1, 0xff)), 2),
    (table(0, (2, 15), (9, 0)), 2), (table(0, (1, 8), (8, 0)), 1),
    (table(0x10, (8, 0)), 1), (table(0x10, (9, 0x70)), 2),
    (table(0, (4, 0)) + table(0x10, (4, 0)), 1), (table(0, (4, 0)) + table(0x10, (4, 1)), 2),
    (table(0, (9, 0)) + table(0, (8, 0)), 1), (table(1, (16, 15)) + table(0, (8, 0)), 1),
    (table(0x11, (16, 15)) + table(0, (8, 0)), 1)])
def test_fewest_bits_of_a_block(tables: bytes, least: int) -> None:
    check_least(least, frame(0x11), segment(0xc4, tables))


def test_tables_of_a_scan() -> None:
    tables = segment(0xc4, table(0x02, (9, 0)) + table(0x13, (16, 0)) + table(0x03, (1, 0)))
    check_least(4, frame(0x11), tables, tables=0x23)
    check_least(1, frame(0x11), tables, tables=0x30)


def test_scan_that_needs_no_bits() -> None:
    for tables in (b'', segment(0xc4, table(0) + table(0x10))):
        jpeg = jpeg_of(frame(0x11), tables, scan(1))
        assert check_jpeg(jpeg) == len(jpeg) - 2


@pytest.mark.parametrize(('marker', 'options', 'least'), [
    (0xc0, {}, 3), (0xc1, {}, 3), (0xc0, {'first': 1}, 3), (0xc0, {'approximation': 0x10}, 3),
    (0xc2, {}, 1), (0xc2, {'approximation': 0x01}, 1), (0xc2, {'approximation': 0x0f}, 1),
    (0xc2, {'approximation': 0x10}, 0), (0xc2, {'first': 1}, 0), (0xc3, {}, 0), (0xc9, {}, 0)])
def test_scans_whose_bits_are_counted(marker: int, options: dict[str, int], least: int) -> None:
    before = frame(0x11, marker=marker), segment(0xc4, table(0, (8, 0)) + table(0x10, (16, 0)))
    if least:
        check_least(least, *before, **options)
    else:
        check_jpeg(jpeg_of(*before, scan(1, **options)))


def test_stuffed_zeros_and_fill_bytes_are_no_data() -> None:
    before = frame(0x11, size=(24, 8)), BYTE_CODE
    for data in (b'abc', b'\xff\0\xff\0\xff\0', b'a\xff\xd0', b'a\xff\xd7'):
        jpeg = jpeg_of(*before, scan(1, data=data + b'\xff\xff'))
        assert jpeg[check_jpeg(jpeg):] == b'\xff\xff' + ENDS
    for data in (b'ab\xff', b'ab\xff\xff\xff', b'a\xff\0'):
        assert error_of(jpeg_of(*before, scan(1, data=data))) == NO_END


def test_fill_bytes_of_a_scan_without_data() -> None:
    head = jpeg_of(frame(0x11), scan(1, approximation=0xff))[:-2]
    assert check_jpeg(head + b'\xff\xff\xff' + ENDS) == len(head)


def test_stuffed_zero_at_any_place_of_a_long_scan() -> None:
    blocks = 64 * 1025
    before = frame(0x11, size=(8 * 64, 8 * 1025)), BYTE_CODE
    for place in range(65_532, 65_540):
        data = bytes(place) + b'\xff\0' + bytes(blocks - place - 1)
        jpeg = jpeg_of(*before, scan(1, data=data))
        assert check_jpeg(jpeg) == len(jpeg) - 2
        assert error_of(jpeg_of(*before, scan(1, data=data[1:]))) == NO_END


def test_marker_at_any_place_of_a_long_scan() -> None:
    for length in range(65_532, 65_540):
        jpeg = jpeg_of(frame(0x11), scan(1, data=bytes(length)))
        assert check_jpeg(jpeg) == len(jpeg) - 2
        assert error_of(jpeg[:-1]) == NO_END


@pytest.mark.parametrize(('parts', 'message'), [
    ((), NO_SIZE), ((BYTE_CODE,), NO_SIZE), ((scan(1),), DAMAGED),
    ((frame(0x11),), 'a JPEG picture without pixels'),
    ((frame(0x11, 0x11), scan(1)), NO_END), ((frame(0x11, 0x11), scan(2), scan(2)), NO_END),
    ((frame(0x11), scan(2)), DAMAGED), ((frame(0x11), scan()), DAMAGED),
    ((frame(0x11), BEGINS + b'\0\2', scan(1)), DAMAGED),
    ((frame(0x11), scan(1, data=b'a' + BEGINS)), DAMAGED),
    ((frame(0x11), segment(0xda)), DAMAGED),
    ((frame(0x11), segment(0xda, b'\1\1\0\0\0')), DAMAGED),
    ((frame(0x11), segment(0xda, b'\1\1\0\0\0\0\0')), DAMAGED),
    ((frame(0x11), segment(0xc4, table(0, (8, 0))[:-1]), scan(1)), DAMAGED),
    ((frame(0x11), segment(0xc4, bytes(16)), scan(1)), DAMAGED)])
def test_contradictions_in_segments(parts: Sequence[bytes], message: str) -> None:
    assert error_of(jpeg_of(*parts)) == message


def test_missing_end() -> None:
    complete = jpeg_of(frame(0x11), scan(1, data=b'abc'))
    check_jpeg(complete)
    many_restarts = BEGINS + frame(0x11) + scan(1, data=2000 * b'\xff\xd0')
    for data in (complete[:-2], complete[:-1], BEGINS, BEGINS + frame(0x11), many_restarts):
        assert error_of(data) == NO_END


@pytest.mark.parametrize('header', [
    frame(0x10), frame(0x01), frame(0x00), frame(0x11, 0x20, 0x11), frame(),
    frame(0x11, size=(0, 8)), frame(0x11, size=(8, 0)),
    segment(0xc0, b'\x08\0\x08\0\x08\2\1\x11\0\1\x11\0'),
    segment(0xc0, b'\x08\0\x08\0\x08\2\1\x11\0'), segment(0xc0, b'\x08\0\x08\0\x08\1\1\x11'),
    segment(0xc0, b'\x08\0\x08\0\x08\1\1\x11\0\2\x11\0'), segment(0xc0, b'\x08\0\x08\0\x08')])
def test_frame_header_without_pixels(header: bytes) -> None:
    assert size_error_of(jpeg_of(header)) == NO_SIZE
    assert error_of(jpeg_of(header, scan(1))) == DAMAGED


def test_size_and_components_of_all_kinds_of_frames() -> None:
    other = set(range(0xc0, 0xd0)) - {0xc4, 0xc8, 0xcc}
    for marker in range(0xc0, 0xd0):
        header = frame(0x11, 0x41, 0x14, 0xff, size=(0x1234, 0xfedc), marker=marker)
        if marker in other:
            assert jpeg_size(BEGINS + header) == (0x1234, 0xfedc)
            assert jpeg_components(BEGINS + header) == 4
        else:
            assert jpeg_size(BEGINS + header + frame(0x11, size=(1, 65_535))) == (1, 65_535)


def test_markers_before_the_size() -> None:
    header = frame(0x11, size=(3, 2))
    for before in (b'\xff\x01', b'\xff\xd0', b'\xff\xd7', b'rubbish\0\xff\0', segment(0xfe),
                   segment(0xfe, header), b'\xff\xff' + segment(0xc8, b'a')):
        assert jpeg_size(BEGINS + before + header) == (3, 2)
    for before in (b'\xff\xfe\0\0', b'\xff\xfe\0\1', b'\xff\xfe\0', b'\xff\x02',
                   BEGINS + b'\0\2'):
        assert size_error_of(BEGINS + before + header) == NO_SIZE
    assert size_error_of(BEGINS + header[:-1]) == NO_SIZE
    assert size_error_of(jpeg_of(ENDS, header)) == NO_SIZE


def test_largest_number_of_markers() -> None:
    header = frame(0x11, size=(3, 2))
    assert jpeg_size(BEGINS + 999 * segment(0xfe) + header) == (3, 2)
    assert size_error_of(BEGINS + 1000 * segment(0xfe) + header) == NO_SIZE
    check_jpeg(jpeg_of(header, 1997 * segment(0xfe), scan(1)))
    assert error_of(jpeg_of(header, 1998 * segment(0xfe), scan(1))) == NO_SIZE


def test_content_of_a_segment() -> None:
    jpeg = jpeg_of(segment(0xe0, b'ABx'), segment(0xe1, b'A'), segment(0xe1, b'ABfirst'),
                   segment(0xe1, b'ABsecond'), segment(0xe1, b'C'), scan(1, data=b'data'),
                   segment(0xe1, b'late'))
    assert jpeg_segment(jpeg, 0xe1, b'AB') == b'first'
    assert jpeg_segment(jpeg, 0xe0, b'AB') == b'x'
    assert jpeg_segment(jpeg, 0xe1, b'ABs') == b'econd'
    for marker, prefix in ((0xe1, b'late'), (0xe2, b''), (0xe1, b'C\xff'), (0xe1, b'ABsecond2')):
        assert jpeg_segment(jpeg, marker, prefix) == b''
    assert jpeg_segment(b'\xff\xd7' + jpeg[2:], 0xe1, b'AB') == b''
    assert jpeg_segment(jpeg[:20], 0xe2, b'') == jpeg_segment(BEGINS, 0xe2, b'') == b''


@pytest.mark.parametrize(('restarts', 'following'), [
    ([], 0xd0), ([0], 0xd1), ([0, 1, 2], 0xd3), ([7, 0, 1], 0xd2), ([5, 6, 7], 0xd0)])
def test_restart_in_extra_data(restarts: Sequence[int], following: int) -> None:
    head = BEGINS + b''.join(bytes((65, 0xff, 0xd0 + number)) for number in restarts) + b'a'
    rest = b'\xff\xd4' + ENDS
    found = with_extra_data(head + rest, len(head))
    assert found.startswith(head)
    assert found.endswith(rest)
    before, _, after = found[len(head):-len(rest)].partition(b'\xff')
    assert after[0] == following
    assert before == after[1:]
    assert len(set(before)) > 200
    assert 0xff not in before
