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

"""Recording and playback of the messages of other topics beside the images."""

from __future__ import annotations

from collections.abc import Callable
import json
import os
from pathlib import Path
import re
import struct
from typing import Any

from bag_readers import account_of, decode, read_by_all
from conftest import NodeProcess, spin_until
from mcap.reader import SeekingReader
import numpy as np
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import read_definition
from opencv_tools.transport.message_type import message_type
import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from rclpy.serialization import serialize_message
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from sending import create_publisher, stamped
from sensor_msgs.msg import Image, JointState
from type_description_interfaces.msg import TypeSource
from type_description_interfaces.srv import GetTypeDescription
from waiting import pause

Start = Callable[..., NodeProcess]
BAG = 'drive.mcap'
GRIPPER = 'my_robot_msgs/msg/Gripper'
GRIPPER_TEXT = f"""\
string name
float64[3] place
my_robot_msgs/Part[] parts
{"=" * 80}
MSG: my_robot_msgs/Part
uint8 id
"""
TF = 'tf2_msgs/msg/TFMessage'
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TOPICS = {'/tf': TF, '/tf_static': TF, '/joint_states': 'sensor_msgs/msg/JointState',
          '/arm/gripper': GRIPPER}
COUNT = 30


def text_of(name: str) -> str | None:
    return GRIPPER_TEXT if name == GRIPPER else None


def content(name: str, number: int) -> bytes:
    """Return a numbered message."""
    if name == GRIPPER:
        return MessageCodec(read_definition(name, GRIPPER_TEXT)).write(
            {'name': f'left {number}', 'place': [1.0, 2.0, number], 'parts': [{'id': 7}]})
    if name == TF:
        stamp = {'sec': number, 'nanosec': 0}
        zero = {'x': 0.0, 'y': 0.0, 'z': 0.0}
        return MessageCodec(read_definition(name)).write({'transforms': [{
            'header': {'stamp': stamp, 'frame_id': 'base'}, 'child_frame_id': 'arm',
            'transform': {'translation': zero, 'rotation': {**zero, 'w': 1.0}}}]})
    return bytes(serialize_message(JointState(name=['elbow'], position=[float(number)])))


def create_topics(node: Node) -> dict[str, Publisher]:
    return {topic: node.create_publisher(
        message_type(name, text_of(name)), topic, LATCHED if 'static' in topic else 100)
        for topic, name in TOPICS.items()}


def test_topics_of_every_kind(start: Start, node: Node, tmp_path: Path) -> None:
    publishers, images = create_topics(node), create_publisher(node)
    publishers['/tf_static'].publish(content(TF, 0))
    subscriber = start('img_subscriber', output_dir=tmp_path, file_name=BAG,
                       topics='[/tf*, /joint_states, "*/gripper"]')
    spin_until(node, lambda: images.get_subscription_count() and all(
        publisher.get_subscription_count() for publisher in publishers.values()))
    sent = {topic: [content(name, number) for number in range(1, COUNT)]
            for topic, name in TOPICS.items() if topic != '/tf_static'}
    for number in range(COUNT - 1):
        images.publish(stamped(np.full((4, 4), number, np.uint8), 'mono8', number))
        for topic, messages in sent.items():
            publishers[topic].publish(messages[number])
    sent['/tf_static'] = [content(TF, 0)]
    spin_until(node, lambda: all(publisher.wait_for_all_acked() for publisher in (
        images, *publishers.values())))
    subscriber.interrupt()
    assert subscriber.finish() == 0, subscriber.output
    for topic, messages in sent.items():
        assert (f'{topic}: {len(messages)} messages received, {len(messages)} written, 0 lost in '
                'transit') in subscriber.output
    path = tmp_path / BAG
    stored = read_by_all(path)
    for topic, messages in sent.items():
        assert_equal([found.data for found in stored if found.topic == topic], messages)
    assert len([found for found in stored if found.topic == '/video_frames']) == COUNT - 1
    assert_decoded(path, sent['/arm/gripper'])
    assert_channels(path)
    assert_played(start, node, path, sent)


def assert_equal(found: list[bytes], expected: list[bytes]) -> None:
    """Compare messages, which the middleware fills up to four bytes."""
    assert [*map(bytes, found)] == [
        one + bytes(-len(one) % 4) for one in expected]


def assert_decoded(path: Path, messages: list[bytes]) -> None:
    """Decode a type that nobody has compiled with two libraries, by the schema in the bag."""
    found = [one for one in decode(path) if hasattr(one, 'parts')]
    assert [(one.name, one.place[2], one.parts[0].id) for one in found] == [
        (f'left {number}', number, 7) for number in range(1, COUNT)]
    with path.open('rb') as file:
        schemas = SeekingReader(file).get_summary().schemas.values()
    text = next(schema.data.decode() for schema in schemas if schema.name == GRIPPER)
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(text, GRIPPER))
    assert types.deserialize_cdr(messages[2], GRIPPER).name == 'left 3'


def assert_channels(path: Path) -> None:
    with path.open('rb') as file:
        channels = {channel.topic: channel.metadata
                    for channel in SeekingReader(file).get_summary().channels.values()}
    for topic in TOPICS:
        offer, = parse_qos(channels[topic]['offered_qos_profiles'])
        assert (offer.durability.name == 'TRANSIENT_LOCAL') == (topic == '/tf_static')
        assert re.fullmatch('RIHS01_[0-9a-f]{64}', channels[topic]['topic_type_hash'])


def assert_played(
        start: Start, node: Node, path: Path, sent: dict[str, list[bytes]]) -> None:
    """Play a bag twice; each message arrives, also compiled, and also for a late subscriber."""
    got: dict[str, list[Any]] = {topic: [] for topic in sent}
    images: list[Image] = []
    for topic, name in TOPICS.items():
        if topic != '/tf_static':
            node.create_subscription(message_type(name, text_of(name)), f'/played{topic}',
                                     got[topic].append, 1000, raw=topic != '/joint_states')
    node.create_subscription(Image, '/played/frames', images.append, 1000)
    remapped = [part for topic in TOPICS for part in ('-r', f'{topic}:=/played{topic}')]
    publisher = start('img_publisher', '--ros-args', *remapped, '-r',
                      'video_frames:=/played/frames', source=path, topics='/*', publish_rate=0,
                      stamp='original', wait_for_subscribers=1, loop=2)
    spin_until(node, lambda: images or not publisher.is_running())
    node.create_subscription(message_type(TF), '/played/tf_static', got['/tf_static'].append,
                             LATCHED, raw=True)
    spin_until(node, lambda: not publisher.is_running())
    assert publisher.finish() == 0, publisher.output
    spin_until(node, lambda: len(images) == 2 * (COUNT - 1) and all(
        len(messages) >= (1 if topic == '/tf_static' else 2 * len(sent[topic]))
        for topic, messages in got.items()))
    assert [one.position[0] for one in got.pop('/joint_states')] == 2 * [*range(1, COUNT)]
    static = got.pop('/tf_static')
    assert_equal(static, len(static) * [content(TF, 0)])
    for topic, messages in got.items():
        assert_equal(messages, 2 * sent[topic])
    assert f'; {2 * (3 * (COUNT - 1) + 1)} messages of other topics' in publisher.output


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('limits', [
    {}, {'split_bytes': 20_000, 'file_name': 'a{seq}.mcap'}, {'every_n': 10, 'queue_size': 1}])
@pytest.mark.parametrize('overflow', ['drop', 'block'])
@pytest.mark.parametrize('transport', ['raw', 'shm'])
def test_beside_frames(
        start: Start, node: Node, tmp_path: Path, transport: str, overflow: str,
        limits: dict[str, Any]) -> None:
    """Frames are counted, and messages are written, with each kind of reception."""
    publisher = node.create_publisher(JointState, '/joints', 100)
    subscriber = start('img_subscriber', **{
        'output_dir': tmp_path, 'file_name': BAG, 'topics': '/joints', 'transport': transport,
        'on_overflow': overflow, **limits})
    camera = start('img_publisher', source='pattern:64x48@50', publish_rate=50.0)
    spin_until(node, lambda: publisher.get_subscription_count()
               and 'Receiving video frame' in subscriber.output)
    for number in range(100):
        publisher.publish(JointState(position=[float(number)]))
        pause(0.005)
    publisher.wait_for_all_acked()
    for process in (camera, subscriber):
        process.interrupt()
        assert process.finish() == 0, process.output
    found = re.search(r'/joints: (\d+) messages received, (\d+) written(?:, (\d+) dropped)?, '
                      r'(\d+) lost in transit$', subscriber.output, re.MULTILINE)
    assert found, subscriber.output
    received, written, not_written, lost = (int(count or 0) for count in found.groups())
    assert received == written + not_written
    decoded = [one for path in sorted(tmp_path.glob('*.mcap')) for one in decode(path)]
    numbers = [one.position[0] for one in decoded if hasattr(one, 'position')]
    assert len(numbers) == written == len({*numbers})
    assert received + lost == 100
    assert written == 100 or (overflow == 'drop' and 'messages of topics dropped' in
                              subscriber.output)
    summary = re.search(r'Received (\d+) frames .* (\d+) written to .* (\d+) dropped, 0 failed, '
                        r'\d+ lost in transit(?:, \d+ sent before [^,]*)?(, (\d+) skipped)?',
                        subscriber.output)
    assert summary, subscriber.output
    frames, kept, dropped, skipped = (int(summary[part] or 0) for part in (1, 2, 3, 5))
    assert frames == kept + dropped + skipped
    assert kept == sum(hasattr(one, 'encoding') for one in decoded)
    account = account_of(sorted(tmp_path.glob('*.mcap')))
    assert [account['/joints'][name] for name in ('written', 'dropped', 'lost in transit')] == [
        written, not_written, lost]
    assert [account['/video_frames'][name] for name in ('written', 'dropped', 'skipped')] == [
        kept, dropped, skipped]


@pytest.mark.parametrize('topics', ['/*', '/camera_info', '/cam*'])
@pytest.mark.parametrize('transport', ['auto', 'compressed'])
def test_camera_info_is_recorded_once(
        start: Start, tmp_path: Path, topics: str, transport: str) -> None:
    recorder = start('img_subscriber', output_dir=tmp_path, file_name=BAG, topics=topics,
                     transport=transport)
    recorder.wait_for('Waiting for')
    publisher = start('img_publisher', source='pattern:64x48@30', publish_rate=0, max_frames=40,
                      wait_for_subscribers=1)
    assert publisher.finish() == 0, publisher.output
    recorder.interrupt()
    assert recorder.finish() == 0, recorder.output
    stored = [found.data for found in read_by_all(tmp_path / BAG) if found.topic == '/camera_info']
    assert len(stored) == len({*stored}) > 20


@pytest.mark.parametrize('form', ['compressed', 'compressedDepth', 'ffmpeg'])
def test_forms_of_the_images_are_not_recorded_beside_them(
        start: Start, tmp_path: Path, form: str) -> None:
    recorder = start('img_subscriber', output_dir=tmp_path, file_name=BAG, max_frames=3,
                     topics=f'[/joint_states, /video_frames/{form}]')
    publisher = start('img_publisher', source='pattern:depth', encoding="''")
    assert recorder.finish() == 0, recorder.output
    assert f'/video_frames/{form} is not recorded beside /video_frames, because' in recorder.output
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output
    assert {found.topic for found in read_by_all(tmp_path / BAG)} == {
        '/video_frames', '/camera_info'}


@pytest.mark.parametrize('topics', ['/*', '[/video_frames, /joints]'])
def test_topic_that_the_recorder_remaps_is_not_recorded(
        start: Start, tmp_path: Path, topics: str) -> None:
    publisher = start('img_publisher', source='pattern:64x48')
    publisher.wait_for('opened')
    recorder = start('img_subscriber', '--ros-args', '-r', 'video_frames:=/nothing',
                     output_dir=tmp_path, file_name=BAG, topics=topics)
    recorder.wait_for('/video_frames is not recorded: ')
    recorder.interrupt()
    recorder.finish()
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output
    assert recorder.output.count(
        '/video_frames is not recorded: a remapping of this node replaces its name by /nothing'
    ) == 1, recorder.output


def test_publishers_that_change(start: Start, node: Node, tmp_path: Path) -> None:
    """A publisher that offers less is recorded too, and each is counted."""
    first = node.create_publisher(JointState, '/joints', 100)
    subscriber = start('img_subscriber', output_dir=tmp_path, file_name=BAG, topics='/joints')
    spin_until(node, first.get_subscription_count)
    first.publish(JointState(position=[1.0]))
    spin_until(node, first.wait_for_all_acked)
    second = node.create_publisher(JointState, '/joints', qos_profile_sensor_data)
    spin_until(node, lambda: second.get_subscription_count() and first.get_subscription_count())
    path = tmp_path / BAG

    def has_both() -> bool:
        for number, publisher in enumerate((first, second), 1):
            publisher.publish(JointState(position=[float(number)]))
        return path.exists() and struct.pack('<d', 2.0) in path.read_bytes()

    spin_until(node, has_both)
    subscriber.interrupt()
    assert subscriber.finish() == 0, subscriber.output
    assert {message.position[0] for message in decode(path)} == {1.0, 2.0}
    assert subscriber.output.count('Recording /joints (') == 1


@pytest.fixture
def mute(node: Node) -> Any:
    """Create a node that describes no types, with a publisher of a type that is not installed."""
    found = rclpy.create_node('mute', context=node.context, parameter_overrides=[
        Parameter('start_type_description_service', value=False)])
    found.create_publisher(message_type(GRIPPER, GRIPPER_TEXT), '/gripper', 10)
    yield found
    found.destroy_node()


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(('texts', 'said'), [
    ({}, 'is not installed, and /mute does not know its text'),
    ({GRIPPER: 'string name\n'}, f'the definition of {GRIPPER} of /mute is not that of its'),
    ({GRIPPER: 'Part[] parts\n'}, 'the definition of my_robot_msgs/msg/Part is not known'),
    ({GRIPPER: '#' * 300_000}, f'of {GRIPPER} of /mute has 300000 characters; at most 262144'),
])
def test_type_that_is_not_sent(
        start: Start, node: Node, mute: Node, tmp_path: Path, texts: dict[str, str],
        said: str) -> None:
    def answer(
        _request: GetTypeDescription.Request, response: GetTypeDescription.Response,
    ) -> GetTypeDescription.Response:
        response.successful = True
        response.type_sources = [
            TypeSource(type_name=name, encoding='msg', raw_file_contents=text)
            for name, text in texts.items()]
        return response

    mute.create_service(GetTypeDescription, '~/get_type_description', answer)
    subscriber = start('img_subscriber', output_dir=tmp_path, file_name=BAG, topics='/gripper')
    spin_until(mute, lambda: '/gripper is not recorded: ' in subscriber.output)
    assert said in subscriber.output
    subscriber.interrupt()
    assert subscriber.finish() == 0, subscriber.output
    assert subscriber.output.count('is not recorded') == 1
    assert 'No topic was recorded beside the images: no other one matches /gripper' in (
        subscriber.output)


@pytest.mark.parametrize(('name', 'options', 'said'), [
    ('img_subscriber', {'topics': '/tf'}, 'parameter topics is /tf: only a bag has topics; set '
     'file_name to a name with the extension .mcap'),
    ('img_subscriber', {'topics': 'tf', 'file_name': BAG}, "parameter topics is 'tf': tf is no "
     'name of a topic; give names such as /tf and /camera/*'),
    ('img_publisher', {'topics': '/tf', 'source': 'pattern'}, "parameter topics is '/tf', but the "
     'source pattern is not a bag'),
])
def test_topics_without_effect(
        start: Start, tmp_path: Path, name: str, options: dict[str, Any], said: str) -> None:
    if name == 'img_subscriber':
        options = {**options, 'output_dir': tmp_path / 'out'}
    process = start(name, **options)
    assert process.finish() == 2
    assert said in process.output


TALKER = """
import json, sys, time
import rclpy
from sensor_msgs.msg import JointState

rclpy.init()
node = rclpy.create_node('talker')
publishers = {f'/joints_{number}': node.create_publisher(JointState, f'/joints_{number}', 100)
              for number in range(int(sys.argv[1]))}
counts = dict.fromkeys(publishers, 0)
while not all(publisher.get_subscription_count() for publisher in publishers.values()):
    rclpy.spin_once(node, timeout_sec=0.05)
end, due = time.monotonic() + float(sys.argv[2]), time.monotonic()
while time.monotonic() < end:
    for topic, publisher in publishers.items():
        publisher.publish(JointState(name=['elbow'], position=[float(counts[topic])]))
        counts[topic] += 1
    due += 0.01
    time.sleep(max(0, due - time.monotonic()))
for publisher in publishers.values():
    publisher.wait_for_all_acked()
for topic, publisher in publishers.items():
    publisher.publish(JointState())  # so that losses before it are counted
    counts[topic] += 1
for publisher in publishers.values():
    publisher.wait_for_all_acked()
print(json.dumps(counts), flush=True)
rclpy.spin_once(node, timeout_sec=1)
"""


@pytest.mark.thorough
def test_account_of_many_topics(
        start: Start, tmp_path: Path, tell: Callable[[str], None]) -> None:
    """Set TOPICS_SIZE and TOPICS_SECONDS for more than a small camera for a few seconds."""
    program = tmp_path / 'talker.py'
    program.write_text(TALKER)
    subscriber = start('img_subscriber', output_dir=tmp_path / 'out', file_name=BAG,
                       topics='/joints_*', every_n=30)
    size, seconds = (os.environ.get(f'TOPICS_{name}', default)
                     for name, default in (('SIZE', '320x240'), ('SECONDS', '5')))
    camera = start('img_publisher', source=f'pattern:{size}@30', publish_rate=30.0)
    subscriber.wait_for('Receiving video frame')
    talker = start(str(program), '20', seconds)
    assert talker.finish() == 0, talker.output
    for process in (camera, subscriber):
        process.interrupt()
        assert process.finish() == 0, process.output
    published = json.loads(talker.output.splitlines()[-1])
    found = re.findall(r'(/joints_\d+): (\d+) messages received, (\d+) written, (\d+) lost in '
                       'transit$', subscriber.output, re.MULTILINE)
    assert len(found) == len(published) == 20
    for topic, received, written, lost in found:
        assert int(received) + int(lost) == published[topic]
        assert int(written) == int(received) > 0
    tell(f'20 topics at 100 Hz beside {size}: {sum(published.values())} messages, '
         f'{sum(int(lost) for *_, lost in found)} lost')
