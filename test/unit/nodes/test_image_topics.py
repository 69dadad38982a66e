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

"""Topics of frames, and the wait for their subscribers."""

from __future__ import annotations

from pathlib import Path
from threading import Thread
from types import SimpleNamespace

from builtin_interfaces.msg import Time
from calibrations import CALIBRATION
from conftest import spin_until
import numpy as np
from opencv_tools.capture.frame import CapturedFrame
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.capture.settings import CaptureSettings
from opencv_tools.frames import Frame, FrameSubscriber
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.orientation import FLIPS
from opencv_tools.nodes.publisher import backlog
from opencv_tools.nodes.publisher.camera_info import PublishedCalibration
from opencv_tools.nodes.publisher.image_topics import ImageTopics
from opencv_tools.rectification import Rectifier
from opencv_tools.transport.fastdds.profile import NOT_CONFIGURED
from opencv_tools.transport.shared_frames import writer
from opencv_tools.transport.shared_frames.pages import SharedMemoryError
import pytest
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from sharing import picture, TOPIC, Viewer
from std_msgs.msg import Header


def test_delay_after_the_last_awaited_subscriber(
        node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    topics = ImageTopics(
        node, 'video_frames', PublishedCalibration('', 'eye', print), NOT_CONFIGURED, 2)
    now = 100.0
    clock = SimpleNamespace(monotonic=lambda: now)
    assert not topics.may_publish()
    first, _ = (node.create_subscription(Image, 'video_frames', print, 10) for _ in range(2))
    spin_until(node, lambda: topics.images.get_subscription_count() == 2)
    monkeypatch.setattr('opencv_tools.nodes.publisher.image_topics.time', clock)
    assert [topics.may_publish() for _ in range(2)] == [False, False]
    now += 0.19
    assert not topics.may_publish()
    node.destroy_subscription(first)  # the next subscriber restarts the delay
    spin_until(node, lambda: topics.images.get_subscription_count() == 1)
    assert not topics.may_publish()
    node.create_subscription(Image, 'video_frames', print, 10)
    spin_until(node, lambda: topics.images.get_subscription_count() == 2)
    assert not topics.may_publish()
    now += 0.19
    assert not topics.may_publish()
    now += 0.02
    assert topics.may_publish()
    now -= 1.0
    assert topics.may_publish()


@pytest.mark.parametrize('transports', [
    ('shm',), ('auto',), ('shm', 'auto'), ('shm', 'raw'), ('auto', 'raw', 'compressed')])
def test_awaited_subscribers_of_every_transport(
        node: Node, camera: Node, transports: tuple[str, ...]) -> None:
    topics = ImageTopics(camera, TOPIC, PublishedCalibration('', 'eye', print), NOT_CONFIGURED,
                         len(transports))
    nodes = [node] + [Node(f'receiver_{number}', context=node.context)
                      for number in range(len(transports) - 1)]
    subscribers = []
    for receiver, transport in zip(nodes, transports):
        spin_until(node, lambda: topics._topics.count_subscribers() == len(subscribers))
        assert not topics.may_publish()
        subscribers.append(FrameSubscriber(receiver, TOPIC, print, transport=transport))
    spin_until(node, topics.may_publish)
    for subscriber in subscribers:
        subscriber.destroy()
    for receiver in nodes[1:]:
        receiver.destroy_node()
    topics.close()


def test_compressed_topic_follows_the_format(
        node: Node, camera: Node, capfd: pytest.CaptureFixture[str]) -> None:
    topics = ImageTopics(camera, TOPIC, PublishedCalibration('', 'eye', print), NOT_CONFIGURED, 0)
    received: list[CompressedImage] = []
    node.create_subscription(CompressedImage, f'{TOPIC}/compressed', received.append, 10)
    spin_until(node, topics.has_subscribers)

    def publish(number: int, encoding: str) -> bool:
        output = OutputImage(CapturedFrame(picture(number, encoding), encoding), CaptureSettings())
        return topics.publish(output, Time(sec=number), 'eye', is_live=False)

    for number, encoding in enumerate(('32FC1', '8UC2', '16SC1', '64FC3')):
        assert not publish(number, encoding)
        spin_until(node, lambda: not node.count_publishers(f'{TOPIC}/compressed'))
    assert topics.has_subscribers()  # which wait for a frame that has a compressed form
    assert topics.backlog.wait_for_all()
    assert not publish(10, 'yuv422')  # of an odd width
    spin_until(node, lambda: topics._topics.compressed._publisher.get_subscription_count() == 1)
    assert publish(11, 'mono16')
    assert topics.backlog.wait_for_all()
    spin_until(node, lambda: bool(received) and received[-1].header.stamp.sec == 11)
    assert received[-1].format == 'mono16; png compressed mono16'
    assert capfd.readouterr().err.count('cannot be stored as png') == 4
    topics.close()


@pytest.mark.parametrize('is_live', [False, True])
def test_frames_of_any_source_are_shared(node: Node, camera: Node, is_live: bool) -> None:
    topics = ImageTopics(camera, TOPIC, PublishedCalibration('', 'eye', print), NOT_CONFIGURED, 0)
    viewer = Viewer(node)
    viewer.watch(lambda: topics.images.get_subscription_count() > 0
                 and viewer.publishers > 0)
    number = 0

    def publish() -> bool:
        nonlocal number
        if viewer.count == number:
            number += 1
            settings = CaptureSettings(flip=('none', 'vertical')[number % 2])
            pixels = picture(number)[::FLIPS[settings.flip][0]]
            output = OutputImage(CapturedFrame(pixels, '16UC1'), settings)
            assert topics.publish(output, Time(sec=number), 'eye', is_live=is_live)
        return viewer.shared > 20

    viewer.watch(publish)
    viewer.watch(lambda: viewer.count == number)
    viewer.subscription.destroy()
    topics.close()
    assert viewer.numbers == {'eye': [*range(1, number + 1)]}


@pytest.mark.parametrize('failures', [3, 10**9], ids=['for a while', 'for ever'])
def test_frame_of_a_file_waits_for_shared_memory(
        node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str], failures: int) -> None:
    topics = ImageTopics(camera, TOPIC, PublishedCalibration('', 'eye', print), NOT_CONFIGURED, 0)
    viewer = Viewer(node)
    viewer.watch(lambda: topics.images.get_subscription_count() > 0)
    number = 0

    def publish() -> None:
        nonlocal number
        number += 1
        assert topics.publish(OutputImage(CapturedFrame(picture(number), '16UC1'),
                                          CaptureSettings()), Time(sec=number), 'eye',
                              is_live=False)

    def publish_the_next() -> bool:
        if viewer.count == number:
            publish()
        return viewer.shared > 20 and not topics.images.get_subscription_count()

    viewer.watch(publish_the_next)
    left = failures

    def fail(*_: object) -> None:
        nonlocal left
        left -= 1
        if left >= 0:
            raise SharedMemoryError('no room')

    monkeypatch.setattr(writer, 'allocate_pages', fail)
    monkeypatch.setattr(topics._topics.shared._writer, '_allocated', {})
    publisher = Thread(target=lambda: [publish() for _ in range(5)])
    publisher.start()
    viewer.watch(lambda: not publisher.is_alive())
    viewer.watch(lambda: viewer.count == number)
    viewer.subscription.destroy()
    topics.close()
    assert left < failures
    assert 'may lose frames' not in capfd.readouterr().err
    assert viewer.numbers == {'eye': [*range(1, number + 1)]}


def test_publisher_waits_again_without_readers(
        node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    topics = ImageTopics(camera, TOPIC, PublishedCalibration('', 'eye', print), NOT_CONFIGURED, 0)
    node.create_subscription(Image, TOPIC, print, 10)
    spin_until(node, lambda: topics.images.get_subscription_count() > 0)
    monkeypatch.setattr(backlog, '_TIMEOUT_SECONDS', 0.05)
    assert not topics.backlog.deliver(lambda: False)  # to a reader that leaves after this
    output = OutputImage(CapturedFrame(picture(1), '16UC1'), CaptureSettings())
    topics.publish(output, Time(), 'eye', is_live=False)
    spin_until(node, topics.backlog.wait_for_all)
    monkeypatch.setattr(backlog, '_TIMEOUT_SECONDS', 30.0)
    room = iter((False, False, True))
    assert topics.backlog.deliver(lambda: next(room))
    topics.close()


def test_conversion_writes_where_subscribers_read(
        node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    topics = ImageTopics(camera, TOPIC, PublishedCalibration('', 'eye', print), NOT_CONFIGURED, 0)
    frames: list[Frame] = []
    subscriber = FrameSubscriber(node, TOPIC, frames.append, encoding='', every=True)
    slots: list[object] = []
    share = topics._topics.shared.publish
    monkeypatch.setattr(topics._topics.shared, 'publish', lambda image, **options: (
        slots.append(options['slot']) or share(image, **options)))
    colours = picture(1, 'rgb8', 6, 8)
    spin_until(node, lambda: topics.images.get_subscription_count() > 0)

    def publish() -> bool:
        if len(frames) == len(slots):
            settings = (CaptureSettings(encoding='bgr8', flip='vertical') if len(slots) % 2
                        else CaptureSettings())
            topics.publish(OutputImage(CapturedFrame(colours, 'rgb8'), settings), Time(), 'eye',
                           is_live=True)
        return len(frames) > 20 and len(slots) % 2 == 0 and slots[-1] is not None

    spin_until(node, publish)
    assert slots[-2] is None
    for frame in frames[-10:]:
        assert np.array_equal(frame.raw, {
            'bgr8': colours[::-1, :, ::-1], 'rgb8': colours}[frame.raw_encoding])
    assert {frame.raw_encoding for frame in frames[-10:]} == {'bgr8', 'rgb8'}
    subscriber.destroy()
    topics.close()


def test_nothing_is_rectified_without_subscribers(
        node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    calls: list[str] = []
    rectify = Rectifier.rectify
    monkeypatch.setattr(Rectifier, 'rectify', lambda *arguments: (
        calls.append('rectify') or rectify(*arguments)))
    (tmp_path / 'eye.yaml').write_text(CALIBRATION)
    topics = ImageTopics(camera, TOPIC, PublishedCalibration(f'{tmp_path}/eye.yaml', 'eye', print),
                         NOT_CONFIGURED, 0)
    topics.rectify(True)
    assert not topics.has_subscribers()

    def publish() -> bool:
        frame = CapturedFrame(picture(1, 'bgr8', 480, 640), 'bgr8')
        return topics.publish(OutputImage(frame, CaptureSettings()), Time(), 'eye', is_live=True)

    assert not publish()
    images: list[Image] = []
    node.create_subscription(Image, TOPIC, images.append, 10)
    spin_until(node, lambda: publish() and len(images) > 3)
    infos: list[CameraInfo] = []
    node.create_subscription(CameraInfo, '/image_rect/camera_info', infos.append, 10)
    spin_until(node, lambda: publish() and len(infos) > 3)
    assert not calls
    rectified: list[Image] = []
    subscription = node.create_subscription(Image, '/image_rect', rectified.append, 10)
    spin_until(node, lambda: publish() and len(rectified) > 3)
    assert rectified[0].data != images[0].data
    node.destroy_subscription(subscription)
    spin_until(node, lambda: not topics.outputs[1].frames.has_subscribers)
    count = len(calls)
    assert publish() and len(calls) == count > 3
    topics.rectify(False)
    assert not node.get_publishers_info_by_topic('/image_rect') or publish()
    topics.close()


def test_rectified_pixels_are_written_where_subscribers_read(
        node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / 'eye.yaml').write_text(CALIBRATION)
    calibration = PublishedCalibration(f'{tmp_path}/eye.yaml', 'eye', print)
    topics = ImageTopics(camera, TOPIC, calibration, NOT_CONFIGURED, 0)
    topics.rectify(True)
    slots: list[object] = []
    shared = topics.outputs[1].frames.shared
    share = shared.publish
    monkeypatch.setattr(shared, 'publish', lambda image, **options: (
        slots.append(options['slot']) or share(image, **options)))
    frames: list[Frame] = []
    subscriber = FrameSubscriber(node, '/image_rect', frames.append, every=True)
    raw = picture(1, 'rgb8', 480, 640)

    def publish() -> bool:
        if len(frames) == len(slots):
            output = OutputImage(CapturedFrame(raw, 'rgb8'), CaptureSettings(encoding='bgr8'))
            topics.publish(output, Time(), 'eye', is_live=True)
        return len(frames) > 20 and slots[-1] is not None

    spin_until(node, publish)
    spin_until(node, lambda: len(frames) == len(slots))
    expected, _ = Rectifier().rectify(
        raw[..., ::-1], find_encoding('bgr8'), calibration.message(Header(), 640, 480))
    for frame in frames[-10:]:
        assert np.array_equal(frame.raw, expected)
    subscriber.destroy()
    topics.close()
