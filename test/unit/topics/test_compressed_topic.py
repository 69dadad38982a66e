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

"""The topic of compressed images beside raw ones: every type of array, and every reader."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from conftest import spin_until
import numpy as np
from opencv_tools.base.logs import Log
from opencv_tools.frames import publisher as publisher_module
from opencv_tools.image.encodings import DEPTHS, ENCODINGS
from opencv_tools.image.errors import CodecError
from opencv_tools.topics import subscription as subscription_module
from opencv_tools.topics.options import SubscriptionOptions
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.topics.subscription import FrameSubscription
import pytest
from rclpy.node import Node
from sharing import Camera, TOPIC, Viewer

pytest_plugins = ['sharing']

COMPRESSED = f'{TOPIC}/compressed'
TYPES = (*ENCODINGS, *(f'{depth}C{channels}' for depth in DEPTHS
                       for channels in (1, 2, 3, 4, 5, 17)))
_BGR = ENCODINGS['bgr8']
STORED = [name for name in TYPES if (
    name in ENCODINGS or (name[:-1] in ('8UC', '16UC') and name[-1] in '134'))]
# Mosaics and YUV are stored in colour.
DECLARED = [name if ENCODINGS.get(name, _BGR).kind not in ('bayer', 'yuv') else
            f'bgr{8 * np.dtype(ENCODINGS[name].dtype).itemsize}' for name in STORED]
READERS: dict[str, dict[str, Any]] = {
    'raw': {'transport': 'raw'}, 'compressed': {'transport': 'compressed'}, 'auto': {},
    'shared': {'transport': 'shm'}, 'viewer': {'prefers_compressed': True}}

Subscribe = Callable[..., tuple[FrameSubscription, list[Any]]]


@pytest.fixture
def subscribe(node: Node, monkeypatch: pytest.MonkeyPatch) -> Iterator[Subscribe]:
    """Return a function that subscribes, and returns the subscription and its messages."""
    monkeypatch.setattr(subscription_module, '_GRAPH_POLL_SECONDS', 0.1)
    subscriptions: list[FrameSubscription] = []

    def _subscribe(**options: Any) -> tuple[FrameSubscription, list[Any]]:
        messages: list[Any] = []

        def take(received: ReceivedMessage) -> None:
            messages.append(received.message)

        subscriptions.append(FrameSubscription(
            node, TOPIC, Log(node.get_logger()), take, messages.append,
            SubscriptionOptions(depth=None, **options)))
        subscriptions[-1].start()
        return subscriptions[-1], messages

    yield _subscribe
    for subscription in subscriptions:
        subscription.destroy()


def send(camera: Camera, viewer: Viewer, *encodings: str) -> None:
    """Publish a frame of each encoding, after the last one has arrived."""
    for encoding in encodings:
        camera.send(encoding, 4, 6)
        viewer.watch(lambda: viewer.count == camera.sent)


def numbers(messages: list[Any], first: int) -> list[int]:
    """Return the numbers of messages, from a first one on."""
    return [message.header.sec for message in messages if message.header.sec >= first]


def has_topic(node: Node) -> bool:
    """Return whether a node sees a publisher of compressed images."""
    return node.count_publishers(COMPRESSED) > 0


@pytest.mark.parametrize('is_loaned', [False, True], ids=['array', 'loan'])
@pytest.mark.parametrize('reader', READERS)
def test_each_type_for_each_reader(
        node: Node, camera: Node, view: Callable[..., Viewer], subscribe: Subscribe, reader: str,
        is_loaned: bool) -> None:
    ours = Camera(camera, is_loaned=is_loaned)
    viewer = view(transport='raw')
    viewer.watch(lambda: has_topic(node))
    other, messages = subscribe(**READERS[reader])
    compressed = ours.frames._topics.compressed
    viewer.match(ours)
    viewer.watch(lambda: compressed.count_subscribers() == (reader in ('compressed', 'viewer')))
    # The last types have no compressed form, so the topic ends.
    send(ours, viewer, *(TYPES if reader == 'compressed' else (*TYPES[:-6:4], *TYPES[-6:])))
    viewer.assert_complete(ours)
    viewer.watch(lambda: not has_topic(node))
    if reader == 'compressed':
        viewer.watch(lambda: len(messages) >= len(STORED))
        assert [message.format.partition(';')[0] for message in messages] == DECLARED
    assert not any(isinstance(message, Exception) for message in messages)
    assert other.account.lost == 0


def test_topic_follows_the_format(
        node: Node, camera: Node, view: Callable[..., Viewer], subscribe: Subscribe,
        capfd: pytest.CaptureFixture[str]) -> None:
    ours, viewer = Camera(camera), view(transport='raw')
    compressed = ours.frames._topics.compressed
    viewer.watch(lambda: has_topic(node))
    by_name, named = subscribe(transport='compressed')
    preferring, preferred = subscribe(prefers_compressed=True)
    viewer.match(ours)
    viewer.watch(lambda: compressed.count_subscribers() == 2)
    send(ours, viewer, *['bgr8', '32FC1'] * 20, *['32FC1'] * 8)
    viewer.watch(lambda: len(named) == len(preferred) == 20)
    assert has_topic(node)  # a publisher of both formats keeps the topic
    while compressed._publisher:  # until the subscribers have confirmed the last JPEG
        send(ours, viewer, '64FC2')
    viewer.watch(lambda: not has_topic(node) and preferring.topic_name == TOPIC)
    assert by_name.explain_no_frames() == (
        f'no publisher of sensor_msgs/msg/CompressedImage on {COMPRESSED}, but one of '
        f'sensor_msgs/msg/Image on {TOPIC} (node /front/camera); set transport:=raw or '
        'transport:=auto')
    viewer.watch(lambda: ours.subscribers == 2)
    first = ours.sent + 1
    send(ours, viewer, '32FC1', '64FC2', '16SC1', 'bgr8')
    viewer.watch(lambda: compressed._publisher.get_subscription_count() == 1
                 and by_name._sources.image._reader.publisher_count() == 1)
    send(ours, viewer, 'bgr8', '32FC1', 'mono16')
    viewer.watch(lambda: len(numbers(preferred, first)) == 7
                 and named[-1].header.sec == ours.sent)
    assert numbers(preferred, first) == [*range(first, first + 7)]
    assert numbers(named, first + 4) == [first + 4, first + 6]
    viewer.assert_complete(ours)
    warnings = [line for line in capfd.readouterr().err.splitlines() if 'has no frames' in line]
    assert [line.partition('/video')[2] for line in warnings] == [
        f'_frames/compressed has no frames: an image of {encoding} cannot be stored as png; '
        'receive /video_frames, with transport:=raw or transport:=auto'
        for encoding in ('32FC1', '64FC2', '16SC1')]


def test_no_topic_for_a_first_frame_without_a_form(
        node: Node, camera: Node, view: Callable[..., Viewer], subscribe: Subscribe,
        capfd: pytest.CaptureFixture[str]) -> None:
    ours = Camera(camera)
    spin_until(node, lambda: has_topic(node))
    ours.send('32FC1')
    spin_until(node, lambda: not has_topic(node))
    subscription, messages = subscribe(prefers_compressed=True)
    spin_until(node, lambda: ours.subscribers == 1
               and subscription._sources.image._reader.publisher_count() == 1)
    ours.send('32FC1')
    spin_until(node, lambda: len(messages) == 1)
    assert 'has no frames' not in capfd.readouterr().err  # nobody asks for them
    assert subscription.topic_name == TOPIC


def test_failed_codec(
        node: Node, camera: Node, view: Callable[..., Viewer], subscribe: Subscribe,
        monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    def fail(image: np.ndarray, *_: object) -> np.ndarray:
        raise CodecError(f'no memory for {image.shape}')

    ours, viewer = Camera(camera), view(transport='raw')
    viewer.watch(lambda: has_topic(node))
    _, messages = subscribe(transport='compressed')
    viewer.match(ours)
    viewer.watch(lambda: ours.frames._topics.compressed.count_subscribers() == 1)
    with monkeypatch.context() as patch:
        patch.setattr(publisher_module, 'encode_compressed', fail)
        send(ours, viewer, *['bgr8'] * 20)
    send(ours, viewer, 'bgr8')
    viewer.watch(lambda: len(messages) == 1)
    viewer.assert_complete(ours)
    assert messages[0].header.sec == 21
    assert capfd.readouterr().err.count(
        'no image on /video_frames/compressed: no memory for (4, 6, 3)') == 1
