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

"""Frames in a user's own node: arrays, the newest frame, threads, calibration and publishing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from threading import current_thread, Event, get_ident, Timer
from typing import Any

from conftest import spin_until
import numpy as np
from opencv_tools.cv_bridge import CvBridge
import opencv_tools.frames
from opencv_tools.frames import Frame, FrameNode, FramePublisher, FrameSubscriber
from opencv_tools.image.cdr import WireCompressedImage, WireHeader
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import EncodingError
from opencv_tools.image.layout import array_to_wire
from opencv_tools.transport.message_type import message_type
from opencv_tools.video.settings import VideoSettings
import pytest
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sending import stamped
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from waiting import pause, wait_until

IMAGE = np.random.default_rng(1).integers(0, 256, (6, 8, 3), np.uint8)
SMOOTH = np.zeros((32, 48, 3), np.uint8) + np.array([40, 120, 220], np.uint8)


def numbered(number: int) -> Image:
    return stamped(np.full((4, 4), number, np.uint8), 'mono8', number)


def is_waiting(subscriber: FrameSubscriber, number: int) -> bool:
    waiting = subscriber._subscription._queue._frames
    return bool(waiting) and waiting[-1].stamp_ns == number


class Receiver:
    """A subscriber that collects its frames, and a plain publisher."""

    def __init__(self, node: Node, message_type: Any = Image, topic: str = 'camera/image',
                 **options: Any) -> None:
        self.node = node
        self.frames: list[Frame] = []
        self.publisher: Publisher = node.create_publisher(
            message_type, topic, QoSProfile(depth=100))
        self.subscriber = FrameSubscriber(node, 'camera/image', self.frames.append, **options)
        spin_until(node, lambda: self.publisher.get_subscription_count() == 1)

    def wait(self, count: int) -> list[Frame]:
        spin_until(self.node, lambda: len(self.frames) >= count)
        return self.frames

    def send(self, *messages: Any) -> None:
        for message in messages:
            self.publisher.publish(message)


@contextmanager
def receiver(node: Node, *arguments: Any, **options: Any) -> Iterator[Receiver]:
    made = Receiver(node, *arguments, **options)
    yield made
    made.subscriber.destroy()


def test_public_names() -> None:
    for name in opencv_tools.frames.__all__:
        assert getattr(opencv_tools.frames, name).__doc__
    assert opencv_tools.frames.__all__ == sorted(opencv_tools.frames.__all__, key=lambda name: (
        name.islower(), name))


def test_raw_image(node: Node) -> None:
    with receiver(node) as camera:
        camera.send(stamped(IMAGE, 'rgb8', 5_000_000_007, 'lens'))
        (frame,) = camera.wait(1)
    assert np.array_equal(frame.image, IMAGE[..., ::-1])
    assert np.array_equal(frame.raw, IMAGE)
    assert (frame.encoding, frame.raw_encoding) == ('bgr8', 'rgb8')
    assert (frame.stamp_ns, frame.stamp.sec, frame.stamp.nanosec) == (5_000_000_007, 5, 7)
    assert (frame.frame_id, frame.description) == ('lens', '8x6 rgb8')
    assert frame.receive_ns > 10**18
    assert frame.camera_info is None
    expected = CvBridge().imgmsg_to_cv2(stamped(IMAGE, 'rgb8', 0), 'mono8')
    assert np.array_equal(frame.gray, expected)
    assert frame.gray is frame.gray


@pytest.mark.parametrize('encoding', ['', 'bgr8', 'mono8', 'bgra8'])
def test_arrays_are_read_only_views(node: Node, encoding: str) -> None:
    with receiver(node, encoding=encoding) as camera:
        camera.send(stamped(IMAGE, 'bgr8', 0))
        (frame,) = camera.wait(1)
    for array in (frame.image, frame.raw, frame.gray):
        with pytest.raises(ValueError, match='read-only'):
            array[0] = 0
    assert np.shares_memory(frame.image, frame.raw) == (encoding in ('', 'bgr8'))
    assert frame.image.copy().flags.writeable


def test_compressed_image(node: Node) -> None:
    with receiver(node, CompressedImage, 'camera/image/compressed', encoding='mono8') as camera:
        camera.send(CvBridge().cv2_to_compressed_imgmsg(IMAGE, 'bgr8; png compressed bgr8'))
        (frame,) = camera.wait(1)
    assert np.array_equal(frame.raw, IMAGE)
    assert frame.raw_encoding == 'bgr8'
    assert frame.image.shape == (6, 8)


def test_newest_frame_only(node: Node) -> None:
    with receiver(node) as camera:
        camera.send(numbered(1))
        camera.wait(1)
        camera.send(*map(numbered, range(2, 21)))
        spin_until(node, lambda: camera.frames[-1].stamp_ns == 20)
        numbers = [frame.stamp_ns for frame in camera.frames]
        assert numbers == sorted(set(numbers))
        assert len(numbers) + camera.subscriber.skipped == 20


def test_every_frame_in_order(node: Node) -> None:
    with receiver(node, every=True, depth=50) as camera:
        camera.send(*map(numbered, range(1, 41)))
        assert [frame.stamp_ns for frame in camera.wait(40)] == [*range(1, 41)]
        assert camera.subscriber.skipped == 0


def test_every_frame_at_a_maximum_rate(node: Node) -> None:
    with receiver(node, every=True, depth=50, max_rate=10.0) as camera:
        stamps = [10**11 + number * 10**9 // 30 for number in range(40)]
        camera.send(*(stamped(IMAGE, 'bgr8', stamp) for stamp in stamps))
        assert [frame.stamp_ns for frame in camera.wait(14)] == stamps[::3]
        assert camera.subscriber.skipped == 26


def test_newest_frames_at_a_maximum_rate(node: Node) -> None:
    with receiver(node, max_rate=10.0) as camera:
        stamps = [10**11 + number * 10**9 // 30 for number in range(40)]
        first, *others = (stamped(IMAGE, 'bgr8', stamp) for stamp in stamps)
        camera.send(first)
        camera.wait(1)
        camera.send(*others)
        spin_until(node, lambda: len(camera.frames) + camera.subscriber.skipped == 40)
        assert 1 <= len(camera.frames) <= 14


@pytest.mark.parametrize('every', [False, True])
def test_callback_in_a_thread(node: Node, every: bool) -> None:
    entered, may_return = Event(), Event()
    numbers: list[int] = []
    threads = set()

    def callback(frame: Frame) -> None:
        numbers.append(frame.stamp_ns)
        threads.add(get_ident())
        entered.set()
        wait_until(may_return.is_set)

    publisher = node.create_publisher(Image, 'camera/image', QoSProfile(depth=100))
    subscriber = FrameSubscriber(node, 'camera/image', callback, threaded=True, every=every,
                                 depth=5)
    spin_until(node, lambda: publisher.get_subscription_count() == 1)
    publisher.publish(numbered(1))
    spin_until(node, entered.is_set)
    for number in range(2, 10):  # the executor goes on while the callback runs
        publisher.publish(numbered(number))
        spin_until(node, partial(is_waiting, subscriber, number))
    may_return.set()
    spin_until(node, lambda: numbers[-1] == 9)
    assert numbers == ([1, 5, 6, 7, 8, 9] if every else [1, 9])
    assert subscriber.skipped == (3 if every else 7)
    subscriber.destroy()
    assert get_ident() not in threads and len(threads) == 1


@pytest.mark.parametrize('error', [ValueError('mine'), SystemExit('mine')])
def test_exception_in_a_thread_ends_the_executor(node: Node, error: BaseException) -> None:
    threads = set()

    def fail(_: Frame) -> None:
        threads.add(current_thread())
        raise error

    publisher = node.create_publisher(Image, 'camera/image', 10)
    subscriber = FrameSubscriber(node, 'camera/image', fail, threaded=True)
    spin_until(node, lambda: publisher.get_subscription_count() == 1)
    publisher.publish(numbered(1))
    with pytest.raises(type(error), match='mine') as raised:
        spin_until(node, lambda: False)
    assert raised.traceback[-1].name == 'fail'
    subscriber.destroy()
    assert not any(thread.is_alive() for thread in threads) and len(threads) == 1


def test_exception_in_a_thread_after_the_last_spin(node: Node) -> None:
    entered, may_fail = Event(), Event()

    def fail(_: Frame) -> None:
        entered.set()
        wait_until(may_fail.is_set)
        raise ValueError('mine')

    publisher = node.create_publisher(Image, 'camera/image', 10)
    subscriber = FrameSubscriber(node, 'camera/image', fail, threaded=True)
    spin_until(node, lambda: publisher.get_subscription_count() == 1)
    publisher.publish(numbered(1))
    spin_until(node, entered.is_set)
    may_fail.set()
    with pytest.raises(ValueError, match='mine'):
        subscriber.destroy()
    subscriber.destroy()


@pytest.mark.parametrize('threaded', [False, True])
def test_callback_destroys_its_subscriber(node: Node, threaded: bool) -> None:
    returned = Event()

    def destroy(_: Frame) -> None:
        subscriber.destroy()
        returned.set()

    publisher = node.create_publisher(Image, 'camera/image', 10)
    guards = len(list(node.guards))
    subscriber = FrameSubscriber(node, 'camera/image', destroy, threaded=threaded)
    spin_until(node, lambda: publisher.get_subscription_count() == 1)
    publisher.publish(numbered(1))
    spin_until(node, returned.is_set)
    spin_until(node, lambda: publisher.get_subscription_count() == 0)
    spin_until(node, lambda: len(list(node.guards)) == guards)


@pytest.mark.parametrize('infos_first', [False, True])
def test_calibration_of_the_same_stamp(node: Node, infos_first: bool) -> None:
    infos = node.create_publisher(CameraInfo, 'camera/camera_info', 10)
    with receiver(node, camera_info=True, every=True) as camera:
        spin_until(node, lambda: infos.get_subscription_count() == 1)
        queue = camera.subscriber._subscription._queue

        def send_infos() -> None:
            for number in (2, 3, 5):
                info = CameraInfo(width=100 + number)
                info.header.stamp.nanosec = number
                infos.publish(info)
            spin_until(node, lambda: queue._infos.keys() >= {5} or camera.frames)

        if infos_first:
            send_infos()
        camera.send(*map(numbered, range(1, 6)))
        if not infos_first:
            spin_until(node, lambda: len(queue._unpaired) == 5)
            send_infos()
        pairs = [(frame.stamp_ns, frame.camera_info.width) for frame in camera.wait(3)]
        assert pairs == [(2, 102), (3, 103), (5, 105)]
        assert camera.subscriber.skipped == 2


def test_invalid_images_are_counted(node: Node) -> None:
    with receiver(node, every=True) as camera:
        broken = numbered(1)
        broken.step = 3
        camera.send(broken, stamped(IMAGE, 'bgr8', 2), Image(encoding='secret'), numbered(4))
        assert [frame.stamp_ns for frame in camera.wait(2)] == [2, 4]
        assert (camera.subscriber.failed, camera.subscriber.skipped) == (2, 0)


@pytest.mark.parametrize(('shape', 'dtype', 'encoding', 'expected'), [
    ((4, 5), 'uint8', '', 'mono8'), ((4, 5, 1), 'uint8', '', 'mono8'),
    ((4, 5, 3), 'uint8', '', 'bgr8'), ((4, 5, 4), 'uint8', '', 'bgra8'),
    ((4, 5, 3), 'uint8', 'rgb8', 'rgb8'), ((4, 5), 'uint16', '', '16UC1'),
    ((4, 5), 'uint16', 'mono16', 'mono16'), ((4, 5, 2), 'float32', '', '32FC2')])
def test_published_array(node: Node, shape: tuple[int, ...], dtype: str, encoding: str,
                         expected: str) -> None:
    array = np.arange(np.prod(shape)).reshape(shape).astype(dtype)[:, ::-1]
    received: list[Image] = []
    publisher = FramePublisher(node, 'result')
    assert not publisher.has_subscribers
    publisher.publish(array, encoding=encoding)  # nobody receives this one
    node.create_subscription(Image, 'result', received.append, 10)
    spin_until(node, lambda: publisher.has_subscribers)
    publisher.publish(array, encoding=encoding)
    spin_until(node, lambda: bool(received))
    assert (received[0].encoding, received[0].width, received[0].height) == (expected, 5, 4)
    assert np.array_equal(CvBridge().imgmsg_to_cv2(received[0]).reshape(shape), array)
    assert received[0].header.stamp.sec > 10**9
    publisher.destroy()


@pytest.mark.parametrize(('array', 'encoding', 'codec'), [
    (SMOOTH, 'bgr8', 'jpeg'), (SMOOTH, 'rgb8', 'jpeg'), (SMOOTH[..., 0], 'mono8', 'jpeg'),
    (IMAGE[..., 0].astype(np.uint16), '16UC1', 'png')])
def test_published_compressed_image(node: Node, array: np.ndarray, encoding: str,
                                    codec: str) -> None:
    received: list[CompressedImage] = []
    node.create_subscription(CompressedImage, 'result/compressed', received.append, 10)
    publisher = FramePublisher(node, 'result', quality=100)
    spin_until(node, lambda: publisher.has_subscribers)
    source = Frame(array_to_wire(IMAGE, find_encoding('bgr8'), WireHeader(0, 7, 'lens')))
    publisher.publish(array, source, encoding=encoding)
    spin_until(node, lambda: bool(received))
    message = received[0]
    assert (message.header.frame_id, message.header.stamp.nanosec) == ('lens', 7)
    assert f'{encoding}; {codec}' in message.format
    wire = WireCompressedImage(
        header=WireHeader(0, 7, 'lens'), format=message.format, data=message.data)
    decoded = Frame(wire, encoding).image
    assert decoded.shape == array.shape
    assert np.abs(decoded.astype(int) - array).max() < 4


@pytest.mark.parametrize('subscribed', ['result', 'result/compressed', 'result/ffmpeg'])
def test_images_without_subscribers_are_counted(node: Node, subscribed: str) -> None:
    publisher = FramePublisher(node, 'result', video=VideoSettings())
    for _ in range(7):
        publisher.publish(IMAGE)
    assert publisher.without_subscribers == 7
    kind = message_type('ffmpeg_image_transport_msgs/msg/FFMPEGPacket') if (
        subscribed.endswith('ffmpeg')) else CompressedImage if '/' in subscribed else Image
    node.create_subscription(kind, subscribed, lambda _: None, 10, raw=True)
    spin_until(node, lambda: publisher.has_subscribers)
    publisher.publish(IMAGE)
    with publisher.loan(4, 5) as loan:
        loan.image[:] = 1
    assert publisher.without_subscribers == 7
    assert publisher.without_form == 0
    publisher.destroy()


@pytest.mark.parametrize(('subscribed', 'kind', 'encoding', 'sent'), [
    ('result/compressed', CompressedImage, '32FC1', 0),
    ('result/compressed', CompressedImage, '16UC3', 2),
    ('result/compressed', CompressedImage, '8UC2', 0),
    ('result', Image, '32FC1', 2),
])
def test_images_without_a_form_are_counted(
        node: Node, subscribed: str, kind: type, encoding: str, sent: int) -> None:
    publisher = FramePublisher(node, 'result')
    node.create_subscription(kind, subscribed, lambda _: None, 10)
    spin_until(node, lambda: publisher.has_subscribers)
    shape = (4, 5) if encoding == '32FC1' else (4, 5, int(encoding[-1]))
    kinds = {'3': 'float32', '1': 'uint16', '8': 'uint8'}
    image = np.ones(shape, kinds[encoding[0]])
    for _ in range(2):
        publisher.publish(image, encoding=encoding)
    assert (publisher.without_form, publisher.without_subscribers) == (2 - sent, 0)
    publisher.destroy()


@pytest.mark.parametrize(('wanted', 'encoding', 'loss'), [
    ('jpeg', 'mono16', 'mono16 images lose 8 bits in mono8'),
    ('jpeg', 'rgba16', 'rgba16 images lose 8 bits and alpha in bgr8'),
    ('jpeg', 'bgra8', 'bgra8 images lose alpha in bgr8'),
    ('auto', 'mono16', ''), ('jpeg', 'mono8', '')])
def test_reduction_by_the_compressed_format_is_said_once(
        node: Node, capfd: pytest.CaptureFixture[str], wanted: str, encoding: str, loss: str,
) -> None:
    publisher = FramePublisher(node, 'result', compressed_format=wanted)
    node.create_subscription(CompressedImage, 'result/compressed', lambda _: None, 10)
    spin_until(node, lambda: publisher.has_subscribers)
    found = find_encoding(encoding)
    for _ in range(3):
        publisher.publish(np.ones((4, 6, found.channels)[:3 if found.channels > 1 else 2],
                                  found.dtype), encoding=encoding)
    text = capfd.readouterr().err
    assert text.count(' lose ') == bool(loss)
    assert not loss or (
        f'/result/compressed: {loss}, as compressed_format jpeg has it' in text)
    publisher.destroy()


def test_refused_arrays(node: Node) -> None:
    publisher = FramePublisher(node, 'result')
    node.create_subscription(Image, 'result', lambda _: None, 10)
    spin_until(node, lambda: publisher.has_subscribers)
    with pytest.raises(TypeError, match='an array is needed, not list'):
        publisher.publish([[1]])  # type: ignore[arg-type]
    with pytest.raises(TypeError, match='source of a frame is 5: give a Frame, a Header or None'):
        publisher.publish(IMAGE, 5)  # type: ignore[arg-type]
    with pytest.raises(EncodingError):
        publisher.publish(IMAGE, encoding='mono8')


def test_node_closes_its_frames(node: Node, domain: int) -> None:
    frame_node = FrameNode('frames', context=node.context)
    subscriber = frame_node.receive_frames('camera/image', lambda _: None, threaded=True)
    publisher = frame_node.publish_frames('result')
    assert (subscriber.topic_name, publisher.topic_name) == ('/camera/image', '/result')
    frame_node.done.set_result(3)
    assert frame_node.close() == 3
    assert not list(frame_node.subscriptions)
    assert not [one.topic_name for one in frame_node.publishers if 'result' in one.topic_name]
    frame_node.destroy_node()


@pytest.mark.parametrize('is_publisher_first', [False, True])
def test_callback_that_publishes_while_its_node_closes(
        node: Node, is_publisher_first: bool) -> None:
    frame_node = FrameNode('frames', context=node.context)
    entered, is_open, results = Event(), Event(), []
    is_open.set()

    def publish_late(frame: Frame) -> None:
        entered.set()
        wait_until(lambda: not is_open.is_set(), 'the end')
        pause(0.1)
        results[0].publish(frame.image, frame)

    if is_publisher_first:
        results.append(frame_node.publish_frames('result'))
    frame_node.receive_frames('camera/image', publish_late, threaded=True)
    if not is_publisher_first:
        results.append(frame_node.publish_frames('result'))
    camera = node.create_publisher(Image, 'camera/image', 10)

    def publish() -> bool:
        camera.publish(numbered(1))
        return entered.is_set()

    spin_until(frame_node, publish)
    Timer(0.1, is_open.clear).start()
    assert frame_node.close() == 0
    frame_node.destroy_node()
