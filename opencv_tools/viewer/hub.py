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

"""Streams and viewers of the server, and what they know about the graph."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, Protocol, TypeVar

from opencv_tools.base.logs import Log
from opencv_tools.viewer.control import CameraControl
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.executor_calls import ExecutorCalls
from opencv_tools.viewer.graph import Graph, GraphState, open_again, ViewTopic
from opencv_tools.viewer.inspect.history import History
from opencv_tools.viewer.node_table import read_graph
from opencv_tools.viewer.parameters import ViewerSettings
from opencv_tools.viewer.protocol import ViewRequest
from opencv_tools.viewer.streams.feed import Feed, FeedKey
from opencv_tools.viewer.streams.packets import PacketFeed, PACKETS
from opencv_tools.viewer.streams.stream import Stream
from opencv_tools.viewer.streams.video_channel import PacketSource, video_source
from opencv_tools.viewer.watched import in_loop

_T = TypeVar('_T')
_POLL_SECONDS = 1.0
_GOING_AWAY = 1001  # status of WebSockets
_CLOSE_SECONDS = 1.0
_EXECUTOR_SECONDS = 5.0


class Viewer(Protocol):
    """An open page."""

    def update(self, changed: dict[str, Any]) -> None:
        """Send the state, and the lists that have changed."""

    def close(self, code: int | None = None, reason: str | None = None) -> None:
        """Close the connection to the page."""


class Hub:
    """
    Open a stream while somebody looks at it.

    All methods run in the loop of the server.
    """

    def __init__(
        self, settings: ViewerSettings, graph: Graph, calls: ExecutorCalls, pool: Executor,
        log: Log,
    ) -> None:
        """
        Create a hub without streams.

        :param graph: image topics, used in the executor.
        :param pool: threads that encode.
        """
        self.settings = settings
        self.viewers: set[Viewer] = set()
        #: Viewers that are not pages of topics.
        self.connections: set[object] = set()
        #: Functions that are called once a second.
        self.watchers: set[Callable[[], object]] = set()
        self.state = GraphState()
        self.history = History(settings.history_bytes)
        self._graph = graph
        self._calls = calls
        self._pool = pool
        self._log = log
        self._loop = asyncio.get_running_loop()
        self._streams: dict[FeedKey, Stream] = {}
        # Sources of the streams that pages get as video, for slow links or not.
        self._videos: dict[tuple[FeedKey, bool], PacketSource] = {}
        self._pending: asyncio.Future[GraphState] | None = None
        self._poll: asyncio.Task[None] | None = None

    # Viewers

    def check_room(self) -> None:
        """
        Check that another viewer may come.

        :raises RequestError: there are too many.
        """
        if (count := len(self.viewers) + len(self.connections)) >= self.settings.viewers:
            raise RequestError(f'{count} pages look already: close one, or raise the parameter '
                               'viewers', 503)

    def add_connection(self, viewer: object) -> None:
        """
        Count a viewer that is not a page of topics.

        :raises RequestError: there are too many.
        """
        self.check_room()
        self.connections.add(viewer)

    def add_viewer(self, viewer: Viewer) -> None:
        """Send the state to a page from now on."""
        self.viewers.add(viewer)
        self.watch()

    def watch(self, *watchers: Callable[[], object]) -> None:
        """Read the state once a second from now on, and call functions then."""
        self.watchers.update(watchers)
        if self._poll is None or self._poll.done():
            self._poll = asyncio.ensure_future(self._update_viewers())

    async def close(self) -> None:
        """Close all pages."""
        if self._poll:
            self._poll.cancel()
        for viewer in tuple(self.viewers):
            viewer.close(_GOING_AWAY, 'the node has ended')
        deadline = self._loop.time() + _CLOSE_SECONDS
        while self.viewers and self._loop.time() < deadline:
            await asyncio.sleep(_CLOSE_SECONDS / 50)

    # Streams

    async def stream(self, name: str, original: bool = False, video: bool = False,
                     slow: bool = False) -> Stream:
        """
        Return the stream of a topic, which ends in two seconds unless somebody uses it.

        :param original: whether raw images are preferred to other ones.
        :param video: whether the method ``video`` has a source, if the parameters allow it.
        :param slow: whether the source is for a slow link; a video topic is encoded again.
        :raises RequestError: there is no such image topic.
        """
        topic = await self._find(name)
        transport = topic.transport(self.settings.transport, original=original, video=video)
        key = name, 'video' if slow and transport == PACKETS else transport
        stream = self._streams.get(key)
        if stream is None:
            stream = self._streams[key] = Stream(
                topic.number, key, self._loop, self._pool, self._log,
                PacketFeed if transport == PACKETS and not slow else Feed)
            stream.feed.keep = partial(self.history.add, key)
            stream.on_unused = partial(self._close, stream)
            self._calls.call(partial(self._graph.open, key, stream.feed), stream.feed.opened)
        if video and (key, slow) not in self._videos and (
                transport == PACKETS or self.settings.video == 'always'):
            again = partial(open_again, self._graph, key, stream.feed)
            self._videos[key, slow] = video_source(stream, self.settings.rate, partial(
                self._calls.call, again, stream.feed.opened), slow)
        stream.acquire()
        stream.release()
        return stream

    def video(self, stream: Stream, slow: bool) -> PacketSource | None:
        """Return the source of the video of a stream; None if pages get JPEGs."""
        return self._videos.get((stream.key, slow))

    def options(self, requested: ViewRequest) -> ViewRequest:
        """Return what a viewer requests, within the parameters of the node."""
        settings = self.settings
        widths = [width for width in (requested.width, settings.width) if width]
        return replace(
            requested, width=min(widths, default=0), quality=requested.quality or settings.quality,
            rate=min(requested.rate or settings.rate, settings.rate),
            video=requested.video and settings.shown_video != 'never')

    # State

    async def refresh(self) -> GraphState:
        """
        Read the state of the graph in the executor; simultaneous calls share one reading.

        :raises RequestError: the executor is busy, or the state cannot be read.
        """
        if self._pending is None:
            self._pending = _ask(partial(self._calls.call, self._graph.state))
            self._pending.add_done_callback(self._set_state)
        return await _answer(self._pending)

    async def control(
        self, choose: Callable[[CameraControl], Coroutine[Any, Any, dict[str, Any]]],
    ) -> dict[str, Any]:
        """
        Control another node.

        :returns: the answer for the page.
        :raises RequestError: control is off, or the node does not answer.
        """
        if (control := self._graph.control) is None:
            raise RequestError('control is off: start the node with control:=true', 403)
        answer: dict[str, Any] = await _ask(partial(self._calls.start, choose(control)))
        return answer

    async def node_table(self) -> dict[str, Any]:
        """
        Return the nodes and topics of the graph.

        :raises RequestError: the executor is busy.
        """
        read = partial(self._calls.call, partial(read_graph, self._graph.node))
        table: dict[str, Any] = await _answer(_ask(read))
        return table

    def full_json(self) -> list[dict[str, Any]]:
        """Return the list of topics with the state of those that somebody looks at."""
        topics: list[dict[str, Any]] = self.state.lists()['topics']
        for topic in topics:
            for transport in (self.settings.transport, PACKETS):
                if stream := self._streams.get((topic['name'], transport)):
                    topic |= {'status': stream.status(),
                              'viewers': stream.users + topic.get('viewers', 0)}
        return topics

    async def _find(self, name: str) -> ViewTopic:
        """Return a topic, which need not be in the list; refuse a name that is no image topic."""
        if name not in self.state.topics:
            await self.refresh()
        topic = self.state.topics.get(name)
        if topic is None and self.state.more:
            topic = await _answer(_ask(partial(self._calls.call, partial(self._graph.find, name))))
        if topic is None:
            raise RequestError(self.state.describe_unknown(name), 404)
        return topic

    def _set_state(self, read: asyncio.Future[GraphState]) -> None:
        self._pending = None
        if not read.exception():
            self.state = read.result()

    def _close(self, stream: Stream) -> None:
        del self._streams[stream.key]
        for slow in (False, True):
            self._videos.pop((stream.key, slow), None)
        self._calls.call(partial(self._graph.close, stream.key, stream.feed))

    async def _update_viewers(self) -> None:
        """Send the state to all pages once a second, while somebody wants it."""
        before = self.state.lists()
        while self.viewers or self.watchers:
            with suppress(RequestError):
                await self.refresh()
            # Others refresh the state as well, so it is compared with what pages have got.
            lists = self.state.lists()
            changed = {name: value for name, value in lists.items() if value != before.get(name)}
            before = lists
            for viewer in tuple(self.viewers):
                viewer.update(changed)
            for watcher in tuple(self.watchers):
                watcher()
            await asyncio.sleep(_POLL_SECONDS)


def _ask(request: Callable[[Callable[[Any], object]], object]) -> asyncio.Future[Any]:
    """
    Return the answer of the executor to a request.

    :param request: function that gets what the executor calls with the result, or the refusal.
    """
    answered: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
    request(in_loop(partial(_set_result, answered)))
    return answered


async def _answer(future: asyncio.Future[_T]) -> _T:
    """
    Return an answer of the executor, which others may wait for as well.

    :raises RequestError: the executor is busy, or has refused.
    """
    try:
        return await asyncio.wait_for(asyncio.shield(future), _EXECUTOR_SECONDS)
    except asyncio.TimeoutError as err:
        raise RequestError('the node is busy and does not answer: try again', 503) from err


def _set_result(future: asyncio.Future[Any], result: Any) -> None:
    if future.done():  # the page may have been closed
        return
    if isinstance(result, RequestError):
        future.set_exception(result)
    else:
        future.set_result(result)
