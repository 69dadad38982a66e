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

"""Checksums and metadata of FFV1, against the packets of FFmpeg."""

from __future__ import annotations

import av
import numpy as np
from opencv_tools.video.lossless import (
    describe_tags, has_no_sums, has_valid_sums, lossless_tags, tagged_encoding)
import pytest


def packet(height: int, width: int, slices: int, sums: int = 1) -> bytes:
    """Return a packet of noise from FFmpeg."""
    context = av.CodecContext.create('ffv1', 'w')
    context.width, context.height, context.pix_fmt = width, height, 'gray16le'
    context.framerate = context.time_base = 1
    context.options = {'level': '3', 'slices': str(slices), 'slicecrc': str(sums),
                       'strict': 'experimental'}
    image = np.random.default_rng(1).integers(0, 2**16, (height, width)).astype(np.uint16)
    frame = av.VideoFrame.from_ndarray(image, 'gray16le')
    frame.pts = 0
    found, = [*context.encode(frame), *context.encode(None)]
    return bytes(found)


@pytest.mark.parametrize(('height', 'width', 'slices'), [
    (1, 1, 1), (9, 31, 1), (64, 64, 4), (200, 64, 6), (64, 64, 16)])
def test_checksums_of_ffmpeg(height: int, width: int, slices: int) -> None:
    data = packet(height, width, slices)
    assert has_valid_sums(data) and not has_no_sums(data)
    places = {*range(30), *range(0, len(data), 1 + len(data) // 300), *range(-30, 0)}
    for place in places:
        place %= len(data)
        changed = bytes(byte ^ (index == place) << place % 8 for index, byte in enumerate(data))
        assert not (has_valid_sums(changed) or has_no_sums(changed)), place
    assert not any(has_valid_sums(data[:-count]) for count in range(1, min(50, len(data))))
    assert not has_valid_sums(b'\0' + data)


@pytest.mark.parametrize('data', [b'', bytes(7), b'\xff' * 100, packet(64, 64, 4, sums=0)])
def test_packets_without_valid_checksums(data: bytes) -> None:
    assert not has_valid_sums(data)


@pytest.mark.parametrize('slices', [1, 4])
def test_slices_without_checksums(slices: int) -> None:
    data = packet(64, 64, slices, sums=0)
    assert has_no_sums(data)
    assert not any(map(has_no_sums, (b'', bytes(2), data[1:], data[:-1], b'\xff' * 100)))


def test_checksums_with_another_first_value() -> None:
    try:
        data = packet(64, 64, 4, sums=2)
    except av.error.FFmpegError:
        pytest.skip('this FFmpeg has one kind of checksums only')
    assert has_valid_sums(data) and not has_valid_sums(data[:99] + b'\0' + data[100:])


def test_encodings_in_the_metadata() -> None:
    assert lossless_tags('16UC1') == {'encoding': '16UC1', 'depth_unit': 'mm'}
    assert lossless_tags('mono16') == {'encoding': 'mono16'}
    assert tagged_encoding({'ENCODING': 'mono16', 'DEPTH_UNIT': 'mm'}) == 'mono16'
    assert not any(map(describe_tags, (
        {}, lossless_tags('16UC1'), lossless_tags('mono16'), {'ENCODING': '16UC1'})))
    assert [tagged_encoding(tags) for tags in (
        {}, {'encoding': ''}, {'encoding': 'bgr8'}, {'comment': '16UC1'})] == [''] * 4


@pytest.mark.parametrize(('tags', 'sentence'), [
    ({'encoding': '32FC1'}, 'the encoding 32FC1, but is read as mono16'),
    ({'ENCODING': '16UC1', 'DEPTH_UNIT': 'm'}, 'the depth_unit m, but is read as 16UC1'),
    ({'encoding': 'mono16', 'depth_unit': 'mm'}, 'the depth_unit mm, but is read as mono16'),
    ({'encoding': 'x', 'depth_unit': 'm'},
     'the encoding x and the depth_unit m, but is read as mono16')])
def test_metadata_that_are_not_followed(tags: dict[str, str], sentence: str) -> None:
    assert describe_tags(tags) == sentence
