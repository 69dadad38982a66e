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

"""Answers that nobody reads, without a node."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack
import socket
from typing import Any, cast

from opencv_tools.base import sending
from opencv_tools.base.logs import Log
from opencv_tools.base.sending import BoundedServer, SendingHandler
from opencv_tools.viewer.access import Access
from opencv_tools.viewer.hub import Hub
from opencv_tools.viewer.web.web import Site, SiteHandler
import pytest
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application
from waiting import LONGEST_SECONDS, result_of, until

_LARGE = 50_000_000  # bytes, more than the buffers of two sockets


class AnswerHandler(SiteHandler):
    """A handler that waits until its answer is read."""

    async def get(self) -> None:
        await self.finish(bytes(_LARGE))
        self.application.settings['ended'].set()


class PartHandler(SiteHandler):
    """A handler that waits until a part of its answer is read."""

    async def get(self) -> None:
        self.write(bytes(_LARGE))
        assert not await self.is_taken(self.flush())
        self.application.settings['ended'].set()


@pytest.mark.parametrize('handler', [AnswerHandler, PartHandler])
def test_answer_that_is_not_read_ends(
        handler: type[SiteHandler], monkeypatch: pytest.MonkeyPatch,
        caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(sending, '_TAKEN_SECONDS', 0.1)

    async def ask() -> int:
        ended = asyncio.Event()
        site = Site(cast(Hub, None), Access('', {'localhost'}), {}, '/viewer', 0, False,
                    cast(Log, None), cast(Any, None))
        server = HTTPServer(Application(
            [('/', handler, {'site': site})], log_function=lambda _: None, ended=ended))
        (listening,) = bind_sockets(0, '127.0.0.1')
        server.add_sockets([listening])
        with socket.socket() as unread:
            unread.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            unread.settimeout(LONGEST_SECONDS)
            unread.connect(listening.getsockname())
            unread.sendall(b'GET / HTTP/1.1\r\nHost: localhost\r\n\r\n')
            await result_of(ended.wait())
            server.stop()
            await server.close_all_connections()
            return await asyncio.to_thread(_count_bytes, unread)

    assert 0 < asyncio.run(ask()) < _LARGE
    assert not caplog.records


class WaitingHandler(SendingHandler):
    """A handler that waits for an event."""

    async def get(self) -> None:
        self.application.settings['waiting'].append(self)
        await self.ready()

    async def ready(self) -> None:
        await asyncio.Event().wait()


class PartsHandler(WaitingHandler):
    """A handler that waits after the first part of its answer."""

    async def ready(self) -> None:
        self.write('part')
        await self.flush()
        await super().ready()


class ClosedHandler(WaitingHandler):
    """A handler that answers some turns of the loop after its connection is closed."""

    def initialize(self) -> None:
        self._closed = asyncio.Event()

    def on_connection_close(self) -> None:
        self._closed.set()

    async def ready(self) -> None:
        await self._closed.wait()
        await asyncio.to_thread(bool)


@pytest.mark.parametrize('count', [1, 7, 40])
@pytest.mark.parametrize('handler', [WaitingHandler, PartsHandler, ClosedHandler])
def test_end_with_open_requests(
    handler: type[WaitingHandler], count: int, caplog: pytest.LogCaptureFixture,
) -> None:
    async def ask() -> None:
        waiting: list[SendingHandler] = []
        server = BoundedServer(Application(
            [('/', handler)], log_function=lambda _: None, waiting=waiting))
        (listening,) = bind_sockets(0, '127.0.0.1')
        server.add_sockets([listening])
        with ExitStack() as stack:
            for _ in range(count):
                connection = stack.enter_context(socket.socket())
                connection.connect(listening.getsockname())
                connection.sendall(b'GET / HTTP/1.1\r\nHost: localhost\r\n\r\n')
            await until(lambda: len(waiting) == count)
            await server.end()
        assert asyncio.all_tasks() == {asyncio.current_task()}

    asyncio.run(ask())
    assert not caplog.records


def _count_bytes(connection: socket.socket) -> int:
    """Return the number of bytes until the server closes the connection."""
    return sum(map(len, iter(lambda: connection.recv(65_536), b'')))
