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

"""Lines about simulated time that does not begin, stands still or goes on."""

from __future__ import annotations

from conftest import spin_until
from opencv_tools.nodes.run_node import ClockWatch
import pytest
import rclpy
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

MISSING = 'use_sim_time is set, but nothing publishes /clock: start the simulator'


@pytest.fixture
def simulated(node: Node) -> Node:
    made = Node('simulated', context=node.context,
                parameter_overrides=[rclpy.Parameter('use_sim_time', value=True)])
    yield made
    made.destroy_node()


def test_clock_that_begins_late_and_stops(
        node: Node, simulated: Node, capfd: pytest.CaptureFixture[str]) -> None:
    watch = ClockWatch(simulated, 0.02)
    text = ''

    def has(part: str) -> bool:
        nonlocal text
        text += capfd.readouterr().err
        return part in text

    spin_until(simulated, lambda: has(MISSING), looks=lambda: watch._looks)
    assert watch._looks == 3
    publisher = node.create_publisher(Clock, '/clock', 10)
    clock = Clock()

    def ticks(part: str) -> bool:
        clock.clock.nanosec += 1
        publisher.publish(clock)
        return has(part)

    spin_until(simulated, lambda: ticks('simulated time goes on'),
               looks=lambda: watch._looks)
    spin_until(simulated, lambda: has('use_sim_time is set, but /clock stands still'),
               looks=lambda: watch._looks)
    assert text.count(MISSING) == 1
    node.destroy_publisher(publisher)


def test_node_without_simulated_time(node: Node) -> None:
    timers = [*node.timers]
    ClockWatch(node)
    assert [*node.timers] == timers
