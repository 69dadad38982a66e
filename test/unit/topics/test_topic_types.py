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

import time

from conftest import executor_of, spin_until
from opencv_tools.message_types.definition import DefinitionError
from opencv_tools.topics import topic_types
from opencv_tools.topics.topic_patterns import check_patterns, matches
from opencv_tools.topics.topic_types import TopicTypes
from opencv_tools.transport.message_type import message_type
import pytest
from rclpy.node import Node

UNKNOWN = 'my_robot_msgs/msg/Door', 'bool is_open\n'


@pytest.mark.process
def test_installed_shipped_and_told_types(node: Node, camera: Node) -> None:
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
    monkeypatch.setattr(topic_types, '_ANSWER_SECONDS', 0.2)
    camera.create_publisher(message_type(*UNKNOWN), '/door', 1)
    types = TopicTypes(node)
    spin_until(node, lambda: any(
        offer.node_name == 'camera' for offer in node.get_publishers_info_by_topic('/door')))
    offer, = node.get_publishers_info_by_topic('/door')
    assert types.find(offer) is None
    time.sleep(0.2)
    with pytest.raises(DefinitionError, match=r'/front/camera has not told it within 0\.2 s; '
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
