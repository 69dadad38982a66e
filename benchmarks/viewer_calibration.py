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

"""
Rate of the search for a board in the page of a calibration, with images of 720p30.

A WebSocket client stands for the page. It reads the pictures and the corners as the page does, but
draws nothing. With --browser, a Chromium shows the page beside it.
"""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, ExitStack
import json
from pathlib import Path
import sys
import tempfile
import time

from figures import add_json_option, Figure, print_figures
from node_process import enter_domain, NodeProcess
from opencv_tools.viewer.protocol import unpack_frame
from tornado.websocket import websocket_connect
from viewer import SETTLE_SECONDS, TOPIC, Viewer

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / 'test' / 'support'))
from chromium import new_browser  # noqa: E402, I100
from shown_boards import BOARD, held_board  # noqa: E402

SIZE = (1280, 720)
RATE, PICTURE_RATE = 30.0, 15.0
WIDTH = 960  # of the pictures, on a screen of 1280x800
PLACES = 12
TOKEN = 'benchmark'
QUERY = f'token={TOKEN}&topic={TOPIC}'


class Counts:
    """Messages of the server so far."""

    searches = found = pictures = 0


@asynccontextmanager
async def opened_page(url: str, shows_pictures: bool) -> AsyncIterator[Counts]:
    """
    Keep a page open that calibrates the topic.

    :param url: address of the viewer's WebSocket.
    :param shows_pictures: whether it reads the pictures.
    """
    counts = Counts()
    pictures = await websocket_connect(f'{url}?token={TOKEN}')
    while f'"{TOPIC}"' not in str(await pictures.read_message()):
        pass  # the publisher is not discovered yet
    session = await websocket_connect(f'{url.replace("/ws", "/calibrate/ws")}?{QUERY}')
    await session.write_message(json.dumps({'board': BOARD}))
    if shows_pictures:
        await pictures.write_message(json.dumps(
            {'subscribe': TOPIC, 'width': WIDTH, 'rate': PICTURE_RATE}))

    async def read_pictures() -> None:
        while (message := await pictures.read_message()) is not None:
            if isinstance(message, bytes):
                counts.pictures += 1
                _, sequence, *_ = unpack_frame(message)
                await pictures.write_message(json.dumps({'got': sequence}))

    async def read_session() -> None:
        while (message := await session.read_message()) is not None:
            seen = json.loads(message).get('seen')
            counts.searches += seen is not None
            counts.found += bool(seen and seen['corners'])

    tasks = [asyncio.ensure_future(read()) for read in (read_pictures, read_session)]
    try:
        yield counts
    finally:
        for task in tasks:
            task.cancel()


async def measure(viewer: Viewer, shows_pictures: bool, seconds: float) -> tuple[float, ...]:
    """Return searches, boards and pictures a second, and the load of a core in percent."""
    async with opened_page(viewer.url, shows_pictures) as counts:
        await asyncio.sleep(SETTLE_SECONDS)
        begin, cpu = time.perf_counter(), viewer.cpu()
        before = counts.searches, counts.found, counts.pictures
        await asyncio.sleep(seconds)
        elapsed = time.perf_counter() - begin
        after = counts.searches, counts.found, counts.pictures
        return (*((late - early) / elapsed for early, late in zip(before, after)),
                100 * (viewer.cpu() - cpu) / elapsed)


def figures(folder: Path, seconds: float, has_browser: bool) -> Iterator[Figure]:
    """Measure the searches without pictures, with pictures, and beside a browser."""
    held_board(folder / 'pictures', PLACES, SIZE, '.bmp')
    with ExitStack() as stack:
        publisher = NodeProcess('publisher', folder, source=folder / 'pictures', loop=0,
                                publish_rate=RATE)
        stack.callback(publisher.end)
        viewer = Viewer('viewer', folder, port=0, control='true', token=TOKEN)
        stack.callback(viewer.end)
        viewer.wait_for('in a browser')
        kinds = {'without pictures': False, 'with pictures': True}
        if has_browser:
            browser = stack.enter_context(new_browser())
            address = viewer.url.replace('ws', 'http', 1).removesuffix('/ws')
            page = browser.new_page(f'{address}/calibrate?{QUERY}')
            page.wait_for('document.querySelector("canvas")?.hidden === false')
            kinds = {'beside Chromium': False}
        for name, shows_pictures in kinds.items():
            searches, found, pictures, load = asyncio.run(
                measure(viewer, shows_pictures, seconds))
            yield Figure('viewer_calibration', f'searches of 720p30, {name}', searches, 'Hz',
                         'at least 10', searches >= 10)
            yield Figure('viewer_calibration', f'boards of 720p30, {name}', found, 'Hz')
            yield Figure('viewer_calibration', f'load of the viewer, {name}', load, '% of a core')
            if shows_pictures:
                yield Figure('viewer_calibration', 'pictures of the page', pictures, 'Hz')


def main() -> int:
    """Print the figures; the exit status is 1 when a goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=10.0, help='of each measurement')
    parser.add_argument('--browser', action='store_true', help='show the page in a Chromium')
    add_json_option(parser)
    options = parser.parse_args()
    enter_domain()
    with tempfile.TemporaryDirectory() as folder:
        found = print_figures(
            figures(Path(folder), options.seconds, options.browser), options.json)
    return int(any(one.met is False for one in found))


if __name__ == '__main__':
    sys.exit(main())
