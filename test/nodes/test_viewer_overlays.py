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
"""Overlays of ``img_viewer`` as a page asks for them."""

from __future__ import annotations

from collections.abc import Callable

from conftest import NodeProcess
from detections import Detector
import numpy as np
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from viewing import address_of, Camera, Page, run_page
from waiting import pause_loop, until

Start = Callable[..., NodeProcess]
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
GRAY = np.full((48, 64, 3), 90, np.uint8)
SECOND = 10**9  # the stamp of the first image


@pytest.fixture
def viewer(start: Start) -> NodeProcess:
    """Start a viewer on any free port."""
    return start('img_viewer', port=0)


async def open_page(viewer: NodeProcess, *topics: str) -> Page:
    """Look at image topics."""
    page = await Page.connect(address_of(viewer))
    names: set[str] = set()
    while not names >= {*topics}:
        names = {topic['name'] for topic in await page.text('topics')}
    for topic in topics:
        await page.send(subscribe=topic, looks=True)
    return page


@pytest.mark.thorough
def test_only_published_topics_of_boxes(viewer: NodeProcess, node: Node) -> None:
    Camera(node, '/image', latched=True).publish(GRAY)
    detector = Detector(node, '/boxes', LATCHED)
    detector.publish(SECOND, [(1, 2, 3, 4, 0, 'cup', 0.5)], 'camera')

    async def look() -> None:
        page = await open_page(viewer, '/image')
        for name in ('/image', '/no', '/../boxes', 'boxes\0', '<b>', 'a' * 250, '/boxes/'):
            await page.send(overlays='/image', boxes=name)
            state = await page.status(lambda state: 'is not a published' in state['overlay'])
            assert state['overlay'].endswith('topic of vision_msgs/msg/Detection2DArray')
            assert state['overlay'].isprintable()
            await page.send(overlays='/image')
            await page.status(lambda state: not state['overlay'])
        await page.send(overlays='/image', boxes='/boxes')
        assert (await page.text('boxes'))['list'] == [[1, 2, 3, 4, 0, 'cup 0.50']]
        await page.send(unsubscribe='/image')
        await until(lambda: detector.publisher.get_subscription_count() == 0)

    run_page(look())


@pytest.mark.thorough
def test_topic_of_boxes_that_ends_and_comes_again(viewer: NodeProcess, node: Node) -> None:
    Camera(node, '/image', latched=True).publish(GRAY)
    boxes = [(1.0, 2.0, 3.0, 4.0, 0.0, 'cup', 0.5)]
    first = Detector(node, '/boxes', LATCHED)
    first.publish(SECOND, boxes)

    async def look() -> None:
        page = await open_page(viewer, '/image')
        await page.send(overlays='/image', boxes='/boxes')
        await page.status(lambda state: state['overlay'] == '1 box')
        node.destroy_publisher(first.publisher)
        await page.status(lambda state: state['overlay'] == (
            '/boxes is not a published topic of vision_msgs/msg/Detection2DArray'))
        last = Detector(node, '/boxes', BEST_EFFORT)
        await until(lambda: last.publisher.get_subscription_count() > 0)
        last.publish(SECOND, boxes * 2)
        await page.status(lambda state: state['overlay'] == '2 boxes')

    run_page(look())


@pytest.mark.thorough
def test_topics_of_the_parameter(start: Start, node: Node) -> None:
    viewer = start('img_viewer', port=0, topics='/image,/boxes')
    Camera(node, '/image', latched=True).publish(GRAY)
    detectors = [Detector(node, name, LATCHED) for name in ('/boxes', '/others')]
    for detector in detectors:
        detector.publish(SECOND, [(1, 2, 3, 4, 0, 'cup', 0.5)])

    async def look() -> None:
        page = await open_page(viewer, '/image')
        await page.send(overlays='/image', boxes='/others')
        await page.status(lambda state: '/others is not a published' in state['overlay'])
        await page.send(overlays='/image', boxes='/boxes')
        assert (await page.text('boxes'))['topic'] == '/image'
        other = await Page.connect(address_of(viewer))
        while await other.text('detections') != ['/boxes']:
            pass

    run_page(look())


def test_requests_that_are_refused(viewer: NodeProcess, node: Node) -> None:
    topics = [f'/image{number}' for number in range(6)]
    for topic in topics:
        Camera(node, topic, latched=True).publish(GRAY)

    async def look() -> None:
        page = await open_page(viewer, *topics)
        for wrong in ({'overlays': 5}, {'overlays': topics[0], 'boxes': 5},
                      {'overlays': topics[0], 'boxes': 'a' * 300}, {'overlays': ''}):
            await page.send(**wrong)
            assert len(await page.text('error')) < 100
        await page.send(overlays='/unknown', boxes='/boxes', camera=True)
        for topic in topics[:5]:
            await page.send(overlays=topic, camera=True)
        assert await page.text('error') == 'a page can have overlays of 4 topics at most'
        await page.send(overlays=topics[0])
        await page.send(overlays=topics[4], camera=True)
        state = await page.status(lambda state: state['name'] == topics[4] and state['overlay'])
        assert state['overlay'].startswith('/camera_info is not a published topic')

    run_page(look())


@pytest.mark.thorough
def test_publisher_of_many_messages(viewer: NodeProcess, node: Node) -> None:
    Camera(node, '/image', latched=True).publish(GRAY)
    detector = Detector(node, '/boxes')

    async def look() -> None:
        page = await open_page(viewer, '/image')
        await page.picture()
        await page.send(overlays='/image', boxes='/boxes')
        await until(lambda: detector.publisher.get_subscription_count() > 0)
        for number in range(2000):
            detector.publish(SECOND, [(1, 2, 3, 4, 0, str(number), 1)])
            if number % 10 == 0:
                await pause_loop(0.01)
        labels = []
        while not labels or labels[-1] != '1999 1.00':
            boxes = await page.text('boxes')
            labels.append(boxes['list'][0][5])
        assert len(labels) < 1000
        assert labels == sorted(labels, key=lambda text: int(text.split()[0]))

    run_page(look())
