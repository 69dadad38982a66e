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

"""A page without a browser: Tornado's own client, and images to look at."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import suppress
from dataclasses import dataclass
import json
import re
from typing import Any, TypeVar
from urllib.parse import urlsplit

from conftest import NodeProcess
import cv2
import numpy as np
from opencv_tools.viewer.protocol import unpack_frame
from page_messages import problems
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from sending import stamped
from sensor_msgs.msg import CompressedImage, Image
from tornado.httpclient import AsyncHTTPClient, HTTPRequest, HTTPResponse
from tornado.websocket import websocket_connect, WebSocketClientConnection
from waiting import LONGEST_SECONDS, pause_loop, result_of, until

_T = TypeVar('_T')


@dataclass(frozen=True)
class ShownPicture:
    """A binary message of the server."""

    topic: int
    sequence: int
    stamp: float
    sent: float
    place: tuple[int, ...]
    data: bytes

    @property
    def pixels(self) -> np.ndarray:
        return cv2.imdecode(np.frombuffer(self.data, np.uint8), cv2.IMREAD_UNCHANGED)


#: Shapes of the messages of the server, by the path of the WebSocket.
SHAPES = {'/calibrate/ws': 'SessionAnswer', '/robot/ws': 'RobotAnswer'}


class Page:
    """A connection as a page has it."""

    def __init__(self, socket: WebSocketClientConnection, shape: str = 'Answer') -> None:
        self.socket = socket
        self._shape = shape  # of the messages of the server

    @classmethod
    async def connect(cls, url: str, **headers: str) -> Page:
        """Connect to a server, given the address that it has printed."""
        address = url.replace('http', 'ws', 1).replace('/?', '/ws?')
        if not address.partition('?')[0].endswith('/ws'):
            address += 'ws'
        shape = next((shape for path, shape in SHAPES.items() if path in address), 'Answer')
        return cls(await websocket_connect(HTTPRequest(
            address, headers=headers, validate_cert=False)), shape)

    async def send(self, **message: Any) -> None:
        await self.socket.write_message(json.dumps(message))

    async def read(self) -> ShownPicture | dict[str, Any]:
        """Read the next message; a closed connection fails the test."""
        message = await result_of(self.socket.read_message(), 'a message')
        assert message is not None, f'closed: {self.socket.close_code}'
        if isinstance(message, bytes):
            return ShownPicture(*unpack_frame(message))
        answer = json.loads(message)
        assert not (found := problems(answer, self._shape)), found
        return answer

    async def text(self, key: str) -> Any:
        """Read until a text message with a key; return its value. Pictures are answered."""
        while True:
            message = await self.read()
            if isinstance(message, ShownPicture):
                await self.send(got=message.sequence)
            elif key in message:
                return message[key]

    async def picture(self, answers: bool = True) -> ShownPicture:
        """Read the next picture."""
        while True:
            message = await self.read()
            if isinstance(message, ShownPicture):
                if answers:
                    await self.send(got=message.sequence)
                return message

    async def status(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Read until the state of a topic has a property."""
        while True:
            for state in await self.text('status'):
                if condition(state):
                    return state

    async def read_until(self, work: Coroutine[Any, Any, object]) -> None:
        """Read texts until other work is done; a page that reads nothing answers no ping."""
        task = asyncio.ensure_future(work)
        while not task.done():
            await self.text('status')
        await task

    async def close_code(self) -> int | None:
        """Read until the server closes the connection."""
        while await result_of(self.socket.read_message(), 'the end') is not None:
            pass
        return self.socket.close_code


class PausedPage:
    """A page that stops reading where a picture begins."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer

    @classmethod
    async def connect(cls, url: str) -> PausedPage:
        """Connect to a server, given the address that it has printed; it reads 128 KB ahead."""
        address = urlsplit(url)
        reader, writer = await asyncio.open_connection(address.hostname, address.port)
        writer.write(f'GET /ws HTTP/1.1\r\nHost: {address.netloc}\r\nUpgrade: websocket\r\n'
                     'Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n'
                     f'Sec-WebSocket-Key: {"A" * 22}==\r\n\r\n'.encode())
        assert b' 101 ' in await reader.readuntil(b'\r\n\r\n')
        return cls(reader, writer)

    def send(self, **message: Any) -> None:
        content = json.dumps(message).encode()
        self._writer.write(bytes((0x81, 0x80 | len(content), 0, 0, 0, 0)) + content)  # RFC 6455

    async def begin_of(self, text: bytes = b'') -> None:
        """Read until a text with some words has come, or up to the content of a picture."""
        while True:
            first, second = await self._read(2)
            size = second & 127
            if size > 125:
                size = int.from_bytes(await self._read(2 if size == 126 else 8), 'big')
            if first & 15 == 2:
                assert not text, 'a picture came first'
                return
            content = await self._read(size)
            if text and text in content:
                return

    async def end(self) -> None:
        """Read until the server has closed the connection."""
        with suppress(ConnectionError):
            while await result_of(self._reader.read(1 << 16), 'the end'):
                pass
        self._writer.close()

    async def _read(self, size: int) -> bytes:
        return await result_of(self._reader.readexactly(size), 'a message')


def address_of(viewer: NodeProcess) -> str:
    """Wait for the address that a viewer prints."""
    viewer.wait_for('in a browser')
    found = re.search(r'Open (https?://\S+) in a browser', viewer.output)
    assert found
    return found[1]


def run_page(work: Coroutine[Any, Any, _T]) -> _T:
    """Run the part of a test that uses the server."""
    return asyncio.run(result_of(work, 'the end of the part'))


async def fetch(url: str, path: str = '/', method: str = 'GET', **headers: str) -> HTTPResponse:
    """Return the answer to a request, given the address that the server has printed."""
    base = url.partition('?')[0].rstrip('/')
    return await AsyncHTTPClient().fetch(
        HTTPRequest(base + path, method=method, headers=headers, request_timeout=LONGEST_SECONDS,
                    follow_redirects=False, allow_nonstandard_methods=True, validate_cert=False),
        raise_error=False)


async def publishing(publish: Callable[[], object], work: Awaitable[_T]) -> _T:
    """Publish at 20 Hz while something else is done."""
    async def repeat() -> None:
        while True:
            publish()
            await pause_loop(0.05)

    task = asyncio.ensure_future(repeat())
    try:
        return await work
    finally:
        task.cancel()


class Camera:
    """A publisher of numbered images; the stamp of an image is its number in seconds."""

    def __init__(self, node: Node, topic: str, *, latched: bool = False,
                 compressed: bool = False, depth: int = 10) -> None:
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        self._node = node
        self.publisher: Publisher = node.create_publisher(
            CompressedImage if compressed else Image, topic,
            QoSProfile(depth=depth, durability=durability))
        self.number = 0

    def publish(self, image: np.ndarray, encoding: str = 'bgr8') -> None:
        self.number += 1
        self.publisher.publish(stamped(image, encoding, self.number * 10**9))

    def publish_compressed(self, data: bytes, name: str = 'jpeg') -> None:
        self.number += 1
        message = CompressedImage(format=name)
        message.header.stamp.sec = self.number
        message.data.frombytes(data)
        self.publisher.publish(message)

    def destroy(self) -> None:
        self._node.destroy_publisher(self.publisher)

    async def seen(self) -> None:
        """Wait for a subscription."""
        await until(lambda: self.publisher.get_subscription_count() > 0)
