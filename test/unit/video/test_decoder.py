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

"""Decoder of video packets."""

from __future__ import annotations

import base64
from fractions import Fraction
from io import BytesIO
import json
from pathlib import Path
import subprocess
import sys

import av
from conftest import PRINT_PEAK_MEMORY
from hypothesis import given, settings, strategies as st
import numpy as np
from opencv_tools.image.errors import KeyFrameNeeded, VideoError
from opencv_tools.video import pixels
from opencv_tools.video.bit_stream import obu
from opencv_tools.video.decoder import VideoDecoder
from opencv_tools.video.packet import CODECS
from opencv_tools.video.parameter_sets import (
    is_key_frame, parameter_sets, picture_size, webcodecs_name)
from opencv_tools.video.pixels import to_bgr
from opencv_tools.video.settings import VideoSettings
import pytest
from video_packets import draw, encoded, every_codec, packets
from waiting import LONGEST_SECONDS

AV1 = Path(__file__).parents[2] / 'data' / 'av1_160x120.json'
# An SPS of H.264 with 16384x16384 pixels: Baseline, level 6.2, width and height ue(1023) + 1.
HUGE_SPS = bytes.fromhex('0000000167 42c03e') + int(
    '1' '1' '011' '010' '0' + 2 * ('0' * 10 + '10000000000') + '1' '1' '0' '0' '1', 2
).to_bytes(7, 'big')


@every_codec
@pytest.mark.parametrize('size', [(320, 240), (65, 47)])
def test_pictures_are_alike(codec: str, size: tuple[int, int]) -> None:
    decoder = VideoDecoder(codec)
    for number, packet in enumerate(encoded(VideoSettings(codec=codec), *size, 8)):
        image = decoder.decode(packet.data, size)
        assert image.flags.c_contiguous and image.dtype == np.uint8
        assert np.abs(image.astype(int) - draw(*size, number)).mean() < 4


@pytest.mark.parametrize(('codec', 'name'), [('h264', 'h264'), ('h265', 'hevc')])
@pytest.mark.parametrize('left', [2, 16, 34, 100])
def test_picture_that_is_cropped_at_the_left(codec: str, name: str, left: int) -> None:
    bitstream = pytest.importorskip('av.bitstream', reason='PyAV 12 has no such module')
    data = packets(codec)[0].data
    with av.open(BytesIO(data), format=name) as container:
        crop = bitstream.BitStreamFilterContext(
            f'{name}_metadata=crop_left={left}', container.streams[0])
        data, = (bytes(packet) for given in container.demux() if given.size
                 for packet in crop.filter(given))
    whole = VideoDecoder(codec).decode(packets(codec)[0].data)
    image = VideoDecoder(codec).decode(data, (160 - left, 120))
    assert np.abs(image.astype(int) - whole[:, left:]).mean() < 1


@every_codec
def test_key_frame_is_needed(codec: str) -> None:
    key, *others = (packet.data for packet in packets(codec))
    decoder = VideoDecoder(codec)
    for packet in others:
        with pytest.raises(KeyFrameNeeded, match='wait for a key frame'):
            decoder.decode(packet)
    for packet in (key, *others):
        decoder.decode(packet)
    with pytest.raises(VideoError):
        decoder.decode(b'')
    with pytest.raises(KeyFrameNeeded):
        decoder.decode(others[0])
    for packet in (key, *others):
        decoder.decode(packet)


@pytest.mark.parametrize('codec', ['h264', pytest.param('h265', marks=pytest.mark.skipif(
    av.library_versions['libavcodec'] < (62,), reason='this FFmpeg shows a picture anyway'))])
def test_lost_packet_is_found(codec: str) -> None:
    sent = [packet.data for packet in packets(codec)]
    decoder = VideoDecoder(codec)
    decoder.decode(sent[0])
    decoder.decode(sent[1])
    with pytest.raises(VideoError):
        decoder.decode(sent[4])
    with pytest.raises(KeyFrameNeeded):
        decoder.decode(sent[5])
    decoder.decode(sent[0])


def test_key_frame_without_parameter_sets() -> None:
    data = packets('h264')[0].data
    decoder = VideoDecoder('h264')
    with pytest.raises(KeyFrameNeeded, match='has no parameter sets'):
        decoder.decode(data[data.rindex(b'\0\0\1\x65'):])
    expected = decoder.decode(data)
    for _ in range(2):
        assert np.array_equal(decoder.decode(data[data.rindex(b'\0\0\1\x65'):]), expected)
        with pytest.raises(VideoError):
            decoder.decode(b'')


@every_codec
def test_size_of_the_stream_may_change(codec: str) -> None:
    decoder = VideoDecoder(codec)
    for size in ((160, 120), (64, 64), (320, 240)):
        for packet in packets(codec, *size):
            assert decoder.decode(packet.data).shape == (size[1], size[0], 3)


@every_codec
def test_announced_size_is_compared(codec: str) -> None:
    decoder = VideoDecoder(codec)
    data = packets(codec)[0].data
    assert decoder.decode(data, (159, 119)).shape == (119, 159, 3)
    for size in ((158, 120), (161, 120), (160, 121), (0, 0)):
        with pytest.raises(VideoError, match=f'160x120 pixels, but {size[0]}x{size[1]} are'):
            decoder.decode(data, size)


@every_codec
def test_max_pixels(codec: str) -> None:
    data = packets(codec)[0].data
    assert VideoDecoder(codec, 160 * 120).decode(data).shape == (120, 160, 3)
    with pytest.raises(VideoError, match='160x120 pixels are more than max_pixels=19199'):
        VideoDecoder(codec, 160 * 120 - 1).decode(data)


@pytest.mark.process
def test_huge_picture_takes_no_memory() -> None:
    script = (
        'import sys\n'
        'from opencv_tools.image.errors import VideoError\n'
        'from opencv_tools.video.decoder import VideoDecoder\n'
        'data = bytes.fromhex(sys.argv[1])\n'
        'try: VideoDecoder("h264", 2**26).decode(data)\n'
        'except VideoError as err: print(err)\n' + PRINT_PEAK_MEMORY)
    data = HUGE_SPS + bytes.fromhex('0000000168ce3c80 00000001658884') + bytes(range(1, 200))
    finished = subprocess.run([sys.executable, '-c', script, data.hex()], capture_output=True,
                              text=True, timeout=LONGEST_SECONDS, check=True)
    error, peak = finished.stdout.splitlines()
    assert error == ('a h264 packet is too large: 16384x16384 pixels are more than '
                     'max_pixels=35651584')
    assert int(peak) < 250_000


def test_picture_of_another_size_is_not_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    decoder = VideoDecoder('h264')
    monkeypatch.setattr(decoder, '_decode', lambda data: pytest.fail('it was decoded'))
    with pytest.raises(VideoError, match='160x120 pixels, but 80x60 are announced'):
        decoder.decode(packets('h264')[0].data, (80, 60))


def test_sizes_after_the_picture_are_checked() -> None:
    data = packets('h264')[0].data + HUGE_SPS
    with pytest.raises(VideoError, match='16384x16384 pixels are more than'):
        VideoDecoder('h264').decode(data)


def test_damaged_picture_is_not_converted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pixels, 'to_bgr', lambda frame: pytest.fail('it was converted'))
    data = packets('h264')[0].data
    with pytest.raises(VideoError, match='bytes of h264 are damaged'):
        VideoDecoder('h264').decode(data[:-len(data) // 4])


def test_many_frames_of_av1_are_refused() -> None:
    with pytest.raises(VideoError, match='more than 16 frames'):
        VideoDecoder('av1').decode(obu(6, b'\x10') * 17)


@pytest.mark.parametrize('codec', CODECS)
@settings(max_examples=60, deadline=None)
@given(data=st.binary(max_size=300))
def test_random_bytes(codec: str, data: bytes) -> None:
    with pytest.raises(VideoError):
        VideoDecoder(codec).decode(data)


@every_codec
def test_errors_of_ffmpeg_without_their_numbers(codec: str) -> None:
    data, errors = next(iter(packets(codec))).data, []
    for place in range(80):
        damaged = bytearray(data)
        damaged[place] ^= 0xff
        try:
            VideoDecoder(codec).decode(bytes(damaged))
        except VideoError as err:
            errors.append(str(err))
    assert any('cannot be decoded: Invalid data found' in error for error in errors)
    assert not [error for error in errors if 'Errno' in error]


@every_codec
def test_damaged_packets(codec: str) -> None:
    sent = [packet.data for packet in packets(codec)]
    rng = np.random.default_rng(2)
    decoder = VideoDecoder(codec, 2 ** 20)
    failed = 0
    for _ in range(60):
        for number, packet in enumerate(sent):
            data = bytearray(packet)
            if rng.integers(3) == 0:
                del data[int(rng.integers(len(data))):]
            for place in rng.integers(0, len(data), 3) if data else ():
                data[place] ^= int(rng.integers(1, 256)) if rng.integers(2) else 0
            try:
                image = decoder.decode(bytes(data) if number or rng.integers(4) else packet)
                assert image.size <= 3 * 2 ** 21
            except VideoError:
                failed += 1
        decoder.decode(sent[0])
    assert failed > 60


MATRICES = {1: (0.2126, 0.0722), 2: (0.299, 0.114), 5: (0.299, 0.114), 6: (0.299, 0.114),
            9: (0.2627, 0.0593)}


@pytest.mark.parametrize('space', MATRICES)
@pytest.mark.parametrize('is_full', [False, True])
@pytest.mark.parametrize('name', ['yuv420p', 'yuvj420p', 'yuv422p', 'yuv444p', 'yuv420p10le',
                                  'yuv422p10le', 'nv12', 'gray'])
def test_matrix_and_range(space: int, is_full: bool, name: str) -> None:
    if name.startswith('yuvj') and not is_full:
        pytest.skip('the format is full range')
    blue, green, red = (120, 120, 120) if name == 'gray' else (40, 90, 150)
    red_weight, blue_weight = MATRICES[space]
    luma = red_weight * red + blue_weight * blue + (1 - red_weight - blue_weight) * green
    chroma = (blue - luma) / (2 - 2 * blue_weight), (red - luma) / (2 - 2 * red_weight)
    values = ([luma, *(128 + one for one in chroma)] if is_full else
              [16 + luma * 219 / 255, *(128 + one * 224 / 255 for one in chroma)])
    planes = [np.full((64, 64), round(values[0]), np.uint8)]
    planes += [np.full((32, 32), round(one), np.uint8) for one in values[1:]]
    frame = av.VideoFrame.from_ndarray(
        np.concatenate([plane.reshape(-1) for plane in planes]).reshape(96, 64), 'yuv420p')
    if name == 'gray':
        frame = av.VideoFrame.from_ndarray(planes[0], 'gray')
    elif name != 'yuvj420p':
        frame = frame.reformat(format=name)
    else:
        frame = av.VideoFrame.from_ndarray(
            np.concatenate([plane.reshape(-1) for plane in planes]).reshape(96, 64), name)
    frame.colorspace, frame.color_range = space, 2 if is_full else 1
    image = to_bgr(frame)
    assert image.shape == (64, 64, 3)
    assert np.abs(image.astype(int) - (blue, green, red)).max() <= 3


@pytest.mark.parametrize(('name', 'size'), [('yuv420p', (33, 17)), ('yuv444p', (33, 17)),
                                            ('yuv422p', (17, 33)), ('gbrp', (16, 16))])
def test_planes_of_odd_sizes(name: str, size: tuple[int, int]) -> None:
    image = np.full((size[1], size[0], 3), (40, 90, 150), np.uint8)
    frame = av.VideoFrame(*size, name)
    # BT.601 in limited range, and the planes G, B and R
    for plane, value in zip(frame.planes, (90, 40, 150) if name == 'gbrp' else (104, 97, 158)):
        plane.update(bytes((value,)) * plane.buffer_size)
    shown = to_bgr(frame)
    assert shown.shape == image.shape and np.abs(shown.astype(int) - image).max() <= 4


def test_frame_with_invalid_colours_is_refused() -> None:
    encoder = av.CodecContext.create('libx264', 'w')
    encoder.width, encoder.height, encoder.pix_fmt = 64, 64, 'yuv420p10le'
    encoder.framerate, encoder.options = 30, {
        'tune': 'zerolatency', 'colorspace': 'ycgco', 'color_trc': 'smpte2084'}
    encoder.time_base = 1 / encoder.framerate
    frame = av.VideoFrame(64, 64, 'yuv420p10le')
    for plane in frame.planes:  # x264 crashes at samples of more than 10 bits in new memory
        plane.update(bytes(plane.buffer_size))
    packet, = encoder.encode(frame)
    try:
        assert VideoDecoder('h264').decode(bytes(packet)).shape == (64, 64, 3)
    except VideoError as err:
        assert 'cannot be decoded' in str(err)


def test_video_of_av1() -> None:
    sent = [base64.b64decode(text) for text in json.loads(AV1.read_text())]
    assert [is_key_frame('av1', data) for data in sent] == [True, *5 * [False]]
    assert picture_size('av1', sent[0]) == (160, 120)
    assert webcodecs_name('av1', sent[0]) == 'av01.0.00M.08'
    assert parameter_sets('av1', sent[0]) and not parameter_sets('av1', sent[1])
    decoder = VideoDecoder('av1')
    with pytest.raises(KeyFrameNeeded):
        decoder.decode(sent[1])
    for number, data in enumerate(sent):
        error = decoder.decode(data).astype(int) - draw(160, 120, number)
        assert abs(error).mean() < 4
    with pytest.raises(VideoError, match='160x120'):
        VideoDecoder('av1', 160 * 120 - 1).decode(sent[0])


@pytest.mark.parametrize(('encoder', 'parameters', 'codec'), [
    ('libx264', 'x264-params', 'h264'), ('libx265', 'x265-params', 'h265')])
@pytest.mark.parametrize('count', [1, 2, 5])
def test_reordered_pictures_are_refused_with_their_reason(
        encoder: str, parameters: str, codec: str, count: int) -> None:
    context = av.CodecContext.create(encoder, 'w')
    context.width, context.height, context.pix_fmt = 160, 120, 'yuv420p'
    context.options = {parameters: f'bframes={count}:b-adapt=0:keyint=8:log-level=none'}
    context.framerate, context.time_base = 30, Fraction(1, 30)
    frames = [av.VideoFrame(160, 120, 'yuv420p') for _ in range(16)]
    for number, frame in enumerate(frames):
        frame.pts = number
    sent = [bytes(packet) for frame in (*frames, None) for packet in context.encode(frame)]
    decoder, reasons = VideoDecoder(codec), []
    for data in sent:
        try:
            decoder.decode(data)
        except KeyFrameNeeded:
            pass
        except VideoError as err:
            reasons.append(str(err))
    assert len(reasons) >= 2  # one for each key frame
    assert all('reorders pictures (B frames)' in reason for reason in reasons)
