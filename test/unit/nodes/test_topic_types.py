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

from collections.abc import Callable, Iterator
import errno

from conftest import executor_of, spin_until
from opencv_tools.message_types.definition import DefinitionError
from opencv_tools.nodes.subscriber import topic_types
from opencv_tools.nodes.subscriber.topic_types import TopicTypes
from opencv_tools.nodes.topic_patterns import check_patterns, matches
from opencv_tools.topics.topic_discovery import UNKNOWN_NODE
from opencv_tools.transport.message_type import message_type
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.topic_endpoint_info import TopicEndpointInfo
from type_description_interfaces.msg import Field, TypeSource
from type_description_interfaces.srv import GetTypeDescription
from waiting import LONGEST_SECONDS

UNKNOWN = 'my_robot_msgs/msg/Door', 'bool is_open\n'


@pytest.fixture
def types() -> Iterator[TopicTypes]:
    found = TopicTypes()
    yield found
    found.close()


@pytest.mark.process
def test_installed_shipped_and_sent_types(node: Node, camera: Node, types: TopicTypes) -> None:
    names = {'/joints': 'sensor_msgs/msg/JointState', '/tf': 'tf2_msgs/msg/TFMessage'}
    for topic, name in names.items():
        camera.create_publisher(message_type(name), topic, 1)
    camera.create_publisher(message_type(*UNKNOWN), '/door', 1)

    def found(topic: str) -> tuple[str, str]:
        offers = node.get_publishers_info_by_topic(topic)
        definition = types.find(offers[0]) if offers else None
        answering.spin_once(0)
        return (definition.name, definition.text) if definition else ('', '')

    with executor_of(camera) as answering:
        spin_until(node, lambda: found('/door') == UNKNOWN)
        spin_until(node, lambda: all(found(topic)[0] == names[topic] for topic in names))
    assert not types._questions
    assert found('/door') == UNKNOWN  # without a question
    assert not (types._questions or types._inquiries)


def test_patterns() -> None:
    names = ['/tf', '/tf_static', '/camera/left', '/camera/right/info']
    for pattern, count in (('/tf', 1), ('/tf*', 2), ('/camera/*', 2), ('*', 4), ('*/info', 1)):
        assert sum(matches(name, ['/none', pattern]) for name in names) == count, pattern
    check_patterns('/tf *  /camera/*/info /a__b /*1')
    for pattern in ('tf', '/a?', '/[ab]', '/é', '/tf,', '~/tf', '/', '/a/', '*/', '//a', '/a//b',
                    '/1a', '/a/2*'):
        with pytest.raises(ValueError, match='is no name of a topic'):
            check_patterns(f'/tf {pattern}')


@pytest.mark.process
def test_silent_publishers(
        node: Node, camera: Node, types: TopicTypes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each publisher has its own time, and neither an answer nor its absence leaves a process."""
    monkeypatch.setattr(topic_types, '_ANSWER_SECONDS', 0.5)
    monkeypatch.setattr(topic_types, '_END_SECONDS', LONGEST_SECONDS)  # of a busy machine
    first, second = offers(node, camera, '/door', '/lid')
    other = changed(first, node_name='other')  # of the same process
    for offer in (first, second, other):
        assert types.find(offer) is None
    assert len(types._inquiries) == 2
    for offer, name in ((first, '/front/camera'), (other, '/front/other')):
        assert said(node, types, offer) == (
            f'the definition of {offer.topic_type} is not installed, and {name} has not sent it '
            'within 0.5 s; install the package silent_msgs')
    assert types.find(changed(first, endpoint_gid=16 * [7])) is None  # was started again
    assert 'has not sent it' in said(node, types, second)
    monkeypatch.setattr(topic_types, '_FORGOTTEN_SECONDS', 0.0)
    assert types.find(first) is None  # it is asked again, and all others are forgotten
    assert [(question[0], owner[0]) for question, owner in types._questions] == [
        (first.topic_type, '/front/camera')]
    assert len(types._inquiries) == 1


@pytest.mark.process
def test_node_whose_name_is_discovered_later(
        node: Node, camera: Node, types: TopicTypes) -> None:
    offer, _ = offers(node, camera, '/door', '/lid')
    assert types.find(changed(offer, node_name=UNKNOWN_NODE)) is None
    assert not types._inquiries
    assert types.find(offer) is None
    assert len(types._inquiries) == len(types._questions) == 1


@pytest.mark.process
def test_node_whose_name_is_never_discovered(
        node: Node, camera: Node, types: TopicTypes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(topic_types, '_ANSWER_SECONDS', 0.1)
    offer, _ = offers(node, camera, '/door', '/lid')
    assert 'and its node has not sent it within 0.1 s' in said(
        node, types, changed(offer, node_name=UNKNOWN_NODE))


@pytest.mark.process
def test_number_of_questions_and_processes(
        node: Node, camera: Node, types: TopicTypes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(topic_types, '_MAX_QUESTIONS', 3)
    first, second = offers(node, camera, '/door', '/lid')
    for name in ('a', 'b', 'c', 'd'):
        assert types.find(changed(first, node_name=name)) is None
    assert len(types._questions) == 3
    assert len(types._inquiries) == 2
    monkeypatch.setattr(topic_types, '_FORGOTTEN_SECONDS', 0.0)
    assert types.find(second) is None
    assert [question[0] for question, _ in types._questions] == [second.topic_type]
    assert [name for name, _ in types._inquiries] == ['/front/camera']


@pytest.mark.process
def test_process_that_cannot_be_started(
        node: Node, camera: Node, types: TopicTypes, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise BlockingIOError(errno.EAGAIN, 'Resource temporarily unavailable')

    offer, _ = offers(node, camera, '/door', '/lid')
    with monkeypatch.context() as patch:
        patch.setattr(topic_types, 'Popen', refuse)
        with pytest.raises(DefinitionError, match=r'/front/camera cannot be asked for it: '
                           r'Resource temporarily unavailable$'):
            types.find(offer)
    assert not (types._questions or types._inquiries)
    assert types.find(offer) is None


@pytest.mark.process
def test_installed_type_of_another_version(node: Node, camera: Node, types: TopicTypes) -> None:
    offer, _ = offers(node, camera, '/door', '/lid')
    name = 'std_msgs/msg/String'
    assert types.find(changed(offer, topic_type=name)) is None  # it has another hash
    assert [question[0] for question, _ in types._questions] == [name]


@pytest.mark.process
# A server that has not discovered its client drops the answer; the client asks again.
@pytest.mark.filterwarnings('ignore:failed to send response')
@pytest.mark.parametrize(('memory', 'fields', 'text', 'reason'), [
    (1_500_000_000, 20_000, 'bool is_open\n', 'is not that of its messages'),
    (1_500_000_000, 0, '#' * 300_000, 'has 300000 characters; at most 262144 are read'),
    (100_000_000, 0, '', 'the process that asked it ended with status'),
])
def test_answer_that_is_too_large(
        node: Node, camera: Node, types: TopicTypes, monkeypatch: pytest.MonkeyPatch, memory: int,
        fields: int, text: str, reason: str) -> None:
    """An answer costs nothing in the process that records."""
    monkeypatch.setattr(topic_types, '_MEMORY', memory)
    asked: list[str] = []

    def answer(
        request: GetTypeDescription.Request, response: GetTypeDescription.Response,
    ) -> GetTypeDescription.Response:
        asked.append(request.type_name)
        response.successful = True
        response.type_description.type_description.fields = fields * [Field(name='field')]
        response.type_sources = [TypeSource(
            type_name=request.type_name, encoding='msg', raw_file_contents=text)]
        return response

    liar = Node('liar', context=camera.context, parameter_overrides=[
        Parameter('start_type_description_service', value=False)])
    liar.create_service(GetTypeDescription, '~/get_type_description', answer)
    offer, second = (changed(found, node_name='liar', node_namespace='/')
                     for found in offers(node, camera, '/door', '/lid'))
    with executor_of(liar) as answering:
        assert reason in said(node, types, offer, lambda: answering.spin_once(0))
        if not asked:
            assert reason in said(node, types, second)  # it is not asked again
            assert not types._inquiries
    liar.destroy_node()


def said(node: Node, types: TopicTypes, offer: TopicEndpointInfo,
         answer: Callable[[], object] = bool) -> str:
    """Return the sentence with which a question ends, while somebody answers."""
    sentences: list[str] = []

    def has_ended() -> bool:
        answer()
        try:
            assert types.find(offer) is None
        except DefinitionError as err:
            sentences.append(str(err))
        return bool(sentences)

    spin_until(node, has_ended)
    return sentences[0]


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
