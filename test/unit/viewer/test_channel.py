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

"""Streams and channels without a node: which frames are encoded and sent, and when."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import gc
from threading import Barrier
import weakref

from console import Console
import numpy as np
from opencv_tools.image.cdr import NO_HEADER, WireCompressedImage, WireImage
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.layout import array_to_wire
from opencv_tools.image_codecs import encode_image
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.viewer.protocol import ViewRequest
from opencv_tools.viewer.region import Region
from opencv_tools.viewer.streams import stream as stream_module
from opencv_tools.viewer.streams.channel import Channel
from opencv_tools.viewer.streams.encoding import Picture, PictureOptions
from opencv_tools.viewer.streams.feed import Feed, NewFrame
from opencv_tools.viewer.streams.stream import Stream
import pytest
from waiting import due, LONGEST_SECONDS, pause_loop, until

_THREADS = 2
OPTIONS = ViewRequest(width=0, quality=80, rate=1000.0)


class Receiver:
    """A page that keeps what a channel sends."""

    def __init__(self, stream: Stream, options: ViewRequest = OPTIONS) -> None:
        self.pictures: list[tuple[NewFrame, Picture]] = []
        self.channel = Channel(stream, options, self._receive)

    async def wait(self, count: int) -> Picture:
        """Wait for a number of pictures; return the last one."""
        await until(lambda: len(self.pictures) >= count)
        return self.pictures[-1][1]

    def _receive(self, frame: NewFrame, picture: Picture) -> int:
        self.pictures.append((frame, picture))
        return len(self.pictures)


def image(width: int = 640, height: int = 480) -> WireImage:
    return array_to_wire(np.full((height, width, 3), 90, np.uint8), find_encoding('bgr8'))


async def settled(stream: Stream) -> None:
    """Wait until the loop and the threads have done what they had to do, and what followed."""
    for _ in range(20):
        together = Barrier(_THREADS + 1)
        for _ in range(_THREADS):  # none of them has other work left
            stream._pool.submit(together.wait)
        await asyncio.to_thread(together.wait)
        await due()


def run(work: Callable[[Stream, Console], Awaitable[None]]) -> None:
    """Run a test with a stream."""
    async def begin() -> None:
        log = Console()
        with ThreadPoolExecutor(_THREADS) as pool:
            await work(Stream(7, ('/image', 'auto'), asyncio.get_running_loop(), pool, log), log)

    asyncio.run(begin())


def test_one_picture_is_unanswered_and_the_newest_follows() -> None:
    async def work(stream: Stream, _: Console) -> None:
        page = Receiver(stream)
        for count in range(1, 7):
            stream.feed.put(ReceivedMessage(image(), 0))
            await page.wait(1)
            assert stream.feed.frames == count
        await settled(stream)
        assert len(page.pictures) == 1
        assert not page.channel.answered(5)
        assert page.channel.answered(1)
        await page.wait(2)
        assert [frame.number for frame, _ in page.pictures] == [1, 6]
        assert not page.channel.answered(1)

    run(work)


def test_newest_frame_is_sent_at_once_and_again_with_new_options() -> None:
    async def work(stream: Stream, _: Console) -> None:
        stream.feed.put(ReceivedMessage(image(), 0))
        page = Receiver(stream)
        assert (await page.wait(1)).width == 640
        page.channel.answered(1)
        page.channel.set_options(ViewRequest(width=100, quality=80, rate=1000.0))
        assert (await page.wait(2)).width == 160
        page.channel.answered(2)
        page.channel.set_options(ViewRequest(width=100, quality=80, rate=1000.0, fixed=True))
        assert (await page.wait(3)).width == 100

    run(work)


def test_image_that_grows_is_sent_in_full_size_at_once() -> None:
    async def work(stream: Stream, _: Console) -> None:
        page = Receiver(stream)
        for count, width in enumerate((64, 640, 320), 1):
            stream.feed.put(ReceivedMessage(image(width), 0))
            assert (await page.wait(count)).width == width
            page.channel.answered(count)

    run(work)


def test_equal_options_share_an_encoding() -> None:
    async def work(stream: Stream, _: Console) -> None:
        narrow = ViewRequest(width=320, quality=80, rate=1000.0)
        pages = [Receiver(stream, options) for options in (OPTIONS, OPTIONS, narrow, narrow)]
        stream.feed.put(ReceivedMessage(image(), 0))
        pictures = [await page.wait(1) for page in pages]
        assert pictures[0] is pictures[1]
        assert pictures[2] is pictures[3]
        assert stream.encodings == 2

    run(work)


def test_pictures_of_old_frames_are_forgotten() -> None:
    async def work(stream: Stream, _: Console) -> None:
        pictures = []
        for width in (320, 160):
            stream.feed.put(ReceivedMessage(image(), 0))
            frame = stream.feed.newest
            assert frame
            pictures.append(weakref.ref(await stream.picture(frame, PictureOptions(width, 80))))
        gc.collect()
        await until(lambda: pictures[0]() is None)
        assert pictures[1]()

    run(work)


def test_nothing_is_encoded_without_a_channel() -> None:
    async def work(stream: Stream, _: Console) -> None:
        page = Receiver(stream)
        page.channel.close()
        stream.feed.put(ReceivedMessage(image(), 0))
        await settled(stream)
        assert stream.encodings == 0
        assert not stream.watchers

    run(work)


def test_broken_images_are_counted_once() -> None:
    async def work(stream: Stream, log: Console) -> None:
        pages = [Receiver(stream), Receiver(stream, ViewRequest(width=80, quality=9, rate=99.0))]
        stream.feed.put(ReceivedMessage(WireCompressedImage(
            header=NO_HEADER, format='jpeg', data=b'\xff\xd8'), 0))
        await until(lambda: stream.broken == 1)
        await settled(stream)
        assert stream.broken == 1
        assert len(log.lines) == 1
        assert log.lines[0].startswith('warning: frame of /image left out: ')
        stream.feed.put(ReceivedMessage(image(), 0))
        for page in pages:
            await page.wait(1)

    run(work)


def test_jpeg_of_a_page_with_fixed_quality_is_encoded_again() -> None:
    jpeg = encode_image(np.full((48, 64), 90, np.uint8), '.jpg').tobytes()

    async def work(stream: Stream, _: Console) -> None:
        fixed = ViewRequest(width=0, quality=20, rate=1000.0, fixed=True)
        pages = Receiver(stream), Receiver(stream, fixed)
        stream.feed.put(ReceivedMessage(WireCompressedImage(
            header=NO_HEADER, format='jpeg', data=jpeg), 0))
        assert (await pages[0].wait(1)).data == jpeg
        assert (await pages[1].wait(1)).data != jpeg
        assert pages[0].channel.status()['sent']['passed_through']

    run(work)


def test_jpeg_is_encoded_again_when_the_link_is_slow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Feed, 'rate', 1000.0)  # an answer after 5 ms is late
    jpeg = encode_image(np.full((48, 64), 90, np.uint8), '.jpg').tobytes()

    async def work(stream: Stream, _: Console) -> None:
        page = Receiver(stream)
        kept = []
        for count in range(1, 8):
            stream.feed.put(ReceivedMessage(WireCompressedImage(
                header=NO_HEADER, format='jpeg', data=jpeg), 0))
            kept.append((await page.wait(count)).is_kept)
            await pause_loop(0.005)
            page.channel.answered(count)
        assert kept == [True] * 6 + [False]

    run(work)


@pytest.mark.parametrize('seconds', [0.0, 0.05])
def test_next_frame_is_waited_for_only_so_long(seconds: float) -> None:
    async def work(stream: Stream, _: Console) -> None:
        assert await stream.next_frame(0, seconds) is None
        waiting = asyncio.ensure_future(stream.next_frame(0, LONGEST_SECONDS))
        await settled(stream)
        stream.feed.put(ReceivedMessage(image(), 5))
        frame = await waiting
        assert frame
        assert (frame.number, frame.receive_ns) == (1, 5)
        assert await stream.next_frame(0, 0) is frame
        assert not stream.watchers

    run(work)


def test_frame_of_the_shown_picture_is_kept() -> None:
    async def work(stream: Stream, _: Console) -> None:
        page = Receiver(stream, replace(OPTIONS, looks=True))
        stream.feed.put(ReceivedMessage(image(), 0))
        await page.wait(1)
        first = stream.feed.newest
        assert page.channel.shown.of(1) is None  # the page has not drawn it yet
        page.channel.answered(1)
        stream.feed.put(ReceivedMessage(image(), 0))
        await page.wait(2)
        assert page.channel.shown.of(1) is first
        page.channel.answered(2)
        assert page.channel.shown.of(1) is None
        assert page.channel.shown.of(2) is stream.feed.newest

    run(work)


def test_frame_is_kept_without_a_look() -> None:
    async def work(stream: Stream, _: Console) -> None:
        page = Receiver(stream)
        stream.feed.put(ReceivedMessage(image(), 0))
        await page.wait(1)
        page.channel.answered(1)
        assert page.channel.shown.of(1) is stream.feed.newest  # which can be saved

    run(work)


def test_held_picture_gets_other_regions_but_no_other_frame() -> None:
    async def work(stream: Stream, _: Console) -> None:
        looks = replace(OPTIONS, looks=True)
        page = Receiver(stream, looks)
        stream.feed.put(ReceivedMessage(image(), 0))
        await page.wait(1)
        page.channel.answered(1)
        held = replace(looks, held=True)
        page.channel.set_options(held)
        stream.feed.put(ReceivedMessage(image(), 0))
        await settled(stream)
        assert len(page.pictures) == 1
        region = Region(x=10, y=20, width=30, height=40)
        page.channel.set_options(replace(held, region=region))
        assert (await page.wait(2)).region == region
        page.channel.answered(2)
        await settled(stream)
        assert [frame.number for frame, _ in page.pictures] == [1, 1]
        assert page.channel.status()['sent']['rate'] == 0  # no frame came twice

    run(work)


def test_held_frame_does_not_change_what_the_stream_shows() -> None:
    async def work(stream: Stream, _: Console) -> None:
        page = Receiver(stream)
        stream.feed.put(ReceivedMessage(image(), 0))
        picture = await page.wait(1)
        for number, data in ((8, b'8'), (9, b'9'), (8, b'8')):  # a page holds frame 8, and zooms
            stream.record(number, replace(picture, data=data))
        assert stream.last_picture and stream.last_picture.data == b'9'

    run(work)


def test_another_region_keeps_the_quality_of_a_slow_link() -> None:
    async def work(stream: Stream, _: Console) -> None:
        page = Receiver(stream, replace(OPTIONS, region=Region(x=0, y=0, width=400, height=400)))
        stream.feed.put(ReceivedMessage(image(), 0))
        await page.wait(1)
        link = page.channel._link
        page.channel.answered(1)
        moved = Region(x=100, y=0, width=400, height=400)
        page.channel.set_options(replace(OPTIONS, region=moved))
        assert (await page.wait(2)).region == moved
        assert page.channel._link is link

    run(work)


@pytest.mark.parametrize(('seconds', 'busy', 'is_lowered'), [
    (0.5, 0.5, False), (3.0, 2.99, False), (40.0, 60.0, False), (3.0, 0.0, True),
    (3.0, 1.0, True)])
def test_busy_browser_is_not_a_slow_link(seconds: float, busy: float, is_lowered: bool) -> None:
    async def work(stream: Stream, _: Console) -> None:
        page = Receiver(stream)
        for number in range(1, 21):
            stream.feed.put(ReceivedMessage(image(), 0))
            await page.wait(number)
            at, size, frame = page.channel._unanswered[number]
            page.channel._unanswered[number] = at - seconds, size, frame
            page.channel.answered(number, busy)
        assert page.channel._link.is_lowered is is_lowered

    run(work)


def test_few_regions_of_a_frame_are_kept() -> None:
    async def work(stream: Stream, _: Console) -> None:
        stream.feed.put(ReceivedMessage(image(), 0))
        frame = stream.feed.newest
        assert frame
        pictures = []
        for x in range(0, 100, 2):
            region = Region(x=x, y=0, width=64, height=64)
            pictures.append(weakref.ref(await stream.picture(
                frame, PictureOptions(64, 80, region=region))))
        await settled(stream)
        gc.collect()
        assert 2 < sum(picture() is not None for picture in pictures) < 20

    run(work)


def test_pixels_are_forgotten_after_the_last_question(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_module, '_PIXELS_SECONDS', 600)

    async def work(stream: Stream, _: Console) -> None:
        depth = np.arange(64 * 48, dtype=np.uint16).reshape(48, 64)
        content = encode_image(depth, '.png').tobytes()
        stream.feed.put(ReceivedMessage(
            WireCompressedImage(header=NO_HEADER, format='png', data=content), 0))
        assert stream.feed.newest
        first = await stream.pixels(stream.feed.newest)
        monkeypatch.setattr(stream_module, '_PIXELS_SECONDS', 0.05)
        second = await stream.pixels(stream.feed.newest)
        assert first is second
        kept = weakref.ref(first)
        del first, second
        await until(lambda: gc.collect() >= 0 and kept() is None)
        again = await stream.pixels(stream.feed.newest)
        assert np.array_equal(again.image, depth)

    run(work)


def test_range_of_a_page_is_not_that_of_another_page() -> None:
    async def work(stream: Stream, _: Console) -> None:
        depth = np.tile(np.arange(1000, 1640).astype(np.uint16), (480, 1))
        stream.feed.put(ReceivedMessage(array_to_wire(depth, find_encoding('16UC1')), 0))
        page = Receiver(stream)
        assert page.channel.status()['range'] is None
        automatic = (await page.wait(1)).limits
        other = Receiver(stream, replace(OPTIONS, limits=(0.0, 500.0)))
        assert (await other.wait(1)).limits == (0, 500)
        assert other.channel.status()['range'] == [0, 500]
        assert automatic and page.channel.status()['range'] == [*automatic]
        assert automatic[0] > 1000

    run(work)


def depth_from(low: int) -> WireImage:
    """Return an image with depths from a number to 640 more."""
    return array_to_wire(np.tile(np.arange(low, low + 640).astype(np.uint16), (480, 1)),
                         find_encoding('16UC1'))


def test_first_picture_of_another_scene_has_its_range() -> None:
    async def work(stream: Stream, _: Console) -> None:
        page = Receiver(stream)
        for count, low in enumerate((1000, 5000, 200), 1):
            stream.feed.put(ReceivedMessage(depth_from(low), 0))
            limits = (await page.wait(count)).limits
            assert limits == pytest.approx((low + 13, low + 626), abs=3)
            assert page.channel.status()['range'] == pytest.approx(limits)
            page.channel.answered(count)

    run(work)


def test_held_picture_keeps_its_colours() -> None:
    async def work(stream: Stream, _: Console) -> None:
        page = Receiver(stream, replace(OPTIONS, looks=True))
        for count, low in enumerate((1000, 1500), 1):
            stream.feed.put(ReceivedMessage(depth_from(low), 0))
            limits = (await page.wait(count)).limits
            page.channel.answered(count)
        page.channel.set_options(replace(
            OPTIONS, looks=True, held=True, region=Region(x=0, y=0, width=64, height=48)))
        assert (await page.wait(3)).limits == limits

    run(work)
