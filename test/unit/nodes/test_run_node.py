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

"""The executor of the nodes: one wait set for each callback, and wake-ups by other threads."""

from __future__ import annotations

from threading import Thread, Timer

from opencv_tools.nodes.run_node import _Executor
from opencv_tools.topics.message_reader import WakeUps
from rclpy.node import Node


def test_wait_set_is_built_once_for_each_callback(node: Node) -> None:
    executor = _Executor(node.context)
    executor.add_node(node)
    built = [0]

    class Counted(WakeUps):
        """Wake-ups that count the wait sets."""

        def add_to_wait_set(self, wait_set: object) -> None:
            built[0] += 1
            super().add_to_wait_set(wait_set)

    calls: list[object] = []
    wake_ups = Counted(node, lambda *_: calls.append(None), lambda: False)
    wake_ups.start()
    executor.spin_once(timeout_sec=0.0)
    before = built[0]
    for _ in range(10):
        Timer(0.02, wake_ups.wake).start()
        executor.spin_once()
    assert (len(calls), built[0] - before) == (10, 10)
    wake_ups.destroy()
    executor.remove_node(node)
    executor.shutdown()


def test_task_of_another_thread_ends_the_wait(node: Node) -> None:
    executor = _Executor(node.context)
    executor.add_node(node)
    executor.spin_once(timeout_sec=0.0)
    other = Thread(target=lambda: executor.create_task(bool))
    other.start()
    executor.spin_once()
    other.join()
    executor.remove_node(node)
    executor.shutdown()
