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

"""Timers of waits, which a clock that is set or simulated must not change."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer


class Delay:
    """Call something once, a time after it was asked for first, however often it was asked."""

    def __init__(self, node: Node, seconds: float, call: Callable[[], object]) -> None:
        """
        Wait to be asked.

        :param node: whose executor calls it.
        :param seconds: from the first time that it is asked for to the call.
        :param call: what is called.
        """
        self._call = call
        self._timer = create_steady_timer(node, seconds, self._ring)
        self._timer.cancel()

    def ask(self) -> None:
        """Have it called, unless it is going to be."""
        if self._timer.is_canceled():
            self._timer.reset()

    def _ring(self) -> None:
        self._timer.cancel()
        self._call()


def create_steady_timer(node: Node, seconds: float, call: Callable[[], object]) -> Timer:
    """
    Have something called again and again.

    :param node: whose executor calls it.
    :param seconds: from one call to the next, by a clock that only goes on.
    :param call: what is called.
    :returns: the timer.
    """
    return node.create_timer(seconds, call, clock=Clock(clock_type=ClockType.STEADY_TIME))
