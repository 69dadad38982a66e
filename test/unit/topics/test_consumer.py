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

"""The consumer of frames in the executor of the nodes, and in one of rclpy."""

from __future__ import annotations

from collections.abc import Iterator

from opencv_tools.topics.consumer import Consumer
from opencv_tools.topics.executor import FrameExecutor
from opencv_tools.topics.order import Position
from opencv_tools.topics.queue import FrameQueue
import pytest
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from test_queue import frame, PUBLISHER


@pytest.fixture(params=[FrameExecutor, SingleThreadedExecutor])
def executor(node: Node, request: pytest.FixtureRequest) -> Iterator[Executor]:
    """Return an executor with the node."""
    created = request.param(context=node.context)
    created.add_node(node)
    yield created
    created.remove_node(node)
    created.shutdown()


@pytest.mark.parametrize('count', [1, 3, 40])
def test_frames_that_the_executor_knows_of_are_not_pending(
    executor: Executor, node: Node, count: int,
) -> None:
    queue = FrameQueue(100)
    passed: list[int] = []
    woken: list[bool] = []
    consumer = Consumer(
        node, queue, lambda received: passed.append(received.number), lambda err: None,
        lambda: woken.append(queue.has_frames))
    assert not consumer.is_pending
    for number in range(1, count + 1):
        queue.put(frame(number), PUBLISHER, Position(number))
        assert consumer.is_pending == (number == 1 or not isinstance(executor, FrameExecutor))
        consumer.wake()
    if isinstance(executor, FrameExecutor):
        assert not (consumer.is_pending or woken)
        for number in range(1, count + 1):
            executor.spin_once()
            assert len(passed) == number
    else:
        assert consumer.is_pending
        assert len(woken) == count
        while waiting := consumer.next_in_executor():
            consumer.pass_on(waiting)
    assert passed == [*range(1, count + 1)]
    assert not consumer.is_pending
