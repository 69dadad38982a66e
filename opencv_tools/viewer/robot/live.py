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

"""The live robot of the server: the positions of its joints, and the pages."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, Protocol

from opencv_tools.topics.rate_meter import RateMeter
from opencv_tools.viewer.errors import RequestError
from opencv_tools.viewer.executor_calls import ExecutorCalls
from opencv_tools.viewer.hub import Hub
from opencv_tools.viewer.robot.descriptions import Descriptions
from opencv_tools.viewer.robot.positions import Positions
from opencv_tools.viewer.robot.topics import (
    DESCRIPTION, Inbox, missing_publishers, MOTION, RobotTopics, STATES, TRANSFORMS)
from opencv_tools.viewer.stream import UNUSED_SECONDS

_PERIOD = 1 / 30  # between two looks at the messages in seconds
_LOAD = 4  # part of the time, 1 / 4, that untrusted messages may take
_STATE_SECONDS = 1.0
_QUIET_SECONDS, _QUIET_PERIODS = 1.0, 3


class RobotPage(Protocol):
    """A page that shows the robot."""

    def show(self, state: dict[str, Any]) -> None:
        """Send the state; a later one replaces it."""

    def move(self, positions: dict[int, list[float]]) -> None:
        """Send positions of joints; later ones replace those of the same joint."""


class LiveRobots:
    """
    Subscribe while pages look, and read what arrives.

    All methods run in the loop of the server.
    """

    def __init__(self, hub: Hub, topics: RobotTopics, calls: ExecutorCalls) -> None:
        """
        Create an object without a robot.

        :param topics: topics of the robot, used in the executor.
        :param calls: calls in the executor.
        """
        self._hub = hub
        self._topics = topics
        self._calls = calls
        self._loop = asyncio.get_running_loop()
        self.descriptions = Descriptions(self._show)
        self.positions = Positions()
        self._pages: set[RobotPage] = set()
        self._inbox: Inbox | None = None
        self._meter = RateMeter()
        self._polling: asyncio.Task[None] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._closing: asyncio.TimerHandle | None = None
        self._due = 0.0

    def close(self) -> None:
        """End all work."""
        self.descriptions.close()
        if self._polling:
            self._polling.cancel()

    def join(self, page: RobotPage) -> None:
        """Send the robot to a page from now on."""
        self._pages.add(page)
        page.show(self._state())
        if self._inbox is None:
            self._meter = RateMeter()
            self._inbox = Inbox(partial(self._in_loop, self._arrived))
            self._open(self._inbox, DESCRIPTION, *(MOTION if self.descriptions.robot else ()))
        if self._polling is None:
            self._polling = asyncio.ensure_future(self._poll())

    def leave(self, page: RobotPage) -> None:
        """Send nothing to a page any more; unsubscribe two seconds after the last one."""
        self._pages.discard(page)
        if not self._pages and self._inbox:
            if self._closing:
                self._closing.cancel()
            self._closing = self._loop.call_later(UNUSED_SECONDS, self._close_unused)

    def _close_unused(self) -> None:
        if not self._pages and self._inbox:
            self._inbox = None
            self._calls.call(self._topics.close)

    def _open(self, inbox: Inbox, *topics: str) -> None:
        self._calls.call(partial(self._topics.open, inbox, topics), lambda outcome: (
            self._in_loop(self.descriptions.refuse, str(outcome)) if outcome else None))

    def _in_loop(self, call: Callable[..., object], *args: object) -> None:
        """Call a function in the loop, from the executor."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(call, *args)

    def _arrived(self) -> None:
        if self._timer is None:
            wait = max(0.0, self._due - self._loop.time())
            self._timer = self._loop.call_later(wait, self._look)

    def _look(self) -> None:
        """Use the messages that have arrived."""
        self._timer, inbox, begin = None, self._inbox, self._loop.time()
        if inbox is None:
            return
        inbox.begin()
        changed: dict[int, list[float]] = {}
        for kind, read in ((STATES, self.positions.read_states),
                           (TRANSFORMS, self.positions.read_transforms)):
            for message in inbox.take(kind):
                before = self.positions.used
                changed |= read(message)
                if self.positions.used > before:
                    self._meter.add()
        if changed:
            for page in self._pages:
                page.move(changed)
        self.descriptions.read(inbox, self._hub.state.robot.topics[0])
        self._due = begin + max(_PERIOD, _LOAD * (self._loop.time() - begin))

    def _show(self, is_new: bool = False) -> None:
        """Show the state, after a change of the robot as well."""
        if is_new and self.descriptions.robot:
            self.positions = Positions(self.descriptions.robot.joints)
            if self._inbox:
                self._open(self._inbox, *MOTION)
        for page in self._pages:
            page.show(self._state())

    async def _poll(self) -> None:
        """Send the state once a second, while there are pages."""
        while self._pages:
            with suppress(RequestError):
                await self._hub.refresh()
            self._show()
            await asyncio.sleep(_STATE_SECONDS)
        self._polling = None

    def _state(self) -> dict[str, Any]:
        quiet = self._meter.silent_seconds
        is_late = quiet is None or quiet > max(
            _QUIET_SECONDS, _QUIET_PERIODS * self._meter.period)
        version, error = self.descriptions.version, self.descriptions.error
        state = self._hub.state.robot
        is_reading = self.descriptions.is_reading
        notes = missing_publishers(state, bool(version or error or is_reading), quiet is not None)
        if is_reading:
            notes.append('A new description is being read.')
        if self.positions.problem:
            notes.append(f'{state.topics[1]}: {self.positions.problem}.')
        return {'version': version, 'error': error, 'late': is_late, 'age': quiet,
                'rate': round(self._meter.rate, 1),
                'notes': notes + (self._inbox.refusals() if self._inbox else [])}
