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

"""Video of a camera that encodes it: passed on unchanged, decoded only for raw subscribers."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Thread

from conftest import spin_until
from h264_camera import connect, DEVICE, H264Device
import numpy as np
from opencv_tools.frames import Frame, FrameSubscriber
from opencv_tools.nodes.parameters import with_values
from opencv_tools.nodes.publisher.camera_controls import CameraControls
from opencv_tools.nodes.publisher.camera_info import PublishedCalibration
from opencv_tools.nodes.publisher.image_topics import ImageTopics
from opencv_tools.nodes.publisher.loop import PublishLoop
from opencv_tools.nodes.publisher.parameters import PARAMETERS, PublisherSettings
from opencv_tools.transport.fastdds.profile import NOT_CONFIGURED
from opencv_tools.video import decoder, encoder
from opencv_tools.video.encoder import VideoEncoder
from opencv_tools.video.messages import VIDEO_TOPICS
from opencv_tools.video.settings import VideoSettings
import pytest
from rclpy.node import Node
from video_packets import draw
from video_receiver import Receiver

TOPIC = '/front/video_frames'
GROUP = 5


class Passing:
    """A publisher of a camera that encodes H.264."""

    def __init__(self, node: Node, device: H264Device, **values: object) -> None:
        self._node, self._device = node, device
        self._encoder = VideoEncoder(VideoSettings(key_interval=GROUP - 0.5), 160, 120, 1)
        self.sent: list[bytes] = []
        topics = ImageTopics(node, 'video_frames', PublishedCalibration('', 'eye', print),
                             NOT_CONFIGURED, 0, VideoSettings())
        self.loop = PublishLoop(
            node, with_values(PublisherSettings(source=DEVICE), {'publish_rate': 0.0, **values}),
            topics, CameraControls(node, PARAMETERS, lambda: None))
        self.thread = Thread(target=self.loop.run, daemon=True)
        self.thread.start()

    def send(self, count: int = 1) -> None:
        """Send pictures, whose numbers count from 0."""
        for _ in range(count):
            number = len(self.sent)
            data = self._encoder.encode(
                draw(160, 120, number), 'bgr8', number * 10 ** 9).data
            self.sent.append(data)
            self._device.send(data)


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> H264Device:
    return connect(H264Device(), monkeypatch)


@pytest.fixture
def passing(camera: Node, device: H264Device) -> Iterator[Passing]:
    found = Passing(camera, device)
    yield found
    found.loop.stop()
    found.thread.join(30)
    assert not found.thread.is_alive()


def refuse(monkeypatch: pytest.MonkeyPatch, *modules: object) -> None:
    """Fail when anything is decoded or encoded by these modules."""
    def fail() -> None:
        raise AssertionError('no codec is needed')

    for module in modules:
        monkeypatch.setattr(module, 'import_av', fail)


def matched(node: Node, camera: Node, *topics: str) -> None:
    spin_until(node, lambda: all(camera.count_subscribers(topic) for topic in topics))


def test_packets_are_those_of_the_camera(
        node: Node, camera: Node, passing: Passing, monkeypatch: pytest.MonkeyPatch) -> None:
    receivers = [Receiver(node, type_name, TOPIC) for type_name in VIDEO_TOPICS]
    matched(node, camera, *(f'{TOPIC}/{suffix}' for suffix in VIDEO_TOPICS.values()))
    spin_until(node, lambda: passing.loop.camera is not None)
    video = passing.loop._topics._topics.video
    spin_until(node, lambda: all(
        publisher.get_subscription_count() for publisher in video.publishers.values()))
    passing.send(GROUP)
    refuse(monkeypatch, decoder, encoder)
    passing._device.send(passing.sent[0])
    spin_until(node, lambda: all(len(one.messages) > GROUP for one in receivers))
    for receiver in receivers:
        assert [bytes(message.data) for message in receiver.messages] == [
            *passing.sent, passing.sent[0]]
        assert {message.codec for message in receiver.messages} == {'h264'}


def test_raw_subscriber_gets_pictures_from_a_key_frame_on(
        node: Node, camera: Node, passing: Passing, device: H264Device) -> None:
    video: list[Frame] = []
    watcher = FrameSubscriber(node, TOPIC, video.append, every=True, transport='video')
    spin_until(node, lambda: passing.loop._topics.has_subscribers())
    passing.send(2)
    spin_until(node, lambda: len(video) == 2)
    raw: list[Frame] = []
    late = FrameSubscriber(node, TOPIC, raw.append, every=True, transport='raw')
    spin_until(node, lambda: passing.loop._topics.images.get_subscription_count() == 1)
    passing.send(GROUP)
    spin_until(node, lambda: len(video) == GROUP + 2 and len(raw) == 2)
    for frames, first in ((video, 0), (raw, GROUP)):
        for number, frame in enumerate(frames, first):
            assert np.abs(frame.image.astype(int) - draw(160, 120, number)).mean() < 4
    assert device.requested_keys >= 1
    assert passing.loop._events.dropped == 0
    watcher.destroy()
    late.destroy()


def test_turned_pictures_are_encoded_again(
        node: Node, camera: Node, passing: Passing) -> None:
    frames: list[Frame] = []
    watcher = FrameSubscriber(node, TOPIC, frames.append, every=True, transport='video')
    spin_until(node, lambda: passing.loop._topics.has_subscribers())
    passing.send(2)
    spin_until(node, lambda: len(frames) == 2)
    passing.loop.apply_changes({'flip': 'horizontal'})
    passing.send(GROUP)  # the pictures before were not decoded
    spin_until(node, lambda: len(frames) == 4)
    passing.loop.apply_changes({'flip': 'none'})
    passing.send(GROUP)
    spin_until(node, lambda: len(frames) == 6)
    numbers = [0, 1, GROUP, GROUP + 1, 2 * GROUP, 2 * GROUP + 1]
    for place, (number, frame) in enumerate(zip(numbers, frames)):
        expected = draw(160, 120, number)[:, ::-1 if place in (2, 3) else 1]
        assert np.abs(frame.image.astype(int) - expected).mean() < 6
    watcher.destroy()


def test_rate_of_images_beside_all_packets(
        node: Node, camera: Node, passing: Passing, monkeypatch: pytest.MonkeyPatch) -> None:
    passing.loop.apply_changes({'publish_rate': 1e-3})  # only the first image is due
    receiver = Receiver(node, 'foxglove_msgs/msg/CompressedVideo', TOPIC)
    raw: list[Frame] = []
    viewer = FrameSubscriber(node, TOPIC, raw.append, every=True, transport='raw')
    spin_until(node, lambda: passing.loop._topics._topics.count_subscribers() == 2)
    passing.send(GROUP)
    spin_until(node, lambda: len(receiver.messages) == GROUP and len(raw) == 1)
    passing.loop.apply_changes({'publish_rate': 0.0})
    passing.send()  # the first one is a key frame; the packets between were decoded for this one
    passing.send(2)
    spin_until(node, lambda: len(receiver.messages) == GROUP + 3)
    assert [bytes(message.data) for message in receiver.messages] == passing.sent
    viewer.destroy()


@pytest.mark.parametrize('flip', ['none', 'horizontal'])
def test_no_key_frame_is_requested_without_need(
        node: Node, passing: Passing, device: H264Device, flip: str) -> None:
    passing.loop.apply_changes({'flip': flip})
    frames: list[Frame] = []
    viewers = [FrameSubscriber(node, TOPIC, frames.append, every=True, transport='raw')]
    if flip != 'none':
        viewers.append(FrameSubscriber(node, TOPIC, lambda _: None, transport='video'))
    spin_until(node, lambda: passing.loop._topics._topics.count_subscribers() == len(viewers))
    passing.send(GROUP - 1)
    spin_until(node, lambda: len(frames) == GROUP - 1)
    assert device.requested_keys == 0
    for viewer in viewers:
        viewer.destroy()
