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

"""Change between the image topic and shared memory: no frame is lost, doubled or out of order."""

from __future__ import annotations

from collections.abc import Callable
import gc
import json
from threading import Event
import time

from conftest import DEADLINE, spin_until
from opencv_tools.frames import Frame, FrameSubscriber
from opencv_tools.ros.shared_frames.announcement import announce, SUFFIX
from opencv_tools.ros.shared_frames.memory import MAX_DEPTH
from opencv_tools.ros.shared_frames.pages import SharedMemoryError
from opencv_tools.ros.shared_frames.reader import MAX_VIEWS
from opencv_tools.ros.subscriber import shared_frames
from opencv_tools.ros.subscriber.raw_subscription import TakenMessage
from opencv_tools.ros.zero_copy import publisher_id
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sharing import Camera, is_picture, TOPIC, Viewer
from std_msgs.msg import String

pytest_plugins = ['sharing']
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_change_to_shared_memory(viewer: Viewer, camera: Node) -> None:
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch_sharing(ours)
    assert not viewer.node.count_subscribers(TOPIC)
    viewer.assert_complete(ours)


@pytest.mark.parametrize('first', ['message', 'shared frame'])
def test_each_order_of_arrival(
        view: Callable[..., Viewer], camera: Node, first: str) -> None:
    viewer = view()
    ours = Camera(camera)
    viewer.match(ours)
    shared = viewer.subscription._shared

    def receive() -> None:
        """Receive the waiting frames, first by one way and then by both."""
        deadline = time.monotonic() + DEADLINE
        while viewer.count < ours.sent:
            assert time.monotonic() < deadline, viewer.numbers
            if first == 'message':
                viewer.subscription._subscription.drain()
            else:
                shared._wake()

    viewer.watch(lambda: bool(shared._links), ours)
    deadline = time.monotonic() + DEADLINE
    while viewer.count < ours.sent:
        assert time.monotonic() < deadline
        viewer.subscription._subscription.drain()
    ours.send()
    receive()
    viewer.watch_sharing(ours)
    viewer.assert_complete(ours)
    plain = Camera(camera, 'plain', is_plain=True)
    viewer.match(ours, plain)
    ours.send()
    receive()
    viewer.watch(lambda: plain.sent > 20, ours, plain)
    viewer.assert_complete(ours, plain)
    assert not shared._links


@pytest.mark.parametrize('end', ['publisher leaves', 'frame is overdue', 'messages are lost'])
def test_messages_that_wait_before_a_shared_frame(
        viewer: Viewer, camera: Node, monkeypatch: pytest.MonkeyPatch, end: str) -> None:
    ours = Camera(camera)
    viewer.match(ours)
    subscription = viewer.subscription
    shared = subscription._shared
    with monkeypatch.context() as patch:
        patch.setattr(shared, '_open', lambda publisher: False)
        viewer.watch(lambda: bool(subscription._publishers)
                     and shared._services.include(subscription._publishers), ours)
        spin_until(viewer.node, lambda: viewer.count == ours.sent)
        before = ours.sent
        for _ in range(8):
            ours.send()
    subscription._update_sharing()
    link, = shared._links.values()
    ours.send()
    ours.send()
    _repeat(shared._wake, lambda: link.is_held)
    if end == 'messages are lost':
        taken: list[TakenMessage] = []
        _repeat(lambda: taken.extend(subscription._subscription.take_data()),
                lambda: len(taken) == 10)
    if end == 'publisher leaves':
        ours.destroy()
        _repeat(subscription._adapt_qos, lambda: not subscription._publishers)
    else:
        _repeat(shared._wake, lambda: viewer.count > before)
    lost = 8 if end == 'messages are lost' else 0
    numbers = [*range(1, ours.sent + 1)]
    assert viewer.numbers['ours'] == numbers[:before] + numbers[before + lost:]
    assert subscription.losses.count == lost


def _repeat(action: Callable[[], object], condition: Callable[[], bool]) -> None:
    """Call a function, outside the executor, until a condition holds."""
    deadline = time.monotonic() + DEADLINE
    while not condition():
        assert time.monotonic() < deadline
        action()


def test_executor_that_loses_a_wake_up(
        view: Callable[..., Viewer], camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    viewer = view()
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch_sharing(ours)
    viewer.assert_complete(ours)
    lost = Event()
    with monkeypatch.context() as patch:
        patch.setattr(viewer.subscription._shared._guard, 'trigger', lost.set)
        ours.send()
        assert lost.wait(DEADLINE)
    viewer.assert_complete(ours)


def test_plain_publisher_joins_and_leaves(viewer: Viewer, camera: Node) -> None:
    ours = Camera(camera)
    viewer.match(ours)
    for turn in range(3):
        viewer.watch_sharing(ours)
        plain = Camera(camera, f'plain{turn}', is_plain=True)
        viewer.watch(lambda: not viewer.is_sharing, ours)
        viewer.match(ours, plain)
        viewer.watch(lambda: not viewer.shared and plain.sent > 20, ours, plain)  # noqa: B023
        viewer.watch(lambda: not viewer.subscription._shared._links, ours, plain)
        viewer.assert_complete(ours, plain)
        plain.destroy()
    viewer.watch_sharing(ours)
    viewer.assert_complete(ours)


def test_two_sharing_publishers(viewer: Viewer, camera: Node, node: Node) -> None:
    first = Camera(camera, 'first')
    viewer.match(first)
    viewer.watch(lambda: viewer.is_sharing, first)
    second = Camera(camera, 'second')
    viewer.watch(lambda: not viewer.is_sharing, first)
    spin_until(node, lambda: second.subscribers > 0)
    spin_until(node, lambda: viewer.subscription._subscription.publisher_count() == 2)
    viewer.watch_sharing(first, second)
    viewer.assert_complete(first, second)
    second.destroy()
    viewer.watch(lambda: first.sent > 100, first)
    viewer.assert_complete(first)


def test_publisher_and_subscriber_of_one_node(viewer: Viewer) -> None:
    ours = Camera(viewer.node)
    viewer.match(ours)
    viewer.watch_sharing(ours)
    viewer.assert_complete(ours)


def test_size_and_encoding_that_change(viewer: Viewer, camera: Node) -> None:
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch_sharing(ours)
    for encoding, height, width in (
            ('mono8', 1, 1), ('bgr8', 481, 641), ('32FC1', 7, 3), ('bayer_rggb8', 1080, 1920),
            ('nv21', 4, 6), ('16UC3', 1081, 1921), ('yuv422_yuy2', 5, 4), ('mono8', 2, 1)):
        for _ in range(4):
            ours.send(encoding, height, width)
            spin_until(viewer.node, lambda: viewer.count == ours.sent)
    assert viewer.shared > 50
    viewer.assert_complete(ours)


def test_publisher_that_starts_again(viewer: Viewer, camera: Node) -> None:
    for turn in range(20):
        ours = Camera(camera, f'turn{turn}')
        spin_until(viewer.node, lambda: ours.subscribers > 0)  # noqa: B023
        viewer.match(ours)
        viewer.watch_sharing(ours)
        viewer.assert_complete(ours)
        ours.destroy()


@pytest.mark.parametrize('depth', [1, 3, None])
def test_overwritten_frames_are_counted(
        view: Callable[..., Viewer], camera: Node, depth: int | None) -> None:
    viewer = view(depth=depth)
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch(lambda: viewer.is_sharing, ours, window=1)
    spin_until(viewer.node, lambda: viewer.count == ours.sent)
    before = ours.sent
    for _ in range(100):
        ours.send()
    spin_until(viewer.node, lambda: viewer.numbers['ours'][-1] == ours.sent)
    kept = depth or MAX_DEPTH
    assert viewer.numbers['ours'] == [
        *range(1, before + 1), *range(101 + before - kept, ours.sent + 1)]
    assert viewer.subscription.losses.count == 100 - kept


@pytest.mark.parametrize('depth', [1, None])
def test_overwritten_frames_before_the_image_topic_are_counted(
        view: Callable[..., Viewer], camera: Node, depth: int | None) -> None:
    viewer = view(depth=depth)
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch(lambda: viewer.is_sharing, ours, window=1)
    plain = Camera(camera, 'plain', is_plain=True)
    viewer.watch(lambda: not viewer.is_sharing, ours, window=1)
    for _ in range(100):  # some before the camera discovers the subscription, and some after
        ours.send()
    spin_until(viewer.node, lambda: ours.subscribers > 0)
    for _ in range(100):
        ours.send()
    spin_until(viewer.node, lambda: viewer.numbers['ours'][-1] == ours.sent)
    assert viewer.numbers['ours'] == sorted(set(viewer.numbers['ours']))
    assert viewer.count + viewer.subscription.losses.count == ours.sent + plain.sent


@pytest.mark.parametrize('every', [False, True])
def test_skipped_frames_of_a_slow_callback(camera: Node, node: Node, every: bool) -> None:
    ours = Camera(camera)
    numbers: list[int] = []
    may_return = Event()

    def slow(frame: Frame) -> None:
        assert is_picture(frame)
        numbers.append(frame.stamp.sec)
        assert may_return.wait(DEADLINE)

    subscriber = FrameSubscriber(node, TOPIC, slow, encoding='', every=every, threaded=True)
    try:
        subscription = subscriber._subscription
        spin_until(node, lambda: ours.subscribers > 0
                   and subscription._subscription.publisher_count() > 0)
        ours.send()
        spin_until(node, lambda: bool(numbers))

        def send_until_shared() -> bool:
            ours.send()
            return subscription._subscription.is_stopped

        spin_until(node, send_until_shared)
        for _ in range(100):
            ours.send()
        may_return.set()
        spin_until(node, lambda: numbers[-1] == ours.sent)
    finally:
        may_return.set()
        subscriber.destroy()
    assert numbers == sorted(set(numbers))
    assert len(numbers) + subscriber.skipped == ours.sent


@pytest.mark.parametrize('in_thread', [False, True])
def test_every_frame_is_kept(view: Callable[..., Viewer], camera: Node, in_thread: bool) -> None:
    held: list[Frame] = []
    viewer = view(in_thread=in_thread, hold=held.append)
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch(lambda: viewer.shared > 100, ours)
    viewer.assert_complete(ours)
    assert all(map(is_picture, held))


def test_view_outlives_subscription_and_node(domain: int, camera: Node) -> None:
    held: list[Frame] = []
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = Node('leaves', context=context)
    viewer = Viewer(node, hold=held.append)
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch_sharing(ours)
    frames = [frame for frame in held if frame.raw.base is not None][-MAX_VIEWS:]
    with pytest.raises(ValueError, match='read-only'):
        frames[0].raw[0] = 0
    with pytest.raises(ValueError, match='WRITEABLE'):
        frames[0].raw.flags.writeable = True
    del held[:]
    viewer.subscription.destroy()
    node.destroy_node()
    rclpy.shutdown(context=context)
    del viewer, node, context
    gc.collect()
    for _ in range(100):
        ours.send()
    assert all(map(is_picture, frames))
    ours.destroy()
    del ours
    gc.collect()
    assert all(map(is_picture, frames))


@pytest.mark.parametrize('changed', [
    {}, {'service': '0' * 32}, {'service': ''}, {'boot': '0' * 36}, {'version': 7}],
    ids=['repeated', 'of nobody', 'withdrawn', 'of another host', 'of another version'])
def test_hostile_announcement(
        viewer: Viewer, camera: Node, changed: dict[str, object]) -> None:
    announced: list[str] = []
    viewer.node.create_subscription(
        String, TOPIC + SUFFIX, lambda message: announced.append(message.data), LATCHED)
    hostile = camera.create_publisher(String, TOPIC + SUFFIX, LATCHED)
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch_sharing(ours)
    viewer.watch(lambda: bool(announced), ours)
    text = json.dumps({**json.loads(announced[0]), **changed})
    hostile.publish(String(data=text))
    viewer.watch(lambda: announced[-1] == text, ours)
    until = ours.sent + 200
    viewer.watch(lambda: ours.sent > until, ours)
    viewer.assert_complete(ours)
    is_harmless = not changed or 'version' in changed
    assert viewer.is_sharing == is_harmless


def test_announcements_of_many_strangers(viewer: Viewer, camera: Node) -> None:
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch_sharing(ours)
    hostile = camera.create_publisher(String, TOPIC + SUFFIX, QoSProfile(
        depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    spin_until(viewer.node, lambda: hostile.get_subscription_count() > 0)
    for number in range(500):
        hostile.publish(String(data=announce(f'{number:032x}', f'{number:032x}').to_text()))
    until = ours.sent + 200
    viewer.watch(lambda: ours.sent > until, ours)
    viewer.assert_complete(ours)


def test_failed_service_is_not_tried_again(
        viewer: Viewer, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    tries = []

    def fail() -> None:
        tries.append(1)
        raise SharedMemoryError('broken')

    monkeypatch.setattr(shared_frames, 'process_memory', fail)
    announced: list[str] = []
    viewer.node.create_subscription(
        String, TOPIC + SUFFIX, lambda message: announced.append(message.data), LATCHED)
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch(lambda: bool(tries and announced), ours)
    viewer.subscription._update_sharing()
    viewer.subscription._shared._services.add(announced[0])
    viewer.subscription._update_sharing()
    until = ours.sent + 20
    viewer.watch(lambda: ours.sent > until, ours)
    viewer.assert_complete(ours)
    assert len(tries) == 1


@pytest.mark.parametrize(('changed', 'reason'), [
    ({}, 'DoesNotExist'), ({'service': ''}, 'its /dev/shm has too little room'),
    ({'user': 7}, 'it runs on another machine, in another container or as another user'),
    ({'version': 7}, 'it has no frames yet, reads a file, or is not of opencv_tools with')])
def test_explanation_of_frames_that_are_not_shared(
        view: Callable[..., Viewer], camera: Node, changed: dict[str, object], reason: str,
) -> None:
    viewer = view(transport='shm')
    assert 'no publisher on /video_frames' in viewer.subscription.explain_no_frames()
    plain = Camera(camera, is_plain=True)
    announcement = announce('0' * 32, publisher_id(plain._plain.handle).hex())
    announcing = camera.create_publisher(String, TOPIC + SUFFIX, LATCHED)
    announcing.publish(String(data=json.dumps({**json.loads(announcement.to_text()), **changed})))
    viewer.watch(lambda: reason in viewer.subscription.explain_no_frames())
    sentence = viewer.subscription.explain_no_frames()
    assert sentence.startswith('/video_frames has a publisher that does not share its frames')
    assert sentence.endswith('; set transport:=auto')
