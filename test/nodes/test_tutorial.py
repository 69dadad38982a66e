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

"""Compatibility with nodes, topics and names of the tutorial."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import signal
import time

from conftest import NodeProcess, read_pictures, recorded_files, spin_until
from images import draw_pattern
import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import Image

Start = Callable[..., NodeProcess]


def fill_as_the_tutorial_does(frame: np.ndarray) -> Image:
    """Fill a message as ``cv_bridge.cv2_to_imgmsg(frame)`` of ROS 2 does: no stamp, 8UC3."""
    message = Image()
    message.height, message.width = frame.shape[:2]
    message.encoding = '8UC3'
    message.is_bigendian = 0
    message.data.frombytes(frame.tobytes())
    message.step = len(message.data) // message.height
    return message


def test_publisher_of_the_tutorial_is_recorded(
        start: Start, node: Node, tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    frames = [random.integers(0, 256, (48, 64, 3), np.uint8) for _ in range(10)]
    publisher = node.create_publisher(Image, 'video_frames', 10)
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', max_frames=10)
    spin_until(node, lambda: publisher.get_subscription_count() == 1)
    for frame in frames:
        publisher.publish(fill_as_the_tutorial_does(frame))
    assert subscriber.finish() == 0, subscriber.output
    assert 'Receiving video frame 1: 64x48 8UC3' in subscriber.output
    written = read_pictures(tmp_path / 'out')
    assert all(np.array_equal(left, right) for left, right in zip(written, frames, strict=True))


def test_plain_subscriber_receives_frames(start: Start, node: Node) -> None:
    messages: list[Image] = []
    node.create_subscription(Image, 'video_frames', messages.append, 10)
    began = time.time()
    publisher = start('img_publisher', source='pattern:65x49', publish_rate=20, max_frames=20,
                      wait_for_subscribers=1)
    spin_until(node, lambda: len(messages) == 20)
    assert publisher.finish() == 0, publisher.output

    stamps = []
    for number, message in enumerate(messages):
        assert (message.width, message.height, message.step) == (65, 49, 65 * 3)
        assert (message.encoding, message.is_bigendian) == ('bgr8', 0)
        assert message.header.frame_id == 'camera'
        frame = np.frombuffer(message.data, np.uint8).reshape(49, 65, 3)
        assert np.array_equal(frame, draw_pattern(number, 65, 49))
        stamps.append(message.header.stamp.sec + message.header.stamp.nanosec * 1e-9)
    assert began < stamps[0] < stamps[-1] < time.time()
    assert min(np.diff(stamps)) > 1 / 20 - 0.001  # a busy machine is later, none is earlier


def test_names_of_the_tutorial(start: Start, node: Node) -> None:
    subscriber = start('img_subscriber')
    # Until the publisher shares its frames.
    spin_until(node, lambda: bool(node.get_subscriptions_info_by_topic('/video_frames')))
    publisher = start('img_publisher', source='pattern')
    spin_until(node, lambda: {'image_publisher', 'image_subscriber'} <= set(node.get_node_names()))
    spin_until(node, lambda: bool(node.get_publishers_info_by_topic('/video_frames')))
    (offered,) = node.get_publishers_info_by_topic('/video_frames')
    assert offered.topic_type == 'sensor_msgs/msg/Image'
    assert offered.qos_profile.reliability.name == 'RELIABLE'
    publisher.wait_for('Publishing video frame')
    subscriber.wait_for('Receiving video frame')


def test_inconsistent_messages_are_skipped(
        start: Start, node: Node, tmp_path: Path) -> None:
    good = fill_as_the_tutorial_does(np.full((4, 6, 3), 7, np.uint8))
    messages = []
    for fields in ({'encoding': ''}, {'encoding': 'x' * 10000}, {'step': 1}, {'height': 2**32 - 1},
                   {'width': 2**32 - 1, 'height': 2**32 - 1, 'step': 2**32 - 1}, {'data': b'x'},
                   {'is_bigendian': 1}, {}):
        message = fill_as_the_tutorial_does(np.full((4, 6, 3), 7, np.uint8))
        for name, value in fields.items():
            setattr(message, name, value)
        messages.append(message)
    publisher = node.create_publisher(Image, 'video_frames', 10)
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', max_frames=2)
    spin_until(node, lambda: publisher.get_subscription_count() == 1)
    for message in messages:
        publisher.publish(message)
    assert subscriber.finish() == 1
    assert 'message not recorded: Unrecognized image encoding []' in subscriber.output
    assert ': 2 written to' in subscriber.output and '6 failed' in subscriber.output
    assert 'Received 8 frames' in subscriber.output
    expected = np.frombuffer(good.data, np.uint8).reshape(4, 6, 3)
    assert all(np.array_equal(picture, expected) for picture in read_pictures(tmp_path / 'out'))


def test_second_publisher_leaving_loses_no_frames(
        start: Start, node: Node, tmp_path: Path) -> None:
    message = fill_as_the_tutorial_does(np.zeros((48, 64, 3), np.uint8))
    stays, leaves = (node.create_publisher(Image, 'video_frames', 10) for _ in range(2))
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', on_overflow='block')
    spin_until(node, lambda: stays.get_subscription_count() and leaves.get_subscription_count())

    def publish(publisher: Publisher, count: int) -> None:
        for _ in range(count):
            before = len(recorded_files(tmp_path / 'out'))
            publisher.publish(message)
            spin_until(node, lambda count=before: len(recorded_files(tmp_path / 'out')) > count)

    publish(stays, 20)
    publish(leaves, 1)
    node.destroy_publisher(leaves)
    publish(stays, 20)
    subscriber.interrupt()
    assert subscriber.finish() == 0, subscriber.output
    assert re.search(r'Received 41 .*: 41 written to .*, 0 dropped', subscriber.output)


def test_lost_frames_are_counted(start: Start, node: Node, tmp_path: Path) -> None:
    message = fill_as_the_tutorial_does(np.zeros((720, 1280, 3), np.uint8))
    publisher = node.create_publisher(Image, 'video_frames', 10)
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', file_name='f{sec}.png')
    spin_until(node, lambda: publisher.get_subscription_count() == 1)

    def publish(number: int) -> Path:
        message.header.stamp.sec = number
        publisher.publish(message)
        return tmp_path / 'out' / f'f{number}.png'

    spin_until(node, publish(0).exists)
    subscriber.interrupt(signal.SIGSTOP)
    for number in range(1, 60):  # of which the middleware keeps ten
        last = publish(number)
    subscriber.interrupt(signal.SIGCONT)
    spin_until(node, last.exists)
    subscriber.interrupt()
    assert subscriber.finish() == 0, subscriber.output
    received, written, lost = map(int, re.search(
        r'Received (\d+) .*: (\d+) written to .* (\d+) lost', subscriber.output).groups())
    assert lost > 30
    assert received + lost == 60
    assert written == received
