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

"""Sources of shared frames: their begin, their end, and what the executor has to notice."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
import gc
from queue import Queue
from threading import Event, Thread

from opencv_tools.base.logs import Log
from opencv_tools.topics import shared_source
from opencv_tools.topics.options import SubscriptionOptions
from opencv_tools.topics.order import Position, Way
from opencv_tools.topics.queue import FrameQueue, ReceivedMessage
from opencv_tools.topics.shared_frames import MAX_PUBLISHERS, SharedFrames
from opencv_tools.topics.shared_source import SharedSource
from opencv_tools.topics.topic_discovery import TopicDiscovery
from opencv_tools.transport.shared_frames.announcement import announce, SUFFIX
from opencv_tools.transport.shared_frames.header import FrameHeader, publisher_identity
from opencv_tools.transport.shared_frames.memory import MAX_DEPTH, process_memory
from opencv_tools.transport.zero_copy import publisher_id
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image
from sharing import TOPIC
from std_msgs.msg import String
from switching import switching_in
from waiting import item_of, join, wait_until

pytest_plugins = ['sharing']
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STRANGER = bytes(16)  # publisher without an announcement
Hold = Callable[[Iterable[SharedSource]], None]


class Publisher:
    """A publisher of the image topic that shares frames with any numbers."""

    def __init__(self, node: Node) -> None:
        self._images = node.create_publisher(Image, TOPIC, 10)
        self._announcements = node.create_publisher(String, TOPIC + SUFFIX, LATCHED)
        self.identifier = publisher_id(self._images.handle)
        self.share()

    def share(self, frames: int = 0) -> None:
        """Create a service and announce it, with a number of frames that were only shared."""
        self.writer = process_memory().create_writer(16)
        self.announce(frames)

    def announce(self, frames: int) -> None:
        """Announce the service."""
        self._announcements.publish(String(data=announce(
            self.writer.service, self.identifier.hex(), frames).to_text()))

    def send(self, *numbers: int, message: int = 1) -> None:
        """Share frames; a frame is also a message if its number is that of the message."""
        for number in numbers:
            slot = self.writer.lend(1)
            slot.data[:] = 0
            header = FrameHeader(number=number, message=message, is_message=number == message,
                                 height=1, width=1, step=1)
            header.identity[:] = publisher_identity(self.identifier, TOPIC)
            slot.publish(header, '', 'mono8')


class Receiver:
    """The shared frames of the topic, without an executor and without the image topic."""

    def __init__(self, node: Node) -> None:
        self.queue = FrameQueue(MAX_DEPTH)
        #: Value of ``has_changed`` at each call of ``on_change``.
        self.changes: Queue[bool] = Queue()
        #: An element for each frame that a source has put.
        self.puts: Queue[None] = Queue()
        self.shared = SharedFrames(
            TopicDiscovery(node, TOPIC, 'auto'), self.queue, Log(node.get_logger()),
            SubscriptionOptions(depth=MAX_DEPTH, max_views=1),
            on_frame=lambda: self.puts.put(None),
            on_change=lambda: self.changes.put(self.shared.has_changed))

    @property
    def sources(self) -> list[SharedSource]:
        """Return the sources."""
        return [*self.shared._sources.values()]

    def way(self, publisher: Publisher) -> Way:
        """Return how the frames of a publisher arrive."""
        with self.queue.lock:
            return self.queue.order.way(publisher.identifier)

    def read(self, publisher: Publisher) -> None:
        """Read announcements until the service of a publisher is known."""
        def is_known() -> bool:
            self.shared.read_announcement()
            return self.shared._services.of(publisher.identifier) == publisher.writer.service

        wait_until(is_known, 'the announcement')

    def join(self, publisher: Publisher) -> None:
        """Open the frames of a publisher."""
        self.read(publisher)
        assert not self.shared.update({publisher.identifier})
        assert self.way(publisher) is Way.JOINING

    def share(self, publisher: Publisher) -> None:
        """Open the frames of a publisher and receive the first one."""
        self.join(publisher)
        publisher.send(1)
        wait_until(lambda: self.way(publisher) is Way.SHARED, 'the first frame')

    def pop_all(self) -> list[int]:
        """Return the numbers of the frames in the queue."""
        numbers = []
        while frame := self.queue.pop():
            assert isinstance(frame, ReceivedMessage), frame
            numbers.append(frame.number)
        return numbers


@pytest.fixture
def publisher(camera: Node) -> Publisher:
    return Publisher(camera)


@pytest.fixture
def receiver(node: Node) -> Iterator[Receiver]:
    receiving = Receiver(node)
    yield receiving
    receiving.shared.destroy()


def test_rest_of_a_publisher_that_left(
        receiver: Receiver, publisher: Publisher, hold_threads: Hold) -> None:
    receiver.share(publisher)
    hold_threads(receiver.sources)
    publisher.send(2, 3)
    assert not receiver.shared.update(frozenset())
    assert receiver.pop_all() == [1, 2, 3]
    assert receiver.way(publisher) is Way.TOPIC


def test_rest_of_a_service_that_another_one_follows(
        receiver: Receiver, publisher: Publisher, hold_threads: Hold) -> None:
    receiver.share(publisher)
    hold_threads(receiver.sources)
    publisher.send(2, 3)
    before = publisher.writer
    publisher.share()
    receiver.join(publisher)
    assert receiver.pop_all() == [1, 2, 3]
    wait_until(lambda: before.readers == 0, 'the end of the first reader')
    assert publisher.writer.readers == 1


def test_shared_frames_that_precede_a_message(
        receiver: Receiver, publisher: Publisher, hold_threads: Hold) -> None:
    receiver.share(publisher)
    hold_threads(receiver.sources)
    publisher.send(2, 3)
    assert not receiver.shared.update({publisher.identifier, STRANGER})
    assert receiver.shared.check() == []
    assert receiver.way(publisher) is Way.LEAVING
    receiver.shared.receive_before_message(publisher.identifier)
    assert receiver.pop_all() == [1, 2, 3]
    assert receiver.shared.has_changed


def test_publisher_that_is_not_shared_any_more_while_it_joins(
        receiver: Receiver, publisher: Publisher) -> None:
    receiver.join(publisher)
    assert not receiver.shared.update({publisher.identifier, STRANGER})
    assert receiver.way(publisher) is Way.TOPIC
    wait_until(lambda: publisher.writer.readers == 0, 'the end of the reader')


@pytest.mark.parametrize('is_message_first', [False, True])
def test_announcement_of_a_publisher_that_is_found_later(
        receiver: Receiver, publisher: Publisher, is_message_first: bool) -> None:
    def accept() -> None:
        assert receiver.queue.order.accepts(publisher.identifier, Position(1))

    publisher.share(frames=14)
    receiver.read(publisher)
    receiver.shared.update(frozenset())
    if is_message_first:
        accept()
        assert receiver.queue.order.before == 0
    receiver.shared.update({publisher.identifier})
    if not is_message_first:
        accept()
    assert receiver.queue.order.before == 14
    assert receiver.queue.order.count == 0


def test_announcements_of_many_publishers(receiver: Receiver, publisher: Publisher) -> None:
    for number in range(3 * MAX_PUBLISHERS):
        publisher.identifier = publisher.identifier[:-4] + number.to_bytes(4, 'big')
        publisher.announce(frames=1)
        receiver.read(publisher)
    assert len(receiver.shared._services._numbers) == MAX_PUBLISHERS


def test_changes_that_the_executor_has_to_see(
        receiver: Receiver, publisher: Publisher) -> None:
    assert not receiver.shared.has_changed
    receiver.read(publisher)
    assert receiver.shared.has_changed
    receiver.shared.update({publisher.identifier})
    assert receiver.shared.check() == []
    assert not receiver.shared.has_changed
    publisher.send(1)
    assert item_of(receiver.changes)
    assert receiver.shared.check() == []
    del publisher.writer
    gc.collect()
    assert item_of(receiver.changes)
    assert receiver.shared.check() == []
    assert receiver.way(publisher) is Way.TOPIC
    assert receiver.shared.explain({publisher.identifier}) == 'its writer has ended'


def test_messages_that_are_missing_for_too_long(
        receiver: Receiver, publisher: Publisher, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_source, '_JOIN_SECONDS', 0.0)
    receiver.join(publisher)
    publisher.send(5, message=5)
    item_of(receiver.puts)
    assert item_of(receiver.changes)
    assert receiver.way(publisher) is Way.JOINING
    assert receiver.shared.check() == [publisher.identifier]
    receiver.shared.stop_joining(publisher.identifier)
    assert receiver.shared.check() == []  # once is enough
    publisher.send(6, message=6)
    wait_until(lambda: receiver.way(publisher) is Way.SHARED, 'the next frame')
    assert receiver.pop_all() == [6]


def test_threads_that_receive_at_once(receiver: Receiver, publisher: Publisher) -> None:
    ended = Event()

    def receive() -> None:
        while not ended.is_set():
            source.receive()

    numbers: list[int] = []
    with switching_in(SharedSource.receive):
        receiver.join(publisher)
        source, = receiver.sources
        threads = [Thread(target=receive, daemon=True) for _ in range(2)]
        for thread in threads:
            thread.start()
        for last in range(8, 161, 8):
            publisher.send(*range(last - 7, last + 1))
            wait_until(lambda: numbers.extend(receiver.pop_all())
                       or numbers[-1:] == [last], f'frame {last}')  # noqa: B023
        ended.set()
        for thread in threads:
            join(thread)
    assert numbers == [*range(1, 161)]
    assert receiver.queue.order.count == 0
