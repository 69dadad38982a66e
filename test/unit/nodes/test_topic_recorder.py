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

"""Recording of other topics from real publishers, in this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import ctypes
from pathlib import Path
from threading import Event

from conftest import destroy, executor_of
from console import Console
from opencv_tools.message_types.definition import read_definition
from opencv_tools.nodes.subscriber import topic_recorder as module
from opencv_tools.nodes.subscriber.topic_recorder import TopicRecorder
from opencv_tools.recording.bag_sink import MessageBatch, RecordedMessage
from opencv_tools.recording.recorder import OnDone
from opencv_tools.transport.message_type import message_type
from opencv_tools.transport.type_support import TypeSupport
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Empty, String
from waiting import join, LONGEST_SECONDS, pause, wait_until

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)

pytestmark = pytest.mark.process


class Recording:
    """A recorder of topics, and what it has recorded."""

    def __init__(self, node: Node, patterns: str) -> None:
        self.console = Console()
        self.batches: list[tuple[RecordedMessage, ...]] = []
        self.recorder = TopicRecorder(
            node, patterns.split(), '/video_frames', self.console, self._put)

    def _put(self, batch: MessageBatch, on_done: OnDone) -> None:
        self.batches.append(batch.messages)
        batch.result.written = len(batch.messages)
        on_done(Path('drive.mcap'))

    @property
    def messages(self) -> list[RecordedMessage]:
        return [message for batch in self.batches for message in batch]

    def texts(self) -> list[str]:
        return [deserialize_message(bytes(message.parts[0]), String).data
                for message in self.messages]

    def topics(self) -> set[str]:
        return {message.channel.topic for message in self.messages}

    def has(self, line: str) -> bool:
        return any(line in found for found in self.console.lines)

    def end(self) -> bool:
        self.recorder.close()
        return self.recorder.log_summary()


Record = Callable[[str], Recording]


@pytest.fixture
def record(node: Node) -> Iterator[Record]:
    """Return a function that records topics."""
    recordings: list[Recording] = []

    def _record(patterns: str) -> Recording:
        recordings.append(Recording(node, patterns))
        return recordings[-1]

    yield _record
    for recording in recordings:
        recording.recorder.close()


@pytest.fixture
def other(domain: int) -> Iterator[Node]:
    """Create a third node, because one has a type for each topic."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    created = Node('other', context=context)
    yield created
    destroy(created)


def say(publisher: Publisher, *texts: str) -> None:
    """Publish as soon as the recorder has subscribed, and wait until it has the messages."""
    wait_until(publisher.get_subscription_count)
    for text in texts:
        publisher.publish(String(data=text))
    wait_until(publisher.wait_for_all_acked)


def poll_slowly(monkeypatch: pytest.MonkeyPatch, recording: Recording, seconds: float) -> None:
    """Return when the recorder sleeps so long, so that messages wait in the middleware."""
    is_closing, sleeps = recording.recorder._is_closing, []
    wait = is_closing.wait
    monkeypatch.setattr(is_closing, 'wait', lambda given: sleeps.append(given) or wait(given))
    monkeypatch.setattr(module, '_POLL_SECONDS', seconds)
    wait_until(lambda: seconds in sleeps, 'a long sleep', sleeps=lambda: len(sleeps))


def discover_again(recording: Recording) -> None:
    """Wait until the recorder has looked for topics once more from begin to end."""
    rounds: list[None] = []
    discover = recording.recorder._discover
    recording.recorder._discover = lambda: rounds.append(discover())
    wait_until(lambda: rounds, 'a look for topics')


def create_foreign_publisher(node: Node, topic: str) -> Callable[[], None]:
    """Create a publisher of a DDS topic with any name; return what destroys it."""
    class Qos(ctypes.Structure):
        _fields_ = (
            ('history', ctypes.c_int), ('depth', ctypes.c_size_t), ('reliability', ctypes.c_int),
            ('durability', ctypes.c_int), ('deadline', ctypes.c_uint64 * 2),
            ('lifespan', ctypes.c_uint64 * 2), ('liveliness', ctypes.c_int),
            ('lease', ctypes.c_uint64 * 2), ('avoids_conventions', ctypes.c_bool))

    class Options(ctypes.Structure):
        _fields_ = (('payload', ctypes.c_void_p), ('unique_flow', ctypes.c_int))

    pointer = ctypes.c_void_p
    rcl, rmw, fast = map(ctypes.CDLL, ('librcl.so', 'librmw.so', 'librmw_fastrtps_cpp.so'))
    rcl.rcl_node_get_rmw_handle.restype, rcl.rcl_node_get_rmw_handle.argtypes = pointer, [pointer]
    rmw.rmw_get_default_publisher_options.restype = Options
    fast.rmw_create_publisher.restype = pointer
    fast.rmw_create_publisher.argtypes = [pointer, pointer, ctypes.c_char_p, pointer, pointer]
    fast.rmw_destroy_publisher.argtypes = [pointer, pointer]
    support = TypeSupport(read_definition('foreign_msgs/msg/A', 'int8 a'))
    qos = Qos(history=1, depth=1, reliability=1, durability=2, liveliness=1,
              avoids_conventions=True)
    options = rmw.rmw_get_default_publisher_options()
    with node.handle:
        owner = rcl.rcl_node_get_rmw_handle(node.handle.pointer)
        publisher = fast.rmw_create_publisher(
            owner, support.address, topic.encode(), ctypes.byref(qos), ctypes.byref(options))
    assert publisher

    def destroy_publisher() -> None:
        with node.handle:
            assert fast.rmw_destroy_publisher(owner, publisher) == 0

    return destroy_publisher


def test_topic_whose_name_is_not_of_ros(record: Record, camera: Node) -> None:
    destroy_publisher = create_foreign_publisher(camera, 'rt/bad-name')
    try:
        recording = record('/*')
        publisher = camera.create_publisher(String, '/good', 10)
        wait_until(lambda: recording.has('/bad-name is not recorded: '))
        say(publisher, 'a')
        assert recording.end()
        assert recording.texts() == ['a']
        assert sum('/bad-name' in line for line in recording.console.lines) == 1
    finally:
        destroy_publisher()


def test_type_of_a_package_without_messages(
        record: Record, node: Node, camera: Node) -> None:
    kind = message_type('std_srvs/msg/Door', 'bool is_open')
    publisher = camera.create_publisher(kind, '/door', 10)
    recording = record('/door')
    with executor_of(camera) as answering, executor_of(node) as asking:
        wait_until(publisher.get_subscription_count, 'the subscription', lambda: (
            answering.spin_once(0.01), asking.spin_once(0.01)))
    publisher.publish(b'\0\1\0\0\1\0\0\0')
    wait_until(lambda: recording.messages)
    assert recording.messages[0].channel.definition == 'bool is_open'
    assert recording.end()


@pytest.mark.parametrize('count', [1, 2, 5])
def test_end_before_the_type_is_known(record: Record, camera: Node, count: int) -> None:
    names = [f'/door_{number}' for number in range(count)]
    for number, name in enumerate(names):
        camera.create_publisher(
            message_type(f'odd_msgs/msg/Door{number}', 'bool is_open'), name, 10)
    recording = record('/door_*')
    wait_until(lambda: len(recording.recorder._asked) == count, 'the topics')
    assert recording.end()
    assert recording.has('not recorded: the recording ended before the definition of the type')
    assert all(recording.has(name) for name in names)


def test_end_of_ros_before_the_recorder(domain: int, camera: Node) -> None:
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = Node('ending', context=context)
    try:
        publisher = camera.create_publisher(String, '/said', 10)
        recording = Recording(node, '/said')
        say(publisher, 'a')
        wait_until(lambda: recording.messages)
        context.shutdown()
        join(recording.recorder._thread)
        assert not recording.recorder._thread.is_alive()
        assert recording.end()
        assert not any(line.startswith('error: the topics') for line in recording.console.lines)
    finally:
        node.destroy_node()
        pause(0.03)  # see conftest.destroy


def test_failure_of_the_thread(
        record: Record, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    publisher = camera.create_publisher(String, '/said', 10)
    recording = record('/said')
    say(publisher, 'a')
    wait_until(lambda: recording.messages)
    monkeypatch.setattr(module, 'MessageReader', None)
    camera.create_publisher(String, '/said', qos_profile_sensor_data)
    wait_until(lambda: recording.has('error: the topics are not recorded any more: TypeError'))
    assert not recording.end()
    assert recording.has('info: /said: 1 messages received, 1 written')


def test_latched_message_after_a_change(record: Record, camera: Node) -> None:
    publisher = camera.create_publisher(String, '/map', LATCHED)
    publisher.publish(String(data='one'))
    recording = record('/map')
    wait_until(lambda: recording.messages)
    reader = recording.recorder._topics['/map'].reader
    second = camera.create_publisher(String, '/map', 10)  # nothing is latched any more
    wait_until(lambda: recording.recorder._topics['/map'].reader is not reader)
    reader = recording.recorder._topics['/map'].reader
    camera.destroy_publisher(second)  # and now again
    wait_until(lambda: recording.recorder._topics['/map'].reader is not reader)
    say(publisher, 'two')
    wait_until(lambda: 'two' in recording.texts())
    assert recording.end()
    assert recording.texts() == ['one', 'two']
    assert recording.has('/map: 2 messages received, 2 written, 0 lost in transit')


def test_publisher_that_is_replaced_at_once(
        record: Record, node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    first = camera.create_publisher(String, '/said', 10)
    recording = record('/said')
    say(first, 'a')
    wait_until(lambda: recording.messages)
    is_replaced, looks = Event(), []
    discover = recording.recorder._discover

    def look() -> None:
        looks.append(is_replaced.is_set())
        if is_replaced.is_set():
            discover()

    monkeypatch.setattr(recording.recorder, '_discover', look)
    wait_until(lambda: looks, 'a look for topics')
    second = camera.create_publisher(String, '/said', qos_profile_sensor_data)
    camera.destroy_publisher(first)
    wait_until(lambda: [info.qos_profile.reliability
                        for info in node.get_publishers_info_by_topic('/said')]
               == [qos_profile_sensor_data.reliability], 'the second publisher alone')
    is_replaced.set()
    wait_until(second.get_subscription_count)
    second.publish(String(data='b'))
    wait_until(lambda: recording.texts() == ['a', 'b'])


def test_messages_that_wait_at_a_change(
        record: Record, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    first = camera.create_publisher(String, '/said', 10)
    recording = record('/said')
    say(first, 'a')
    wait_until(lambda: recording.messages)
    poll_slowly(monkeypatch, recording, 1.0)
    say(first, 'b', 'c')
    second = camera.create_publisher(String, '/said', qos_profile_sensor_data)
    wait_until(second.get_subscription_count)
    assert recording.end()
    assert recording.texts() == ['a', 'b', 'c']


def test_messages_that_wait_at_the_end(
        record: Record, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    publisher = camera.create_publisher(String, '/said', 10)
    recording = record('/said')
    say(publisher, 'a')
    poll_slowly(monkeypatch, recording, LONGEST_SECONDS)
    say(publisher, 'b', 'c')
    assert recording.end()
    assert recording.texts() == ['a', 'b', 'c']


def test_order_of_two_topics(
        record: Record, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    publishers = [camera.create_publisher(String, topic, 10) for topic in ('/a', '/b')]
    recording = record('/a /b')
    for publisher in publishers:
        say(publisher, 'first')
    poll_slowly(monkeypatch, recording, LONGEST_SECONDS)
    for number in range(6):
        say(publishers[number % 2], f'{number}')
    assert recording.end()
    assert recording.texts()[-6:] == [*map(str, range(6))]
    assert all([*batch] == sorted(batch, key=lambda message: message.log_ns)
               for batch in recording.batches)


def test_topics_beside_the_images_are_not_recorded_twice(record: Record, camera: Node) -> None:
    info = camera.create_publisher(CameraInfo, '/camera_info', 10)
    publisher = camera.create_publisher(String, '/said', 10)
    recording = record('/*')
    say(publisher, 'a')
    wait_until(lambda: recording.messages)
    discover_again(recording)
    assert not info.get_subscription_count()
    assert '/camera_info' not in recording.recorder._topics


def test_many_topics_that_are_not_recorded(
        record: Record, node: Node, camera: Node, other: Node,
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, '_MAX_LOGGED', 2)
    for number in range(4):
        camera.create_publisher(String, f'/mixed_{number}', 10)
        other.create_publisher(Empty, f'/mixed_{number}', 10)
    wait_until(lambda: all(node.count_publishers(f'/mixed_{number}') == 2 for number in range(4)))
    recording = record('/*')
    wait_until(lambda: recording.has('more than 2 topics are not recorded'))
    publisher = camera.create_publisher(String, '/said', 10)
    say(publisher, 'a')
    assert recording.end()
    assert recording.texts() == ['a']
    reasons = [line for line in recording.console.lines if 'not recorded' in line]
    assert len(reasons) == 3 and 'it has several types, ' in reasons[0]


def test_topics_beyond_the_limit(
        record: Record, node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, '_MAX_TOPICS', 2)
    for number in range(6):
        camera.create_publisher(String, f'/said_{number}', 10)
    wait_until(lambda: all(node.count_publishers(f'/said_{number}') for number in range(6)))
    recording = record('/said_*')
    wait_until(lambda: recording.has('not recorded'))
    discover_again(recording)
    assert [line for line in recording.console.lines if 'not recorded' in line] == [
        'warning: 4 topics are not recorded, such as /said_2: 2 topics are, which is the limit']


def test_topic_that_is_tried_again_with_other_publishers(
        record: Record, node: Node, camera: Node, other: Node) -> None:
    publisher = camera.create_publisher(String, '/mixed', 10)
    second = other.create_publisher(Empty, '/mixed', 10)
    wait_until(lambda: node.count_publishers('/mixed') == 2)
    recording = record('/mixed')
    wait_until(lambda: recording.has('/mixed is not recorded: it has several types'))
    other.destroy_publisher(second)
    say(publisher, 'a')
    wait_until(lambda: recording.texts() == ['a'])


def test_publisher_of_another_type(
        record: Record, node: Node, camera: Node, other: Node) -> None:
    """The type that is left is recorded once the first one has no publisher, and later again."""
    first = camera.create_publisher(String, '/mixed', 10)
    recording = record('/mixed')
    say(first, 'a')
    wait_until(lambda: recording.messages)
    second = other.create_publisher(Empty, '/mixed', 10)
    wait_until(lambda: recording.has(
        'warning: /mixed has publishers of std_msgs/msg/Empty, whose messages are neither '
        'recorded nor counted while there are publishers of std_msgs/msg/String'))
    second.publish(Empty())
    say(first, 'b')
    wait_until(lambda: len(recording.messages) == 2)
    camera.destroy_publisher(first)
    wait_until(second.get_subscription_count)
    second.publish(Empty())
    wait_until(lambda: len(recording.messages) == 3)
    assert recording.messages[2].channel.type_name == 'std_msgs/msg/Empty'
    other.destroy_publisher(second)
    wait_until(lambda: not node.count_publishers('/mixed'))
    third = camera.create_publisher(String, '/mixed', 10)
    say(third, 'c')
    wait_until(lambda: len(recording.messages) == 4)
    assert recording.messages[3].channel is recording.messages[0].channel
    assert recording.end()
    accounts = [line for line in recording.console.lines if 'messages received' in line]
    assert [line.partition(' written')[0] for line in accounts] == [
        'info: /mixed (std_msgs/msg/Empty): 1 messages received, 1',
        'info: /mixed (std_msgs/msg/String): 3 messages received, 3']
    assert not recording.has('definition')


def test_publisher_with_another_definition(record: Record, camera: Node, other: Node) -> None:
    publisher = camera.create_publisher(String, '/said', 10)
    recording = record('/said')
    say(publisher, 'a')
    older = TypeSupport(read_definition('std_msgs/msg/String', 'string text'))
    other.create_publisher(older.python_class(), '/said', 10)
    wait_until(lambda: recording.has('/said has publishers with another definition of std_msgs'))
    assert recording.end()


def test_message_without_a_byte(record: Record, camera: Node) -> None:
    publisher = camera.create_publisher(String, '/said', 10)
    recording = record('/said')
    wait_until(publisher.get_subscription_count)
    publisher.publish(b'')
    wait_until(lambda: recording.messages)
    assert [message.size for message in recording.messages] == [0]
