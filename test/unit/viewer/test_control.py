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

"""Calls of services that several nodes have, in one process."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

from conftest import executor_of, spin_until
from opencv_tools.viewer.control import CameraControl
from opencv_tools.viewer.errors import RequestError
import pytest
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.node import Node
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import SetBool, Trigger
from waiting import wait_until


@pytest.fixture
def pair(node: Node) -> Iterator[tuple[Node, Node]]:
    """Create two nodes of the root namespace, without services."""
    nodes = tuple(Node(name, context=node.context, start_parameter_services=False)
                  for name in ('left', 'right'))
    yield nodes
    for one in nodes:
        one.destroy_node()


def call(node: Node, others: tuple[Node, ...], service_type: Any, name: str) -> Any:
    """Return the answer of a service, and raise what its call raises."""
    control = CameraControl(node)
    with executor_of(node) as executor:
        for other in others:
            executor.add_node(other)
        calling = executor.create_task(control.call(service_type, name, service_type.Request()))
        wait_until(calling.done, 'the answer', partial(executor.spin_once, timeout_sec=0.05))
        for other in others:
            executor.remove_node(other)
    return calling.result()


@pytest.mark.parametrize('service_type', [SetBool, Trigger, SetParameters, SetCameraInfo])
def test_service_of_two_nodes_is_refused(
        node: Node, pair: tuple[Node, Node], service_type: Any) -> None:
    calls: list[str] = []

    def serve(owner: Node) -> Any:
        return owner.create_service(
            service_type, '/act', lambda _, answer: calls.append(owner.get_name()) or answer)

    left, right = map(serve, pair)
    spin_until(node, lambda: node.count_services('/act') == 2)
    with pytest.raises(RequestError) as caught:
        call(node, pair, service_type, '/act')
    assert str(caught.value).startswith(
        '/act has 2 servers, in the nodes /left, /right: start each with a namespace of its own')
    assert calls == []
    pair[0].destroy_service(left)
    spin_until(node, lambda: node.count_services('/act') == 1)
    call(node, pair, service_type, '/act')
    assert calls == ['right']
    pair[1].destroy_service(right)


def test_two_nodes_of_one_name_are_named_twice(node: Node, pair: tuple[Node, Node]) -> None:
    twin = Node('left', context=node.context, start_parameter_services=False)
    for owner in (pair[0], twin):
        owner.create_service(SetBool, '~/set_capture', lambda _, answer: answer)
    spin_until(node, lambda: node.count_services('/left/set_capture') == 2)
    with pytest.raises(RequestError, match='has 2 servers, in the nodes /left, /left: start'):
        call(node, (*pair, twin), SetBool, '/left/set_capture')
    twin.destroy_node()


def test_reading_does_not_ask_for_one_server(node: Node, pair: tuple[Node, Node]) -> None:
    for owner in pair:
        owner.create_service(GetParameters, '/read', lambda _, answer: answer)
    spin_until(node, lambda: node.count_services('/read') == 2)
    assert list(call(node, pair, GetParameters, '/read').values) == []
    for owner in pair:
        for service in [*owner.services]:
            owner.destroy_service(service)


def test_only_services_of_nodes_are_recorders(node: Node, pair: tuple[Node, Node]) -> None:
    pair[0].create_service(Trigger, '~/save', lambda _, answer: answer)
    for name in ('/save', '/maps/save', '/right/saves/save'):
        pair[1].create_service(Trigger, name, lambda _, answer: answer)
    control = CameraControl(node)
    spin_until(node, lambda: '/right/saves/save' in dict(node.get_service_names_and_types()))
    assert control.nodes([])['recorders'] == ['/left']
