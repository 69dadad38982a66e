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

"""Encoder of video packets."""

from __future__ import annotations

import av
from av.video.frame import PictureType
import numpy as np
from opencv_tools.image.encodings import ENCODINGS
from opencv_tools.image.errors import EncodingError, VideoError
from opencv_tools.video.bit_stream import nal_units, START_CODE
from opencv_tools.video.decoder import VideoDecoder
from opencv_tools.video.encoder import VideoEncoder
from opencv_tools.video.parameter_sets import (
    has_parameter_sets, is_key_frame, parameter_sets, picture_size)
from opencv_tools.video.settings import VideoSettings
import pytest
from video_packets import DECODERS, draw, encoded, every_codec, has_encoder, packets, PERIOD_NS

SETTINGS = [VideoSettings(codec=codec, **more) for codec, more in (
    ('h264', {}), ('h264', {'preset': 'ultrafast', 'quality': 35}), ('libx264', {}),
    ('h264', {'bit_rate': 400_000}), ('h264', {'preset': 'veryfast', 'quality': 0}),
    ('h265', {}), ('h265', {'bit_rate': 400_000}), ('h265', {'preset': 'ultrafast'}))]
SETTINGS = [one for one in SETTINGS if has_encoder(one.encoder_name)]
# Encodings that have a video.
SUITABLE = {'bgr8', 'rgb8', 'bgra8', 'rgba8', 'mono8', 'yuv422', 'uyvy', 'yuv422_yuy2', 'yuyv',
            'nv12', 'nv21', 'nv24', 'bayer_rggb8', 'bayer_bggr8', 'bayer_gbrg8', 'bayer_grbg8',
            '8UC1', '8UC3', '8UC4'}
COLORS = {'black': (0, 0, 0), 'white': (255, 255, 255), 'gray': (128, 128, 128),
          'red': (20, 20, 220), 'green': (30, 200, 30), 'blue': (220, 40, 20),
          'brown': (30, 80, 140)}


@pytest.mark.parametrize('settings', SETTINGS, ids=str)
@pytest.mark.parametrize('size', [(160, 88), (161, 87)])
def test_each_packet_is_one_picture(settings: VideoSettings, size: tuple[int, int]) -> None:
    sent = encoded(settings, *size, 6)
    codec = sent[0].codec
    decoder = av.CodecContext.create(DECODERS[codec], 'r')
    # Without low_delay, so that the SPS must declare that pictures are not reordered.
    decoder.options = {'threads': '1'}
    for number, packet in enumerate(sent):
        frame, = decoder.decode(av.Packet(packet.data))
        assert (packet.width, packet.height) == size
        assert frame.pict_type != PictureType.B
        assert packet.is_key == (number == 0)
        squares = (frame.to_ndarray(format='bgr24')[:size[1], :size[0]].astype(float)
                   - draw(*size, number)) ** 2
        assert 10 * np.log10(255 ** 2 / squares.mean()) > 28
    assert not decoder.has_b_frames
    assert (frame.color_range, frame.colorspace) == (1, 6)
    if hasattr(frame, 'color_trc'):  # PyAV 15
        assert (decoder.color_trc, decoder.color_primaries) == (6, 6)


@pytest.mark.parametrize('settings', SETTINGS, ids=str)
def test_key_frames_have_their_parameter_sets(settings: VideoSettings) -> None:
    encoder = VideoEncoder(settings, 160, 90, 30)
    sent = [encoder.encode(draw(160, 90, number), 'bgr8', number * PERIOD_NS, number % 3 == 0)
            for number in range(9)]
    assert [packet.is_key for packet in sent] == 3 * [True, False, False]
    sets = {parameter_sets(packet.codec, packet.data) for packet in sent[::3]}
    assert len(sets) == 1
    for packet in sent[::3]:
        assert has_parameter_sets(packet.codec, packet.data)
        decoder = VideoDecoder(packet.codec)
        assert decoder.decode(packet.data).shape == (90, 160, 3)
        assert packet.data.replace(b'\0\0\0\1', b'\0\0\1').startswith(
            sets.copy().pop().replace(b'\0\0\0\1', b'\0\0\1'))
    for packet in sent[1::3]:
        assert not parameter_sets(packet.codec, packet.data)


def test_units_of_an_h264_key_frame() -> None:
    data = packets('h264')[0].data
    kinds = [unit[0] & 31 for unit in nal_units(data)]
    assert kinds[:2] == [7, 8] and kinds[-1] == 5 and set(kinds) == {5, 6, 7, 8}
    assert data.startswith(START_CODE)


@every_codec
def test_key_frames_by_irregular_stamps(codec: str) -> None:
    encoder = VideoEncoder(VideoSettings(codec=codec, key_interval=0.5), 64, 64, 30)
    keys = {0: True, 10: False, 499: False, 500: True, 501: False, 999: False, 1800: True,
            2299: False, 2300: True, 700: True, 1199: False, 1200: True}
    for stamp, is_key in keys.items():
        packet = encoder.encode(draw(64, 64, stamp), 'bgr8', stamp * 1_000_000)
        assert packet.is_key == is_key == is_key_frame(codec, packet.data), stamp


@every_codec
@pytest.mark.parametrize('size', [(64, 48), (65, 47), (33, 64)])
@pytest.mark.parametrize('color', COLORS)
def test_colours_of_flat_pictures(codec: str, size: tuple[int, int], color: str) -> None:
    image = np.full((size[1], size[0], 3), COLORS[color], np.uint8)
    packet = VideoEncoder(VideoSettings(codec=codec, quality=12), *size, 30).encode(
        image, 'bgr8', 0)
    shown = VideoDecoder(codec).decode(packet.data, size)
    assert shown.shape == image.shape
    assert np.abs(shown.astype(int) - image).max() <= 6


@pytest.mark.parametrize('size', [(64, 48), (65, 47)])
def test_gray_pictures(size: tuple[int, int]) -> None:
    gray = draw(*size, 0)[..., 0]
    packet = VideoEncoder(VideoSettings(quality=5), *size, 30).encode(gray, 'mono8', 0)
    shown = VideoDecoder('h264').decode(packet.data, size)
    assert np.abs(shown.astype(int) - gray[..., None]).max() <= 6


@pytest.mark.parametrize('name', [*ENCODINGS, '8UC1', '8UC3', '8UC4', '8UC2', '32FC1', '16UC1'])
def test_encodings(name: str) -> None:
    encoder = VideoEncoder(VideoSettings(), 32, 24, 30)
    encoding = ENCODINGS.get(name)
    rows = encoding.rows(24) if encoding else 24
    channels = encoding.channels if encoding else int(name[-1])
    dtype = encoding.dtype if encoding else {'8': 'uint8', '3': 'float32', '1': 'uint16'}[name[0]]
    image = np.full((rows, 32, channels), 100, dtype)
    if name in SUITABLE:
        image.flags.writeable = False
        shown = VideoDecoder('h264').decode(encoder.encode(image, name, 0).data)
        assert shown.shape == (24, 32, 3)
        return
    with pytest.raises(VideoError, match=f"'{name}' has no video: convert it to mono8"):
        encoder.encode(image, name, 0)


def test_unsuitable_images() -> None:
    encoder = VideoEncoder(VideoSettings(), 32, 24, 30)
    with pytest.raises(EncodingError, match='Unrecognized image encoding'):
        encoder.encode(np.zeros((24, 32, 3), np.uint8), 'nonsense', 0)
    with pytest.raises(EncodingError, match='incompatible type'):
        encoder.encode(np.zeros((24, 32), np.uint8), 'bgr8', 0)
    with pytest.raises(VideoError, match='the encoder has 32x24 pixels, but the image has 64x24'):
        encoder.encode(np.zeros((24, 64, 3), np.uint8), 'bgr8', 0)
    with pytest.raises(VideoError):
        encoder.encode(np.zeros((0, 0, 3), np.uint8), 'bgr8', 0)


def test_strided_images_are_not_modified() -> None:
    wide = np.repeat(draw(64, 48, 0), 2, axis=1)
    before = wide.copy()
    packet = VideoEncoder(VideoSettings(quality=5), 64, 48, 30).encode(wide[:, ::2], 'bgr8', 0)
    assert np.array_equal(wide, before)
    assert np.abs(VideoDecoder('h264').decode(packet.data).astype(int) - wide[:, ::2]).mean() < 2


@pytest.mark.thorough
@every_codec
def test_small_bit_rate_makes_small_packets(codec: str) -> None:
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 256, (12, 240, 320, 3), np.uint8)
    total = {}
    for bit_rate in (200_000, 2_000_000):
        encoder = VideoEncoder(VideoSettings(codec=codec, bit_rate=bit_rate), 320, 240, 30)
        sent = [encoder.encode(image, 'bgr8', number * PERIOD_NS)
                for number, image in enumerate(noise)]
        total[bit_rate] = sum(len(packet.data) for packet in sent[1:])
    assert total[200_000] < total[2_000_000] / 2


@every_codec
def test_bits_of_each_second(codec: str) -> None:
    rng = np.random.default_rng(2)
    encoder = VideoEncoder(VideoSettings(codec=codec, bit_rate=500_000), 160, 120, 30)
    bits = [8 * len(encoder.encode(image, 'bgr8', number * PERIOD_NS).data)
            for number, image in enumerate(rng.integers(0, 256, (50, 120, 160, 3), np.uint8))]
    assert max(sum(bits[begin:begin + 30]) for begin in range(20)) < 2.2 * 500_000


@pytest.mark.parametrize(('settings', 'size', 'text'), [
    (VideoSettings(codec='mjpeg'), (64, 48), "'mjpeg', an encoder for other videos"),
    (VideoSettings(codec='h264_nothing'), (64, 48), "'h264_nothing': the installed PyAV has no"),
    (VideoSettings(), (0, 48), 'a 0x48 image has no video'),
    (VideoSettings(), (64, 20000), 'a 64x20000 image has no video'),
    (VideoSettings(codec='h265'), (2, 2), "'libx265' cannot be opened for 2x2 images"),
])
def test_encoders_that_cannot_be_opened(
    settings: VideoSettings, size: tuple[int, int], text: str, capfd: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(VideoError, match=text) as caught:
        VideoEncoder(settings, *size, 30)
    assert '\n' not in str(caught.value)
    assert capfd.readouterr() == ('', '')


@pytest.mark.skipif(not has_encoder('h264_v4l2m2m'), reason='this PyAV has no such encoder')
def test_encoder_without_its_hardware(capfd: pytest.CaptureFixture[str]) -> None:
    level = av.logging.get_level()
    for _ in range(2):  # FFmpeg suppresses repeated lines
        with pytest.raises(VideoError, match='64x48 images: Could not find a valid device'):
            VideoEncoder(VideoSettings(codec='h264_v4l2m2m'), 64, 48, 30)
    assert av.logging.get_level() == level
    assert capfd.readouterr() == ('', '')


@every_codec
def test_nothing_on_standard_streams(codec: str, capfd: pytest.CaptureFixture[str]) -> None:
    sent = encoded(VideoSettings(codec=codec), 64, 64, 3)
    VideoDecoder(codec).decode(sent[0].data)
    assert picture_size(codec, sent[0].data) == (64, 64)
    assert capfd.readouterr() == ('', '')
