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

"""Files of the pictures that a page shows, without a node."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.inspect import picture_files
from opencv_tools.viewer.inspect.picture_files import PictureFiles
import pytest
from test_channel import until
from test_looks import Asker

GONE = 'the node has the frame of this picture no more: '


class Saver(Asker):
    """A page that saves its pictures."""

    def __init__(self) -> None:
        super().__init__()
        self.files = PictureFiles()

    def ask(self, picture: Any, topic: str = '/front') -> dict[str, Any]:
        """Return the answer about a picture: its address, or an error."""
        answer: dict[str, Any] = self.files.answer(
            {'file': topic, 'picture': picture}, {'/front': self.channel})['file']
        assert answer.pop('topic') == topic
        return answer

    def level(self, answer: dict[str, Any]) -> int:
        """Return the value of the pixels of the frame at an address, which is taken."""
        (key,) = parse_qs(urlsplit(answer['address']).query)['picture']
        _, frame = self.files.take(key)
        return int(np.frombuffer(frame.message.data, np.uint8)[0])


def test_frame_of_the_picture_waits_for_its_page() -> None:
    async def work() -> None:
        page = Saver()
        answers = []
        for level in (50, 110, 170):
            answers.append(page.ask(await page.show(level)))
        await page.show(230)
        assert [page.level(answer) for answer in answers] == [50, 110, 170]
        with pytest.raises(RequestError, match='no longer kept: save it again'):
            page.level(answers[0])  # it was taken
        page.close()

    asyncio.run(work())


def test_picture_that_is_gone() -> None:
    async def work() -> None:
        page = Saver()
        first, second = await page.show(50), await page.show(110)
        for gone in (first, second + 1, 2 ** 53):
            assert page.ask(gone) == {'error': GONE + 'wait for the next one'}
        with pytest.raises(RequestError, match="picture is '-1'"):
            page.ask(-1)
        page.channel.set_options(replace(page.channel.options, held=True))  # a pause
        assert page.level(page.ask(second)) == 110
        assert page.ask(first) == {'error': GONE + 'resume the page'}
        assert page.ask(second, '/rear') == {'error': GONE + 'resume the page'}
        page.close()

    asyncio.run(work())


def test_picture_of_the_grid() -> None:
    async def work() -> None:
        page = Saver()
        page.channel.set_options(replace(page.channel.options, looks=False))  # in the grid
        picture = await page.show(50)
        assert page.level(page.ask(picture)) == 50
        await page.show(110)
        assert page.ask(picture)['error'].endswith('show the topic alone, then save')
        assert page.level(page.ask(picture + 1)) == 110
        page.close()

    asyncio.run(work())


@pytest.mark.parametrize('picture', [None, '1', -2, True, 1e300, [1], float('nan')])
def test_number_that_is_refused(picture: Any) -> None:
    with pytest.raises(RequestError, match='picture is '):
        PictureFiles().answer({'file': '/front', 'picture': picture}, {})


def test_few_frames_wait_for_a_short_time(monkeypatch: pytest.MonkeyPatch) -> None:
    async def work() -> None:
        page = Saver()
        picture = await page.show(50)
        first, *others = (page.ask(picture) for _ in range(9))
        with pytest.raises(RequestError):
            page.level(first)
        assert [page.level(answer) for answer in others] == [50] * 8
        monkeypatch.setattr(picture_files, '_SECONDS', 0.0)
        late = page.ask(picture)
        await until(lambda: not page.files._kept)
        with pytest.raises(RequestError):
            page.level(late)
        page.close()

    asyncio.run(work())
