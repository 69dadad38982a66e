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
"""Pictures of the video that a paused page steps through, and the packets kept for them."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np
from opencv_tools.image.cdr import WireHeader
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.video.decoder import VideoDecoder
from opencv_tools.video.messages import FFMPEG_PACKET, WireVideo
from opencv_tools.video.parameter_sets import is_key_frame
from opencv_tools.video.settings import VideoSettings
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.inspect import held_video
from opencv_tools.viewer.inspect.held_video import HeldVideo
from opencv_tools.viewer.inspect.history import History, KEPT_SECONDS, KeptFrame
import pytest
from video_packets import encoded, every_codec, HERE, packets

KEY = '/front', 'packets'


def message(codec: str, data: bytes, number: int) -> ReceivedMessage:
    """Return a packet that was received, with its number as seconds of its stamp."""
    return ReceivedMessage(WireVideo(
        type_name=FFMPEG_PACKET, header=WireHeader(number, 0, 'camera'), encoding=codec,
        data=memoryview(data), serialized=b''), receive_ns=number, number=number)


def groups(codec: str, lengths: tuple[int, ...]) -> list[ReceivedMessage]:
    """Return packets in groups, each of which begins with a key frame."""
    data = [packet.data for length in lengths for packet in packets(codec, count=length)]
    return [message(codec, one, number) for number, one in enumerate(data, 1)]


def kept(messages: list[ReceivedMessage]) -> list[KeptFrame]:
    """Return messages as a history keeps them."""
    async def work() -> list[KeptFrame]:
        history = History(1 << 30)
        history.watch(KEY)
        for one in messages:
            history.add(KEY, one, is_key_frame(one.message.codec, bytes(one.message.data)))
        return history.held(history.hold(KEY))

    return asyncio.run(work())


def decoded(messages: list[ReceivedMessage]) -> list[np.ndarray]:
    """Return the picture of each packet, decoded in their order."""
    decoder = VideoDecoder(messages[0].message.codec)
    return [decoder.decode(bytes(one.message.data)) for one in messages]


def picture(video: HeldVideo, frames: list[KeptFrame], place: int) -> np.ndarray:
    """Return the picture of a packet as an array."""
    wire = (video.found(frames[place]) or video.decode(frames, place)).message
    assert wire.header == frames[place].received.message.header
    return np.asarray(wire.data).reshape(wire.height, wire.width, 3)


@every_codec
@pytest.mark.parametrize('most', [1, 200_000, 1 << 30])
def test_pictures_in_any_order(
        codec: str, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(held_video, '_MAX_BYTES', most)
    messages = groups(codec, (1, 7, 3, 13))
    frames, expected, video = kept(messages), decoded(messages), HeldVideo()
    order = np.random.default_rng(55).integers(0, len(frames), 40)
    for place in (*order, *reversed(range(len(frames))), *range(len(frames))):
        assert np.array_equal(picture(video, frames, place), expected[place])
        size = sum(one.message.data.nbytes for one in video._pictures.values())
        assert size <= max(most, expected[0].nbytes)


@pytest.mark.parametrize('codec', HERE[:1])
def test_damage_costs_the_pictures_that_need_it(codec: str) -> None:
    messages = groups(codec, (5, 4))
    messages[2] = replace(messages[2], message=replace(
        messages[2].message, data=memoryview(bytes(messages[2].message.data[:20]))))
    frames, video = kept(messages), HeldVideo()
    for place in (0, 1, 5, 8):
        assert picture(video, frames, place).shape == (120, 160, 3)
    for place in (2, 3, 4):
        with pytest.raises(RequestError, match=r'damaged|key frame'):
            video.decode(frames, place)


@pytest.mark.parametrize('codec', HERE[:1])
@pytest.mark.parametrize('seconds', [2, 7, 25])
def test_key_frame_is_kept_while_a_packet_needs_it(codec: str, seconds: int) -> None:
    data = [packet.data for packet in encoded(
        VideoSettings(codec=codec), 64, 48, 60)[:seconds]]

    async def work() -> None:
        time = 0.0
        history = History(1 << 20, lambda: time)
        history.watch(KEY)
        for number in range(60):
            time = float(number)
            history.add(KEY, message(codec, data[number % seconds], number), not number % seconds)
            numbers = [one.receive_ns for one in history.frames(KEY[0])]
            oldest = max(0, number - int(KEPT_SECONDS))
            assert numbers == [*range(oldest - oldest % seconds, number + 1)]

    asyncio.run(work())
