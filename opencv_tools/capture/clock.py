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

"""The clock that paces sources; tests replace it by their own."""

from __future__ import annotations

from threading import Event
import time


class Clock:
    """The monotonic clock of the machine, and waits that time out by this clock."""

    def monotonic(self) -> float:
        """Return the seconds of CLOCK_MONOTONIC."""
        return time.monotonic()

    def wait(self, event: Event, seconds: float) -> bool:
        """
        Wait until an event is set or the timeout has passed.

        :param event: event that ends the wait.
        :param seconds: timeout in seconds.
        :returns: whether the event is set.
        """
        return event.wait(seconds)


#: The default clock of all classes of this package.
SYSTEM_CLOCK = Clock()
