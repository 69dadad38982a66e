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

"""Subscriber of shared frames: slow callbacks, announcements, threads and arguments."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import itertools
import json
import re
import sys
import threading
from threading import Thread
import time
from types import FrameType
from typing import Any
import uuid

from conftest import destroy, spin_until, spinning
from numbered_nodes import offer
from opencv_tools.frames import Frame, FrameNode, FramePublisher, FrameSubscriber
from opencv_tools.topics.errors import ParameterError
from opencv_tools.transport.shared_frames.announcement import SUFFIX
from opencv_tools.transport.shared_frames.memory import MAX_DEPTH
from opencv_tools.video.settings import VideoSettings
import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, Image
from sharing import Camera, TOPIC
from std_msgs.msg import String
from waiting import pause, wait_until

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Receiver:
    """A subscriber that collects the numbers of its frames."""

    def __init__(self, node: Node, on_frame: Callable[[Frame], object] = bool,
                 **options: Any) -> None:
        self.node = node
        self.numbers = [0]
        self._on_frame = on_frame
        self.subscriber = FrameSubscriber(
            node, TOPIC, self._take, **{'encoding': '', 'every': True, **options})

    @property
    def is_sharing(self) -> bool:
        """Whether frames arrive, but not by the image topic."""
        return len(self.numbers) > 1 and not self.node.count_subscribers(TOPIC)

    def match(self, camera: Camera) -> None:
        """Wait until the image topic connects this subscriber and a camera."""
        spin_until(self.node, lambda: camera.subscribers > 0
                   and self.node.count_publishers(TOPIC) > 0)

    def send_until(self, condition: Callable[[], bool], camera: Camera,
                   spin: Callable[[], object] | None = None, ahead: int = 5) -> None:
        """
        Publish until a condition holds.

        :param spin: what lets frames arrive; by default the node is spun.
        :param ahead: published frames that may be on their way; after 0.1 s one more is published.
        """
        sent_at = 0.0

        def step() -> bool:
            nonlocal sent_at
            if condition():
                return True
            if camera.sent < self.numbers[-1] + ahead or time.monotonic() > sent_at + 0.1:
                camera.send()
                sent_at = time.monotonic()
            return False

        if spin is None:
            spin_until(self.node, step)
            return
        wait_until(step, 'the condition', spin, sent=lambda: camera.sent,
                   received=lambda: len(self.numbers))

    def assert_counted(self, camera: Camera) -> None:
        """Check that every frame arrived once and in order, or was counted as lost."""
        self.send_until(lambda: self.numbers[-1] == camera.sent, camera, ahead=0)
        assert self.numbers == sorted(set(self.numbers))
        assert len(self.numbers) - 1 + self.subscriber.skipped == camera.sent

    def _take(self, frame: Frame) -> None:
        self.numbers.append(frame.stamp.sec)
        self._on_frame(frame)


class Announcements:
    """The announcements of a camera, repeated by a node with another service."""

    def __init__(self, listener: Node, node: Node) -> None:
        self._texts: list[str] = []
        listener.create_subscription(
            String, TOPIC + SUFFIX, lambda message: self._texts.append(message.data), LATCHED)
        self._publisher = node.create_publisher(String, TOPIC + SUFFIX, LATCHED)

    @property
    def are_known(self) -> bool:
        """Whether an announcement was received."""
        return bool(self._texts)

    def repeat(self, **changed: object) -> None:
        """Publish the first announcement with other values."""
        self._publisher.publish(String(data=json.dumps({**json.loads(self._texts[0]), **changed})))


@pytest.fixture
def neighbour(domain: int) -> Iterator[Node]:
    """Create a third node, in a participant of its own."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = Node('neighbour', context=context)
    yield node
    destroy(node)


@contextmanager
def switching_threads(*modules: str) -> Iterator[list[BaseException]]:
    """Switch threads at each line of modules, and collect the exceptions that end a thread."""
    errors: list[BaseException] = []
    interval, hook = sys.getswitchinterval(), threading.excepthook

    def trace(frame: FrameType, event: str, _: object) -> Any:
        if not frame.f_globals.get('__name__', '').startswith(modules):
            return None
        if event == 'line':
            pause(0)
        return trace

    sys.setswitchinterval(1e-6)
    threading.excepthook = lambda ended: errors.append(ended.exc_value or SystemExit())
    threading.settrace(trace)
    sys.settrace(trace)
    try:
        yield errors
    finally:
        sys.settrace(None)
        threading.settrace(None)  # type: ignore[arg-type]
        threading.excepthook = hook
        sys.setswitchinterval(interval)


@pytest.mark.thorough
def test_timer_beside_a_callback_that_never_waits(camera: Node, node: Node) -> None:
    ours = Camera(camera)
    ticks: list[int] = []

    def send_next(_: Frame) -> None:
        if receiver.is_sharing and ours.sent < 400:
            ours.send()  # the next frame waits when this call returns

    receiver = Receiver(node, send_next, every=False)
    receiver.match(ours)
    receiver.send_until(lambda: receiver.is_sharing, ours)
    first = len(receiver.numbers)
    node.create_timer(1e-6, lambda: ticks.append(len(receiver.numbers)))
    receiver.send_until(lambda: ours.sent >= 400, ours)
    receiver.subscriber.destroy()
    counts = [first, *ticks, len(receiver.numbers)]
    assert max(after - before for before, after in itertools.pairwise(counts)) <= MAX_DEPTH


def test_service_without_a_writer(camera: Node, node: Node) -> None:
    ours = Camera(camera)
    receiver = Receiver(node)
    receiver.match(ours)
    receiver.send_until(lambda: receiver.is_sharing, ours)
    ours.end_sharing()
    until = ours.sent + 20
    receiver.send_until(lambda: receiver.numbers[-1] > until, ours)
    receiver.subscriber.destroy()
    assert receiver.numbers == sorted(set(receiver.numbers))


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize('liar', ['neighbour', 'camera'])
@pytest.mark.parametrize('frames', [1, 5, 20])
def test_service_that_opens_and_one_that_does_not(
        request: pytest.FixtureRequest, camera: Node, node: Node, liar: str, frames: int) -> None:
    announcements = Announcements(node, request.getfixturevalue(liar))
    ours = Camera(camera)
    receiver = Receiver(node)
    receiver.match(ours)
    receiver.send_until(lambda: receiver.is_sharing and announcements.are_known, ours)
    for _ in range(50):
        announcements.repeat(service=uuid.uuid4().hex)
        until = ours.sent + frames
        receiver.send_until(lambda: ours.sent >= until, ours)  # noqa: B023
        announcements.repeat()
    receiver.assert_counted(ours)
    receiver.subscriber.destroy()


@pytest.mark.thorough
def test_changes_in_an_executor_of_several_threads(camera: Node, node: Node) -> None:
    ours = Camera(camera)
    receiver = Receiver(node)
    receiver.match(ours)
    executor = MultiThreadedExecutor(4, context=node.context)
    executor.add_node(node)
    with switching_threads('opencv_tools.') as errors, spinning(executor):

        def wait() -> None:
            assert errors == []
            pause(0.001)

        for _ in range(10):
            receiver.send_until(lambda: receiver.is_sharing, ours, wait)
            offer(ours.frames, 'withdraw')
            receiver.send_until(lambda: not receiver.is_sharing, ours, wait)
            offer(ours.frames, 'share')
        receiver.send_until(lambda: receiver.numbers[-1] == ours.sent, ours, wait, ahead=0)
        assert errors == []
    receiver.assert_counted(ours)
    receiver.subscriber.destroy()


@pytest.mark.thorough
def test_calibration_of_frames_at_full_speed(camera: Node, node: Node) -> None:
    ours = Camera(camera)
    infos = camera.create_publisher(CameraInfo, '/camera_info', 10)
    widths: dict[int, int] = {}

    def send() -> None:
        info = CameraInfo(width=ours.sent + 1)
        info.header.stamp.sec = ours.sent + 1
        infos.publish(info)
        ours.send()

    def send_many() -> None:
        for _ in range(1000):
            send()

    def arrives() -> bool:
        send()
        return bool(errors) or (receiver.is_sharing and receiver.numbers[-1] > until)

    until = 0
    with switching_threads('opencv_tools.frames.subscriber') as errors:
        receiver = Receiver(
            node, lambda frame: widths.update({frame.stamp.sec: frame.camera_info.width}),
            threaded=True, camera_info=True)
        receiver.match(ours)
        spin_until(node, lambda: infos.get_subscription_count() > 0)
        spin_until(node, arrives)
        sending = Thread(target=send_many, daemon=True)
        sending.start()
        spin_until(node, lambda: not sending.is_alive())
        until = ours.sent
        spin_until(node, arrives)
        receiver.subscriber.destroy()
    assert errors == []
    assert all(number == width for number, width in widths.items())
    assert receiver.numbers == sorted(set(receiver.numbers))


def test_rectified_images_never_get_the_calibration_of_the_raw_ones(
        node: Node, camera: Node) -> None:
    pairs: list[tuple[int, int]] = []
    subscriber = FrameSubscriber(
        node, '/front/image_rect',
        lambda frame: pairs.append((frame.stamp.sec, frame.camera_info.width)),
        every=True, camera_info=True)
    images = camera.create_publisher(Image, 'image_rect', 10)
    raw = camera.create_publisher(CameraInfo, 'camera_info', 10)
    spin_until(node, lambda: raw.get_subscription_count() == images.get_subscription_count() == 1)

    def send(publisher: Publisher, sec: int, width: int) -> None:
        message = CameraInfo(width=width)
        message.header.stamp.sec = sec
        publisher.publish(message)

    send(raw, 1, 100)
    spin_until(node, lambda: bool(subscriber._subscription._queue._infos))
    own = camera.create_publisher(CameraInfo, 'image_rect/camera_info', 10)
    spin_until(node, lambda: node.count_publishers(own.topic_name) > 0)
    send(raw, 2, 100)  # perhaps before the next poll
    spin_until(node, lambda: own.get_subscription_count() > 0)
    for sec in (1, 2, 3):
        image = Image(height=1, width=1, encoding='mono8', step=1, data=[0])
        image.header.stamp.sec = sec
        images.publish(image)
        send(own, sec, 200 + sec)
    spin_until(node, lambda: len(pairs) == 3)
    assert pairs == [(1, 201), (2, 202), (3, 203)]
    subscriber.destroy()


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({'encoding': 'nope'}, "encoding is 'nope'"),
    ({'encoding': 8}, 'encoding is 8'),
    ({'every': True, 'depth': -1}, 'depth is -1'),
    ({'every': True, 'depth': 0}, 'depth is 0'),
    ({'every': True, 'depth': 'x'}, "depth is 'x'"),
    ({'every': True, 'depth': 2.5}, 'depth is 2.5'),
    ({'depth': -1}, 'depth is -1'),
    ({'max_rate': -1}, 'max_rate is -1'),
    ({'max_rate': float('nan')}, 'max_rate is nan'),
    ({'max_rate': '5'}, "max_rate is '5'"),
    ({'max_rate': True}, 'max_rate is True'),
    ({'transport': 'pigeon'}, "transport is 'pigeon'"),
    ({'transport': ''}, "transport is ''"),
    ({'every': 1}, 'every is 1'),
    ({'threaded': 'no'}, "threaded is 'no'"),
    ({'camera_info': 3}, 'camera_info is 3')]


@pytest.mark.parametrize('is_method', [False, True])
def test_refused_options_of_a_subscriber(node: Node, is_method: bool) -> None:
    frame_node = FrameNode('frames', context=node.context)
    for options, text in REFUSED:
        with pytest.raises(ParameterError) as raised:
            if is_method:
                frame_node.receive_frames(TOPIC, bool, **options)
            else:
                FrameSubscriber(frame_node, TOPIC, bool, **options)
        assert text in str(raised.value)
        assert not frame_node.count_subscribers(TOPIC)
    assert frame_node.close() == 0
    frame_node.destroy_node()


@pytest.mark.parametrize('quality', [0, 101, -1, 'high', 50.5])
def test_refused_quality(node: Node, quality: object) -> None:
    with pytest.raises(ParameterError) as raised:
        FramePublisher(node, TOPIC, quality=quality)  # type: ignore[arg-type]
    assert f'quality is {quality!r}' in str(raised.value)
    assert not node.count_publishers(TOPIC)


def test_invalid_video(node: Node) -> None:
    for depth in ('rvl', None, 20.0):
        with pytest.raises(ParameterError, match=(
                rf"depth is {depth!r}: give DepthSettings\(\), such as DepthSettings\('rvl', 20")):
            FramePublisher(node, 'image', depth=depth)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match=r'video is True: give VideoSettings\(\), or None'):
        FramePublisher(node, TOPIC, video=True)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="codec is 'foo': the installed PyAV has no such"):
        FramePublisher(node, TOPIC, video=VideoSettings(codec='foo'))


@pytest.mark.parametrize('kind', ['subscriber', 'publisher'])
def test_refused_topic(node: Node, kind: str) -> None:
    entities = [*node.waitables, *node.subscriptions, *node.publishers]
    topics: list[Any] = ['', 'a b', 'a//b', '1st', 'a/', 'a~b', '{node', '{nobody}', 'a' * 231,
                         'a' * 300, 'a\0b', 7, None]
    for topic in topics:
        with pytest.raises(ParameterError) as raised:
            if kind == 'subscriber':
                FrameSubscriber(node, topic, bool)
            else:
                FramePublisher(node, topic)
        assert str(raised.value).startswith(f'the topic name {topic!r} cannot be used: ')
        assert not re.search(r'\.c\b|rclpy|0x|\n', str(raised.value))
        assert [*node.waitables, *node.subscriptions, *node.publishers] == entities, topic


@pytest.mark.parametrize('length', [1, 230])
def test_lengths_of_topics(node: Node, length: int) -> None:
    subscriber = FrameSubscriber(node, 'a' * length, bool, camera_info=True)
    publisher = FramePublisher(node, 'a' * length)
    assert subscriber.topic_name == publisher.topic_name == '/' + 'a' * length
    subscriber.destroy()
    publisher.destroy()
