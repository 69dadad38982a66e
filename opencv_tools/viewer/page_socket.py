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

"""The WebSocket of a page."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import suppress
from functools import partial
import json
import socket
import time
from typing import Any

from opencv_tools.viewer.access import is_same_origin
from opencv_tools.viewer.channel import Channel
from opencv_tools.viewer.control import Control
from opencv_tools.viewer.encoding import Picture
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.feed import NewFrame
from opencv_tools.viewer.graph import MAX_TOPICS
from opencv_tools.viewer.protocol import (
    pack_frame, parse_message, parse_options, topic_of, VERSION)
from opencv_tools.viewer.web import Refusal, SiteHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

_MAX_BAD_MESSAGES = 10
_POLICY_VIOLATION = 1008

_Message = dict[str, Any]
# What each word of a page makes the control do, given the node and the message.
_CONTROLS: dict[str, Callable[[Control, Any, _Message], Coroutine[Any, Any, _Message]]] = {
    'parameters': lambda control, node, _: control.parameters(node),
    'set': lambda control, node, message: control.set(
        node, message.get('name'), message.get('value')),
    'capture': lambda control, node, message: control.capture(node, message.get('on')),
    'save': lambda control, node, _: control.save(node),
}


class PageSocket(SiteHandler, WebSocketHandler):
    """Send pictures and states to a page, and read its wishes."""

    def prepare(self) -> None:
        """Refuse a page without the token, and more pages than allowed."""
        super().prepare()
        try:
            self.site.hub.check_room()
        except RequestError as err:
            raise Refusal(err) from err

    def check_origin(self, origin: str) -> bool:
        """Return whether the page is of this server."""
        return is_same_origin(origin, self.request.headers.get('Host', ''))

    def open(self) -> None:  # noqa: A003
        """Send the state of the node."""
        self._channels: dict[str, Channel] = {}
        self._sequence = 0
        self._bad_messages = 0
        self._sending: asyncio.Future[None] | None = None
        self.set_nodelay(True)
        hub = self.site.hub
        settings = hub.settings
        self._post({'hello': {
            'version': VERSION, 'node': self.site.node, 'host': socket.gethostname(),
            'control': settings.control, 'width': settings.width, 'quality': settings.quality,
            'rate': settings.rate, 'now': time.time()}})
        for name, value in hub.lists().items():
            self._post({name: value})
        hub.add_viewer(self)

    def on_close(self) -> None:
        """Release the streams of the page."""
        self.site.hub.viewers.discard(self)
        for name in tuple(getattr(self, '_channels', ())):
            self._unsubscribe(name)

    async def on_message(self, message: str | bytes) -> None:
        """Fulfil a wish of the page; the next message is read when the answer was sent."""
        try:
            answer = await self._answer(parse_message(message))
        except RequestError as err:
            self._bad_messages += 1
            answer = {'error': str(err)}
        if answer:
            with suppress(WebSocketClosedError):
                await self.write_message(json.dumps(answer))
        if self._bad_messages >= _MAX_BAD_MESSAGES:
            self.close(_POLICY_VIOLATION, 'too many messages that cannot be used')

    def update(self, changed: dict[str, Any]) -> None:
        """Send the state, unless the page has not read the last one."""
        for name, value in changed.items():
            self._post({name: value})
        if self._channels and (self._sending is None or self._sending.done()):
            hub = self.site.hub
            self._post({'status': [
                {**hub.status(channel.stream), **channel.status()}
                for channel in self._channels.values()]})

    async def _answer(self, message: _Message) -> _Message | None:
        """Fulfil a wish and return the answer."""
        if 'got' in message:
            self._acknowledge(message['got'])
        elif 'ping' in message:
            return {'pong': message['ping'], 'now': time.time()}
        elif 'subscribe' in message:
            return await self._subscribe(message)
        elif 'unsubscribe' in message:
            self._unsubscribe(topic_of(message['unsubscribe']))
        else:
            return await self._control(message)
        return None

    async def _control(self, message: _Message) -> _Message:
        """Control a camera or a recorder; a refusal has the form of the answer."""
        kind = next((key for key in _CONTROLS if key in message), None)
        if kind is None:
            raise RequestError('the message has no known word, such as subscribe or got')
        try:
            return await self.site.hub.control(
                lambda control: _CONTROLS[kind](control, message[kind], message))
        except RequestError as err:
            return {kind: {'node': message[kind], 'name': message.get('name'), 'ok': False,
                           'message': str(err)}}

    def _acknowledge(self, sequence: Any) -> None:
        if not isinstance(sequence, int) or not 0 < sequence <= self._sequence:
            raise RequestError('got is not the number of a picture')
        for channel in self._channels.values():
            if channel.answered(sequence):
                return

    async def _subscribe(self, message: _Message) -> _Message | None:
        name = topic_of(message['subscribe'])
        options = self.site.hub.options(parse_options(message))
        if name in self._channels:
            self._channels[name].set_options(options)
            return None
        if len(self._channels) >= MAX_TOPICS:
            raise RequestError(f'a page can look at {MAX_TOPICS} topics at most')
        try:
            stream = await self.site.hub.acquire(name)
        except RequestError as err:
            return {'error': str(err), 'topic': name}
        if self.ws_connection is None or name in self._channels:
            self.site.hub.release(stream)  # the page was closed meanwhile
            return None
        self._channels[name] = Channel(
            stream, options, partial(self._send_picture, stream.number))
        return None

    def _unsubscribe(self, name: str) -> None:
        channel = self._channels.pop(name, None)
        if channel:
            channel.close()
            self.site.hub.release(channel.stream)

    def _send_picture(self, number: int, frame: NewFrame, picture: Picture) -> int:
        self._sequence += 1
        self._start(pack_frame(
            number, self._sequence, frame.stamp, time.time(), picture.data), binary=True)
        return self._sequence

    def _post(self, message: _Message) -> None:
        """Send a message without waiting for the page to read it."""
        self._sending = self._start(json.dumps(message))

    def _start(self, message: str | bytes, binary: bool = False) -> asyncio.Future[None] | None:
        """Begin to send a message; nothing happens if the page was closed."""
        with suppress(WebSocketClosedError):  # on_close follows
            future = self.write_message(message, binary)
            future.add_done_callback(_ignore_closed)
            return future
        return None


def _ignore_closed(future: asyncio.Future[None]) -> None:
    if not future.cancelled():
        future.exception()
