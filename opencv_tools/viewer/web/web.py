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

"""Handlers of HTTP: the page, its files and the list of topics."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
import json
from typing import Any

from opencv_tools.base.logs import Log
from opencv_tools.base.regular_files import user_path
from opencv_tools.base.sending import SendingHandler
from opencv_tools.base.text import printable
from opencv_tools.viewer.access import Access, check_origin, is_same_origin
from opencv_tools.viewer.errors import RequestError, WrongTokenError
from opencv_tools.viewer.hub import Hub
from opencv_tools.viewer.overlays.page_overlays import PageOverlays
from opencv_tools.viewer.protocol import parse_message, pong
from opencv_tools.viewer.web.page_files import (
    CALIBRATE, GRAPH, INDEX, PageFile, TOKEN_FORM)
from tornado.web import HTTPError
from tornado.websocket import WebSocketClosedError, WebSocketHandler

_MESSAGES = {404: 'there is no such page', 405: 'only GET and HEAD are allowed'}
# Time until a wrong token is refused, so that nobody can try many.
_REFUSAL_SECONDS = 1.0
_LOG_SECONDS = 10.0
_COOKIE_SECONDS = 90 * 24 * 3600
# Status of WebSockets.
POLICY_VIOLATION, _TRY_AGAIN = 1008, 1013
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self' ws://{host} wss://{host}; form-action 'self'; frame-src 'self'; "
    "base-uri 'none'; frame-ancestors 'none'")


@dataclass(frozen=True)
class Site:
    """
    Everything that the handlers need.

    :param access: rules for requests.
    :param page: files of the page by name.
    :param is_secure: whether the connection is encrypted.
    """

    hub: Hub
    access: Access
    page: Mapping[str, PageFile]
    node: str
    port: int
    is_secure: bool
    log: Log
    overlays: Callable[..., PageOverlays]

    @property
    def cookie(self) -> str:
        """Name of the cookie with the token; cookies of all ports of a host are shared."""
        return f'img_viewer_{self.port}'


class SiteHandler(SendingHandler):
    """A handler that checks the host and the token of each request."""

    site: Site
    needs_token = True
    policy = _POLICY
    resource_policy = 'same-site'

    def initialize(self, site: Site) -> None:
        """Store the site."""
        self.site = site

    async def prepare(self) -> None:
        """Refuse a request of a foreign host or without the token."""
        host = self.request.headers.get('Host', '')
        self.site.access.check_host(host)
        self.set_header('Content-Security-Policy', self.policy.format(host=host))
        if self.needs_token:
            await self.check_token()

    def send_error(self, status_code: int = 500, **kwargs: Any) -> None:
        """Answer with the status of an error."""
        err = kwargs.get('exc_info', (None, None))[1]
        super().send_error(err.status if isinstance(err, RequestError) else status_code, **kwargs)

    def log_exception(self, *exception: Any) -> None:
        """Log an error that is not a refusal."""
        if not isinstance(exception[1], RequestError):
            super().log_exception(*exception)

    async def check_token(self) -> None:
        """
        Check the token in the cookie, in the URL or in the header ``Authorization``.

        :raises RequestError: none of them is the token.
        """
        authorization = self.request.headers.get('Authorization', '')
        try:
            self.site.access.check_token(
                self.get_cookie(self.site.cookie), self.get_query_argument('token', None),
                authorization.removeprefix('Bearer '))
        except WrongTokenError:
            self.site.log.warning(f'{self.request.remote_ip} has given a wrong token',
                                  every=_LOG_SECONDS, key='wrong token')
            await asyncio.sleep(_REFUSAL_SECONDS)
            raise

    def keep_token(self) -> None:
        """Keep the token of the URL in a cookie; the token was checked."""
        token = self.site.access.token
        if token and self.get_query_argument('token', None) == token:
            self.set_cookie(self.site.cookie, token, httponly=True, samesite='Strict',
                            secure=self.site.is_secure,
                            max_age=_COOKIE_SECONDS if self.site.access.is_kept else None)

    def sentence(self, status_code: int, err: BaseException | None) -> str:
        """Return the sentence for an error."""
        return printable(str(err) if isinstance(err, RequestError)
                         else _MESSAGES.get(status_code, self._reason), 1000)

    def write_file(self, file: PageFile) -> None:
        """Write a file of the page."""
        self.set_header('Content-Type', file.content_type)
        self.set_header('Cache-Control', 'no-cache')
        self.set_header('ETag', file.tag)
        if self.check_etag_header():
            self.set_status(304)
            self.finish()
        else:
            self.finish(file.content)


class SocketHandler(SiteHandler, WebSocketHandler):
    """A WebSocket for the pages of this server, within the number of pages."""

    SUPPORTED_METHODS: Any = ('GET',)
    most_bad_messages = 10

    def initialize(self, site: Site) -> None:
        """Store the site."""
        super().initialize(site)
        self._bad_messages = 0

    async def prepare(self) -> None:
        """Refuse a page without the token, a malformed origin, and more pages than allowed."""
        await super().prepare()
        check_origin(self.request.headers.get('Origin', ''))
        self.site.hub.check_room()

    def check_origin(self, origin: str) -> bool:
        """Return whether the page is of this server."""
        return is_same_origin(origin, self.request.headers.get('Host', ''))

    async def on_message(self, message: str | bytes) -> None:
        """Answer a message of the page; the next one is read when the answer was sent."""
        try:
            wanted = parse_message(message)
            answer = pong(wanted['ping']) if 'ping' in wanted else await self.answer(wanted)
        except RequestError as err:
            await self.refuse(err)
        else:
            if answer:
                await self.send_json(answer)

    async def answer(self, wanted: dict[str, Any]) -> dict[str, Any] | None:
        """
        Return the answer to a message, if it has one.

        :raises RequestError: the message cannot be used.
        """
        raise NotImplementedError

    async def refuse(self, err: RequestError) -> None:
        """Send why a message cannot be used; close the connection if there are many."""
        await self.send_json({'error': str(err)})
        self._bad_messages += 1
        if self._bad_messages >= self.most_bad_messages:
            self.close(POLICY_VIOLATION, 'too many messages that cannot be used')

    async def send_json(self, message: dict[str, Any]) -> None:
        """Send a message and wait until it is sent; nothing happens if the page was closed."""
        with suppress(WebSocketClosedError):  # on_close follows
            await self.write_message(json.dumps(message))

    def on_close(self) -> None:
        """Count the page no longer."""
        self.site.hub.connections.discard(self)

    def try_again(self, err: RequestError) -> None:
        """Close the connection, which the page may open again; the reason has 120 bytes."""
        self.close(_TRY_AGAIN, str(err).encode()[:120].decode(errors='ignore'))


class UnknownHandler(SiteHandler):
    """All other addresses."""

    async def prepare(self) -> None:
        """Refuse the request."""
        await super().prepare()
        raise HTTPError(404)


class IndexHandler(SiteHandler):
    """The page, and the form for the token."""

    needs_token = False
    page_name = INDEX

    async def get(self) -> None:
        """Write the page, and keep a token of the URL in a cookie."""
        try:
            await self.check_token()
        except RequestError as err:
            if TOKEN_FORM not in self.site.page:
                raise
            self.set_status(err.status)
            self._write_page(TOKEN_FORM)
            return
        self.keep_token()
        self._write_page(self.page_name)

    def _write_page(self, name: str) -> None:
        file = self.site.page[name]
        self.set_header('Content-Type', file.content_type)
        self.finish(file.content)


class FileHandler(SiteHandler):
    """A file of the page; none of them is secret."""

    needs_token = False

    def get(self, name: str) -> None:
        """Write the file."""
        file = self.site.page.get(name)
        if file is None or name in (INDEX, CALIBRATE, GRAPH, TOKEN_FORM):
            raise HTTPError(404)
        self.write_file(file)


class TopicsHandler(SiteHandler):
    """The image topics as JSON."""

    async def get(self) -> None:
        """Write the list, with the state of topics that somebody looks at."""
        await self.site.hub.refresh()
        self.finish({'node': self.site.node, 'topics': self.site.hub.full_json(),
                     'more': self.site.hub.state.more})


class GraphHandler(IndexHandler):
    """The page of the nodes and topics."""

    page_name = GRAPH


class GraphDataHandler(SiteHandler):
    """The nodes and topics as JSON."""

    async def get(self) -> None:
        """Write them."""
        self.finish(await self.site.hub.node_table())


class BagHandler(SiteHandler):
    """The bag of the last recording."""

    async def get(self) -> None:
        """Write the file, if the node allows it."""
        hub = self.site.hub
        if not hub.settings.record_download:
            raise RequestError('start the node with record_download:=true to download bags', 403)
        name = self.get_query_argument('name', '')
        await hub.refresh()
        account = hub.state.lists().get('recording') or {}
        path = user_path(hub.settings.record_dir).resolve() / name
        if account.get('phase') or name != account.get('name') or not path.is_file():
            raise RequestError(f'{printable(name)} is not the bag of the last recording', 404)
        self.set_header('Content-Type', 'application/octet-stream')
        self.set_header('Content-Disposition', f'attachment; filename="{path.name}"')
        await self.send_file(path, path.stat().st_size)


class HealthHandler(SiteHandler):
    """A sign of life."""

    needs_token = False

    async def get(self) -> None:
        """Write ``ok`` when the executor of the node answers."""
        await self.site.hub.refresh()
        self.set_header('Content-Type', 'text/plain; charset=utf-8')
        self.finish('ok\n')
