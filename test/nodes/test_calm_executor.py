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

"""The executor of the nodes: one wait for each callback, and no wake-up that is missed."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Semaphore, Thread
import time
from typing import Any

from opencv_tools.nodes.run_node import CalmExecutor
import pytest
import rclpy
from rclpy.context import Context
from rclpy.guard_condition import GuardCondition
from rclpy.node import Node
from waiting import LONGEST_SECONDS


@pytest.fixture
def node(domain: int) -> Iterator[Node]:
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = Node('calm', context=context, enable_rosout=False, start_parameter_services=False)
    yield node
    node.destroy_node()
    context.shutdown()


class _CountedExecutor(CalmExecutor):

    waits = 0

    def can_execute(self, entity: Any) -> bool:
        self.waits += isinstance(entity, GuardCondition)
        return bool(super().can_execute(entity))


@pytest.mark.parametrize('calls', (1, 5, 23, 60))
def test_waits_for_each_callback(node: Node, calls: int) -> None:
    is_called = Semaphore()
    guard = node.create_guard_condition(is_called.release)
    executor = _CountedExecutor(context=node.context)
    executor.add_node(node)
    executor.spin_once(timeout_sec=0)  # for the node that was added

    def trigger() -> None:
        for _ in range(calls):
            is_called.acquire(timeout=LONGEST_SECONDS)
            time.sleep(0.01)  # the executor waits again
            guard.trigger()

    executor.waits = 0
    thread = Thread(target=trigger)
    thread.start()
    for _ in range(calls):
        executor.spin_once(timeout_sec=LONGEST_SECONDS)
    thread.join()
    assert executor.waits == calls
    executor.shutdown()


@pytest.mark.parametrize('is_other_thread', (False, True))
def test_task_ends_the_wait(node: Node, is_other_thread: bool) -> None:
    executor = CalmExecutor(context=node.context)
    executor.add_node(node)
    executor.spin_once(timeout_sec=0)
    done = []

    def create() -> None:
        executor.create_task(lambda: done.append(0))

    if is_other_thread:
        thread = Thread(target=create)
        thread.start()
    else:
        create()
    executor.spin_once(timeout_sec=LONGEST_SECONDS)
    assert done == [0]
    executor.shutdown()


def test_entity_of_a_callback_is_waited_for(node: Node) -> None:
    """A callback that creates a timer does not wake the executor, which waits for it anyway."""
    done = []
    guard = node.create_guard_condition(lambda: node.create_timer(0.01, lambda: done.append(0)))
    executor = CalmExecutor(context=node.context)
    executor.add_node(node)
    guard.trigger()
    while not done:
        executor.spin_once(timeout_sec=LONGEST_SECONDS)
    executor.shutdown()
