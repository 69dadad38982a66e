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

"""The node of the recorder in this process: steps of a message, and exact counts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
import re
from threading import Event

from conftest import recorded_files
from opencv_tools.basic_image_subscriber import ImageSubscriber
from opencv_tools.recording.image_sink import ImageSink
from opencv_tools.recording.recorder import Recorder
from opencv_tools.topics.queue import ReceivedMessage
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import Image
from waiting import join, LONGEST_SECONDS, wait_until

TOPIC = '/video_frames'
IMAGE = Image(height=1, width=1, encoding='mono8', step=1, data=[1])
MAX_STEPS = 8

Create = Callable[..., tuple[ImageSubscriber, SingleThreadedExecutor]]


class PutError(Exception):
    """A frame has reached ``Recorder.put``."""


@pytest.fixture
def create(domain: int, tmp_path: Path) -> Iterator[Create]:
    """Return a function that creates the node, with its executor, until the test ends."""
    created: list[tuple[ImageSubscriber, SingleThreadedExecutor]] = []

    def _create(
        subscriber_class: type[ImageSubscriber] = ImageSubscriber, **parameters: object,
    ) -> tuple[ImageSubscriber, SingleThreadedExecutor]:
        words = ['--ros-args', '-p', f'output_dir:={tmp_path}']
        for name, value in parameters.items():
            words += ['-p', f'{name}:={value}']
        rclpy.init(domain_id=domain, args=words)
        subscriber, executor = subscriber_class(), SingleThreadedExecutor()
        executor.add_node(subscriber)
        created.append((subscriber, executor))
        return created[-1]

    yield _create
    for subscriber, executor in created:
        executor.shutdown()
        subscriber.destroy_node()
        rclpy.shutdown()


def wait_until_matched(publisher: Publisher, subscriber: ImageSubscriber) -> None:
    """Wait until both ends have discovered each other."""
    wait_until(lambda: publisher.get_subscription_count()
               and subscriber.subscription._sources.image._reader.publisher_count(), 'the match')


def test_steps_of_a_received_message(
        create: Create, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    def put(*_: object) -> None:
        raise PutError

    monkeypatch.setattr(Recorder, 'put', put)
    publisher = camera.create_publisher(Image, TOPIC, 10)
    subscriber, executor = create()
    wait_until_matched(publisher, subscriber)
    publisher.publish(IMAGE)
    with pytest.raises(PutError) as raised:
        wait_until(lambda: False, 'the error', partial(executor.spin_once, timeout_sec=0.05))
    names = [entry.name for entry in raised.traceback]
    steps = names[names.index('handler'):]
    assert 'listener_callback' in steps and steps[-1] == 'put'
    assert len(steps) <= MAX_STEPS, steps
    subscriber.close()


def spin_until_done(subscriber: ImageSubscriber, executor: SingleThreadedExecutor) -> None:
    wait_until(subscriber.done.done, 'the end of the recording',
               partial(executor.spin_once, timeout_sec=0.05))


def test_dropped_frames_count_for_max_frames(
        create: Create, camera: Node, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str]) -> None:
    has_begun, may_write, prepare = Event(), Event(), ImageSink.prepare

    def wait(*arguments: object) -> object:
        has_begun.set()
        assert may_write.wait(LONGEST_SECONDS)
        return prepare(*arguments)

    monkeypatch.setattr(ImageSink, 'prepare', wait)
    publisher = camera.create_publisher(Image, TOPIC, 10)
    subscriber, executor = create(max_frames=6, queue_size=2, writers=1)
    wait_until_matched(publisher, subscriber)
    publisher.publish(IMAGE)
    wait_until(has_begun.is_set, 'the first frame', partial(executor.spin_once, timeout_sec=0.05))
    for _ in range(5):  # of which the queue keeps two
        publisher.publish(IMAGE)
    spin_until_done(subscriber, executor)
    may_write.set()
    assert subscriber.close() == 0
    assert re.search(r'Received 6 frames .* 3 written .*, 3 dropped, 0 failed, 0 lost in transit',
                     capfd.readouterr().err)
    assert len(recorded_files(tmp_path)) == 3


class DescribingSubscriber(ImageSubscriber):
    """A subscriber with its own callback, as followers of the tutorial write it."""

    def listener_callback(self, received: ReceivedMessage) -> None:
        self.get_logger().info(f'own callback: {received.message.description}')
        super().listener_callback(received)


def test_overridden_callback(
        create: Create, camera: Node, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    publisher = camera.create_publisher(Image, TOPIC, 10)
    subscriber, executor = create(DescribingSubscriber, max_frames=1)
    wait_until_matched(publisher, subscriber)
    publisher.publish(IMAGE)
    spin_until_done(subscriber, executor)
    assert subscriber.close() == 0
    assert 'own callback: 1x1 mono8' in capfd.readouterr().err
    assert len(recorded_files(tmp_path)) == 1


@pytest.mark.thorough
def test_exact_sum_of_20000_frames(
        create: Create, camera: Node, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    subscriber, executor = create(
        on_overflow='block', queue_size=1, every_n=100, file_name='f{seq:06d}.npy')
    publisher = camera.create_publisher(Image, TOPIC, 10)
    wait_until_matched(publisher, subscriber)
    wait_until(lambda: len(recorded_files(tmp_path)) >= 2, '2 files', lambda: (
        publisher.publish(IMAGE), executor.spin_once(timeout_sec=0.05)))
    for _ in range(20_000):  # the middleware keeps 5000 of them for the node
        publisher.publish(IMAGE)
    subscriber.close()
    received, lost = map(int, re.search(
        r'Received (\d+) frames .* (\d+) lost in transit,', capfd.readouterr().err).groups())
    (publisher_frames,) = subscriber.subscription._queue.order._publishers.values()
    assert received > 1000
    assert received + lost == publisher_frames.last


def test_status_after_a_failure_of_the_topics(
        create: Create, camera: Node, monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr('opencv_tools.nodes.subscriber.topic_recorder.matches', None)
    camera.create_publisher(Image, '/other', 10)
    subscriber, _ = create(file_name='a.mcap', topics='/other')
    join(subscriber._topic_recorder._thread)
    assert subscriber.close() == 1
    assert 'the topics are not recorded any more: TypeError' in capfd.readouterr().err
