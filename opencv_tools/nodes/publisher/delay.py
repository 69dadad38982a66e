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

"""A delayed call for several requests."""

from __future__ import annotations

from collections.abc import Callable

from opencv_tools.topics.timers import create_steady_timer
from rclpy.node import Node


class Delay:
    """Call a function once, some time after the first of several requests."""

    def __init__(self, node: Node, seconds: float, call: Callable[[], object]) -> None:
        """
        Create an inactive delay.

        :param seconds: time from the first request to the call, in seconds.
        :param call: function to call.
        """
        self._call = call
        self._timer = create_steady_timer(node, seconds, self._fire, is_active=False)

    def request(self) -> None:
        """Request a call, unless one is pending."""
        if self._timer.is_canceled():
            self._timer.reset()

    def _fire(self) -> None:
        self._timer.cancel()
        self._call()
