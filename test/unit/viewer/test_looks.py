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

"""Questions of a page that wait, without a node."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Event
from typing import Any

from console import Console
import cv2
from images import oriented_jpeg, UPRIGHT
import numpy as np
from opencv_tools.image.cdr import NO_HEADER, WireCompressedImage
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.layout import array_to_wire
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.inspect.looks import _ANSWERS, Looks, MAX_LOOKS
from opencv_tools.viewer.protocol import ViewRequest
from opencv_tools.viewer.streams.channel import Channel
from opencv_tools.viewer.streams.stream import Stream
import pytest
from waiting import pause_loop, until

OPTIONS = ViewRequest(quality=80, rate=1000.0, looks=True)
QUALITIES = {'.jpg': cv2.IMWRITE_JPEG_QUALITY, '.webp': cv2.IMWRITE_WEBP_QUALITY}
PIXEL, HISTOGRAM = {'pixel': '/front', 'at': [0, 0]}, {'histogram': '/front', 'region': None}


class Asker:
    """A page that shows a topic and asks about its pictures."""

    def __init__(self) -> None:
        self.pool = ThreadPoolExecutor(1)
        self.stream = Stream(
            1, ('/front', 'auto'), asyncio.get_running_loop(), self.pool, Console())
        self.sent = 0
        self.answers: list[dict[str, Any]] = []
        self.channel = Channel(self.stream, OPTIONS, self._send)
        self.looks = Looks({'/front': self.channel}.get, self._write)

    async def show(self, level: int) -> int:
        """Publish a frame and draw it; return the number of its picture."""
        return await self.show_message(array_to_wire(
            np.full((48, 64), level, np.uint8), find_encoding('mono8')))

    async def show_message(self, message: Any) -> int:
        expected = self.sent + 1
        self.stream.feed.put(ReceivedMessage(message, 0))
        await until(lambda: self.sent == expected)
        self.channel.answered(expected)
        return expected

    def close(self) -> None:
        self.looks.close()
        self.channel.close()
        self.pool.shutdown()

    @contextmanager
    def busy(self) -> Iterator[None]:
        """Let the pool do nothing."""
        may_end = Event()
        self.pool.submit(may_end.wait)
        try:
            yield
        finally:
            may_end.set()

    async def answer(self, count: int) -> dict[str, Any]:
        """Wait for a number of answers; return the last one."""
        await until(lambda: len(self.answers) >= count)
        (answer,) = self.answers[-1].values()
        return answer

    def _send(self, *_: object) -> int:
        self.sent += 1
        return self.sent

    async def _write(self, message: dict[str, Any]) -> None:
        self.answers.append(message)


def test_frame_waits_with_its_question() -> None:
    async def work() -> None:
        page = Asker()
        first = await page.show(50)
        with page.busy():
            assert page.looks.ask({**HISTOGRAM, 'picture': first})
            assert page.looks.ask({**PIXEL, 'picture': first})
            await pause_loop()  # the histogram waits for the pool, the pixel for the histogram
            page.channel.shown.drawn(first + 1, None)  # the page draws the next picture
        assert (await page.answer(2))['text'] == '50'
        assert [next(iter(one)) for one in page.answers] == ['histogram', 'pixel']
        page.looks.ask({**PIXEL, 'picture': first})
        assert (await page.answer(3))['error'].endswith('no more: wait for the next one')
        page.close()

    asyncio.run(work())


def test_questions_that_wait_are_bounded() -> None:
    async def work() -> None:
        page = Asker()
        for number in range(len(_ANSWERS) * MAX_LOOKS):
            assert page.looks.ask({'pixel': f'/{number}', 'at': [0, 0], 'picture': 1})
        with pytest.raises(RequestError, match='questions about 4 topics wait'):
            page.looks.ask({'pixel': '/another', 'at': [0, 0], 'picture': 1})
        assert page.looks.ask({'pixel': '/0', 'at': [1, 1], 'picture': 1})  # instead of the first
        await page.answer(len(_ANSWERS) * MAX_LOOKS)
        assert {one['pixel']['topic'] for one in page.answers} == {
            f'/{number}' for number in range(len(_ANSWERS) * MAX_LOOKS)}
        page.close()

    asyncio.run(work())


def test_value_of_a_jpeg_that_the_page_shows_turned() -> None:
    async def work() -> None:
        page = Asker()
        shown = np.zeros((64, 48, 3), np.uint8)
        shown[:16, 32:] = 255
        picture = await page.show_message(WireCompressedImage(
            header=NO_HEADER, format='jpeg',
            data=oriented_jpeg(np.ascontiguousarray(UPRIGHT[8](shown)), 6)))
        for place, level in (([47, 0], 255), ([0, 0], 0), ([47, 63], 0)):
            page.looks.ask({'pixel': '/front', 'at': place, 'picture': picture})
            answer = await page.answer(len(page.answers) + 1)
            assert answer['text'] == f'B {level}, G {level}, R {level} of the JPEG'
        page.close()

    asyncio.run(work())


@pytest.mark.parametrize(('suffix', 'quality', 'end'), [
    ('.png', None, ''), ('.jpg', 95, ' of the JPEG'), ('.webp', 101, ''),
    ('.webp', 90, ' of the WebP')])
def test_value_names_the_codec_that_changes_it(
        suffix: str, quality: int | None, end: str) -> None:
    async def work() -> None:
        page = Asker()
        content = cv2.imencode(suffix, np.full((48, 64, 3), 90, np.uint8), (
            () if quality is None else (QUALITIES[suffix], quality)))[1].tobytes()
        picture = await page.show_message(WireCompressedImage(
            header=NO_HEADER, format=suffix[1:], data=content))
        page.looks.ask({**PIXEL, 'picture': picture})
        assert (await page.answer(1))['text'] == f'B 90, G 90, R 90{end}'
        page.close()

    asyncio.run(work())
