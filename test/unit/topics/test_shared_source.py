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

from collections.abc import Callable, Iterable
import gc
import json
from threading import Event

from conftest import spin_until
from opencv_tools.frames import Frame, FrameSubscriber
from opencv_tools.topics import shared_frames, shared_source
from opencv_tools.topics.order import Way
from opencv_tools.topics.queue import FrameQueue, ReceivedMessage
from opencv_tools.topics.shared_source import Origin, SharedSource, WriterEndedError
from opencv_tools.transport.shared_frames import publisher as shared_publisher
from opencv_tools.transport.shared_frames.announcement import (
    announce, Announcement, read_announcement, SUFFIX)
from opencv_tools.transport.shared_frames.header import FrameHeader, publisher_identity
from opencv_tools.transport.shared_frames.memory import MAX_DEPTH, MAX_READERS, process_memory
from opencv_tools.transport.shared_frames.pages import SharedMemoryError
from opencv_tools.transport.shared_frames.reader import MAX_VIEWS
from opencv_tools.transport.zero_copy import publisher_id
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image
from sharing import Camera, is_picture, TOPIC, Viewer
from std_msgs.msg import String
from waiting import pause, wait_until, Watch, work

pytest_plugins = ['sharing']
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_change_to_shared_memory(viewer: Viewer, camera: Node) -> None:
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch_sharing(ours)
    assert not viewer.node.count_subscribers(TOPIC)
    viewer.assert_complete(ours)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('turns', [3, 8])
@pytest.mark.parametrize('end', ['goes on', 'ends'])
def test_frames_that_wait_for_a_busy_executor(
        viewer: Viewer, camera: Node, end: str, turns: int) -> None:
    # Messages wait for the executor while shared frames already arrive.
    for turn in range(turns):
        ours = Camera(camera, f'turn{turn}')
        viewer.watch(lambda: ours.subscribers > 0 and viewer.publishers > 0)  # noqa: B023
        watch = Watch('sharing', {'sent': lambda: ours.sent, 'work': work})  # noqa: B023
        while not viewer.is_sharing:
            watch.check()
            for _ in range(6):
                ours.send()
                pause(0.004)
            if end == 'ends' and ours.sent > 6 * turn:
                break
            viewer.watch(lambda: viewer.received(ours) == ours.sent)  # noqa: B023
            viewer.watch(iter([False, True]).__next__)  # a thread may have received all
        if end == 'ends':
            ours.destroy()
        viewer.assert_complete(ours)
        if end == 'goes on':
            ours.destroy()


def test_executor_that_loses_a_wake_up(
        view: Callable[..., Viewer], camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    viewer = view()
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch_sharing(ours)
    viewer.assert_complete(ours)
    lost = Event()
    with monkeypatch.context() as patch:
        patch.setattr(viewer.subscription._wake_ups._guard, 'trigger', lost.set)
        ours.send()
        wait_until(lost.is_set)
    viewer.assert_complete(ours)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('turns', [1, 3])
def test_plain_publisher_joins_and_leaves(viewer: Viewer, camera: Node, turns: int) -> None:
    ours = Camera(camera)
    viewer.match(ours)
    for turn in range(turns):
        viewer.watch_sharing(ours)
        plain = Camera(camera, f'plain{turn}', is_plain=True)
        viewer.watch(lambda: not viewer.is_sharing, ours)
        viewer.match(ours, plain)
        viewer.watch(lambda: not viewer.shared and plain.sent > 20, ours, plain)  # noqa: B023
        viewer.watch(lambda: not viewer.subscription._sources.shared._sources, ours, plain)
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
    spin_until(node, lambda: viewer.publishers == 2)
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


@pytest.mark.quick_cases(1)
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


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('turns', [5, 20])
def test_publisher_that_starts_again(viewer: Viewer, camera: Node, turns: int) -> None:
    for turn in range(turns):
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
    numbers = viewer.numbers['ours']
    assert numbers[:before] == [*range(1, before + 1)]
    assert numbers[-kept:] == [*range(ours.sent + 1 - kept, ours.sent + 1)]
    assert numbers == sorted(set(numbers))
    assert viewer.count + viewer.missed == ours.sent


@pytest.mark.thorough
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
    assert viewer.count + viewer.missed == ours.sent + plain.sent


@pytest.mark.parametrize('every', [False, True])
def test_skipped_frames_of_a_slow_callback(camera: Node, node: Node, every: bool) -> None:
    ours = Camera(camera)
    numbers: list[int] = []
    may_return = Event()

    def slow(frame: Frame) -> None:
        assert is_picture(frame)
        numbers.append(frame.stamp.sec)
        wait_until(may_return.is_set)

    subscriber = FrameSubscriber(node, TOPIC, slow, encoding='', every=every, threaded=True)
    try:
        subscription = subscriber._subscription
        spin_until(node, lambda: ours.subscribers > 0
                   and subscription._sources.image._reader.publisher_count() > 0)
        ours.send()
        spin_until(node, lambda: bool(numbers))

        def send_until_shared() -> bool:
            ours.send()
            return subscription.is_shared

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


@pytest.mark.parametrize('threaded', [False, True])
def test_every_frame_is_kept(view: Callable[..., Viewer], camera: Node, threaded: bool) -> None:
    held: list[Frame] = []
    viewer = view(threaded=threaded, hold=held.append)
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch(lambda: viewer.shared > 40, ours)
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


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize('changed', [
    {}, {'service': '0' * 32}, {'service': ''}, {'boot': '0' * 36}, {'version': 7}],
    ids=['repeated', 'of nobody', 'withdrawn', 'of another host', 'of another version'])
@pytest.mark.parametrize('sender', ['stranger', 'publisher'])
def test_changed_announcement(
        viewer: Viewer, camera: Node, domain: int, changed: dict[str, object], sender: str,
) -> None:
    announced: list[str] = []
    viewer.node.create_subscription(
        String, TOPIC + SUFFIX, lambda message: announced.append(message.data),
        QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch_sharing(ours)
    viewer.watch(lambda: bool(announced), ours)
    text = json.dumps({**json.loads(announced[0]), **changed})
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = camera if sender == 'publisher' else Node('stranger', context=context)
    node.create_publisher(String, TOPIC + SUFFIX, LATCHED).publish(String(data=text))
    viewer.watch(lambda: text in announced[1:], ours)
    assert viewer.is_sharing or sender == 'publisher'
    until = ours.sent + 60
    viewer.watch(lambda: ours.sent > until, ours)
    viewer.assert_complete(ours)
    assert viewer.is_sharing or sender == 'publisher'
    rclpy.shutdown(context=context)


def test_announcements_of_many_strangers(viewer: Viewer, camera: Node) -> None:
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch_sharing(ours)
    hostile = camera.create_publisher(String, TOPIC + SUFFIX, QoSProfile(
        depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    spin_until(viewer.node, lambda: hostile.get_subscription_count() > 0)
    for number in range(500):
        hostile.publish(String(data=announce(f'{number:032x}', f'{number:032x}').to_text()))
    until = ours.sent + 60
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
    viewer.subscription._sources.update_sharing()
    viewer.subscription._sources.shared._services.add(
        announced[0], bytes.fromhex(json.loads(announced[0])['publisher']))
    viewer.subscription._sources.update_sharing()
    until = ours.sent + 20
    viewer.watch(lambda: ours.sent > until, ours)
    viewer.assert_complete(ours)
    assert len(tries) == 1


def test_announced_service_of_another_publisher(viewer: Viewer, camera: Node) -> None:
    ours, other = Camera(camera), Camera(camera, 'other', topic='/other')
    camera.create_subscription(Image, '/other', lambda _: None, 10)
    announced: list[Announcement] = []
    for topic in (TOPIC, '/other'):
        viewer.node.create_subscription(
            String, topic + SUFFIX,
            lambda message: announced.append(read_announcement(message.data)), LATCHED)
    viewer.match(ours)
    viewer.watch_sharing(ours)
    publisher = publisher_id(ours.frames._topics.images.handle)

    viewer.watch(lambda: other.subscribers > 0 and other.frames._topics.shared.has_subscribers)
    for _ in range(100 + ours.sent):  # so that the next ones would be new
        other.send()
    viewer.watch(lambda: len(announced) > 1)
    service, = (found.service for found in announced if found.publisher != publisher.hex())
    text = announce(service, publisher.hex()).to_text()
    camera.create_publisher(String, TOPIC + SUFFIX, LATCHED).publish(String(data=text))

    def is_refused() -> bool:
        other.send()
        reason = viewer.subscription._sources.shared.explain({publisher})
        return 'frames of another publisher' in reason or 'other' in viewer.numbers

    viewer.watch(is_refused)
    assert viewer.numbers.keys() == {'ours'}
    viewer.watch(lambda: not viewer.is_sharing, ours)
    viewer.assert_complete(ours)


def test_more_readers_than_a_service_has(
        view: Callable[..., Viewer], camera: Node, capfd: pytest.CaptureFixture[str]) -> None:
    viewer = view()
    ours = Camera(camera)
    viewer.match(ours)
    ours.send()
    service = ours.frames._topics.shared._writer.service
    readers = [process_memory().open_reader(service, 1) for _ in range(MAX_READERS)]
    reason = f'it has {MAX_READERS} readers already, which is the limit'
    publisher = publisher_id(ours.frames._topics.images.handle)
    viewer.watch(lambda: reason in viewer.subscription._sources.shared.explain({publisher}), ours)
    viewer.watch(lambda: ours.sent > 50, ours)
    viewer.assert_complete(ours)
    assert not viewer.is_sharing
    del readers
    assert capfd.readouterr().err.count(reason) == 1


def test_count_after_frames_that_were_only_shared(
        view: Callable[..., Viewer], camera: Node) -> None:
    early = view(transport='shm')
    ours = Camera(camera)
    spin_until(early.node, lambda: ours.frames.has_subscribers)

    def is_shared() -> bool:
        ours.send()
        return early.shared > 20

    spin_until(early.node, is_shared)
    plain = Camera(camera, 'plain', is_plain=True)  # so that the late one remains on the topic
    late = view()
    late.match(ours, plain)
    announcements = late.subscription._sources.shared.announcements
    spin_until(late.node, lambda: announcements.publisher_count() > 0)
    before = ours.sent
    for _ in range(10):
        ours.send()
    spin_until(late.node, lambda: late.received(ours) == 10)
    account = late.subscription.account
    assert account.lost == 0
    assert account.before == before
    assert account.uncounted == f', {before} sent before the first received frame'
    given = late.given[ours.name]  # messages 1 to 10, as soon as the announcement is read
    assert given == sorted(given) and given[-1] == before + 10


def test_waiting_messages_precede_the_next_shared_frame(
        view: Callable[..., Viewer], camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_source, '_JOIN_SECONDS', 0.0)
    viewer = view()
    ours = Camera(camera)
    viewer.match(ours)
    subscription, shared = viewer.subscription, viewer.subscription._sources.shared
    publisher = publisher_id(ours.frames._topics.images.handle)
    publishers = frozenset({publisher})
    spin_until(viewer.node, lambda: subscription._sources.image.publishers == publishers)
    # From here the executor does not run.
    for _ in range(6):
        ours.send()
    wait_until(lambda: shared.read_announcement() or shared.has_changed,
               'the announcement')
    subscription._sources.update_sharing()
    ours.send()
    wait_until(lambda: shared.has_changed, 'the frame that messages precede')
    subscription._sources.update_sharing()
    ours.send()
    wait_until(lambda: subscription._queue.order.way(publisher) is Way.SHARED,
               'the next shared frame')
    viewer.watch(lambda: viewer.numbers.get('ours', [])[-1:] == [ours.sent])
    assert viewer.numbers['ours'] == [*range(1, ours.sent + 1)]
    assert viewer.missed == 0


def test_shared_frames_at_close(
        view: Callable[..., Viewer], camera: Node,
        hold_threads: Callable[[Iterable[SharedSource]], None]) -> None:
    viewer = view()
    ours = Camera(camera)
    viewer.match(ours)
    viewer.watch_sharing(ours)
    viewer.assert_complete(ours)
    hold_threads(viewer.subscription._sources.shared._sources.values())
    for _ in range(3):
        ours.send()
    assert viewer.subscription.close(lambda: True) == 0
    assert viewer.numbers['ours'] == [*range(1, ours.sent + 1)]


@pytest.mark.parametrize('growth', [0, 1, 10_000])
@pytest.mark.parametrize('end', ['of the writer', 'of the subscription'])
def test_frames_of_a_file_that_wait_in_the_memory(end: str, growth: int) -> None:
    publisher = bytes(range(16))
    writer = process_memory().create_writer(1, overwrites=False)
    origin = Origin(publisher, writer.service, publisher_identity(publisher, TOPIC))
    queue = FrameQueue(2)
    queue.order.change(publisher, Way.SHARED)
    source = SharedSource(
        origin, process_memory().open_reader(writer.service, MAX_DEPTH), queue,
        lambda: None, lambda: None)
    for number in range(1, MAX_DEPTH + 1):
        header = FrameHeader(number=number, height=1, width=1, step=1, sec=number)
        header.identity[:] = origin.identity
        slot = writer.lend(1 + growth * number)
        slot.data[:] = number
        assert slot.publish(header, '', 'mono8')
    wait_until(lambda: queue.is_full, 'a full queue')
    numbers: list[int] = []

    def pop() -> bool:
        found = queue.pop()
        if found:
            assert isinstance(found, ReceivedMessage)
            assert source.error is None or queue.count == MAX_DEPTH
            numbers.append(found.message.header.sec)
        return len(numbers) == MAX_DEPTH

    if end == 'of the writer':
        writer.end()
        wait_until(lambda: not writer.readers, 'the end of the reader')
        del slot, writer
        gc.collect()
        wait_until(pop, 'all frames')
        wait_until(lambda: isinstance(source.error, WriterEndedError), 'the end of the source')
    else:
        source.receive()
        while not pop():
            assert queue.has_frames
    source.close()
    source.join()
    assert (numbers, queue.skipped) == ([*range(1, MAX_DEPTH + 1)], 0)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('is_shared', [False, True])
def test_message_that_was_not_published(
        viewer: Viewer, camera: Node, monkeypatch: pytest.MonkeyPatch, is_shared: bool) -> None:
    ours = Camera(camera)
    viewer.match(ours)
    camera.create_subscription(Image, TOPIC, lambda _: None, 10)
    viewer.watch_sharing(ours)
    if not is_shared:
        plain = Camera(camera, 'plain', is_plain=True)
        viewer.watch(lambda: not viewer.is_sharing, ours)
        viewer.match(ours, plain)
        viewer.watch(lambda: not viewer.shared, ours)
    viewer.assert_complete(ours)

    def fail(*_: object) -> None:
        raise RuntimeError('mine')

    with monkeypatch.context() as patch, pytest.raises(RuntimeError, match='mine'):
        patch.setattr(shared_publisher, 'publish_image', fail)
        ours.send()
    for _ in range(5):
        ours.send()
    spin_until(viewer.node, lambda: viewer.numbers['ours'][-1] == ours.sent)
    if is_shared:
        Camera(camera, 'plain', is_plain=True)
        viewer.watch(lambda: not viewer.is_sharing)
        spin_until(viewer.node, lambda: viewer.publishers == 2)
        for _ in range(5):
            ours.send()
        spin_until(viewer.node, lambda: viewer.numbers['ours'][-1] == ours.sent)
    assert viewer.numbers['ours'] == sorted(set(viewer.numbers['ours']))
    assert (viewer.count, viewer.missed) == (ours.sent - 1, 1)


@pytest.mark.parametrize(('changed', 'reason'), [
    ({}, 'DoesNotExist'), ({'service': ''}, 'its /dev/shm has too little room'),
    ({'user': 7}, 'it runs on another machine, in another container or as another user'),
    ({'version': 7}, 'it has no frames yet, or is not of opencv_tools with iceoryx2')])
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
