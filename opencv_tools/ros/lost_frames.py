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

"""Frames that were published and did not arrive, counted for each publisher."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
import time

from opencv_tools.ros.rcl import MessageInfo

# A publisher that is discovered later after the subscription than this is taken for a new one.
_DISCOVERY_SECONDS = 2.0


@dataclass(frozen=True)
class _First:
    """The first message that arrived of a publisher, though others may have gone before it."""

    number: int
    source_timestamp: int
    arrived: float


class LostFrames:
    """
    Count by the numbers that publishers give to their messages.

    A publisher that began after the subscription is counted from its first message, any other one
    from the first that arrived. A publisher began after it when it was discovered later, and would
    not have been able to send all its messages in the time since, at the rate of those that
    arrived first. What follows the last message that arrived is in no number.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """
        Begin to count.

        :param clock: returns seconds that only go on.
        """
        self.count = 0
        self._clock = clock
        self._is_partial = False
        self._last: dict[bytes, int] = {}
        self._first: dict[bytes, _First] = {}
        self._discovered: dict[bytes, float] = {}
        self.begin()

    @property
    def is_complete(self) -> bool:
        """Return whether every publisher is counted from its first message on."""
        return not (self._is_partial or self._first)

    def begin(self) -> None:
        """Note a subscription to a topic that was not subscribed to before."""
        self._began = self._clock()

    def discover(self, publishers: Iterable[bytes]) -> None:
        """Note the publishers that are there."""
        now = self._clock()
        for publisher in publishers:
            self._discovered.setdefault(publisher, now)

    def take(self, info: MessageInfo) -> None:
        """Count what a message's publisher has sent since its last one but did not arrive."""
        if not info.number:
            self._is_partial = True
            return
        publisher = bytes(info.publisher)
        if publisher in self._last:
            self._begin_earlier(publisher, info)
        elif info.number > 1:
            now = self._clock()
            if self._discovered.get(publisher, now) - self._began >= _DISCOVERY_SECONDS:
                self._first[publisher] = _First(info.number, info.source_timestamp, now)
            else:
                self._is_partial = True
        last = self._last.get(publisher, info.number)
        self.count += max(0, info.number - last - 1)
        # What was published before may come later, when it is asked for.
        self._last[publisher] = max(info.number, last)

    def _begin_earlier(self, publisher: bytes, info: MessageInfo) -> None:
        """Count what a new publisher had sent before its first message that arrived."""
        first = self._first.get(publisher)
        if first and info.number > first.number:
            del self._first[publisher]
            period = (info.source_timestamp - first.source_timestamp) / (
                info.number - first.number) / 1e9
            if first.arrived - (first.number - 1) * period >= self._began:
                self.count += first.number - 1
            else:
                self._is_partial = True
