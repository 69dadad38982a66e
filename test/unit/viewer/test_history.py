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

"""Frames that are kept for steps, within their bytes, and the steps of a page."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
import random
from threading import Thread
from typing import Any

from console import Console
import numpy as np
from opencv_tools.base.units import NANO
from opencv_tools.image.cdr import WireCompressedImage, WireHeader, WireImage
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.inspect import history as history_module
from opencv_tools.viewer.inspect.history import History, message_size
from opencv_tools.viewer.inspect.steps import Steps
from opencv_tools.viewer.protocol import ViewRequest
from opencv_tools.viewer.streams.channel import Channel
from opencv_tools.viewer.streams.feed import NewFrame
from opencv_tools.viewer.streams.stream import Stream
import pytest
from waiting import due, pause_loop, until

KEY, OTHER = ('/front', 'auto'), ('/rear', 'auto')
SIZE = 30_000
LIVE = ViewRequest(quality=80, rate=1000.0, looks=True)
PAUSED = replace(LIVE, held=True)


def received(number: int, data: Any = None, size: int = SIZE) -> ReceivedMessage:
    """Return a gray image, whose stamp is its number in tenths of a second."""
    header = WireHeader(*divmod(number * NANO // 10, NANO), 'camera')
    data = memoryview(bytes([number % 256]) * size) if data is None else data
    return ReceivedMessage(WireImage(
        header=header, height=len(data) // 100, width=100, encoding='mono8', is_bigendian=False,
        step=100, data=data), number)


def run(work: Callable[[], Awaitable[None]]) -> None:
    """Run the work of a test in a loop."""
    async def begin() -> None:
        await work()

    asyncio.run(begin())


def numbers(history: History, name: str = KEY[0]) -> list[int]:
    """Return the numbers of the messages that are kept."""
    return [one.receive_ns for one in history.frames(name)]


def test_frames_of_watched_topics_are_kept_as_they_were_received() -> None:
    async def work() -> None:
        history = History(10 * SIZE)
        history.add(KEY, received(1), True)
        assert history.frames(KEY[0]) == []
        history.watch(KEY)
        messages = [received(number) for number in (2, 3)]
        assert [history.add(KEY, one, True) for one in messages] == messages
        history.add(OTHER, received(9), True)
        assert all(kept is one for kept, one in zip(
            history.frames(KEY[0]), messages, strict=True))
        assert history.frames(OTHER[0]) == []
        assert history.size == sum(message_size(one.image) for one in messages) > 2 * SIZE

    run(work)


def test_bytes_never_exceed_the_limit() -> None:
    async def work() -> None:
        choose = random.Random(36)
        limit = 20 * SIZE
        history = History(limit)
        for key in (KEY, OTHER):
            history.watch(key)
        holds = []
        for number in range(3000):
            key = choose.choice((KEY, OTHER))
            message = received(number, size=choose.choice((0, 100, SIZE, 7 * SIZE, limit, 2**20)))
            before = numbers(history, key[0])
            history.add(key, message, True)
            kept = [one for name in (KEY[0], OTHER[0]) for one in history.frames(name)]
            assert history.size == sum(message_size(one.image) for one in kept) <= limit
            is_kept = message_size(message.image) <= limit
            assert (number in numbers(history, key[0])) == is_kept
            assert is_kept or numbers(history, key[0]) == before
            if choose.random() < 0.02:
                holds.append(history.hold(key))
            if len(holds) > 3:
                history.release(holds.pop(0))

    run(work)


def test_oldest_frames_of_all_topics_leave_first() -> None:
    async def work() -> None:
        history = History(4 * message_size(received(0).image))
        for key in (KEY, OTHER):
            history.watch(key)
        for number, key in enumerate((KEY, KEY, OTHER, KEY, OTHER)):
            history.add(key, received(number), True)
        assert numbers(history) == [1, 3] and numbers(history, OTHER[0]) == [2, 4]
        history.add(OTHER, received(5), True)
        history.add(OTHER, received(6), True)
        assert numbers(history) == [3] and numbers(history, OTHER[0]) == [4, 5, 6]

    run(work)


def test_frames_of_a_pause_leave_last_within_half_of_the_limit() -> None:
    async def work() -> None:
        history = History(8 * message_size(received(0).image))
        for key in (KEY, OTHER):
            history.watch(key)
        for number in range(3):
            history.add(KEY, received(number), True)
        holds = [history.hold(KEY), history.hold(KEY)]
        for number in range(3, 20):
            history.add(OTHER, received(number), True)
        assert numbers(history) == [0, 1, 2]
        assert numbers(history, OTHER[0]) == [15, 16, 17, 18, 19]
        holds.append(history.hold(OTHER))  # both need more than half
        for number in range(20, 30):
            history.add(OTHER, received(number), True)
        assert numbers(history) == []
        assert numbers(history, OTHER[0]) == [16, 17, 18, 19, 26, 27, 28, 29]
        for hold in holds:
            history.release(hold)
        history.add(OTHER, received(30), True)
        assert numbers(history, OTHER[0]) == [17, 18, 19, 26, 27, 28, 29, 30]

    run(work)


def test_frame_larger_than_the_limit_is_not_kept() -> None:
    async def work() -> None:
        history = History(SIZE)
        history.watch(KEY)
        history.add(KEY, received(1), True)
        hold = history.hold(KEY)
        assert history.size == 0 and hold.numbers == ()
        history.unwatch(KEY)
        history._drop_unused(KEY)  # as two seconds later
        assert history.explain(hold) == (
            f'a frame has {message_size(received(1).image)} bytes, and history_bytes is {SIZE}')

    run(work)


def test_ten_seconds_before_the_newest_frame() -> None:
    now = 100.0

    async def work() -> None:
        nonlocal now
        history = History(2**30, lambda: now)
        history.watch(KEY)
        for number in range(30):
            history.add(KEY, received(number), True)
            now += 1
        assert numbers(history) == [*range(19, 30)]
        hold = history.hold(KEY)
        for number in range(30, 50):
            history.add(KEY, received(number), True)
            now += 1
        # The frames of the pause stay, and those of the other pages are the newest.
        assert numbers(history) == [*range(19, 30), *range(39, 50)]
        assert [kept.received.receive_ns for kept in history.held(hold)] == [*range(19, 30)]
        history.release(hold)
        history.add(KEY, received(50), True)
        assert numbers(history) == [*range(40, 51)]

    run(work)


def test_frames_are_forgotten_when_nobody_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(history_module, 'UNUSED_SECONDS', 0.0)

    async def work() -> None:
        history = History(2**30)
        history.watch(KEY)
        history.add(KEY, received(1), True)
        hold = history.hold(KEY)
        history.unwatch(KEY)
        history.add(KEY, received(2), True)  # of a page that does not show the topic alone
        await due()
        assert numbers(history) == [1]
        history.release(hold)
        history.watch(KEY)  # the page is live again
        await due()
        assert numbers(history) == [1]
        history.unwatch(KEY)
        await until(lambda: not history.frames(KEY[0]))
        assert history.size == 0

    run(work)


def test_no_history_with_a_limit_of_zero() -> None:
    async def work() -> None:
        history = History(0)
        history.watch(KEY)
        message = received(1, data=np.arange(4, dtype=np.uint8)[1:])
        assert history.add(KEY, message, True) is message
        assert history.explain(history.hold(KEY)) == 'history_bytes is 0'
        history.unwatch(KEY)

    run(work)


def test_shared_memory_is_not_held() -> None:
    async def work() -> None:
        history = History(2**20)
        history.watch(KEY)
        slot = np.full(1000, 7, np.uint8)
        message = received(1, data=slot[:600])
        kept = history.add(KEY, message, True)
        assert history.frames(KEY[0])[0] is kept
        slot[:] = 8  # the publisher has it again
        assert bytes(kept.image.data) == bytes([7]) * 600
        assert not kept.image.data.flags.writeable
        copied = received(2, data=slot[:600].copy())  # by the reader of the shared memory
        assert history.add(KEY, copied, True) is copied

    run(work)


def test_size_of_a_message_has_all_its_bytes() -> None:
    whole = memoryview(bytes(5000))
    part = WireCompressedImage(header=WireHeader(0, 0, 'a' * 3000), format='b' * 2000,
                               data=whole[4000:])
    assert 10_000 <= message_size(part) < 10_500


def test_threads_may_add_while_the_loop_reads() -> None:
    async def work() -> None:
        history = History(50 * SIZE)
        for key in (KEY, OTHER):
            history.watch(key)
        threads = [Thread(target=lambda key=key: [
            history.add(key, received(number), True) for number in range(2000)])
            for key in (KEY, OTHER)]
        for thread in threads:
            thread.start()
        while any(thread.is_alive() for thread in threads):
            hold = history.hold(KEY)
            assert history.size <= history.limit
            assert len(history.held(hold)) <= len(hold.numbers)
            history.release(hold)
            kept = numbers(history)
            assert kept == sorted(kept)
            await pause_loop()
        assert history.size == sum(
            message_size(one.image) for name in (KEY[0], OTHER[0])
            for one in history.frames(name))

    run(work)


class SteppingPage:
    """A page with two topics, which answers each picture at once."""

    def __init__(self, pool: ThreadPoolExecutor, limit: int = 2**30) -> None:
        self.history = History(limit)
        self.pictures: dict[str, list[int]] = {'/front': [], '/rear': []}
        self.answers: list[dict[str, Any]] = []
        self.channels: dict[str, object] = {}
        self.is_answering = True
        self._sequence = 0
        self.steps = Steps(self.history, self.channels, self._write)
        for key in (KEY, OTHER):
            stream = Stream(7, key, asyncio.get_running_loop(), pool, Console())
            stream.feed.keep = partial(self.history.add, key)
            self.channels[key[0]] = Channel(
                stream, LIVE, lambda frame, _, name=key[0]: self._receive(name, frame))
            self.steps.follow(key[0])

    def channel(self, name: str) -> Channel:
        found = self.channels[name]
        assert isinstance(found, Channel)
        return found

    async def show(self, name: str, *frames: int) -> None:
        """Publish frames, each after the page has drawn the one before."""
        for number in frames:
            self.channel(name).stream.feed.put(received(number))
            await until(lambda: self.pictures[name][-1:] == [number])  # noqa: B023

    def pause(self) -> None:
        for name in self.channels:
            self.channel(name).set_options(PAUSED)
            self.steps.follow(name)

    async def step(self, by: int, name: str = '/front', **more: Any) -> dict[str, Any]:
        """Step, and return the answer."""
        count = len(self.answers)
        assert self.steps.ask({'step': name, 'by': by, **more})
        await until(lambda: len(self.answers) > count)
        return self.answers[-1]

    async def _write(self, message: dict[str, Any]) -> None:
        self.answers.append(message['step'])

    def _receive(self, name: str, frame: NewFrame) -> int:
        self._sequence += 1
        self.pictures[name].append(frame.receive_ns)
        if self.is_answering:
            asyncio.get_running_loop().call_soon(self.channel(name).answered, self._sequence)
        return self._sequence


def run_page(work: Callable[[SteppingPage], Awaitable[None]], **options: Any) -> None:
    """Run the work of a test with a page."""
    async def begin() -> None:
        with ThreadPoolExecutor(2) as pool:
            page = SteppingPage(pool, **options)
            await work(page)
            page.steps.close()

    asyncio.run(begin())


def test_steps_to_the_ends() -> None:
    async def work(page: SteppingPage) -> None:
        await page.show('/front', *range(1, 6))
        page.pause()
        page.channel('/front').stream.feed.put(received(6))  # while it is paused
        texts = [(await page.step(by))['text'] for by in (-1, -2, -100, 1, 100, 0)]
        assert texts == [
            'frame 4 of 5, 0.1 s before', 'frame 2 of 5, 0.3 s before',
            'frame 1 of 5, 0.4 s before, the first one', 'frame 2 of 5, 0.3 s before',
            *['frame 5 of 5, 0.0 s before, the last one'] * 2]
        assert page.pictures['/front'] == [1, 2, 3, 4, 5, 4, 2, 1, 2, 5]
        assert page.channel('/front').shown.of(page._sequence).receive_ns == 5

    run_page(work)


def test_other_topic_shows_the_nearest_stamp() -> None:
    async def work(page: SteppingPage) -> None:
        for number in range(10, 20):
            await page.show('/front', number)
            if number % 4 == 0:
                await page.show('/rear', number)
        page.pause()
        for _ in range(4):
            await page.step(-1, beside='/rear')
        assert page.pictures['/front'][-4:] == [18, 17, 16, 15]
        assert page.pictures['/rear'][-1] == 16
        await page.step(-2, beside='/rear')
        assert (page.pictures['/front'][-1], page.pictures['/rear'][-1]) == (13, 12)
        assert 'text' in await page.step(1, beside='/unknown')
        assert 'text' in await page.step(1, beside='/front')

    run_page(work)


def test_newest_of_the_steps_that_wait_counts() -> None:
    async def work(page: SteppingPage) -> None:
        await page.show('/front', *range(1, 9))
        page.pause()
        page.is_answering = False
        page.steps.ask({'step': '/front', 'by': -1})
        await until(lambda: len(page.pictures['/front']) == 9)
        for by in (-5, -6, -2):
            page.steps.ask({'step': '/front', 'by': by})
            await due()
        page.is_answering = True
        page.channel('/front').answered(page._sequence)
        await until(lambda: len(page.answers) == 2)
        assert page.pictures['/front'][8:] == [7, 5]
        assert [one['text'].split(',')[0] for one in page.answers] == [
            'frame 7 of 8', 'frame 5 of 8']

    run_page(work)


def test_frame_without_a_picture_is_reported() -> None:
    async def work(page: SteppingPage) -> None:
        await page.show('/front', 1)
        stream = page.channel('/front').stream
        stream.feed.put(received(2, data=memoryview(b'short')))
        await until(lambda: stream.broken)
        await page.show('/front', 3)
        page.pause()
        answer = await page.step(-1)
        assert answer['text'] == 'frame 2 of 3, 0.1 s before: the image is empty (100x0)'
        assert (await page.step(-1))['text'] == 'frame 1 of 3, 0.2 s before, the first one'
        assert stream.broken == 1 and stream.error == ''

    run_page(work)


def test_frames_that_the_limit_has_forced_out() -> None:
    limit = 6 * message_size(received(0).image)

    async def work(page: SteppingPage) -> None:
        await page.show('/front', *range(1, 5))
        page.channel('/front').set_options(PAUSED)
        page.steps.follow('/front')
        await page.show('/rear', *range(1, 9))  # half of the limit is for the pause
        reason = f'others needed the {limit} bytes of history_bytes'
        assert (await page.step(-3))['text'] == (
            f'frame 1 of 3, 0.2 s before, earlier ones are gone: {reason}')
        page.history.add(OTHER, received(9, size=6 * SIZE), True)
        assert (await page.step(1))['error'] == f'the node has kept no frame: {reason}'

    run_page(work, limit=limit)


@pytest.mark.parametrize('wrong', [
    {}, {'by': None}, {'by': '1'}, {'by': True}, {'by': [1]}, {'by': 1e9}, {'by': -10**400},
    {'by': 1, 'beside': 7}, {'by': 1, 'step': 5}, {'by': 1, 'step': 'x' * 300}])
def test_steps_that_are_refused(wrong: dict[str, Any]) -> None:
    async def work(page: SteppingPage) -> None:
        with pytest.raises(RequestError):
            page.steps.ask({'step': '/front', **wrong})

    run_page(work)


def test_nothing_to_step_to() -> None:
    async def work(page: SteppingPage) -> None:
        await page.show('/front', 1)
        for name in ('/front', '/unknown'):  # which is live
            assert (await page.step(-1, name))['error'].endswith('resume, then pause again')
        assert not page.steps.ask({'subscribe': '/front'})

    run_page(work)
