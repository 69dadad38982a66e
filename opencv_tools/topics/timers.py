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

"""Timers on the monotonic clock, independent of simulated time and clock changes."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer


def create_steady_timer(
    node: Node, seconds: float, call: Callable[[], object], group: CallbackGroup | None = None, *,
    is_active: bool = True,
) -> Timer:
    """
    Create a periodic timer on the monotonic clock.

    :param seconds: period in seconds.
    :param call: function to call.
    :param group: callback group; None for the default one of the node.
    :param is_active: whether it runs; else ``reset`` starts it.
    :returns: the timer.
    """
    return node.create_timer(
        seconds, call, group, clock=Clock(clock_type=ClockType.STEADY_TIME), autostart=is_active)
