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

"""Events of a publisher or a subscription that another thread destroys."""

from __future__ import annotations

from collections.abc import Callable

from opencv_tools.topics.events import destroyable
from opencv_tools.topics.qos import create_frame_publisher
import pytest
from rclpy.event_handler import EventHandler
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Image


def _publish(node: Node) -> tuple[list[EventHandler], Callable[[], object]]:
    publisher = create_frame_publisher(node, Image, 'images')
    return publisher.event_handlers, lambda: node.destroy_publisher(publisher)


def _subscribe(node: Node) -> tuple[list[EventHandler], Callable[[], object]]:
    subscription = destroyable(node.create_subscription(Image, 'images', print, 10))
    return subscription.event_handlers, lambda: node.destroy_subscription(subscription)


@pytest.mark.parametrize('create', [_publish, _subscribe])
def test_destruction_between_two_steps_of_an_executor(
        node: Node, create: Callable[[Node], tuple[list[EventHandler], Callable[[], object]]],
) -> None:
    events, destroy = create(node)
    found: list[object] = []

    class Executor(SingleThreadedExecutor):

        def can_execute(self, entity: object) -> bool:
            if entity in events and not found:
                found.append(entity)
                destroy()  # as another thread would, after this waitable was found
            return bool(super().can_execute(entity))

    executor = Executor(context=node.context)
    executor.add_node(node)
    executor.spin_once(timeout_sec=0.0)
    executor.spin_once(timeout_sec=0.0)
    executor.shutdown()
    assert found == events[:1]
    assert [event.take_data() for event in events] == [None] * len(events)
