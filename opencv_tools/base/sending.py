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

"""A server with few connections, and answers in parts, as fast as the network takes them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from contextlib import suppress
import os
from pathlib import Path
from typing import Any, cast

from opencv_tools.base.regular_files import open_resolved
from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream, StreamClosedError
from tornado.web import HTTPError, RequestHandler

# Time in which an answer, or a part of it, must have been taken by the network.
_TAKEN_SECONDS = 30.0
# Time in which the requests of closed connections must have ended.
_CLOSE_SECONDS = 1.0
_CHUNK = 1 << 18
_WEBSOCKET = 101  # status of an answer after which the connection is a WebSocket


class BoundedServer(HTTPServer):
    """
    A server with a limited number of connections.

    A browser opens six. WebSockets do not count.
    """

    most, most_of_address = 256, 64

    def handle_stream(self, stream: IOStream, address: tuple[str, int]) -> None:
        """Serve a new connection, or close it."""
        addresses = [cast(Any, connection.context).remote_ip
                     for connection in self._connections]
        if len(addresses) >= self.most or addresses.count(address[0]) >= self.most_of_address:
            stream.close()
        else:
            super().handle_stream(stream, address)

    async def end(self) -> None:
        """Close all connections, and cancel every other task of the loop."""
        self.stop()
        asyncio.get_running_loop().set_exception_handler(_log_error)
        with suppress(asyncio.TimeoutError):  # a request may wait for a frame
            await asyncio.wait_for(self.close_all_connections(), _CLOSE_SECONDS)
        pending: set[asyncio.Task[Any]] = set()
        # A request that is cancelled starts a task that writes its answer.
        while not pending and (tasks := asyncio.all_tasks() - {asyncio.current_task()}):
            for task in tasks:
                task.cancel()
            _, pending = await asyncio.wait(tasks, timeout=_CLOSE_SECONDS)


def _log_error(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    if not isinstance(context.get('exception'), asyncio.CancelledError):  # Tornado 6.2 passes it
        loop.default_exception_handler(context)


class SendingHandler(RequestHandler):
    """A handler whose connections keep little memory, and end if nobody reads them."""

    #: Who may show an answer, and what a text may load.
    resource_policy = 'same-origin'
    text_policy = "default-src 'none'; frame-ancestors 'none'"

    def set_default_headers(self) -> None:
        """Set the headers that protect the page."""
        self.clear_header('Server')
        for name, value in (
                ('X-Content-Type-Options', 'nosniff'), ('Referrer-Policy', 'no-referrer'),
                ('Cross-Origin-Resource-Policy', self.resource_policy),
                ('Cache-Control', 'no-store'), ('Content-Security-Policy', self.text_policy)):
            self.set_header(name, value)

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """Write one sentence."""
        self.set_header('Content-Type', 'text/plain; charset=utf-8')
        self.finish(f'{self.sentence(status_code, kwargs.get("exc_info", (None, None))[1])}\n')

    def send_error(self, status_code: int = 500, **kwargs: Any) -> None:
        """Write an error, if the connection is still open."""
        stream = cast(Any, self.request.connection).stream
        if stream and not stream.closed():
            super().send_error(status_code, **kwargs)

    def sentence(self, status_code: int, err: BaseException | None) -> str:
        """Return the sentence for an error."""
        return f'{status_code}: {self._reason}'

    def head(self, *names: str) -> Awaitable[None] | None:
        """Write the header that GET writes."""
        return self.get(*names)

    def compute_etag(self) -> None:
        """Compute no hash of pictures, which are never asked for again."""

    def finish(
        self, chunk: str | bytes | dict[str, Any] | None = None,
    ) -> asyncio.Future[Any]:
        """Write the rest of the answer, and close the connection if nobody reads it."""
        writing = super().finish(chunk)
        if self.get_status() == _WEBSOCKET:
            return writing
        return asyncio.ensure_future(self.is_taken(writing))

    async def is_taken(self, writing: asyncio.Future[None]) -> bool:
        """Return whether the network takes what is written in time; else close the connection."""
        try:
            await asyncio.wait_for(writing, _TAKEN_SECONDS)
        except (StreamClosedError, asyncio.TimeoutError):
            self._abort()
            return False
        return True

    async def send(self, *buffers: bytes | memoryview) -> None:
        """Write an answer, a part after the other, without a copy of the whole."""
        self.set_header('Content-Length', str(sum(map(len, buffers))))
        if self.request.method == 'HEAD':
            return
        for buffer in buffers:
            for begin in range(0, len(buffer), _CHUNK):
                self.write(bytes(buffer[begin:begin + _CHUNK]))
                if not await self.is_taken(self.flush()):
                    return

    async def send_file(self, path: Path, size: int) -> None:
        """
        Write a file.

        :param path: path without links, see `open_resolved`.
        :param size: largest number of bytes.
        :raises HTTPError: the file cannot be opened any more.
        """
        try:
            descriptor = open_resolved(path)
        except OSError as err:
            raise HTTPError(404) from err
        with os.fdopen(descriptor, 'rb', buffering=0) as file:
            left = min(size, os.fstat(descriptor).st_size)
            self.set_header('Content-Length', str(left))
            while left and self.request.method != 'HEAD':
                chunk = await asyncio.to_thread(file.read, min(left, _CHUNK))
                left -= len(chunk)
                self.write(chunk)
                if not await self.is_taken(self.flush()):
                    return
                if not chunk:  # the file has become shorter
                    self._abort()
                    return

    def _abort(self) -> None:
        cast(Any, self.request.connection).close()  # detached, a finished answer would fail
