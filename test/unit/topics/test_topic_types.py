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

from __future__ import annotations


from conftest import executor_of, spin_until
from opencv_tools.message_types.definition import DefinitionError
from opencv_tools.topics import topic_types
from opencv_tools.topics.topic_discovery import UNKNOWN_NODE
from opencv_tools.topics.topic_patterns import check_patterns, matches
from opencv_tools.topics.topic_types import TopicTypes
from opencv_tools.transport.message_type import message_type
import pytest
from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo
from stepped_clock import SteppedClock

UNKNOWN = 'my_robot_msgs/msg/Door', 'bool is_open\n'


def step_clock(monkeypatch: pytest.MonkeyPatch) -> SteppedClock:
    """Let a question end 0.2 s later by the clock that is returned."""
    clock = SteppedClock()
    monkeypatch.setattr(topic_types, 'time', clock)
    monkeypatch.setattr(topic_types, '_ANSWER_SECONDS', 0.2)
    return clock


@pytest.mark.process
def test_installed_shipped_and_sent_types(node: Node, camera: Node) -> None:
    names = {'/joints': 'sensor_msgs/msg/JointState', '/tf': 'tf2_msgs/msg/TFMessage'}
    for topic, name in names.items():
        camera.create_publisher(message_type(name), topic, 1)
    camera.create_publisher(message_type(*UNKNOWN), '/door', 1)
    types = TopicTypes(node)

    def found(topic: str) -> tuple[str, str]:
        offers = node.get_publishers_info_by_topic(topic)
        definition = types.find(offers[0]) if offers else None
        answering.spin_once(0)
        return (definition.name, definition.text) if definition else ('', '')

    with executor_of(camera) as answering:
        spin_until(node, lambda: found('/door') == UNKNOWN)
        spin_until(node, lambda: all(found(topic)[0] == names[topic] for topic in names))
    assert not types._questions


@pytest.mark.process
def test_silent_publisher(
        node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = step_clock(monkeypatch)
    camera.create_publisher(message_type(*UNKNOWN), '/door', 1)
    types = TopicTypes(node)
    spin_until(node, lambda: any(
        offer.node_name == 'camera' for offer in node.get_publishers_info_by_topic('/door')))
    offer, = node.get_publishers_info_by_topic('/door')
    assert types.find(offer) is None
    clock.step_to(clock.now + 0.2)
    with pytest.raises(DefinitionError, match=r'/front/camera has not sent it within 0\.2 s; '
                       'install the package my_robot_msgs'):
        types.find(offer)


def test_patterns() -> None:
    names = ['/tf', '/tf_static', '/camera/left', '/camera/right/info']
    for pattern, count in (('/tf', 1), ('/tf*', 2), ('/camera/*', 2), ('*', 4), ('*/info', 1)):
        assert sum(matches(name, ['/none', pattern]) for name in names) == count, pattern
    check_patterns('/tf *  /camera/*/info')
    for pattern in ('tf', '/a?', '/[ab]', '/é', '/tf,', '~/tf'):
        with pytest.raises(ValueError, match='is no name of a topic'):
            check_patterns(f'/tf {pattern}')


@pytest.mark.process
def test_question_ends_with_its_client(
        node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither an answer, nor its absence, nor the end of the publisher leaves a client."""
    clock = step_clock(monkeypatch)
    types, clients = TopicTypes(node), len([*node.clients])
    first, second = offers(node, camera, '/door', '/lid')
    assert types.find(first) is None
    assert len([*node.clients]) == clients + 1
    clock.step_to(clock.now + 0.2)
    with pytest.raises(DefinitionError, match='has not sent it'):
        types.find(first)
    assert len([*node.clients]) == clients
    assert types.find(first) is None
    monkeypatch.setattr(topic_types, '_FORGOTTEN_SECONDS', 0.0)
    assert types.find(second) is None
    assert [key[0] for key in types._questions] == [second.topic_type]
    assert len([*node.clients]) == clients + 1


@pytest.mark.process
def test_node_that_is_started_again(
        node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another publisher of a type, and a new process of the same node, have their own time."""
    clock = step_clock(monkeypatch)
    types = TopicTypes(node)
    offer, _ = offers(node, camera, '/door', '/lid')
    assert types.find(offer) is None
    clock.step_to(clock.now + 0.2)
    for change in ({'node_name': 'other'}, {'endpoint_gid': 16 * [7]}):
        assert types.find(changed(offer, **change)) is None
    with pytest.raises(DefinitionError, match='has not sent it'):
        types.find(offer)


@pytest.mark.process
def test_node_whose_name_is_discovered_later(
        node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    types, clients = TopicTypes(node), len([*node.clients])
    offer, _ = offers(node, camera, '/door', '/lid')
    assert types.find(changed(offer, node_name=UNKNOWN_NODE)) is None
    assert len([*node.clients]) == clients
    assert types.find(offer) is None
    assert len([*node.clients]) == clients + 1
    assert len(types._questions) == 1


@pytest.mark.process
def test_number_of_questions(
        node: Node, camera: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(topic_types, '_MAX_QUESTIONS', 1)
    types = TopicTypes(node)
    first, second = offers(node, camera, '/door', '/lid')
    assert types.find(first) is types.find(second) is None
    assert len(types._questions) == 1
    types._end(next(iter(types._questions)))
    assert types.find(second) is None
    assert [key[0] for key in types._questions] == [second.topic_type]


@pytest.mark.process
def test_installed_type_of_another_version(node: Node, camera: Node) -> None:
    types = TopicTypes(node)
    offer, _ = offers(node, camera, '/door', '/lid')
    name = 'std_msgs/msg/String'
    assert types.find(changed(offer, topic_type=name)) is None  # it has another hash
    assert [key[0] for key in types._questions] == [name]


def offers(node: Node, camera: Node, *topics: str) -> list[TopicEndpointInfo]:
    """Return a publisher of a type of its own for each topic, whose node does not answer."""
    for number, topic in enumerate(topics):
        camera.create_publisher(
            message_type(f'silent_msgs/msg/A{number}', 'int8 a'), topic, 1)
    spin_until(node, lambda: all(
        offer.node_name == 'camera' for topic in topics
        for offer in node.get_publishers_info_by_topic(topic) or [TopicEndpointInfo()]))
    return [offer for topic in topics for offer in node.get_publishers_info_by_topic(topic)]


def changed(offer: TopicEndpointInfo, **values: object) -> TopicEndpointInfo:
    return TopicEndpointInfo(**{name: values.get(name, getattr(offer, name)) for name in (
        'node_name', 'node_namespace', 'topic_type', 'topic_type_hash', 'endpoint_type',
        'endpoint_gid', 'qos_profile')})
