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

"""Key frames, parameter sets and sizes of video packets."""

from __future__ import annotations

from contextlib import suppress
import io
from pathlib import Path

import av
from hypothesis import example, given, settings, strategies as st
import numpy as np
from opencv_tools.image.errors import VideoError
from opencv_tools.video.bit_stream import BitReader, nal_units, obu, obus, START_CODE, unescaped
from opencv_tools.video.decoder import VideoDecoder
from opencv_tools.video.packet import CODECS
from opencv_tools.video.parameter_sets import (
    h264_frame_number, has_parameter_sets, is_key_frame, length_prefixed_to_annexb,
    parameter_sets, picture_size, read_extradata, sequence_headers, webcodecs_name)
from opencv_tools.video.settings import VideoSettings
import pytest
from video_packets import DECODERS, encoded, every_codec, has_encoder, HERE, packets

SIZES = [(16, 16), (18, 34), (64, 48), (66, 50), (126, 98), (320, 240), (322, 242), (640, 360),
         (854, 480), (1280, 720), (1920, 1080), (4096, 64), (64, 4096), (1022, 66)]
# Options of an encoder and the codec string of its stream.
KNOWN = [
    ('libx264', {'profile': 'baseline', 'level': '3.1'}, 'yuv420p', 'avc1.42C01F'),
    ('libx264', {'profile': 'main', 'level': '4'}, 'yuv420p', 'avc1.4D4028'),
    ('libx264', {'profile': 'high', 'level': '5.1'}, 'yuv420p', 'avc1.640033'),
    ('libx264', {'profile': 'high10', 'level': '1.1'}, 'yuv420p10le', 'avc1.6E000B'),
    ('libx265', {'x265-params': 'log-level=none:level-idc=3.1'}, 'yuv420p', 'hev1.1.6.L93.90'),
    ('libx265', {'x265-params': 'log-level=none:level-idc=5.1:high-tier=0', 'profile': 'main10'},
     'yuv420p10le', 'hev1.2.4.L153.90'),
]
CODEC_OF = {'libx264': 'h264', 'libx265': 'h265'}


def real_size(codec: str, data: bytes) -> tuple[int, int]:
    """Return the size of the picture that FFmpeg decodes."""
    decoder = av.CodecContext.create(DECODERS[codec], 'r')
    decoder.options = {'flags': '+low_delay'}
    frame, = decoder.decode(av.Packet(data))
    return frame.width, frame.height


@pytest.mark.quick_cases(8)
@every_codec
@pytest.mark.parametrize('size', SIZES)
def test_sizes_equal_those_of_ffmpeg(codec: str, size: tuple[int, int]) -> None:
    packet, = encoded(VideoSettings(codec=codec), *size, 1)
    assert picture_size(codec, packet.data) == size == real_size(codec, packet.data)


@pytest.mark.parametrize('options', [
    {'profile': 'high444'}, {'profile': 'high422'}, {'x264-params': 'cqm=jvt'},
    {'x264-params': 'interlaced=1'}, {'x264-params': 'bframes=2'}, {'preset': 'placebo'}])
@pytest.mark.parametrize('size', [(48, 32), (62, 44), (322, 244)])
def test_sizes_of_other_h264_streams(options: dict[str, str], size: tuple[int, int]) -> None:
    pixels = {'high444': 'yuv444p', 'high422': 'yuv422p'}.get(
        options.get('profile', ''), 'yuv420p')
    encoder = av.CodecContext.create('libx264', 'w')
    encoder.width, encoder.height = size
    encoder.pix_fmt, encoder.options, encoder.framerate = pixels, options, 30
    encoder.time_base = 1 / encoder.framerate
    data = b''.join(bytes(packet) for frame in (av.VideoFrame(*size, pixels), None)
                    for packet in encoder.encode(frame))
    assert picture_size('h264', data) == size
    assert is_key_frame('h264', data) and has_parameter_sets('h264', data)
    assert next(sequence_headers('h264', data)).coded_width % 16 == 0


@pytest.mark.parametrize(('encoder_name', 'options', 'pixels', 'name'), [
    row for row in KNOWN if has_encoder(row[0])])
def test_known_webcodecs_names(
    encoder_name: str, options: dict[str, str], pixels: str, name: str, tmp_path: Path,
) -> None:
    file = tmp_path / 'stream'
    is_h265 = encoder_name == 'libx265'  # which the DASH writer of FFmpeg does not support
    with av.open(str(file), 'w', format='hevc' if is_h265 else 'dash') as output:
        stream = output.add_stream(encoder_name, rate=30, options=options)
        stream.width, stream.height, stream.pix_fmt = 160, 120, pixels
        for frame in (av.VideoFrame(160, 120, pixels), None):
            for packet in stream.encode(frame):
                output.mux(packet)
        extradata = stream.codec_context.extradata
    codec = CODEC_OF[encoder_name]
    sets, _ = read_extradata(codec, file.read_bytes() if is_h265 else extradata)
    assert webcodecs_name(codec, sets) == name
    assert is_h265 or f'codecs="{name}"'.lower() in file.read_text().lower()


@pytest.mark.skipif('h265' not in HERE, reason='this PyAV has no encoder for H.265')
def test_webcodecs_name_of_the_high_tier() -> None:
    sps = next(unit for unit in nal_units(packets('h265')[0].data) if unit[0] >> 1 == 33)
    high = START_CODE + sps[:3] + bytes((sps[3] | 0x20,)) + sps[4:]
    assert webcodecs_name('h265', high) == 'hev1.1.6.H93.90'


@every_codec
def test_webcodecs_names_of_own_packets(codec: str) -> None:
    names = {'h264': 'avc1.64001F', 'h265': 'hev1.1.6.L93.90'}
    key, following = packets(codec)[:2]
    assert webcodecs_name(codec, key.data) == names[codec]
    assert webcodecs_name(codec, following.data) is None
    assert picture_size(codec, following.data) is None


@every_codec
def test_parameter_sets_of_packets(codec: str) -> None:
    key, following = packets(codec)[:2]
    sets = parameter_sets(codec, key.data)
    assert has_parameter_sets(codec, sets) and not is_key_frame(codec, sets)
    assert parameter_sets(codec, sets) == sets
    assert picture_size(codec, sets) == (160, 120)
    assert parameter_sets(codec, following.data) == b''
    assert is_key_frame(codec, key.data) and not is_key_frame(codec, following.data)


def test_numbers_of_h264_pictures() -> None:
    sent = packets('h264')
    bits = next(sequence_headers('h264', sent[0].data)).frame_number_bits
    assert [h264_frame_number(packet.data, bits) for packet in sent] == [
        (number, True) for number in range(len(sent))]


@every_codec
@pytest.mark.parametrize('container', ['mp4', 'matroska'])
def test_packets_of_containers(codec: str, container: str) -> None:
    file, sent = io.BytesIO(), packets(codec)
    with av.open(file, 'w', format=container) as output:
        encoder = VideoSettings(codec=codec).encoder_name
        stream = output.add_stream(encoder, rate=30, options={
            'tune': 'zerolatency', 'x265-params': 'log-level=none'})
        stream.width, stream.height, stream.pix_fmt = 160, 120, 'yuv420p'
        for packet in stream.encode(av.VideoFrame(160, 120, 'yuv420p')):
            output.mux(packet)
        output.mux(stream.encode(None))
    with av.open(io.BytesIO(file.getvalue())) as opened:
        video = opened.streams.video[0]
        sets, length_size = read_extradata(codec, video.codec_context.extradata)
        data = next(bytes(packet) for packet in opened.demux(video) if packet.size)
    assert length_size == 4
    assert has_parameter_sets(codec, sets) and picture_size(codec, sets) == (160, 120)
    data = length_prefixed_to_annexb(data, length_size) if length_size else data
    assert is_key_frame(codec, data)
    data = data if has_parameter_sets(codec, data) else sets + data
    assert VideoDecoder(codec).decode(data).shape == (120, 160, 3)
    assert read_extradata(codec, sent[0].data) == (parameter_sets(codec, sent[0].data), 0)


@pytest.mark.parametrize('length_size', [1, 2, 4])
def test_lengths_of_packets(length_size: int) -> None:
    units = [unit for unit in nal_units(packets('h264')[0].data) if unit[0] & 31 in (7, 8)]
    prefixed = [len(unit).to_bytes(2, 'big') + unit for unit in units]
    avcc = (b'\1' + units[0][1:4] + bytes((0xfc | length_size - 1, 0xe1)) + prefixed[0]
            + b'\1' + prefixed[1])
    sets, found = read_extradata('h264', avcc)
    assert (sets, found) == (b''.join(START_CODE + unit for unit in units), length_size)
    small = [b'\x09\xf0', b'\x41' + bytes(range(1, 200))]
    data = b''.join(len(unit).to_bytes(length_size, 'big') + unit for unit in small)
    assert length_prefixed_to_annexb(data, found) == b''.join(
        START_CODE + unit for unit in small)


def test_bits_and_codes() -> None:
    reader = BitReader(bytes((0b1_010_011_0, 0b0100_0010, 0b1_0000000)))
    assert [reader.unsigned() for _ in range(4)] == [0, 1, 2, 3]
    assert reader.signed() == -2
    assert not reader.bits(7)
    with pytest.raises(VideoError, match='ends too early'):
        reader.flag()
    assert [BitReader(bytes((code,))).signed() for code in (0b10000000, 0b01000000, 0b01100000,
                                                            0b00100000)] == [0, 1, -1, 2]
    with pytest.raises(VideoError, match='more than 32 bits'):
        BitReader(bytes(100)).unsigned()
    assert unescaped(b'\0\0\3\0\0\3\1\0\3') == b'\0\0\0\0\1\0\3'


@given(st.lists(st.binary(min_size=1, max_size=300)))
def test_obus_round_trip(payloads: list[bytes]) -> None:
    data = b''.join(obu(6, payload) for payload in payloads)
    assert [*obus(data)] == [(6, payload) for payload in payloads]


def test_many_units_are_refused() -> None:
    with pytest.raises(VideoError, match='more than 10000 NAL units'):
        sum(1 for _ in nal_units(b'\0\0\1\x09' * 20000))
    with pytest.raises(VideoError, match='more than 10000 OBUs'):
        sum(1 for _ in obus(b'\x12\0' * 20000))
    with pytest.raises(VideoError, match="codec 'vp9' is unknown: give one of h264, h265, av1"):
        is_key_frame('vp9', b'')


def read_all(codec: str, data: bytes) -> None:
    """Call each reader; only a VideoError may come out."""
    for read in (is_key_frame, picture_size, webcodecs_name, has_parameter_sets, parameter_sets,
                 read_extradata):
        with suppress(VideoError):
            read(codec, data)
    for read_other in (lambda: length_prefixed_to_annexb(data, 4),
                       lambda: h264_frame_number(data, 9)):
        with suppress(VideoError):
            read_other()


@pytest.mark.parametrize('codec', CODECS)
@settings(max_examples=150, deadline=None)
@given(data=st.binary(max_size=200), start=st.sampled_from(
    (b'', START_CODE, START_CODE + b'\x67', START_CODE + b'\x42\1', b'\x0a', b'\x0a\x0b', b'\1')))
@example(data=b'', start=b'')
def test_random_bytes(codec: str, data: bytes, start: bytes) -> None:
    read_all(codec, start + data)


@every_codec
def test_damaged_headers(codec: str) -> None:
    data = packets(codec)[0].data[:200]
    rng = np.random.default_rng(1)
    for length in range(80):
        read_all(codec, data[:length])
    for _ in range(300):
        damaged = bytearray(data)
        for place in rng.integers(0, 80, 3):
            damaged[place] ^= 1 << int(rng.integers(8))
        read_all(codec, bytes(damaged))
