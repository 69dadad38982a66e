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

"""Delays of repeated requests."""

from __future__ import annotations

from functools import partial
import operator

from conftest import spin_until
from opencv_tools.nodes.publisher.delay import Delay
from rclpy.node import Node


def test_one_call_for_repeated_requests(node: Node) -> None:
    calls: list[int] = []
    delay = Delay(node, 0.3, lambda: calls.append(1))
    for expected in ([1], [1, 1]):
        for _ in range(3):
            delay.request()
        assert calls == expected[1:]
        spin_until(node, partial(operator.eq, calls, expected))
    node.create_timer(0.005, delay.request)  # must not postpone the call
    spin_until(node, lambda: len(calls) > 2)
