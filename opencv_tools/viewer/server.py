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

"""The server of the viewer, in a thread of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
import logging
import os
import socket
from threading import Event, Thread
from typing import Any

from opencv_tools.base.logs import Log
from opencv_tools.base.sending import BoundedServer
from opencv_tools.base.text import without_password
from opencv_tools.viewer.access import Access, read_token
from opencv_tools.viewer.calibrate.routes import calibration_routes
from opencv_tools.viewer.calibrate.sessions import Calibrations
from opencv_tools.viewer.certificate import load_tls
from opencv_tools.viewer.errors import ViewerError
from opencv_tools.viewer.executor_calls import ExecutorCalls
from opencv_tools.viewer.graph import Graph
from opencv_tools.viewer.hub import Hub
from opencv_tools.viewer.inspect.picture_files import PictureFiles
from opencv_tools.viewer.overlays.page_overlays import PageOverlays
from opencv_tools.viewer.overlays.sources import OverlaySources
from opencv_tools.viewer.parameters import ViewerSettings
from opencv_tools.viewer.protocol import MAX_MESSAGE_BYTES
from opencv_tools.viewer.robot.live import LiveRobots
from opencv_tools.viewer.robot.routes import robot_routes, with_robot_page
from opencv_tools.viewer.web.page_files import read_page
from opencv_tools.viewer.web.page_socket import PageSocket
from opencv_tools.viewer.web.web import (
    BagHandler, FileHandler, GraphDataHandler, GraphHandler, HealthHandler,
    IndexHandler, Site, TopicsHandler, UnknownHandler)
from opencv_tools.viewer.web.web_video_server import (
    SnapshotHandler, StreamHandler, StreamViewerHandler)
from tornado.netutil import bind_sockets
from tornado.web import Application

_ENCODERS = 2
_END_SECONDS = 5.0
# Time in which a connection must have sent the header of a request.
_HEADER_SECONDS = 5
# Time in which a page on a slow link must have read its first picture.
_PING_SECONDS = 20
_MAX_HEADER_BYTES = 16_384
_MAX_BODY_BYTES = 4096


class ViewerServer:
    """Serve the page from a thread of its own."""

    def __init__(
        self, settings: ViewerSettings, node: str, graph: Graph, calls: ExecutorCalls, log: Log,
        on_failure: Callable[[], object],
    ) -> None:
        """
        Listen on the port.

        :param graph: image topics, used in the executor.
        :param on_failure: called in the thread if the server ends by itself.
        :raises ViewerError: the port, the address or the certificate cannot be used.
        """
        self._settings = settings
        self._node = node
        self._graph = graph
        self._calls = calls
        self._log = log
        self._on_failure = on_failure
        self._tls = load_tls(settings.certificate, settings.key,
                             [socket.gethostname(), *_own_address()])
        self._sockets = _listen(settings.address, settings.port)
        self._port: int = self._sockets[0].getsockname()[1]
        token = read_token(settings.token_file) if settings.token_file else settings.token
        self._access = Access.create(
            token, settings.address, settings.control, settings.allowed_hosts,
            settings.allowed_origins, bool(settings.token_file))
        _pass_on_errors(log)
        self._loop = asyncio.new_event_loop()
        self._end = asyncio.Event()
        self._has_started = Event()
        self._thread = Thread(target=self._run, name='viewer', daemon=True)
        self._thread.start()
        self._has_started.wait()

    @property
    def has_token(self) -> bool:
        """Return whether a browser needs a token."""
        return bool(self._access.token)

    @property
    def fingerprint(self) -> str:
        """Return the SHA-256 of a created certificate, as browsers show it; '' for another one."""
        return self._tls.fingerprint if self._tls else ''

    @property
    def urls(self) -> list[str]:
        """Return the addresses of the page with its token, for browsers of other machines."""
        address = self._settings.address
        if address in ('0.0.0.0', '::'):
            hosts = [socket.gethostname(), *_own_address()]
        else:
            hosts = [f'[{address}]' if ':' in address else address]
        token = f'?token={self._access.token}' if self._access.token else ''
        scheme = 'https' if self._tls else 'http'
        return [f'{scheme}://{host}:{self._port}/{token}' for host in hosts]

    def close(self) -> None:
        """Close all connections and end the thread."""
        with suppress(RuntimeError):  # it has ended by itself
            self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(_END_SECONDS)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        except Exception as err:  # noqa: B902 (the node must not go on without its server)
            self._log.error(f'the server has failed: {type(err).__name__}: {err}')
        finally:
            self._has_started.set()
            if not self._end.is_set():
                self._on_failure()
            self._loop.close()

    async def _serve(self) -> None:
        with ThreadPoolExecutor(_ENCODERS, 'encoder') as pool:
            hub = Hub(self._settings, self._graph, self._calls, pool, self._log)
            recorder = self._graph.control and self._graph.control.recorder
            if recorder and hub.history.limit:
                recorder.frames_of = hub.history.frames
            site = Site(hub, self._access, with_robot_page(read_page()), self._node,
                        self._port, self._tls is not None, self._log,
                        partial(PageOverlays, OverlaySources(self._graph.overlays, self._calls)))
            calibrations = Calibrations(hub, self._log)
            robots = LiveRobots(hub, self._graph.robot, self._calls)
            application = _application(
                site, calibrations=calibrations, robots=robots, files=PictureFiles())
            server = BoundedServer(
                application, ssl_options=self._tls and self._tls.context,
                max_header_size=_MAX_HEADER_BYTES, max_body_size=_MAX_BODY_BYTES,
                body_timeout=_HEADER_SECONDS, idle_connection_timeout=_HEADER_SECONDS)
            server.add_sockets(self._sockets)
            self._has_started.set()
            await self._end.wait()
            server.stop()
            await hub.close()
            calibrations.close()
            robots.close()
            await server.end()


class _NodeHandler(logging.Handler):
    """Log errors of Tornado as one line of the node."""

    def __init__(self, log: Log) -> None:
        super().__init__(logging.ERROR)
        self._log = log

    def emit(self, record: logging.LogRecord) -> None:
        err = record.exc_info[1] if record.exc_info else None
        first_line, *_ = record.getMessage().splitlines() or ['']
        self._log.error(without_password(first_line)
                        + (f': {type(err).__name__}: {err}' if err else ''),
                        every=1.0, key=record.name)


def _application(site: Site, **settings: Any) -> Application:
    keywords = {'site': site}
    return Application([
        ('/', IndexHandler, keywords),
        ('/page/([A-Za-z0-9_.-]+)', FileHandler, keywords),
        ('/ws', PageSocket, keywords),
        ('/topics', TopicsHandler, keywords),
        ('/healthz', HealthHandler, keywords),
        ('/bag', BagHandler, keywords),
        ('/graph', GraphHandler, keywords),
        ('/graph.json', GraphDataHandler, keywords),
        ('/snapshot', SnapshotHandler, keywords),
        ('/stream', StreamHandler, keywords),
        ('/stream_viewer', StreamViewerHandler, keywords),
        *calibration_routes(site),
        *robot_routes(site),
    ], default_handler_class=UnknownHandler, default_handler_args=keywords,
        log_function=lambda _: None, **settings, compress_response=True,
        websocket_ping_interval=_PING_SECONDS, websocket_ping_timeout=_PING_SECONDS,
        websocket_max_message_size=MAX_MESSAGE_BYTES)


def _listen(address: str, port: int) -> list[socket.socket]:
    try:
        return bind_sockets(port, address)
    except socket.gaierror as err:
        raise ViewerError(f'address {address!r} is unknown: {err.strerror}; set address to an '
                          'address of this machine') from err
    except (OSError, UnicodeError) as err:
        reason = os.strerror(err.errno) if isinstance(err, OSError) and err.errno else str(err)
        raise ViewerError(f'port {port} of {address} cannot be used: {reason}; set port or '
                          'address') from err


def _pass_on_errors(log: Log) -> None:
    """Log errors of Tornado and asyncio with the node; requests are never logged."""
    for name in ('tornado', 'asyncio'):
        logger = logging.getLogger(name)
        logger.handlers = [_NodeHandler(log)]
        logger.propagate = False


def _own_address() -> list[str]:
    """Return the address of this machine in its network; empty without one. Nothing is sent."""
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(('192.0.2.1', 9))  # an address of no machine, see RFC 5737
        return [str(probe.getsockname()[0])]
    return []
