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

"""Video topics in ``img_viewer``, without a browser: packets for pages, JPEGs for the others."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
import itertools
from typing import Any

from conftest import NodeProcess
import cv2
import numpy as np
from opencv_tools.image.cdr import WireHeader
from opencv_tools.topics.qos import create_frame_publisher
from opencv_tools.transport.message_type import message_type
from opencv_tools.video.decoder import NumberedDecoder
from opencv_tools.video.messages import COMPRESSED_VIDEO, FFMPEG_PACKET, video_to_cdr, VIDEO_TOPICS
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.parameter_sets import webcodecs_name
from opencv_tools.viewer.protocol import unpack_video
import pytest
from rclpy.node import Node
from video_packets import packets
from viewing import address_of, fetch, Page, publishing, run_page
from waiting import pause_loop, until

Start = Callable[..., NodeProcess]


class Packets:
    """A publisher of prepared packets of video; the stamp of a packet is its number in seconds."""

    def __init__(self, node: Node, name: str, type_name: str = FFMPEG_PACKET) -> None:
        self._type_name = type_name
        self.publisher = create_frame_publisher(
            node, message_type(type_name), f'{name}/{VIDEO_TOPICS[type_name]}', depth=60)
        self.number = 0

    def publish(self, packet: VideoPacket) -> None:
        self.number += 1
        self.publisher.publish(video_to_cdr(
            self._type_name, WireHeader(self.number, 0, ''), packet, self.number))

    def readers(self, node: Node) -> set[bytes]:
        """Return the identifiers of the subscriptions."""
        return {bytes(info.endpoint_gid) for info in
                node.get_subscriptions_info_by_topic(self.publisher.topic_name)}

    async def seen(self) -> None:
        """Wait for a subscription."""
        await until(lambda: self.publisher.get_subscription_count() > 0)


async def listed(page: Page, name: str) -> dict[str, Any]:
    """Wait until a topic is in the list."""
    while True:
        for topic in await page.text('topics'):
            if topic['name'] == name:
                return topic


async def packet_of(page: Page, answers: bool = True) -> tuple[Any, ...]:
    """Read the next packet of video."""
    while True:
        message = await asyncio.wait_for(page.socket.read_message(), 60)
        assert message is not None
        if isinstance(message, bytes):
            found = unpack_video(message)
            assert found, 'a JPEG came'
            if answers:
                await page.send(got=found[1])
            return found


@pytest.fixture
def viewer(start: Start) -> NodeProcess:
    """Start a viewer on any free port."""
    return start('img_viewer', port=0)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('type_name', [FFMPEG_PACKET, COMPRESSED_VIDEO])
def test_packets_pass_byte_for_byte(type_name: str, viewer: NodeProcess, node: Node) -> None:
    camera, sent = Packets(node, '/front', type_name), packets('h264')

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        assert (await page.text('hello'))['video'] == 'auto'
        topic = await listed(page, '/front')
        assert topic['transports'] == ['video']
        assert topic['publishers'] == 1
        await page.send(codecs=['h264', 'av1'])
        await page.send(subscribe='/front', video=True)
        await camera.seen()
        received = []
        for packet in sent:
            camera.publish(packet)
            received.append(await packet_of(page))
        assert [one[8] for one in received] == [packet.data for packet in sent]
        assert [one[4] for one in received] == [True] + [False] * (len(sent) - 1)
        assert {one[5] for one in received} == {(160, 120)}
        assert [one[2] for one in received] == [*map(float, range(1, len(sent) + 1))]
        numbers = [one[6] for one in received]
        assert numbers == [*range(numbers[0], numbers[0] + len(sent))]
        assert received[0][7] == webcodecs_name('h264', sent[0].data)
        state = await page.status(lambda state: state['sent'])
        assert (state['encoding'], state['width'], state['sent']['video']) == ('h264', 160, 'h264')

    run_page(look())


def test_damaged_packets_are_counted(viewer: NodeProcess, node: Node) -> None:
    camera, sent = Packets(node, '/front'), packets('h264')
    rubbish = VideoPacket(codec='vp9', data=b'rubbish', is_key=False, width=1, height=1)

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/front')
        await page.send(codecs=['h264'])
        await page.send(subscribe='/front', video=True)
        await camera.seen()
        for packet in (sent[0], rubbish, sent[1]):
            camera.publish(packet)
        state = await page.status(lambda state: state['broken'])
        assert 'vp9' in state['reason'] or state['reason'] == ''
        camera.publish(sent[0])
        assert (await packet_of(page))[6] != 0

    run_page(look())


@pytest.mark.thorough
def test_new_subscription_for_a_key_frame(viewer: NodeProcess, node: Node) -> None:
    camera, sent = Packets(node, '/front'), packets('h264')

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/front')
        await page.send(codecs=['h264'])
        await page.send(subscribe='/front', video=True)
        await camera.seen()
        camera.publish(sent[0])
        await packet_of(page)
        for _ in range(2):
            before = camera.readers(node)
            while camera.readers(node) <= before:
                await page.send(key='/front')
                await pause_loop(0.1)
        order = itertools.cycle((sent[1], sent[0]))
        assert (await publishing(lambda: camera.publish(next(order)), packet_of(page)))[4]

    run_page(look())


@pytest.mark.thorough
def test_page_that_falls_behind_twice_gets_smaller_video(
        viewer: NodeProcess, node: Node) -> None:
    camera, order = Packets(node, '/front'), itertools.cycle(packets('h264'))

    async def publish() -> None:
        while True:
            camera.publish(next(order))
            await pause_loop(0.02)

    async def fall_behind(page: Page) -> None:
        """Answer nothing until the page gets nothing, then answer everything."""
        last = await packet_of(page, answers=False)
        with suppress(asyncio.TimeoutError):
            while True:
                last = await asyncio.wait_for(packet_of(page, answers=False), 0.4)
        await page.send(got=last[1])

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/front')
        await page.send(codecs=['h264'])
        await page.send(subscribe='/front', video=True)
        await camera.seen()
        publishing_packets = asyncio.ensure_future(publish())
        await fall_behind(page)
        await fall_behind(page)
        await page.status(lambda state: state['sent'] and state['sent']['slow'])
        decoder, received = NumberedDecoder(), await packet_of(page)
        while not received[4]:
            received = await packet_of(page)
        for _ in range(10):  # other packets than those of the topic, of the same pictures
            assert received[8] not in sent
            assert decoder.decode('h264', received[8], received[6]).shape == (120, 160, 3)
            received = await packet_of(page)
        publishing_packets.cancel()

    sent = {packet.data for packet in packets('h264')}
    run_page(look())


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('announced', [None, [], ['av1']])
def test_pages_without_the_codec_get_jpeg(
        announced: list[str] | None, viewer: NodeProcess, node: Node) -> None:
    camera, (key, *_) = Packets(node, '/front'), packets('h264')

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/front')
        if announced is not None:
            await page.send(codecs=announced)
        await page.send(subscribe='/front', video=True)
        await camera.seen()
        if announced:
            refused = await publishing(lambda: camera.publish(key), page.text('refused'))
            assert refused == {
                'topic': '/front', 'reason': 'this browser cannot decode h264'}
            await page.send(subscribe='/front', video=False)
        picture = await publishing(lambda: camera.publish(key), page.picture())
        assert picture.pixels.shape == (120, 160, 3)

    run_page(look())


@pytest.mark.thorough
def test_snapshot_and_stream_of_a_video_topic(viewer: NodeProcess, node: Node) -> None:
    camera, (key, *_) = Packets(node, '/front'), packets('h264')

    async def look() -> None:
        url = address_of(viewer)
        await listed(await Page.connect(url), '/front')
        for path, head in (('/snapshot?topic=/front', b'\xff\xd8'),
                           ('/snapshot?topic=/front/ffmpeg', b'\xff\xd8'),
                           ('/snapshot?topic=/front&format=original', b'\x89PNG')):
            answer = await publishing(lambda: camera.publish(key), fetch(url, path))
            assert answer.code == 200, answer.body
            assert answer.body.startswith(head)
            image = cv2.imdecode(np.frombuffer(answer.body, np.uint8), cv2.IMREAD_COLOR)
            assert image.shape == (120, 160, 3)
        answer = await publishing(lambda: camera.publish(key), fetch(
            url, '/stream?topic=/front', 'HEAD'))
        assert answer.headers['Content-Type'].startswith('multipart/x-mixed-replace')

    run_page(look())


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize('message', [
    {'codecs': 'h264'}, {'codecs': [1]}, {'codecs': ['h264'] * 99}, {'key': 5}, {'key': ''}])
def test_hostile_messages(message: dict[str, Any], viewer: NodeProcess) -> None:
    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        for _ in range(10):
            await page.send(**message)
        assert await page.close_code() == 1008

    run_page(look())


@pytest.mark.thorough
def test_page_that_reads_no_video(viewer: NodeProcess, node: Node) -> None:
    camera, sent = Packets(node, '/front'), packets('h264')

    async def look() -> None:
        silent, page = [await Page.connect(address_of(viewer)) for _ in range(2)]
        for one in (silent, page):
            await listed(one, '/front')
            await one.send(codecs=['h264'])
            await one.send(subscribe='/front', video=True)
        await camera.seen()
        for step in range(60):
            camera.publish(sent[step % len(sent)])
            await packet_of(page)
            await pause_loop(0.02)
        state = await silent.status(lambda state: state['sent'])
        while not state['sent']['skipped']:
            camera.publish(sent[0])
            state = await silent.status(lambda state: state['sent'])

    run_page(look())


@pytest.mark.thorough
def test_width_of_the_node_needs_jpeg(start: Start, node: Node) -> None:
    viewer = start('img_viewer', port=0, width=80)
    camera, (key, *_) = Packets(node, '/front'), packets('h264', 320, 240)

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        assert (await page.text('hello'))['video'] == 'never'
        await listed(page, '/front')
        await page.send(codecs=['h264'])
        await page.send(subscribe='/front', video=True)
        await camera.seen()
        picture = await publishing(lambda: camera.publish(key), page.picture())
        assert picture.pixels.shape == (120, 160, 3)

    run_page(look())
