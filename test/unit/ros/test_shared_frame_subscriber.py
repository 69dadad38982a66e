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

"""Change between the image topic and shared memory: no frame is lost, doubled or out of order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import gc
from typing import Any

from conftest import spin_until
import numpy as np
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.frames import Frame, FramePublisher, FrameSubscriber
from opencv_tools.image.cdr import WireMessage
from opencv_tools.ros.shared_frames.announcement import announce, SUFFIX
from opencv_tools.ros.subscriber.subscription import FrameSubscription
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image
from std_msgs.msg import Header, String

TOPIC = '/video_frames'
WINDOW = 5  # frames on their way; fewer than any queue holds
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def header_of(number: int, name: str) -> Header:
    header = Header(frame_id=name)
    header.stamp.sec = number
    return header


class Camera:
    """A publisher of numbered frames, which shares them or not."""

    def __init__(self, node: Node, name: str = 'ours', is_plain: bool = False) -> None:
        self.name = name
        self.sent = 0
        self._node = node
        self._plain: Publisher | None = node.create_publisher(Image, TOPIC, 10) \
            if is_plain else None
        self._frames = None if is_plain else FramePublisher(node, TOPIC)

    @property
    def subscribers(self) -> int:
        """Number of subscriptions of the image topic."""
        publisher = self._plain or self._frames._images
        return int(publisher.get_subscription_count())

    def send(self) -> None:
        self.sent += 1
        pixels = np.full((3, 5), self.sent, np.uint16)
        header = header_of(self.sent, self.name)
        if self._plain:
            self._plain.publish(CvBridge().cv2_to_imgmsg(pixels, '16UC1', header=header))
        else:
            self._frames.publish(pixels, header)

    def destroy(self) -> None:
        if self._plain:
            self._node.destroy_publisher(self._plain)
        else:
            self._frames.destroy()


class Viewer:
    """A subscription that checks the pixels and collects the numbers of its frames."""

    def __init__(self, node: Node, transport: str = 'auto', in_thread: bool = False,
                 depth: int | None = None) -> None:
        self.node = node
        self.numbers: dict[str, list[int]] = {}
        self.shared = 0  # consecutive newest frames from shared memory
        self.subscription = FrameSubscription(
            node, TOPIC, transport, depth, node.get_logger(), self._take, self._fail,
            in_thread=in_thread)

    @property
    def is_sharing(self) -> bool:
        """Whether all frames come from shared memory."""
        return self.subscription._subscription.is_stopped

    def _take(self, message: WireMessage, _: int) -> None:
        frame = Frame(message)
        assert (frame.raw == frame.stamp.sec).all()
        assert frame.raw.shape == (3, 5)
        self.numbers.setdefault(frame.frame_id, []).append(frame.stamp.sec)
        self.shared = self.shared + 1 if isinstance(message.data, np.ndarray) else 0

    def _fail(self, err: Exception) -> None:
        raise err

    def watch(self, condition: Callable[[], bool], *cameras: Camera) -> None:
        """Publish, at most a few frames ahead of the reception, until a condition holds."""
        def step() -> bool:
            for camera in cameras:
                if camera.sent - len(self.numbers.get(camera.name, ())) < WINDOW:
                    camera.send()
            return condition()

        spin_until(self.node, step)

    def assert_complete(self, *cameras: Camera) -> None:
        """Check that every frame arrived once and in order."""
        spin_until(self.node, lambda: all(
            len(self.numbers.get(camera.name, ())) >= camera.sent for camera in cameras))
        for camera in cameras:
            assert self.numbers[camera.name] == [*range(1, camera.sent + 1)]
        assert self.subscription.losses.count == 0
        assert self.subscription.losses.is_complete


@pytest.fixture
def view(node: Node) -> Iterator[Callable[..., Viewer]]:
    """Return a function that creates viewers, which end with the test."""
    viewers: list[Viewer] = []

    def _view(**options: Any) -> Viewer:
        viewers.append(Viewer(node, **options))
        return viewers[-1]

    yield _view
    for viewer in viewers:
        viewer.subscription.destroy()


@pytest.fixture(params=[False, True], ids=['executor', 'thread'])
def viewer(request: pytest.FixtureRequest, view: Callable[..., Viewer]) -> Viewer:
    return view(in_thread=request.param)


def match(viewer: Viewer, camera: Camera) -> None:
    """Wait until both ends of the image topic have discovered each other."""
    spin_until(viewer.node, lambda: camera.subscribers > 0 and
               viewer.subscription._subscription.publisher_count() > 0)


def test_change_to_shared_memory(viewer: Viewer, camera: Node) -> None:
    ours = Camera(camera)
    match(viewer, ours)
    viewer.watch(lambda: viewer.is_sharing and viewer.shared > 20, ours)
    assert not viewer.node.count_subscribers(TOPIC)
    viewer.assert_complete(ours)


def test_plain_publisher_joins_and_leaves(viewer: Viewer, camera: Node) -> None:
    ours = Camera(camera)
    match(viewer, ours)
    for turn in range(3):
        viewer.watch(lambda: viewer.is_sharing and viewer.shared > 20, ours)
        plain = Camera(camera, f'plain{turn}', is_plain=True)
        viewer.watch(lambda: not viewer.is_sharing, ours)
        match(viewer, plain)  # noqa: B023
        viewer.watch(lambda: not viewer.shared and plain.sent > 20, ours, plain)  # noqa: B023
        viewer.watch(lambda: not viewer.subscription._shared._links, ours, plain)
        viewer.assert_complete(ours, plain)
        plain.destroy()
    viewer.watch(lambda: viewer.is_sharing and viewer.shared > 20, ours)
    viewer.assert_complete(ours)


def test_two_sharing_publishers(viewer: Viewer, camera: Node, node: Node) -> None:
    first = Camera(camera, 'first')
    match(viewer, first)
    viewer.watch(lambda: viewer.is_sharing, first)
    second = Camera(camera, 'second')
    viewer.watch(lambda: not viewer.is_sharing, first)
    spin_until(node, lambda: second.subscribers > 0)
    spin_until(node, lambda: viewer.subscription._subscription.publisher_count() == 2)
    viewer.watch(lambda: viewer.is_sharing and viewer.shared > 20, first, second)
    viewer.assert_complete(first, second)
    second.destroy()
    viewer.watch(lambda: first.sent > 100, first)
    viewer.assert_complete(first)


def test_publisher_and_subscriber_of_one_node(viewer: Viewer) -> None:
    ours = Camera(viewer.node)
    match(viewer, ours)
    viewer.watch(lambda: viewer.is_sharing and viewer.shared > 20, ours)
    viewer.assert_complete(ours)
