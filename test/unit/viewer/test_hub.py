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

"""Streams, viewers and the state of the graph."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from conftest import spin_until, spinning
from opencv_tools.base.logs import Log
from opencv_tools.viewer import hub as hub_module
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.executor_calls import ExecutorCalls
from opencv_tools.viewer.graph import Graph, GraphState, ViewTopic
from opencv_tools.viewer.hub import Hub
from opencv_tools.viewer.parameters import ViewerSettings
from opencv_tools.viewer.protocol import ViewRequest
from opencv_tools.viewer.streams.feed import Feed
from opencv_tools.viewer.streams.stream import Stream
from opencv_tools.viewer.watched import Watched
import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage, Image
from waiting import due, result_of, until

Run = Callable[[Callable[[Hub], Coroutine[Any, Any, None]]], None]


class FailingGraph(Graph):
    """A graph that cannot be read from the second time on."""

    reads = 0

    def state(self) -> Any:
        self.reads += 1
        if self.reads > 1:
            raise OSError('the graph is gone')
        return super().state()


class RecordedViewer:
    """A page that keeps what it is sent."""

    def __init__(self) -> None:
        self.updates: list[dict[str, Any]] = []
        self.codes: list[int | None] = []

    def update(self, changed: dict[str, Any]) -> None:
        self.updates.append(changed)

    def close(self, code: int | None = None, reason: str | None = None) -> None:
        self.codes.append(code)


@pytest.fixture
def run(node: Node) -> Run:
    """Return a function that runs the work of a test with a hub."""
    def _run(work: Callable[[Hub], Coroutine[Any, Any, None]]) -> None:
        log = Log(node.get_logger())
        calls = ExecutorCalls(node, log)
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)

        async def begin() -> None:
            with ThreadPoolExecutor(1) as pool:
                hub = Hub(ViewerSettings(quality=70, width=800, rate=20.0),
                          FailingGraph(node, (), 'auto', log, None), calls, pool, log)
                await result_of(work(hub))

        with spinning(executor):
            asyncio.run(begin())

    return _run


def test_wishes_within_the_parameters(run: Run) -> None:
    async def work(hub: Hub) -> None:
        assert hub.options(ViewRequest()) == ViewRequest(width=800, quality=70, rate=20)
        assert hub.options(ViewRequest(width=320, quality=30, rate=5, fixed=True)) == ViewRequest(
            width=320, quality=30, rate=5, fixed=True)
        assert hub.options(ViewRequest(width=1280, quality=90, rate=60)) == ViewRequest(
            width=800, quality=90, rate=20)

    run(work)


def test_graph_that_cannot_be_read(run: Run) -> None:
    async def work(hub: Hub) -> None:
        await hub.refresh()
        for _ in range(2):
            with pytest.raises(RequestError, match='the request has failed: OSError') as caught:
                await hub.refresh()
            assert caught.value.status == 500
        viewer = RecordedViewer()
        hub.add_viewer(viewer)
        await until(lambda: len(viewer.updates) >= 2, updates=lambda: len(viewer.updates))
        await hub.close()
        assert viewer.codes == [1001]

    run(work)


def test_pages_get_what_another_reading_has_found(
        run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hub_module, '_POLL_SECONDS', 0.01)

    async def work(hub: Hub) -> None:
        viewer = RecordedViewer()
        hub.add_viewer(viewer)
        await until(lambda: viewer.updates)
        hub.state = GraphState({'/image': ViewTopic(number=1, name='/image')})
        await until(lambda: [update for update in viewer.updates if 'topics' in update])
        (topics,) = [update['topics'] for update in viewer.updates if 'topics' in update]
        assert [topic['name'] for topic in topics] == ['/image']
        await hub.close()

    run(work)


async def used(hub: Hub) -> Stream:
    stream = await hub.stream('/image')
    stream.acquire()
    return stream


def test_stream_is_kept_for_a_page_that_comes_back(
        run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Watched, 'unused_seconds', 0.0)

    async def work(hub: Hub) -> None:
        hub.state = GraphState({'/image': ViewTopic(number=1, name='/image')})
        stream = await used(hub)
        stream.release()
        assert await used(hub) is stream  # before the stream is closed
        await due()
        assert await used(hub) is stream
        for _ in range(2):
            stream.release()
        await due()
        other = await used(hub)
        assert other is not stream
        subscriptions = hub._graph._open
        await until(lambda: other.feed in [feed for feed, _ in [*subscriptions.values()]])
        other.release()
        await until(lambda: not subscriptions)

    run(work)


def test_only_the_feed_of_a_subscription_closes_it(node: Node) -> None:
    graph = Graph(node, (), 'auto', Log(node.get_logger()), None)
    feed, key = Feed(lambda: None), ('/image', 'auto')
    graph.open(key, feed)
    graph.close(key, Feed(lambda: None))
    assert key[0] in graph.state().topics
    graph.close(key, feed)
    assert not graph.state().topics


@pytest.mark.parametrize(('transport', 'shown'), [
    ('compressedDepth', ['/depth/compressedDepth']), ('raw', ['/depth']),
    ('compressed', ['/depth', '/depth/compressedDepth']),
    ('auto', ['/depth', '/depth/compressedDepth'])])
def test_topics_of_a_transport(node: Node, transport: str, shown: list[str]) -> None:
    node.create_publisher(Image, '/depth', 1)
    for end in ('compressed', 'compressedDepth'):
        node.create_publisher(CompressedImage, f'/depth/{end}', 1)
    graph = Graph(node, (), transport, Log(node.get_logger()), None)
    spin_until(node, lambda: [*graph.state().topics] == shown)


def test_end_without_pages(run: Run) -> None:
    async def work(hub: Hub) -> None:
        with pytest.raises(StopIteration):  # it does not wait
            hub.close().send(None)
        viewer = RecordedViewer()
        hub.add_viewer(viewer)
        ending = hub.close()
        ending.send(None)
        assert viewer.codes == [1001]
        hub.viewers.discard(viewer)
        ending.close()

    run(work)
