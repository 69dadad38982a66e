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

"""CPU time and memory of the viewer, with no, one and eight pages."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine, Sequence
from contextlib import asynccontextmanager, suppress
import json
from pathlib import Path
import re
import sys
import tempfile
import time
from typing import Any

from figures import add_json_option, Figure, write_figures
from node_process import enter_domain, NAMESPACE, NodeProcess
from opencv_tools.viewer.protocol import unpack_frame
from tornado.websocket import websocket_connect, WebSocketClientConnection

TOPIC = f'{NAMESPACE}/video_frames'
SOURCE = 'pattern:1920x1080@30'
WIDTH = 640
SETTLE_SECONDS = 3.0
PAGES = 200


class Viewer(NodeProcess):
    """An img_viewer."""

    @property
    def url(self) -> str:
        """Address of the WebSocket."""
        found = re.search(r'Open http(://[^/]+)/\S* in a browser', self.console())
        if not found:
            raise SystemExit(f'the viewer has printed no address:\n{self.console()}')
        return f'ws{found[1]}/ws'

    def memory(self) -> float:
        """Return the resident memory in MB, without that of files."""
        status = Path(f'/proc/{self.process.pid}/status').read_text()
        return int(status.partition('RssAnon:')[2].split()[0]) / 1024

    def descriptors(self) -> int:
        """Return the number of open file descriptors."""
        return len(list(Path(f'/proc/{self.process.pid}/fd').iterdir()))


class Page:
    """A page that answers every picture."""

    def __init__(self, socket: WebSocketClientConnection) -> None:
        """Start reading."""
        self.ages: list[float] = []
        self._socket = socket
        self._reading = asyncio.ensure_future(self._read())

    @classmethod
    async def open(cls, url: str, **options: object) -> Page:  # noqa: A003
        """Open a page that looks at the topic."""
        socket = await websocket_connect(url)
        while f'"{TOPIC}"' not in str(await socket.read_message()):
            pass  # the publisher is not discovered yet
        await socket.write_message(json.dumps({'subscribe': TOPIC, **options}))
        return cls(socket)

    async def close(self) -> None:
        """Close the page."""
        self._reading.cancel()
        self._socket.close()
        with suppress(asyncio.CancelledError):
            await self._reading

    async def _read(self) -> None:
        while True:
            message = await self._socket.read_message()
            if message is None:
                return
            if isinstance(message, bytes):
                _, sequence, stamp, *_ = unpack_frame(message)
                self.ages.append(time.time() - stamp)
                await self._socket.write_message(json.dumps({'got': sequence}))


@asynccontextmanager
async def opened(url: str, count: int, **options: object) -> AsyncIterator[list[Page]]:
    """Keep pages open."""
    pages = [await Page.open(url, **options) for _ in range(count)]
    try:
        yield pages
    finally:
        for page in pages:
            await page.close()


async def load(viewer: Viewer, count: int, seconds: float, **options: object) -> tuple[
        float, float]:
    """Return the load of a core in percent, and the rate of the pictures in Hz."""
    async with opened(viewer.url, count, **options) as pages:
        await asyncio.sleep(SETTLE_SECONDS)
        begin, cpu = time.perf_counter(), viewer.cpu()
        counts = [len(page.ages) for page in pages]
        await asyncio.sleep(seconds)
        cpu, elapsed = viewer.cpu() - cpu, time.perf_counter() - begin
        received = sum(len(page.ages) - before for page, before in zip(pages, counts))
    return 100 * cpu / elapsed, received / elapsed / max(1, count)


async def reception(folder: Path, seconds: float) -> list[Figure]:
    """Measure the load of a node that only receives the raw images, which no page can avoid."""
    receiver = NodeProcess('filter', folder, function='builtins:id', encoding="''",
                           transport='raw')
    try:
        receiver.wait_for('Filtering video frame')
        await asyncio.sleep(SETTLE_SECONDS)
        cpu = receiver.cpu()
        await asyncio.sleep(seconds)
        percent = 100 * (receiver.cpu() - cpu) / seconds
    finally:
        receiver.end()
    print(f'reception of raw 1080p30 alone: {percent:.1f} % of a core')
    return [Figure('viewer', 'reception of raw 1080p30 alone', percent, '% of a core')]


async def loads(folder: Path, seconds: float) -> list[Figure]:
    """Measure the load by the number of pages and by the kind of the topic."""
    figures = await reception(folder, seconds)
    for transport, counts, options, goals in (
            ('raw', (0, 1, 8), {'width': WIDTH}, {0: 0.5, 1: 12.0, 8: 20.0}),
            ('compressed', (1, 8), {}, {})):
        viewer = Viewer('viewer', folder, port=0, transport=transport)
        try:
            viewer.wait_for('in a browser')
            for count in counts:
                percent, rate = await load(viewer, count, seconds, **options)
                what = f'scaled to {WIDTH}' if options else 'passed through'
                goal = goals.get(count)
                figures.append(Figure(
                    'viewer', f'{transport} 1080p30 {what}, {count} pages', percent, '% of a core',
                    f'at most {goal:g}' if goal else '', percent <= goal if goal else None))
                print(f'{figures[-1].name}: {percent:.1f} % of a core, {rate:.1f} Hz')
        finally:
            viewer.end()
    return figures


async def growth(folder: Path, seconds: float) -> list[Figure]:
    """Measure what 200 pages leave behind that were opened and closed."""
    viewer = Viewer('viewer', folder, port=0)

    async def visit() -> None:
        for _ in range(PAGES):
            async with opened(viewer.url, 1, width=WIDTH) as pages:
                while not pages[0].ages:
                    await asyncio.sleep(0.002)

    try:
        viewer.wait_for('in a browser')
        await visit()  # the first ones fill caches
        await asyncio.sleep(SETTLE_SECONDS)
        memory, descriptors = viewer.memory(), viewer.descriptors()
        await visit()
        await asyncio.sleep(SETTLE_SECONDS)
        more = viewer.memory() - memory
        kept = viewer.descriptors() - descriptors
    finally:
        viewer.end()
    print(f'{PAGES} pages opened and closed: {more:.1f} MB and {kept} descriptors more')
    return [Figure('viewer', f'memory after {PAGES} more pages', more, 'MB', 'at most 5',
                   more <= 5),
            Figure('viewer', f'descriptors after {PAGES} more pages', kept, '', 'at most 0',
                   kept <= 0)]


#: Parts of the benchmark, by name.
PARTS: dict[str, Callable[[Path, float], Coroutine[Any, Any, list[Figure]]]] = {
    'loads': loads, 'growth': growth}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=10.0, help='of each measurement')
    parser.add_argument('parts', nargs='*', choices=[[], *PARTS], help='all without any')
    add_json_option(parser)
    options = parser.parse_args(arguments)
    enter_domain()
    figures: list[Figure] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        publisher = NodeProcess('publisher', folder, source=SOURCE, publish_rate=0.0)
        try:
            publisher.wait_for('Publishing video frame')
            for part in options.parts or PARTS:
                figures += asyncio.run(PARTS[part](folder, options.seconds))
        finally:
            publisher.end()
    if options.json:
        write_figures(options.json, figures)
    return 0


if __name__ == '__main__':
    sys.exit(main())
