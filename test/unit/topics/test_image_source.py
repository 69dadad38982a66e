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

"""The image topic of a subscription: its waiting messages, and a change of the topic."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from opencv_tools.base.logs import Log
from opencv_tools.topics.image_source import ImageSource
from opencv_tools.topics.queue import FrameQueue, ReceivedMessage
from opencv_tools.topics.topic_discovery import TopicDiscovery
from opencv_tools.transport.zero_copy import publisher_id
import pytest
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import CompressedImage, Image
from waiting import wait_until

TOPIC = '/video_frames'


class Receiver:
    """The image topic of a subscription, without an executor."""

    def __init__(self, node: Node) -> None:
        self.queue = FrameQueue(100)
        #: Publisher of each message, and the frames that were in the queue before it.
        self.before: list[tuple[bytes, int]] = []
        self.source = ImageSource(
            TopicDiscovery(node, TOPIC, 'auto'), 100, self.queue, Log(node.get_logger()),
            before_message=lambda publisher: self.before.append((publisher, self.queue.count)),
            on_readers=lambda: None)
        self.source.use(True)

    def match(self, publisher: Publisher) -> None:
        """Wait until both ends have discovered each other."""
        wait_until(lambda: bool(
            publisher.get_subscription_count()
            and self.source.readers[-1].publisher_count()), 'the publisher')

    def pop_all(self) -> list[int]:
        """Return the stamps of the frames in the queue."""
        stamps = []
        while frame := self.queue.pop():
            assert isinstance(frame, ReceivedMessage), frame
            stamps.append(frame.message.header.sec)
        return stamps


@pytest.fixture
def receiver(node: Node) -> Iterator[Receiver]:
    receiving = Receiver(node)
    yield receiving
    receiving.source.destroy()


def publish(publisher: Publisher, *stamps: int) -> None:
    """Publish images, and wait until they have arrived."""
    for stamp in stamps:
        message = publisher.msg_type()
        message.header.stamp.sec = stamp
        publisher.publish(message)
    wait_until(lambda: publisher.wait_for_all_acked(Duration()))


def test_first_subscription_after_the_first_publisher(
        node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_STATIC_PEERS', '127.0.0.1')  # publishers may be on other hosts
    source = Receiver(node).source
    assert not source.is_used and not source.choose_topic()
    node.create_publisher(CompressedImage, f'{TOPIC}/compressed', 10)

    def use() -> bool:
        source.use(True)
        return source.is_used

    wait_until(use)
    assert source.topic_name == f'{TOPIC}/compressed'
    source.destroy()


def test_choice_of_frames_that_are_shared_from_the_beginning(node: Node) -> None:
    node.create_publisher(Image, TOPIC, 10)
    queue = FrameQueue(100)
    source = ImageSource(
        TopicDiscovery(node, TOPIC, 'auto'), 100, queue, Log(node.get_logger()),
        before_message=lambda _: None, on_readers=lambda: None)
    source.use(False)
    assert source.is_chosen and not source.is_used


@pytest.mark.parametrize('act', [
    lambda source: source.use(False), lambda source: source.drain()], ids=['left', 'drained'])
def test_waiting_messages(
        receiver: Receiver, camera: Node, act: Callable[[ImageSource], None]) -> None:
    publisher = camera.create_publisher(Image, TOPIC, 10)
    receiver.match(publisher)
    publish(publisher, 1, 2, 3)
    act(receiver.source)
    assert receiver.pop_all() == [1, 2, 3]
    sender = publisher_id(publisher.handle)
    assert receiver.before == [(sender, 0), (sender, 1), (sender, 2)]
