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
from dataclasses import replace
from functools import partial
import json
import socket
import time
from typing import Any

from opencv_tools.viewer.control import CameraControl, recorder_of
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.inspect.looks import Looks, MAX_LOOKS
from opencv_tools.viewer.inspect.steps import Steps
from opencv_tools.viewer.protocol import (
    MAX_TOPICS, pack_frame, pack_video, parse_codecs, parse_options, topic_of, valid_number,
    ViewRequest, WIDTHS)
from opencv_tools.viewer.streams.channel import Channel
from opencv_tools.viewer.streams.stream import Stream
from opencv_tools.viewer.streams.video_channel import VideoChannel, VideoLink
from opencv_tools.viewer.web.web import POLICY_VIOLATION, SocketHandler
from tornado.websocket import WebSocketClosedError

# Unread pictures of topics that the page has left.
_MAX_STALE = 8
# Requests for control that wait for the one before.
_MAX_WAITING = 20

_Message = dict[str, Any]
_Control = Callable[[CameraControl, Any, _Message, Steps], Coroutine[Any, Any, _Message]]
# What each word of a page makes the control do, given what it names and the message.
_CONTROLS: dict[str, _Control] = {
    'parameters': lambda control, node, *_: control.parameters(node),
    'set': lambda control, node, message, _: control.set(
        node, message.get('name'), message.get('value')),
    'capture': lambda control, node, message, _: control.capture(node, message.get('on')),
    'save': lambda control, node, *_: control.save(node),
    'keep': lambda control, wanted, _, steps: recorder_of(control).keep(wanted, steps.kept()),
    'record': lambda control, wanted, message, _: recorder_of(control).request(
        wanted, message.get('since')),
}


class PageSocket(SocketHandler):
    """Send pictures and states to a page, and read its requests."""

    def open(self, *_args: str, **_options: str) -> None:  # noqa: A003
        """Send the state of the node."""
        self._channels: dict[str, Channel | VideoChannel] = {}
        self._links: dict[str, VideoLink] = {}
        self._codecs: frozenset[str] = frozenset()
        self._sequence = 0
        self._changed: _Message = {}
        self._sending: asyncio.Future[None] | None = None
        self._writing: dict[int, asyncio.Future[None]] = {}
        self._controlling = asyncio.Lock()
        self._looks = Looks(self._channels.get, self.send_json)
        self._overlays = self.site.overlays(
            self._channels.get, self.send_json,
            lambda message: self._start(json.dumps(message)))
        self._steps = Steps(self.site.hub.history, self._channels, self.send_json)
        self._tasks: set[asyncio.Task[None]] = set()
        self.set_nodelay(True)
        hub = self.site.hub
        self._post({'hello': {
            'host': socket.gethostname(), 'control': hub.settings.control, 'widths': WIDTHS,
            'download': hub.settings.record_download,
            'video': hub.settings.shown_video, 'token': self.site.access.token}})
        for name, value in hub.state.lists().items():
            self._post({name: value})
        hub.add_viewer(self)

    def on_close(self) -> None:
        """Release the streams of the page."""
        self.site.hub.viewers.discard(self)
        for name in tuple(getattr(self, '_channels', ())):
            self._unsubscribe(name)
        if hasattr(self, '_looks'):
            self._looks.close()
            self._overlays.close()
            self._steps.close()
        for task in tuple(getattr(self, '_tasks', ())):
            task.cancel()

    def update(self, changed: dict[str, Any]) -> None:
        """Send the state, unless the page has not read the last one."""
        self._changed |= changed
        if self._sending and not self._sending.done():
            return
        for name, value in self._changed.items():
            self._post({name: value})
        self._changed = {}
        if self._channels:
            self._post({'status': [
                {**channel.stream.status(), **channel.status(), **self._overlays.status(name)}
                for name, channel in self._channels.items()]})
        for name, channel in tuple(self._channels.items()):
            if isinstance(channel, VideoChannel) and channel.link.is_slow != channel.options.slow:
                self._add_task(self._subscribe_again(name, channel.options))

    async def answer(self, message: _Message) -> _Message | None:
        """Return the answer to a request; control of other nodes has a task of its own."""
        if 'got' in message:
            self._acknowledge(message['got'], valid_number(
                message.get('busy', 0), 'busy', 0, 3600))
        elif 'codecs' in message:
            self._codecs = parse_codecs(message['codecs'])
        elif 'key' in message:
            channel = self._channels.get(topic_of(message['key']))
            if isinstance(channel, VideoChannel):
                channel.request_key()
        elif 'subscribe' in message:
            name = topic_of(message['subscribe'])
            answer = await self._subscribe(name, parse_options(message))
            self._steps.follow(name)
            return answer
        elif 'file' in message:
            file: _Message = self.settings['files'].answer(message, self._channels)
            return file
        elif 'unsubscribe' in message:
            self._unsubscribe(topic_of(message['unsubscribe']))
            self._overlays.forget(topic_of(message['unsubscribe']))
            self._links.pop(message['unsubscribe'], None)
        elif not any(asked.ask(message) for asked in (
                self._looks, self._overlays, self._steps)):
            self._start_control(message)
        return None

    def _start_control(self, message: _Message) -> None:
        """Control a camera or a recorder, after the last request of the page."""
        kind = next((key for key in _CONTROLS if key in message), None)
        if kind is None:
            raise RequestError('the message has no known key, such as subscribe or got')
        if len(self._tasks) >= _MAX_WAITING:
            raise RequestError(f'{_MAX_WAITING} requests wait for an answer: wait as well')
        self._add_task(self._control(kind, message))

    def _add_task(self, work: Coroutine[Any, Any, None]) -> None:
        """Start work that ends with the page."""
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _control(self, kind: str, message: _Message) -> None:
        """Control a camera or a recorder; a refusal has the form of the answer."""
        async with self._controlling:
            try:
                answer = await self.site.hub.control(
                    lambda control: _CONTROLS[kind](
                        control, message[kind], message, self._steps))
            except RequestError as err:
                answer = {kind: {'node': message[kind], 'name': message.get('name'), 'ok': False,
                                 'message': str(err)}}
            await self.send_json(answer)

    def _acknowledge(self, sequence: Any, busy: float) -> None:
        """Use the answer to a picture; one that comes before the picture was sent is a guess."""
        if type(sequence) is not int or not 0 < sequence <= self._sequence:
            raise RequestError('got is not the number of a picture')
        writing = self._writing.get(sequence)
        if writing and not writing.done():
            self.close(POLICY_VIOLATION, 'an answer to a picture that was not sent yet')
            return
        for channel in self._channels.values():
            if channel.answered(sequence, busy):
                return

    async def _subscribe_again(self, name: str, options: ViewRequest) -> None:
        """Change the video of a page whose link has become slow, or is tried again."""
        answer = await self._subscribe(name, options)
        if answer:
            await self.send_json(answer)

    async def _subscribe(self, name: str, requested: ViewRequest) -> _Message | None:
        options = self.site.hub.options(requested)
        link = self._links.get(name) or VideoLink(asyncio.get_running_loop().time)
        has_video = options.video and bool(self._codecs)
        slow = has_video and link.is_slow
        channel = self._channels.get(name)
        holds = options.held and channel is not None and channel.options.looks
        if holds:
            has_video = slow = False  # the pictures that are held are images
        looks = holds or (options.looks and self._may_look(name))
        options = replace(options, video=has_video, slow=slow, looks=looks)
        if holds and isinstance(channel, VideoChannel):
            self._channels[name] = self._image_channel(channel.stream, options)
            channel.close()
            await self._steps.show(name, channel.drawn)
            return None
        if channel and (holds or (
                channel.options.video, channel.options.slow, channel.options.held) == (
                    has_video, slow, options.held)):
            channel.set_options(options)
            return None
        self._unsubscribe(name)
        if options.held:
            return None  # there is no picture to hold
        return await self._open_channel(name, options, link)

    async def _open_channel(
        self, name: str, options: ViewRequest, link: VideoLink,
    ) -> _Message | None:
        """Open the channel of a topic; return an error, or None."""
        if len(self._channels) >= MAX_TOPICS:
            raise RequestError(f'a page can look at {MAX_TOPICS} topics at most')
        try:
            stream = await self.site.hub.stream(
                name, original=options.searched, video=options.video, slow=options.slow)
        except RequestError as err:
            return {'error': str(err), 'topic': name}
        if self.ws_connection is None or name in self._channels:
            return None  # the page was closed meanwhile
        self._links[name] = link
        video = self.site.hub.video(stream, options.slow) if options.video else None
        self._channels[name] = VideoChannel(
            video, options, self._codecs, link=link,
            send=lambda viewed: self._send(lambda sequence: pack_video(
                stream.number, sequence, viewed.stamp_ns / 10**9, time.time(), viewed.packet,
                viewed.number, viewed.name)),
            refuse=lambda reason: self._post({'refused': {'topic': name, 'reason': reason}}),
        ) if video else self._image_channel(stream, options)
        return None

    def _image_channel(self, stream: Stream, options: ViewRequest) -> Channel:
        """Return a channel that sends pictures of images."""
        return Channel(
            stream, options, lambda frame, picture: self._send(lambda sequence: pack_frame(
                stream.number, self._overlays.send(stream.name, frame, sequence),
                (frame.stamp_ns, frame.sequence, frame.message.header.frame_id),
                time.time(), (*picture.region.values, *picture.source_size), picture.data)),
            (lambda _: stream.searched()) if options.searched
            else partial(self._overlays.newest, stream.name))

    def _may_look(self, name: str) -> bool:
        """Return whether the frames of another topic may be kept for questions."""
        others = [channel for topic, channel in self._channels.items()
                  if topic != name and channel.options.looks]
        return len(others) < MAX_LOOKS

    def _unsubscribe(self, name: str) -> None:
        channel = self._channels.pop(name, None)
        if channel:
            channel.close()
            self._steps.follow(name)

    def _send(self, pack: Callable[[int], bytes]) -> int:
        """Send the picture that is packed with a sequence number, and return this number."""
        self._sequence += 1
        sequence = self._sequence
        stale = _MAX_STALE + (VideoChannel.window if self._codecs else 0)
        most = sum(channel.window for channel in self._channels.values()) + stale
        if len(self._writing) >= most:
            self.close(POLICY_VIOLATION, 'too many pictures that the page has not read')
            return sequence
        writing = self._start(pack(sequence), binary=True)
        if writing:
            self._writing[sequence] = writing
            writing.add_done_callback(lambda _: self._writing.pop(sequence))
        return sequence

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
