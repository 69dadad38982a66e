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

"""Subscription that follows its publishers: quality of service, order, loss and topics."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
import itertools
import re
import subprocess
import sys
import threading
import time

from conftest import destroy, spin_until
from opencv_tools.base.logs import Log
from opencv_tools.image.cdr import (
    cdr_to_image, image_to_cdr, WireCompressedImage, WireImage, WireMessage)
from opencv_tools.image.errors import CdrError
from opencv_tools.topics import (
    message_reader, subscription as module, subscription as subscription_module)
from opencv_tools.topics.executor import FrameExecutor
from opencv_tools.topics.options import SubscriptionOptions
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.topics.subscription import FrameSubscription
from opencv_tools.transport import zero_copy
from opencv_tools.transport.rcl_structures import MessageInfo
import pytest
import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CompressedImage, Image
from waiting import join, LONGEST_SECONDS, pause, wait_until

TOPIC = '/video_frames'
RELIABLE = QoSProfile(depth=10)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@dataclass
class Received:
    """Frames and errors that a subscription passed on."""

    frames: list[WireMessage] = field(default_factory=list)
    times: list[int] = field(default_factory=list)
    errors: list[CdrError] = field(default_factory=list)

    def take(self, received: ReceivedMessage) -> None:
        self.frames.append(received.message)
        self.times.append(received.receive_ns)

    def numbers(self, first: int = 0) -> list[int]:
        """Return the numbers of the frames, from a first one on."""
        return [frame.header.sec for frame in self.frames if frame.header.sec >= first]


@pytest.fixture(autouse=True)
def _poll_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subscription_module, '_GRAPH_POLL_SECONDS', 0.1)


@pytest.fixture
def received() -> Received:
    return Received()


@pytest.fixture
def subscribe(node: Node, received: Received) -> Iterator[Callable[..., FrameSubscription]]:
    """Return a function that subscribes to frames until the test ends."""
    subscriptions: list[FrameSubscription] = []

    def _subscribe(
        transport: str = 'auto', depth: int | None = 10, subscriber: Node = node,
    ) -> FrameSubscription:
        subscriptions.append(FrameSubscription(
            subscriber, 'video_frames', Log(subscriber.get_logger()), received.take,
            received.errors.append, SubscriptionOptions(transport=transport, depth=depth)))
        subscriptions[-1].start()
        return subscriptions[-1]

    yield _subscribe
    for subscription in subscriptions:
        subscription.destroy()


def connect(
    node: Node, camera: Node, subscribe: Callable[..., FrameSubscription],
) -> tuple[FrameSubscription, Publisher]:
    """Create a subscription and a matched publisher."""
    subscription = subscribe()
    publisher = camera.create_publisher(Image, TOPIC, RELIABLE)
    spin_until(node, lambda: are_matched(publisher, subscription))
    return subscription, publisher


def are_matched(publisher: Publisher, subscription: FrameSubscription) -> bool:
    """Return whether both ends have discovered each other, which happens at different times."""
    return (publisher.get_subscription_count() > 0
            and subscription._sources.image._reader.publisher_count() > 0)


def image(number: int) -> Image:
    message = Image(height=1, width=1, encoding='mono8', step=1, data=[number % 256])
    message.header.stamp.sec = number
    return message


def wire_image(number: int) -> WireImage:
    return cdr_to_image(serialize_message(image(number)))


def compressed(number: int) -> CompressedImage:
    message = CompressedImage(format='jpeg', data=bytes(range(number % 256)))
    message.header.stamp.sec = number
    return message


def publish_until(
    node: Node, publisher: Publisher, make: Callable[[int], object],
    condition: Callable[[], bool],
) -> None:
    """Publish numbered messages until a condition holds."""
    numbers = itertools.count()

    def step() -> bool:
        publisher.publish(make(next(numbers)))
        return condition()

    spin_until(node, step)


def spin_polls(node: Node, subscription: FrameSubscription, count: int) -> None:
    """Spin until the subscription has looked at the graph so many times again."""
    for _ in range(count):
        before = subscription._polled_at
        spin_until(node, lambda: subscription._polled_at != before)  # noqa: B023


def requests(node: Node, topic: str = TOPIC) -> dict[bytes, QoSProfile]:
    """Return the requested profiles of the subscriptions in the graph."""
    return {bytes(info.endpoint_gid): info.qos_profile
            for info in node.get_subscriptions_info_by_topic(topic)}


def reliabilities(node: Node) -> list[ReliabilityPolicy]:
    return [qos.reliability for qos in requests(node).values()]


@pytest.mark.parametrize('first', ['publisher', 'subscription'])
def test_best_effort_publisher(
        node: Node, camera: Node, received: Received, subscribe: Callable[..., FrameSubscription],
        first: str, capfd: pytest.CaptureFixture[str]) -> None:
    if first == 'subscription':
        subscribe()
    publisher = camera.create_publisher(Image, TOPIC, BEST_EFFORT)
    if first == 'publisher':
        spin_until(node, lambda: node.count_publishers(TOPIC) == 1)
        subscribe()
    publish_until(node, publisher, image, lambda: len(received.frames) > 3)
    spin_until(node, lambda: reliabilities(node) == [ReliabilityPolicy.BEST_EFFORT])
    logged = capfd.readouterr().err.count(
        'Receiving /video_frames (sensor_msgs/msg/Image, best effort), as its publishers offer')
    assert logged == (first == 'subscription')
    assert all(isinstance(frame, WireImage) for frame in received.frames)


class Stream:
    """Publish numbered images from a thread, independent of the executor."""

    def __init__(self, publisher: Publisher, first: int) -> None:
        self.published: list[int] = []
        self._publisher = publisher
        self._first = first
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        for number in itertools.count(self._first):
            self._publisher.publish(image(number))
            self.published.append(number)
            if self._ended.wait(0.005):
                return

    def end(self) -> None:
        self._ended.set()
        self._thread.join()


def test_no_loss_or_duplicate_as_a_publisher_joins_and_leaves(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription]) -> None:
    stays = camera.create_publisher(Image, TOPIC, RELIABLE)
    subscription = subscribe(depth=None)
    spin_until(node, lambda: are_matched(stays, subscription))
    stream = Stream(stays, 1000)
    try:
        spin_until(node, lambda: len(received.frames) > 20)
        assert reliabilities(node) == [ReliabilityPolicy.RELIABLE]
        joins = camera.create_publisher(Image, TOPIC, BEST_EFFORT)
        publish_until(
            node, joins, image, lambda: len(received.frames) > 3 + len(received.numbers(1000)))
        spin_until(node, lambda: reliabilities(node) == [ReliabilityPolicy.BEST_EFFORT])
        requested = requests(node)
        camera.destroy_publisher(joins)
        spin_until(node, lambda: node.count_publishers(TOPIC) == 1)
        spin_polls(node, subscription, 3)
    finally:
        stream.end()
    assert requests(node) == requested  # not subscribed again
    spin_until(node, lambda: received.numbers(1000)[-1] == stream.published[-1])
    assert received.numbers(1000) == stream.published


def test_reliable_publisher_after_a_best_effort_publisher(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription]) -> None:
    subscription = subscribe()
    leaves = camera.create_publisher(Image, TOPIC, BEST_EFFORT)
    publish_until(node, leaves, image, lambda: bool(received.frames))
    camera.destroy_publisher(leaves)
    spin_until(node, lambda: not node.count_publishers(TOPIC))
    spin_polls(node, subscription, 1)
    camera.create_publisher(Image, TOPIC, RELIABLE)
    spin_until(node, lambda: reliabilities(node) == [ReliabilityPolicy.RELIABLE])


def test_latched_image_published_before(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription]) -> None:
    camera.create_publisher(Image, TOPIC, LATCHED).publish(image(7))
    subscribe()
    spin_until(node, lambda: received.numbers() == [7])
    other = camera.create_publisher(Image, TOPIC, RELIABLE)  # without latching
    publish_until(node, other, image, lambda: len(received.frames) > 3)
    assert received.numbers().count(7) <= 2


def test_duplicates_of_two_subscriptions_are_dropped(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription]) -> None:
    subscription = subscribe()
    publisher = camera.create_publisher(Image, TOPIC, LATCHED)
    wait_until(lambda: publisher.get_subscription_count() == 1)  # not subscribed again yet
    for number in range(1, 31):
        publisher.publish(image(number))
    spin_until(node, lambda: DurabilityPolicy.TRANSIENT_LOCAL in [
        qos.durability for qos in requests(node).values()])
    spin_until(node, lambda: len(requests(node)) == 1)  # the old subscription is gone
    assert received.numbers() == list(range(21, 31))
    publisher.publish(image(31))
    spin_until(node, lambda: received.numbers()[-1] == 31)
    assert received.numbers() == list(range(21, 32))
    assert subscription.account.lost == 0


def test_lost_frames_across_a_new_subscription(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription]) -> None:
    subscription, publisher = connect(node, camera, subscribe)
    publisher.publish(image(0))
    spin_until(node, lambda: len(received.frames) == 1)
    for number in range(1, 31):
        publisher.publish(image(number))
    spin_until(node, lambda: len(received.frames) == 11)
    assert received.numbers() == [0, *range(21, 31)]
    assert subscription.account.lost == 20
    # A second publisher with this profile would end the count.
    subscription._sources.image._subscribe_again(subscription._sources.image.topic, BEST_EFFORT)
    assert len(requests(node)) == 2
    spin_until(node, lambda: publisher.get_subscription_count() == 2)
    for number in range(31, 61):
        publisher.publish(image(number))
    spin_until(node, lambda: len(received.frames) == 21)
    spin_until(node, lambda: len(requests(node)) == 1)
    assert received.numbers()[-10:] == list(range(51, 61))
    assert subscription.account.lost == 40


def test_lost_frames_of_each_publisher(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription]) -> None:
    subscription, publisher = connect(node, camera, subscribe)
    other = camera.create_publisher(Image, TOPIC, RELIABLE)
    spin_until(node, lambda: other.get_subscription_count() == 1)
    for sender, number in ((other, 101), (publisher, 0), (other, 102)):
        sender.publish(image(number))
        spin_until(node, lambda count=number: received.numbers()[-1:] == [count])
    for number in range(1, 31):
        publisher.publish(image(number))
    spin_until(node, lambda: received.numbers()[-1:] == [30])
    other.publish(image(103))
    spin_until(node, lambda: received.numbers()[-1:] == [103])
    assert subscription.account.lost == 20


def test_lost_first_frames_of_a_new_publisher(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription]) -> None:
    subscription = subscribe()
    for restarts in range(1, 51):
        publisher = camera.create_publisher(Image, TOPIC, RELIABLE)
        wait_until(lambda: are_matched(publisher, subscription))  # noqa: B023
        for number in range(30):
            publisher.publish(image(100 * restarts + number))
        last = 100 * restarts + 29
        spin_until(node, lambda: received.numbers()[-1:] == [last])  # noqa: B023
        camera.destroy_publisher(publisher)
        wait_until(lambda: not subscription._sources.image._reader.publisher_count())
        account = subscription.account
        before = re.search(r'^, (\d+) sent before', account.uncounted)
        assert (len(received.frames) + account.lost + int(before[1] if before else 0)
                == 30 * restarts)


@pytest.mark.parametrize(('passed_on', 'error'), [(30, None), (7, None), (7, KeyboardInterrupt)])
def test_received_messages_at_close(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription], monkeypatch: pytest.MonkeyPatch,
        passed_on: int, error: type[BaseException] | None) -> None:
    subscription = subscribe(depth=None)
    publisher = camera.create_publisher(Image, TOPIC, QoSProfile(depth=30))
    wait_until(lambda: are_matched(publisher, subscription))
    for number in range(30):
        publisher.publish(image(number))
    wait_until(lambda: publisher.wait_for_all_acked(Duration()))

    def may_continue() -> bool:
        if error and len(received.frames) == passed_on:
            raise error
        return len(received.frames) < passed_on

    assert subscription.close(may_continue if passed_on < 30 else lambda: True) == 30 - passed_on
    assert received.numbers() == list(range(passed_on))
    assert subscription.account.lost == 0
    assert list(node.subscriptions) == []


def test_order_of_old_and_new_subscription(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription]) -> None:
    subscription, publisher = connect(node, camera, subscribe)
    for number in range(5):
        publisher.publish(image(number))
    subscription._sources.image._subscribe_again(subscription._sources.image.topic, BEST_EFFORT)
    wait_until(lambda: publisher.get_subscription_count() == 2)
    for number in range(5, 9):
        publisher.publish(image(number))
    spin_until(node, lambda: len(received.frames) >= 9)
    assert received.numbers() == list(range(9))


def test_received_messages_of_a_publisher_that_left(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription]) -> None:
    subscription, publisher = connect(node, camera, subscribe)
    for number in range(5):
        publisher.publish(image(number))
    camera.destroy_publisher(publisher)
    wait_until(lambda: not subscription._sources.image._reader.publisher_count())
    subscription._sources.image._subscribe_again(subscription._sources.image.topic, BEST_EFFORT)
    spin_until(node, lambda: received.numbers() == list(range(5)))
    assert [subscription.topic_name for subscription in node.subscriptions].count(
            '/video_frames') == 1


def test_no_loss_when_a_publisher_of_other_numbers_leaves(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription]) -> None:
    stays, leaves = (camera.create_publisher(Image, TOPIC, RELIABLE) for _ in range(2))
    for _ in range(50):
        leaves.publish(image(0))  # counted although nobody subscribes
    subscription = subscribe()
    spin_until(node, lambda: all(
        publisher.get_subscription_count() for publisher in (stays, leaves)))
    spin_polls(node, subscription, 2)
    for number in range(5):
        stays.publish(image(number))
        spin_until(node, lambda count=number: len(received.frames) > count)
    leaves.publish(image(5))
    spin_until(node, lambda: len(received.frames) == 6)
    camera.destroy_publisher(leaves)
    spin_until(node, lambda: node.count_publishers(TOPIC) == 1)
    for number in range(6, 10):
        stays.publish(image(number))
        spin_until(node, lambda count=number: len(received.frames) > count)
    assert subscription.account.lost == 0


def test_no_loss_when_a_publisher_replaces_another_unseen(
        node: Node, camera: Node, received: Received, monkeypatch: pytest.MonkeyPatch,
        subscribe: Callable[..., FrameSubscription]) -> None:
    subscription = subscribe(depth=None)
    first = camera.create_publisher(Image, TOPIC, RELIABLE)
    publish_until(node, first, image, lambda: len(received.frames) > 3)
    monkeypatch.setattr(subscription._sources.image, 'adapt', lambda: False)  # as for a late event
    camera.destroy_publisher(first)
    second = camera.create_publisher(Image, TOPIC, QoSProfile(depth=100))
    for number in range(1000, 1030):  # mostly before the discovery
        second.publish(image(number))
    publish_until(node, second, image, lambda: len(received.frames) > 20)
    assert subscription.account.lost == 0


def test_unlimited_depth_keeps_every_frame(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription]) -> None:
    subscription = subscribe(depth=None)
    publisher = camera.create_publisher(Image, TOPIC, RELIABLE)
    spin_until(node, lambda: are_matched(publisher, subscription))
    for number in range(300):
        publisher.publish(image(number))
    spin_until(node, lambda: len(received.frames) == 300)
    assert received.numbers() == list(range(300))
    assert subscription.account.lost == 0


def test_broken_messages_and_the_next_frame(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription]) -> None:
    subscription, publisher = connect(node, camera, subscribe)
    whole = serialize_message(image(1))
    huge = whole[:-5] + b'\xff\xff\xff\xff' + whole[-1:]  # claims to hold 4 GB
    for data in (whole[:30], huge, b'\0\3' + b'\xff' * 60, whole):
        publisher.publish(data)
    spin_until(node, lambda: bool(received.frames))
    assert received.numbers() == [1]
    assert len(received.errors) == 3
    assert 'the message ends after' in str(received.errors[0])
    assert 'needs 4294967295' in str(received.errors[1])
    assert 'the middleware cannot read the message' in str(received.errors[2])
    assert subscription.account.lost == 0


@pytest.fixture
def taken(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list of the functions that take messages, in the order of their calls."""
    names: list[str] = []
    for name in ('take_image', 'take_serialized'):
        def take(handle: object, name: str = name) -> object:
            names.append(name)
            return getattr(zero_copy, name)(handle)

        monkeypatch.setattr(message_reader, name, take)
    return names


def connect_steadily(
    node: Node, camera: Node, received: Received, subscribe: Callable[..., FrameSubscription],
    taken: list[str],
) -> tuple[FrameSubscription, Publisher]:
    """Create a subscription and a publisher, whose images the middleware reads already."""
    subscription, publisher = connect(node, camera, subscribe)
    while taken[-1:] != ['take_image']:
        count = len(received.frames)
        publisher.publish(image(count))
        spin_until(node, lambda: len(received.frames) > count)  # noqa: B023
    return subscription, publisher


WHOLE = image_to_cdr(replace(wire_image(1000), data=bytes(100)))
NO_CDR, CUT_OFF = WHOLE[:30], WHOLE[:-5]


@pytest.mark.parametrize(('messages', 'failed', 'lost'), [
    ([NO_CDR], 1, 0), ([CUT_OFF], 1, 0), ([NO_CDR, CUT_OFF, CUT_OFF], 3, 0),
    ([WHOLE], 0, 0), ([], 0, 0)])
def test_unreadable_messages_of_a_steady_publisher(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription], taken: list[str],
        messages: list[bytes], failed: int, lost: int) -> None:
    subscription, publisher = connect_steadily(node, camera, received, subscribe, taken)
    count = len(received.frames)
    for number, message in enumerate(messages, 1):
        publisher.publish(message)
        spin_until(node, lambda: len(
            received.errors + received.frames) == count + number)  # noqa: B023
    publisher.publish(WHOLE)
    spin_until(node, lambda: received.numbers()[-1:] == [1000])
    assert (len(received.errors), subscription.account.lost) == (failed, lost)
    assert all('the middleware cannot read' in str(err) for err in received.errors[:1])


@pytest.mark.parametrize(('messages', 'failed', 'lost'), [
    ([NO_CDR], 1, 0), ([NO_CDR, NO_CDR], 1, 1),
    ([CUT_OFF], 0, 1),  # the middleware does not report it
    ([WHOLE, NO_CDR, WHOLE, CUT_OFF, NO_CDR], 3, 0)])
def test_unreadable_messages_in_front_of_another(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription], taken: list[str],
        messages: list[bytes], failed: int, lost: int) -> None:
    subscription, publisher = connect_steadily(node, camera, received, subscribe, taken)
    count = len(received.frames)
    for message in (*messages, WHOLE):
        publisher.publish(message)
    wait_until(lambda: publisher.wait_for_all_acked(Duration()))
    spin_until(node, lambda: len(received.frames) == count + 1 + messages.count(WHOLE))
    assert (len(received.errors), subscription.account.lost) == (failed, lost)


def test_unreadable_messages_at_close(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription], taken: list[str]) -> None:
    subscription, publisher = connect_steadily(node, camera, received, subscribe, taken)
    for message in (WHOLE, NO_CDR, WHOLE, CUT_OFF):
        publisher.publish(message)
    wait_until(lambda: publisher.wait_for_all_acked(Duration()))
    assert subscription.close(lambda: False) == 4
    assert subscription.account.lost == 0


def test_readers_of_a_steady_publisher(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription], taken: list[str]) -> None:
    def receive(count: int) -> set[str]:
        taken.clear()
        for number in range(len(received.frames), len(received.frames) + count):
            publisher.publish(image(number))
            spin_until(node, lambda: len(received.frames) > number)  # noqa: B023
        return set(taken)

    subscription, publisher = connect(node, camera, subscribe)
    assert receive(message_reader._STEADY_MESSAGES) == {'take_serialized'}
    receive(2)
    assert receive(10) == {'take_image'}
    subscription._sources.image._subscribe_again(subscription._sources.image.topic, BEST_EFFORT)
    spin_until(node, lambda: publisher.get_subscription_count() == 2)
    # Each of the two subscriptions needs the numbers of all messages.
    assert receive(message_reader._STEADY_MESSAGES + 10) == {'take_serialized'}
    subscription._sources.image._retire_previous()
    spin_until(node, lambda: publisher.get_subscription_count() == 1)
    receive(message_reader._STEADY_MESSAGES + 10)
    assert receive(10) == {'take_image'}
    assert received.numbers() == list(range(len(received.frames)))


def test_reception_time_of_frames(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription], monkeypatch: pytest.MonkeyPatch) -> None:
    subscription, publisher = connect(node, camera, subscribe)
    before = time.time_ns()
    publisher.publish(image(0))  # received before this returns, in one process
    wait_until(lambda: publisher.wait_for_all_acked(Duration()))
    after = time.time_ns()
    pause(0.01)
    spin_until(node, lambda: bool(received.frames))
    assert before <= received.times[0] <= after
    reader = subscription._sources.image._reader
    monkeypatch.setattr(reader, 'take', lambda: [(wire_image(1), MessageInfo())])
    monkeypatch.setattr(time, 'time_ns', lambda: 5)
    subscription._wake([reader], False)
    assert received.times[1] == 5  # the middleware did not report a time


# Transports

@pytest.mark.parametrize(('transport', 'kind'), [
    ('auto', WireCompressedImage), ('compressed', WireCompressedImage)])
def test_compressed_images_are_unchanged(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription], transport: str, kind: type) -> None:
    subscription = subscribe(transport)
    publisher = camera.create_publisher(CompressedImage, f'{TOPIC}/compressed', RELIABLE)
    spin_until(node, lambda: publisher.get_subscription_count() == 1)
    publisher.publish(compressed(255))
    spin_until(node, lambda: bool(received.frames))
    assert subscription.topic_name == f'{TOPIC}/compressed'
    assert isinstance(received.frames[0], kind)
    assert bytes(received.frames[0].data) == bytes(range(255))
    assert (received.frames[0].format, received.frames[0].header.sec) == ('jpeg', 255)


@pytest.mark.parametrize(('transport', 'kind'), [
    ('auto', WireImage), ('raw', WireImage), ('compressed', WireCompressedImage)])
def test_auto_prefers_raw_over_compressed(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription], transport: str, kind: type) -> None:
    publishers = (camera.create_publisher(CompressedImage, f'{TOPIC}/compressed', RELIABLE),
                  camera.create_publisher(Image, TOPIC, RELIABLE))
    subscription = subscribe(transport)

    def publish() -> bool:
        publishers[0].publish(compressed(1))
        publishers[1].publish(image(1))
        return len(received.frames) > 3

    spin_until(node, publish)
    spin_polls(node, subscription, 3)
    assert {type(frame) for frame in received.frames} == {kind}


def test_auto_keeps_its_topic_until_the_publisher_leaves(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription], capfd: pytest.CaptureFixture[str]) -> None:
    subscription = subscribe()
    first = camera.create_publisher(CompressedImage, f'{TOPIC}/compressed', RELIABLE)
    publish_until(node, first, compressed, lambda: bool(received.frames))
    second = camera.create_publisher(Image, TOPIC, RELIABLE)
    spin_until(node, lambda: node.count_publishers(TOPIC) == 1)
    spin_polls(node, subscription, 4)
    assert subscription.topic_name == f'{TOPIC}/compressed'
    camera.destroy_publisher(first)
    received.frames.clear()
    publish_until(node, second, image, lambda: bool(received.frames))
    assert subscription.topic_name == TOPIC
    assert isinstance(received.frames[0], WireImage)
    assert subscription.account.lost == 0
    assert capfd.readouterr().err.count('as its publishers offer') == 2


def test_auto_waits_for_a_raw_topic_that_appears_later(
        node: Node, camera: Node, subscribe: Callable[..., FrameSubscription]) -> None:
    subscription = subscribe()
    camera.create_publisher(CompressedImage, f'{TOPIC}/compressed', RELIABLE)
    wait_until(lambda: node.count_publishers(f'{TOPIC}/compressed') == 1)
    subscription._poll_graph()
    assert subscription.topic_name == TOPIC
    camera.create_publisher(Image, TOPIC, RELIABLE)
    wait_until(lambda: node.count_publishers(TOPIC) == 1)
    for _ in range(3):
        subscription._poll_graph()
        assert subscription.topic_name == TOPIC


def test_auto_changes_to_raw_before_the_first_frame(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription]) -> None:
    subscription = subscribe()
    first = camera.create_publisher(CompressedImage, f'{TOPIC}/compressed', RELIABLE)
    spin_until(node, lambda: first.get_subscription_count() == 1)
    second = camera.create_publisher(Image, TOPIC, RELIABLE)
    spin_until(node, lambda: second.get_subscription_count() == 1)
    first.publish(compressed(1))
    publish_until(node, second, image, lambda: len(received.frames) > 3)
    assert {type(frame) for frame in received.frames} == {WireImage}
    assert subscription.topic_name == TOPIC


@pytest.fixture
def remapped(domain: int) -> Iterator[Callable[[str], Node]]:
    """Return a function that creates a node with a remapping of ``video_frames``."""
    nodes: list[Node] = []

    def _remapped(target: str) -> Node:
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        nodes.append(Node('remapped', context=context, namespace='/robot',
                          cli_args=['--ros-args', '-r', f'video_frames:={target}']))
        return nodes[-1]

    yield _remapped
    for created in nodes:
        destroy(created)


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize(('transport', 'message_type', 'target', 'topic'), [
    ('auto', Image, '/camera/image_raw', '/camera/image_raw'),
    ('auto', CompressedImage, '/camera/image_raw', '/camera/image_raw/compressed'),
    ('compressed', CompressedImage, 'image_raw', '/robot/image_raw/compressed'),
    ('auto', CompressedImage, '/camera/image_raw/compressed', '/camera/image_raw/compressed'),
    ('compressed', CompressedImage, '/camera/image_raw/compressed',
     '/camera/image_raw/compressed'),
    ('compressed', CompressedImage, '/camera/jpeg', '/camera/jpeg'),
    ('auto', CompressedImage, '/camera/jpeg', '/camera/jpeg'),
    ('auto', Image, '/odd/compressed', '/odd/compressed')])
def test_remapped_topics(
        camera: Node, remapped: Callable[[str], Node], received: Received,
        subscribe: Callable[..., FrameSubscription], transport: str, message_type: type,
        target: str, topic: str) -> None:
    receiving = remapped(target)
    subscription = subscribe(transport, subscriber=receiving)
    make = image if message_type is Image else compressed
    publish_until(receiving, camera.create_publisher(message_type, topic, RELIABLE), make,
                  lambda: bool(received.frames))
    assert subscription.topic_name == topic
    subscription.destroy()


# Warnings without frames

def test_warning_for_each_new_reason(
        node: Node, camera: Node, domain: int, received: Received,
        subscribe: Callable[..., FrameSubscription], monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(module, '_MIN_SECONDS', 0.3)
    console = ''

    def logged(text: str) -> bool:
        nonlocal console
        console += capfd.readouterr().err
        return text in console

    subscription = subscribe()
    spin_until(node, lambda: logged(
        f'No frames: no publisher on /video_frames; no images are published in ROS_DOMAIN_ID '
        f'{domain}; is a publisher running, with the same ROS_DOMAIN_ID?'))
    other = camera.create_publisher(Image, '/camera/image_raw', RELIABLE)
    spin_until(node, lambda: logged('receive one with -r video_frames:=/camera/image_raw'))
    publisher = camera.create_publisher(Image, TOPIC, RELIABLE)
    spin_until(node, lambda: logged(
        'no frame arrives from the publisher of /video_frames (node /front/camera); '))
    spin_polls(node, subscription, 2)  # no repetition meanwhile
    publish_until(node, publisher, image, lambda: logged('Frames arrive on /video_frames'))
    console += capfd.readouterr().err
    assert console.count('No frames: ') == 3
    assert console.count('Frames arrive') == 1
    spin_until(node, lambda: logged('Frames arrive') and console.count('No frames: ') == 4)
    assert console.count('no frame arrives from') == 2
    assert '--ipc=host' in console
    camera.destroy_publisher(publisher)
    spin_until(node, lambda: console.count(':=/camera/image_raw') == 2 or logged('never'))
    assert other.get_subscription_count() == 0


def test_no_warning_after_a_latched_image(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription], monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(module, '_MIN_SECONDS', 0.3)
    camera.create_publisher(Image, TOPIC, LATCHED).publish(image(7))
    subscription = subscribe()
    spin_until(node, lambda: received.numbers() == [7])
    capfd.readouterr()  # of a wait on a busy machine
    spin_polls(node, subscription, 2)
    assert 'No frames' not in capfd.readouterr().err


def test_no_warning_while_the_executor_is_busy(
        subscribe: Callable[..., FrameSubscription], monkeypatch: pytest.MonkeyPatch) -> None:
    subscription = subscribe()
    waits: list[float] = []
    monkeypatch.setattr(
        subscription._no_frames_warning, 'check',
        lambda elapsed, *_, **__: waits.append(elapsed))
    subscription._polled_at = time.monotonic() - 60
    subscription._poll_graph()
    subscription._poll_graph()
    assert waits[0] == 2 * subscription_module._GRAPH_POLL_SECONDS
    assert 0 <= waits[1] <= 2 * subscription_module._GRAPH_POLL_SECONDS


# The end

@pytest.mark.parametrize('name', ['receive', 'choose_topic'])
def test_end_by_a_callback_while_the_executor_works(
        node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    is_working, is_destroyed = threading.Event(), threading.Event()
    readers = []

    def end(_: ReceivedMessage) -> None:
        wait_until(is_working.is_set)
        subscription.destroy()
        is_destroyed.set()

    subscription = FrameSubscription(
        node, 'video_frames', Log(node.get_logger()), end, end,
        SubscriptionOptions(depth=10, threaded=True))
    subscription.start()
    work = getattr(subscription._sources.image, name)

    def work_slowly(*arguments: object) -> object:
        if subscription._queue.count:
            is_working.set()
            is_destroyed.wait(0.3)
            readers.append(len(subscription._sources.image.readers))
        return work(*arguments)

    monkeypatch.setattr(subscription._sources.image, name, work_slowly)
    publisher = camera.create_publisher(Image, TOPIC, RELIABLE)
    spin_until(node, lambda: are_matched(publisher, subscription))
    publisher.publish(image(1))
    publisher.publish(image(2))
    spin_until(node, is_destroyed.is_set)
    assert {*readers} == {1}


@pytest.mark.parametrize('name', ['_wake', '_poll_graph'])
def test_call_of_the_executor_after_the_end(
        node: Node, subscribe: Callable[..., FrameSubscription], name: str) -> None:
    subscription = subscribe()
    subscription.destroy()
    getattr(subscription, name)(*([[], True] if name == '_wake' else []))
    assert list(node.subscriptions) == []


@pytest.mark.parametrize('when', ['before', 'during'])
def test_exception_of_a_threaded_callback_at_the_end(
        node: Node, camera: Node, when: str) -> None:
    has_frame, may_fail = threading.Event(), threading.Event()

    def fail(_: ReceivedMessage) -> None:
        has_frame.set()
        wait_until(may_fail.is_set)
        raise ValueError('mine')

    subscription = FrameSubscription(
        node, 'video_frames', Log(node.get_logger()), fail, fail,
        SubscriptionOptions(transport='raw', depth=10, threaded=True))
    subscription.start()
    publisher = camera.create_publisher(Image, TOPIC, RELIABLE)
    publish_until(node, publisher, image, has_frame.is_set)
    thread = subscription._consumer._thread
    if when == 'before':
        may_fail.set()
        join(thread)
    else:
        threading.Timer(0.1, may_fail.set).start()
    with pytest.raises(ValueError, match='mine'):
        subscription.destroy()
    subscription.destroy()


def test_exception_of_a_threaded_callback_after_its_destroy(
        node: Node, camera: Node) -> None:
    def fail(_: ReceivedMessage) -> None:
        subscription.destroy()
        raise ValueError('mine')

    subscription = FrameSubscription(
        node, 'video_frames', Log(node.get_logger()), fail, fail,
        SubscriptionOptions(transport='raw', depth=10, threaded=True))
    subscription.start()
    publisher = camera.create_publisher(Image, TOPIC, RELIABLE)
    with pytest.raises(ValueError, match='mine'):
        publish_until(node, publisher, image, lambda: False)
    subscription.destroy()
    assert subscription._wake_ups not in node.waitables


def test_every_message_beside_a_timer_that_is_always_due(
        node: Node, camera: Node, received: Received,
        subscribe: Callable[..., FrameSubscription]) -> None:
    subscription = subscribe(transport='raw', depth=None)
    publisher = camera.create_publisher(Image, TOPIC, QoSProfile(depth=1000))
    spin_until(node, lambda: are_matched(publisher, subscription))
    node.create_timer(0.0, lambda: None)
    for number in range(1, 201):
        publisher.publish(image(number))
    spin_until(node, lambda: len(received.frames) + subscription.account.skipped == 200)
    assert subscription.account.skipped == 0


def test_timer_that_is_due_comes_before_the_next_frame(node: Node, camera: Node) -> None:
    called: list[str] = []
    publisher = camera.create_publisher(Image, TOPIC, RELIABLE)

    def work() -> None:
        called.append('work')
        publisher.publish(image(len(called)))  # the middleware has it before the timer is due
        pause(0.02)

    def see(_: ReceivedMessage) -> None:
        called.append('frame')
        executor.call_soon(work)

    subscription = FrameSubscription(
        node, 'video_frames', Log(node.get_logger()), see, called.append,
        SubscriptionOptions(transport='raw', depth=1))
    subscription.start()
    node.create_timer(0.01, lambda: called.append('tick'))
    executor = FrameExecutor(node.context)
    executor.add_node(node)
    while not are_matched(publisher, subscription):
        executor.spin_once(timeout_sec=0.01)
    executor.call_soon(work)
    while called.count('frame') < 20:
        executor.spin_once()
    subscription.destroy()
    executor.remove_node(node)
    executor.shutdown()
    assert 'work frame' not in ' '.join(called)


def test_destroy_leaves_no_entity(
        node: Node, subscribe: Callable[..., FrameSubscription]) -> None:
    def entities() -> tuple[list[str], int, int]:
        return (sorted(subscription.topic_name for subscription in node.subscriptions),
                len(list(node.timers)), len(list(node.waitables)))

    names, timers, waitables = entities()
    subscription = subscribe()
    subscription._sources.image._subscribe_again(subscription._sources.image.topic, BEST_EFFORT)
    assert entities() == ([TOPIC, f'{TOPIC}/shm'], timers + 1, waitables + 1)
    subscription.destroy()
    assert entities() == (names, timers, waitables)


@pytest.mark.process
def test_import_without_recording_and_opencv() -> None:
    script = ('import sys; sys.modules.update(dict.fromkeys(("opencv_tools.recording", "cv2"))); '
              'import opencv_tools.topics.subscription')
    subprocess.run([sys.executable, '-c', script], check=True, timeout=LONGEST_SECONDS)
