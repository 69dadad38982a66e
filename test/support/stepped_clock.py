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

"""A clock that the test controls: time passes only during waits."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event

from opencv_tools.capture.player import Clock

# Not 0.0, and exact in binary, like all times that the tests add.
BEGAN = 64.0

# Longer than any test waits; a mutant may wait forever.
_LONGEST = 3600.0
_MOST_WAITS = 10_000


class SteppedClock(Clock):
    """A clock whose waits return at once and advance the time by their duration."""

    def __init__(self) -> None:
        """Create a clock without planned actions."""
        self.now = BEGAN
        self.waits: list[float] = []
        self._planned: list[tuple[float, Callable[[], object]]] = []

    def monotonic(self) -> float:
        return self.now

    def wait(self, event: Event, seconds: float) -> bool:
        self.waits.append(seconds)
        assert len(self.waits) < _MOST_WAITS, 'it waits for ever'
        if not event.is_set():
            self.step_to(self.now + seconds, event)
        return event.is_set()

    def plan(self, seconds: float, action: Callable[[], object]) -> None:
        """Plan an action at some seconds from now."""
        self._planned.append((self.now + seconds, action))
        self._planned.sort(key=lambda planned: planned[0])

    def step_to(self, until: float, event: Event | None = None) -> None:
        """Advance the time and run the planned actions, until a time or a set event."""
        while self._planned and self._planned[0][0] <= until:
            when, action = self._planned.pop(0)
            self.now = max(self.now, when)
            action()
            if event is not None and event.is_set():
                return
        self.now = max(self.now, until)
        assert self.now < BEGAN + _LONGEST, 'it waits for ever'
