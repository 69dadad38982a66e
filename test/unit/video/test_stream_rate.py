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

"""Bit rates of a video at any rate of its frames, which is measured."""

from __future__ import annotations

import numpy as np
from opencv_tools.video.encoder import VideoEncoder
from opencv_tools.video.parameter_sets import parameter_sets
from opencv_tools.video.settings import VideoSettings
from opencv_tools.video.stream import VideoStream
import pytest
from video_packets import every_codec

BITS = 500_000
RANDOM = np.random.default_rng(0)
NOISE = [RANDOM.integers(0, 40, (240, 320, 3), np.uint8) for _ in range(20)]
RAMP = np.mgrid[:240, :320][1].astype(np.uint8)[..., None] // 2


def bits(stream: VideoStream, times: list[float], clock: list[float]) -> list[tuple[float, int]]:
    """Encode a moving picture with noise at each time, and return the bits of its packets."""
    found = []
    for number, seconds in enumerate(times):
        clock[0] = seconds
        image = np.roll(RAMP, 3 * number, 1) + NOISE[number % len(NOISE)]
        packet = stream.encode(image, 'bgr8', int(seconds * 1e9))
        found.append((seconds, 8 * len(packet.data)))
    return found


@pytest.mark.quick_cases(3)
@every_codec
@pytest.mark.parametrize(('rate', 'promised'), [
    (5, BITS), (120, 100_000), (17, 870_000), (30, BITS), (10, 100_000), (60, BITS),
    (5, 3_000_000), (30, 100_000), (120, 3_000_000)])
def test_bit_rate_at_any_frame_rate(codec: str, rate: int, promised: int) -> None:
    clock = [0.0]
    stream = VideoStream(VideoSettings(codec=codec, bit_rate=promised), lambda: clock[0])
    random = np.random.default_rng(rate)
    times = [(number + 0.2 * random.random()) / rate for number in range(12 * rate)]
    assert sum(size for _, size in bits(stream, times, clock)) / 12 == pytest.approx(
        promised, rel=0.15)


@pytest.mark.parametrize(('before', 'after'), [(30, 7), (10, 100), (120, 5)])
def test_bit_rate_after_a_change_of_the_frame_rate(before: int, after: int) -> None:
    clock = [0.0]
    stream = VideoStream(VideoSettings(bit_rate=BITS), lambda: clock[0])
    times = [number / before for number in range(3 * before)]
    times += [4 + number / after for number in range(14 * after)]
    sizes = bits(stream, times, clock)
    assert sum(size for seconds, size in sizes if 8 <= seconds < 18) / 10 == pytest.approx(
        BITS, rel=0.15)


def test_quality_does_not_depend_on_the_frame_rate() -> None:
    clock = [0.0]
    stream = VideoStream(VideoSettings(key_interval=60.0), lambda: clock[0])
    bits(stream, [0.0, 0.1, 0.2, 0.3, 0.4], clock)
    first = stream._encoder
    bits(stream, [0.5 + number / 100 for number in range(300)], clock)
    assert stream._encoder is first


def rising(before: float, after: float, seconds: float) -> list[float]:
    """Return times of frames whose rate is steady for 4 s, rises evenly, and is steady again."""
    random, times, at = np.random.default_rng(0), [], 0.0
    while at < 4 + seconds + 6:
        rate = before + (after - before) * min(1.0, max(0.0, at - 4) / seconds)
        times.append(at + 0.2 * random.random() / rate)
        at += 1 / rate
    return times


@pytest.mark.parametrize(('before', 'after', 'seconds', 'most'), [
    (5, 60, 14, 7), (10, 30, 10, 5), (23, 79, 12, 5)])
def test_few_encoders_follow_a_slow_rise(
        before: float, after: float, seconds: float, most: int) -> None:
    clock = [0.0]
    stream = VideoStream(VideoSettings(bit_rate=BITS), lambda: clock[0])
    stream.expected_rate = before
    sizes, encoders = [], set()
    for at in rising(before, after, seconds):
        sizes += bits(stream, [at], clock)
        encoders.add(stream._encoder)
    assert len(encoders) <= most
    for begin in range(int(seconds) + 4):
        found = sum(size for at, size in sizes if begin <= at < begin + 4) / 4
        assert 0.7 * BITS < found < 1.3 * BITS
    assert stream._rate == pytest.approx(after, rel=0.15)


@pytest.mark.parametrize('rate', [5, 20, 120, 43])
def test_expected_rate_keeps_one_encoder(rate: int) -> None:
    clock = [0.0]
    stream = VideoStream(VideoSettings(bit_rate=BITS), lambda: clock[0])
    stream.expected_rate = rate
    bits(stream, [0.0], clock)
    first = stream._encoder
    random = np.random.default_rng(rate)
    late = 0.4  # the first frame waits for the encoder
    bits(stream, [late + (number + 0.3 * random.random()) / rate for number in range(4 * rate)],
         clock)
    assert stream._encoder is first


@pytest.mark.parametrize('rate', [5, 20, 120, 43])
def test_rate_of_frames_that_were_not_encoded(rate: int) -> None:
    clock = [0.0]
    stream = VideoStream(VideoSettings(bit_rate=BITS), lambda: clock[0])
    for number in range(3 * rate):
        clock[0] = number / rate
        stream.measure()
    bits(stream, [3.0], clock)
    first = stream._encoder
    bits(stream, [3 + number / rate for number in range(1, 4 * rate)], clock)
    assert stream._encoder is first


def test_wrong_expected_rate_is_corrected_after_a_second() -> None:
    clock = [0.0]
    stream = VideoStream(VideoSettings(bit_rate=BITS), lambda: clock[0])
    stream.expected_rate = 30.0
    sizes = bits(stream, [number / 7 for number in range(140)], clock)
    assert sum(size for seconds, size in sizes if 2 <= seconds < 20) / 18 == pytest.approx(
        BITS, rel=0.15)


def alternating(rates: tuple[int, int], seconds: int) -> list[float]:
    """Return times of frames whose rate changes each second."""
    times = [0.0]
    while times[-1] < seconds:
        times.append(times[-1] + 1 / rates[int(times[-1]) % 2])
    return times


@every_codec
@pytest.mark.parametrize('rates', [(6, 30), (10, 20), (90, 25)])
def test_bit_rate_of_a_rate_that_varies(codec: str, rates: tuple[int, int]) -> None:
    clock = [0.0]
    stream = VideoStream(VideoSettings(codec=codec, bit_rate=BITS), lambda: clock[0])
    stream.expected_rate = sum(rates) / 2
    sizes, encoders = [], set()
    for at in alternating(rates, 14):
        sizes += bits(stream, [at], clock)
        encoders.add(stream._encoder)
    assert len(encoders) <= 6  # of 14 changes
    assert 0.3 * BITS < sum(size for _, size in sizes) / 14 < 1.15 * BITS
    assert max(sum(size for at, size in sizes if int(at) == second)
               for second in range(1, 14)) < 2 * BITS


@pytest.mark.parametrize(('before', 'after', 'most'), [(10, 30, 3), (5, 100, 7), (5, 28, 5)])
def test_rate_that_rises_is_noticed_within_half_a_second(
        before: int, after: int, most: int) -> None:
    clock = [0.0]
    stream = VideoStream(VideoSettings(bit_rate=BITS), lambda: clock[0])
    stream.expected_rate = before
    bits(stream, [number / before for number in range(5 * before)], clock)
    sizes = bits(stream, [5 + number / after for number in range(after)], clock)
    assert sum(size for _, size in sizes) < most * BITS


@pytest.mark.parametrize(('before', 'after'), [(10, 30), (5, 100), (60, 7)])
def test_rate_that_is_told_holds_at_once(before: int, after: int) -> None:
    clock = [0.0]
    stream = VideoStream(VideoSettings(bit_rate=BITS), lambda: clock[0])
    stream.expected_rate = before
    bits(stream, [number / before for number in range(5 * before)], clock)
    stream.expected_rate = after
    sizes = bits(stream, [5 + number / after for number in range(4 * after)], clock)
    assert sum(size for _, size in sizes) / 4 == pytest.approx(BITS, rel=0.2)


@every_codec
@pytest.mark.parametrize('size', [(320, 240), (1280, 720), (37, 1003)])
@pytest.mark.parametrize('bit_rate', [0, 10_000, BITS, 3_000_000])
def test_parameter_sets_do_not_depend_on_the_rate(
        codec: str, size: tuple[int, int], bit_rate: int) -> None:
    settings = VideoSettings(codec=codec, bit_rate=bit_rate)
    image = np.zeros((*size[::-1], 3), np.uint8)
    assert len({parameter_sets(codec, VideoEncoder(settings, *size, rate).encode(
        image, 'bgr8', 0).data) for rate in (0.5, 3, 10, 17, 30, 120, 1000)}) == 1
