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

"""Messages with video: equal to those of the definitions, and safe against hostile bytes."""

from __future__ import annotations

from contextlib import suppress

from hypothesis import given, settings, strategies as st
import numpy as np
from opencv_tools.image.cdr import WireHeader
from opencv_tools.image.errors import CdrError
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import read_definition
from opencv_tools.video.messages import (
    cdr_to_video, COMPRESSED_VIDEO, FFMPEG_PACKET, video_to_cdr, VIDEO_TOPICS, WireVideo)
from opencv_tools.video.packet import VideoPacket
import pytest

HEADER = WireHeader(1_700_000_000, 999_999_999, 'eye')
PACKET = VideoPacket(codec='h265', data=b'\0\0\0\1abc', is_key=True, width=641, height=479)
VALUES = {
    FFMPEG_PACKET: {
        'header': {'stamp': {'sec': HEADER.sec, 'nanosec': HEADER.nanosec}, 'frame_id': 'eye'},
        'width': 641, 'height': 479, 'encoding': 'h265', 'pts': 2**40, 'flags': 1,
        'is_bigendian': False, 'data': PACKET.data},
    COMPRESSED_VIDEO: {
        'timestamp': {'sec': HEADER.sec, 'nanosec': HEADER.nanosec}, 'frame_id': 'eye',
        'data': PACKET.data, 'format': 'h265'},
}


@pytest.mark.parametrize('type_name', VIDEO_TOPICS)
def test_bytes_are_those_of_the_definition(type_name: str) -> None:
    codec = MessageCodec(read_definition(type_name))
    written = video_to_cdr(type_name, HEADER, PACKET, 2**40)
    assert written == codec.write(VALUES[type_name])
    found = cdr_to_video(type_name, written)
    assert (found.header, found.encoding, bytes(found.data)) == (HEADER, 'h265', PACKET.data)
    assert found.size == ((641, 479) if type_name == FFMPEG_PACKET else None)
    assert found.serialized is written


def test_key_frames_have_a_flag() -> None:
    codec = MessageCodec(read_definition(FFMPEG_PACKET))
    other = VideoPacket(codec='h264', data=b'x', is_key=False, width=2, height=2)
    assert [codec.read(video_to_cdr(FFMPEG_PACKET, HEADER, packet, 1))['flags']
            for packet in (PACKET, other)] == [1, 0]


@pytest.mark.parametrize(('encoding', 'codec'), [
    ('h264', 'h264'), ('H264', 'h264'), ('hevc', 'h265'), ('h265', 'h265'), ('av1', 'av1'),
    ('libx264', 'h264'), ('hevc_nvenc', 'h265'), ('h264_vaapi', 'h264'), ('libsvtav1', 'av1'),
    ('h264;yuv420p;bgr8;bgr8', 'h264'), (' hevc ;nv12;bgr8;bayer_rggb8', 'h265')])
def test_codec_of_the_names_of_other_publishers(encoding: str, codec: str) -> None:
    assert WireVideo(type_name=FFMPEG_PACKET, header=HEADER, encoding=encoding, data=b'',
                     serialized=b'').codec == codec


@pytest.mark.parametrize('encoding', ['', 'vp9', 'jpeg', ';h264', 'x' * 1000, '\x1b[31m'])
def test_unknown_codecs_are_refused_in_printable_words(encoding: str) -> None:
    found = WireVideo(type_name=FFMPEG_PACKET, header=HEADER, encoding=encoding, data=b'',
                      serialized=b'')
    with pytest.raises(CdrError, match='h264, h265 and av1 are decoded') as caught:
        _ = found.codec
    assert str(caught.value).isprintable() and len(str(caught.value)) < 200
    assert found.description.isprintable()


@pytest.mark.parametrize(('width', 'height'), [(-1, 5), (5, -1), (1 << 16, 5), (5, 2**31 - 1)])
def test_impossible_sizes_are_refused(width: int, height: int) -> None:
    codec = MessageCodec(read_definition(FFMPEG_PACKET))
    with pytest.raises(CdrError, match=f'{width}x{height} pixels'):
        cdr_to_video(FFMPEG_PACKET, codec.write(
            {**VALUES[FFMPEG_PACKET], 'width': width, 'height': height}))


any_content = given(st.sampled_from([*VIDEO_TOPICS]), st.binary(max_size=120), st.booleans())


def check_hostile_bytes(type_name: str, data: bytes, has_head: bool) -> None:
    with suppress(CdrError):
        found = cdr_to_video(type_name, b'\0\1\0\0' * has_head + data)
        assert len(found.data) <= len(data)
        assert found.description.isprintable()
        _ = found.codec


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [75, 300])
def test_hostile_bytes(examples: int) -> None:
    settings(max_examples=examples)(any_content(check_hostile_bytes))()


any_byte = given(st.sampled_from([*VIDEO_TOPICS]), st.integers(0, 60), st.integers(0, 255))


def check_damaged_messages(type_name: str, place: int, value: int) -> None:
    damaged = np.frombuffer(video_to_cdr(type_name, HEADER, PACKET, 1), np.uint8).copy()
    damaged[place % len(damaged)] = value
    with suppress(CdrError):
        assert len(cdr_to_video(type_name, damaged.tobytes()).data) < 100


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [50, 200])
def test_damaged_messages(examples: int) -> None:
    settings(max_examples=examples)(any_byte(check_damaged_messages))()
