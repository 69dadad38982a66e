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

"""Video of one topic for several pages: packets that are sent, skipped and requested."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

from console import Console
import numpy as np
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.layout import array_to_wire
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.settings import VideoSettings
from opencv_tools.viewer.protocol import ViewRequest
from opencv_tools.viewer.streams import video_channel
from opencv_tools.viewer.streams.packets import PacketFeed, PACKETS, ViewedPacket
from opencv_tools.viewer.streams.stream import Stream
from opencv_tools.viewer.streams.video_channel import (
    EncodedVideo, PacketSource, VideoChannel, VideoLink)
import pytest
from waiting import pause_loop, until

OPTIONS = ViewRequest(quality=80, rate=1000.0, video=True)


class Clock:
    """A clock that a test moves."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


class Receiver:
    """A page that keeps what a channel sends."""

    def __init__(self, source: PacketSource, clock: Clock | None = None,
                 codecs: frozenset[str] = frozenset(('h264',))) -> None:
        self.packets: list[ViewedPacket] = []
        self.reasons: list[str] = []
        self.link = VideoLink(clock or asyncio.get_running_loop().time)
        self.channel = VideoChannel(source, OPTIONS, codecs, link=self.link, send=self._receive,
                                    refuse=self.reasons.append)

    @property
    def numbers(self) -> list[int]:
        return [viewed.number for viewed in self.packets]

    def answer(self) -> None:
        """Answer the last packet, and with it the earlier ones."""
        self.channel.answered(len(self.packets))

    def _receive(self, viewed: ViewedPacket) -> int:
        self.packets.append(viewed)
        return len(self.packets)


class Topic:
    """A source of published packets without a node."""

    def __init__(self, pool: ThreadPoolExecutor) -> None:
        self.clock = Clock()
        self.requests = 0
        self.stream = Stream(
            7, ('/image', PACKETS), asyncio.get_running_loop(), pool, Console(), PacketFeed)
        self.source = PacketSource(self.stream, self._count_request, self.clock)
        self.number = 0

    def page(self, codecs: frozenset[str] = frozenset(('h264',))) -> Receiver:
        return Receiver(self.source, self.clock, codecs)

    def publish(self, kinds: str, size: int = 10) -> None:
        """Pass on packets: ``k`` for a key frame, ``-`` for a missing one."""
        for kind in kinds:
            self.number += 1
            if kind != '-':
                packet = VideoPacket(
                    codec='h264', data=bytes(size), is_key=kind == 'k', width=64, height=48)
                self.source.publish(
                    ViewedPacket(number=self.number, stamp_ns=0, packet=packet))

    def _count_request(self) -> None:
        self.requests += 1


def run(work: Callable[[Topic], Coroutine[Any, Any, None]]) -> None:
    """Run a test with a topic."""
    async def begin() -> None:
        with ThreadPoolExecutor(2) as pool:
            await work(Topic(pool))

    asyncio.run(begin())


def test_page_begins_with_a_key_frame() -> None:
    async def work(topic: Topic) -> None:
        page = topic.page()
        topic.publish('ppkpp')
        assert page.numbers == [3, 4, 5]

    run(work)


def test_late_page_gets_the_packets_since_the_key_frame() -> None:
    async def work(topic: Topic) -> None:
        topic.publish('kppkpp')
        page = topic.page()
        assert page.numbers == [4, 5, 6]
        topic.publish('p')
        assert page.numbers == [4, 5, 6, 7]
        assert topic.requests == 0

    run(work)


def test_long_sequence_is_not_kept_for_late_pages() -> None:
    async def work(topic: Topic) -> None:
        first = topic.page()
        topic.publish('k' + 'p' * 120)
        topic.clock.now += 1
        page = topic.page()
        assert page.numbers == []
        assert topic.requests == 1
        first.answer()
        topic.publish('pk')
        assert page.numbers == [123]
        assert first.numbers[-2:] == [122, 123]

    run(work)


def test_gap_is_skipped_up_to_the_next_key_frame() -> None:
    async def work(topic: Topic) -> None:
        page = topic.page()
        topic.clock.now += 1
        topic.publish('kp-pppkp')
        assert page.numbers == [1, 2, 7, 8]
        assert topic.requests == 1

    run(work)


def test_late_page_gets_nothing_from_before_a_gap() -> None:
    async def work(topic: Topic) -> None:
        topic.publish('kpp-p')
        page = topic.page()
        assert page.numbers == []
        topic.publish('pk')
        assert page.numbers == [7]

    run(work)


def test_key_frames_are_requested_less_and_less() -> None:
    async def work(topic: Topic) -> None:
        page = topic.page()
        times = []
        for _ in range(3000):
            before = topic.requests
            page.channel.request_key()
            if topic.requests > before:
                times.append(round(topic.clock.now - 100, 2))
            topic.clock.now += 0.01
        assert times == [1, 3, 7, 15, 23]
        topic.clock.now += 20
        page.channel.request_key()
        topic.clock.now += 1.01
        page.channel.request_key()
        assert topic.requests == len(times) + 2

    run(work)


def test_page_with_a_broken_decoder_waits_for_a_key_frame() -> None:
    async def work(topic: Topic) -> None:
        broken, other = topic.page(), topic.page()
        topic.publish('kp')
        broken.answer()
        broken.channel.request_key()
        topic.publish('ppkp')
        assert broken.numbers == [1, 2, 5, 6]
        assert other.numbers == [1, 2, 3, 4, 5, 6]

    run(work)


def test_slow_page_skips_and_others_do_not() -> None:
    async def work(topic: Topic) -> None:
        slow, quick = topic.page(), topic.page()
        for step in range(12):
            topic.publish('k' if step % 4 == 0 else 'p')
            quick.answer()
            if step == 6:
                slow.answer()
            topic.clock.now += 0.2
        assert quick.numbers == [*range(1, 13)]
        assert slow.numbers == [1, 2, 3, 9, 10, 11]
        assert slow.channel.status()['sent']['skipped'] == 6
        assert topic.requests == 0

    run(work)


def test_pictures_that_a_decoder_holds_back() -> None:
    async def work(topic: Topic) -> None:
        page = topic.page()
        topic.publish('kpp')
        page.channel.answered(1)
        topic.clock.now += 1.9
        topic.publish('pk')
        assert page.numbers == [1, 2, 3]
        topic.clock.now += 0.2
        topic.publish('kp')
        assert page.numbers == [1, 2, 3, 6, 7]

    run(work)


@pytest.mark.parametrize(('limit', 'value', 'size'), [
    ('_MAX_UNANSWERED', 3, 10), ('_MAX_UNANSWERED_BYTES', 25, 10)])
def test_unanswered_packets_are_limited(
        limit: str, value: int, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video_channel, limit, value)

    async def work(topic: Topic) -> None:
        page = topic.page()
        topic.publish('kpppp', size)
        assert page.numbers == [1, 2, 3]
        page.answer()
        topic.publish('pk', size)
        assert page.numbers == [1, 2, 3, 7]

    run(work)


def test_codec_that_the_page_does_not_decode() -> None:
    async def work(topic: Topic) -> None:
        page = topic.page(frozenset(('av1',)))
        topic.publish('kpk')
        assert page.packets == []
        assert page.reasons == ['this browser cannot decode h264']

    run(work)


def test_closed_channel_gets_nothing() -> None:
    async def work(topic: Topic) -> None:
        page = topic.page()
        topic.publish('k')
        page.channel.close()
        topic.publish('pk')
        assert page.numbers == [1]
        assert not topic.source.channels

    run(work)


def test_answers_of_others_are_not_used() -> None:
    async def work(topic: Topic) -> None:
        page = topic.page()
        topic.publish('kpp')
        assert not page.channel.answered(4)
        assert page.channel.answered(2)
        assert not page.channel.answered(1)
        assert page.channel.answered(3)

    run(work)


def put_image(stream: Stream, value: int, encoding: str = 'bgr8') -> None:
    image = np.full((48, 64, 3), value, np.uint8) if encoding == 'bgr8' else np.full(
        (48, 64), value, np.uint16)
    stream.feed.put(ReceivedMessage(array_to_wire(image, find_encoding(encoding)), 0))


def run_encoded(work: Callable[[Stream, EncodedVideo], Coroutine[Any, Any, None]]) -> None:
    """Run a test with images that are encoded."""
    async def begin() -> None:
        loop = asyncio.get_running_loop()
        with ThreadPoolExecutor(2) as pool:
            stream = Stream(7, ('/image', 'auto'), loop, pool, Console())
            await work(stream, EncodedVideo(stream, 1000.0, loop, VideoSettings()))

    asyncio.run(begin())


def test_images_are_encoded_once_for_all_pages() -> None:
    async def work(stream: Stream, source: EncodedVideo) -> None:
        put_image(stream, 1)
        assert stream.encodings == 0
        pages = [Receiver(source), Receiver(source)]
        for count in (1, 2, 3):
            await until(lambda count=count: all(len(page.packets) == count for page in pages))
            put_image(stream, count)
        await until(lambda: len(pages[0].packets) == 4)
        assert pages[0].packets == pages[1].packets
        assert stream.encodings == 4
        assert [viewed.packet.is_key for viewed in pages[0].packets] == [True] + [False] * 3
        assert stream.last_picture
        assert stream.last_picture.source_size == (64, 48)

    run_encoded(work)


def test_nothing_is_encoded_while_all_pages_are_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video_channel, '_MAX_UNANSWERED', 1)

    async def work(stream: Stream, source: EncodedVideo) -> None:
        page = Receiver(source)
        put_image(stream, 1)
        await until(lambda: len(page.packets) == 1)
        for value in range(5):
            put_image(stream, value)
            await pause_loop()
        assert stream.encodings == 1
        page.answer()
        put_image(stream, 9)
        await until(lambda: len(page.packets) == 2)
        assert not page.packets[-1].packet.is_key

    run_encoded(work)


def test_images_that_have_no_video() -> None:
    async def work(stream: Stream, source: EncodedVideo) -> None:
        page = Receiver(source)
        put_image(stream, 1, '16UC1')
        await until(lambda: bool(page.reasons))
        assert '16UC1' in page.reasons[0]
        late = Receiver(source)
        assert late.reasons == page.reasons

    run_encoded(work)


def test_broken_image_is_left_out() -> None:
    async def work(stream: Stream, source: EncodedVideo) -> None:
        page = Receiver(source)
        broken = array_to_wire(np.zeros((48, 64, 3), np.uint8), find_encoding('bgr8'))
        stream.feed.put(ReceivedMessage(replace(broken, encoding='unknown'), 0))
        await until(lambda: stream.broken == 1)
        put_image(stream, 1)
        await until(lambda: len(page.packets) == 1)
        assert stream.error == ''

    run_encoded(work)


def test_encoder_ends_with_the_last_page() -> None:
    async def work(stream: Stream, source: EncodedVideo) -> None:
        page = Receiver(source)
        put_image(stream, 1)
        await until(lambda: len(page.packets) == 1)
        page.channel.close()
        assert not stream.watchers
        again = Receiver(source)
        await until(lambda: len(again.packets) == 1)
        assert again.packets[0].packet.is_key

    run_encoded(work)
