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

"""What pages watch: open while somebody uses it, and used in the loop of the server."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Generic, TypeVar

from opencv_tools.topics.rate_meter import RateMeter

#: Time after the last user until a subscription ends, for a reload of the page.
UNUSED_SECONDS = 2.0
#: Part of the time, 1 / 4, that the untrusted messages of a source may take.
LOAD = 4
# Seconds and periods without a message after which a source is silent.
_QUIET_SECONDS, _QUIET_PERIODS = 1.0, 3

_W = TypeVar('_W')


class Watched(Generic[_W]):
    """
    A source that ends some seconds after its last user.

    All methods run in the loop of the server.
    """

    #: Time between the last user and the end.
    unused_seconds = UNUSED_SECONDS

    def __init__(self) -> None:
        #: Users that want to know about changes: functions, or pages.
        self.watchers: set[_W] = set()
        #: Number of users.
        self.users = 0
        #: Called when there was no user for ``unused_seconds``.
        self.on_unused: Callable[[], object] = lambda: None
        self._end: asyncio.TimerHandle | None = None

    def acquire(self) -> None:
        """Keep the source open until ``release``."""
        self.users += 1
        if self._end:
            self._end.cancel()

    def release(self) -> None:
        """End a use."""
        self.users -= 1
        if not self.users:
            self._end = asyncio.get_running_loop().call_later(
                self.unused_seconds, self.on_unused)

    def join(self, watcher: _W) -> None:
        """Add a watcher, which uses the source."""
        self.watchers.add(watcher)
        self.acquire()

    def leave(self, watcher: _W) -> None:
        """Remove a watcher, and end its use; nothing happens if it has left before."""
        if watcher in self.watchers:
            self.watchers.remove(watcher)
            self.release()


def in_loop(call: Callable[..., object]) -> Callable[..., None]:
    """Return a function for the executor that has the running loop call another one."""
    loop = asyncio.get_running_loop()

    def schedule(*args: object) -> None:
        with suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(call, *args)

    return schedule


def quiet_limit(meter: RateMeter) -> float:
    """Return the time without a message after which a source is silent, in seconds."""
    return max(_QUIET_SECONDS, _QUIET_PERIODS * meter.period)
