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

"""Count of frames that were published but did not arrive, by publisher."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
import time

from opencv_tools.ros.zero_copy import MessageInfo

# A publisher that is discovered later than this after the subscription counts as new.
_DISCOVERY_SECONDS = 2.0


@dataclass(frozen=True)
class _FirstMessage:
    """The first message of a publisher that arrived; earlier messages may have been lost."""

    number: int
    source_timestamp: int
    arrived: float


class LostFrames:
    """
    Count lost messages by the sequence numbers of their publishers.

    The messages of a publisher that started after the subscription are counted from number 1.
    Those of other publishers are counted from the first that arrived. Messages lost after the last
    one that arrived are not counted.

    A publisher started after the subscription if it was discovered later, and if the time since
    the subscription is too short for all its messages at the rate of the first ones.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """
        Create a counter.

        :param clock: monotonic clock in seconds.
        """
        self.count = 0
        self._clock = clock
        self._is_partial = False
        self._unnumbered = 0
        self._last: dict[bytes, int] = {}
        self._first: dict[bytes, _FirstMessage] = {}
        self._discovered: dict[bytes, float] = {}
        self.restart()

    @property
    def is_complete(self) -> bool:
        """Return whether the messages of every publisher are counted from number 1."""
        return not (self._is_partial or self._first)

    def restart(self) -> None:
        """Record the start of a subscription to another topic."""
        self._restarted_at = self._clock()

    def discover(self, publishers: Iterable[bytes]) -> None:
        """Record the discovery of publishers."""
        now = self._clock()
        for publisher in publishers:
            self._discovered.setdefault(publisher, now)

    def resume(self, publisher: bytes, number: int) -> None:
        """Count from the message after a number; those before it arrived in another way."""
        self._last[publisher] = number

    def add(self, info: MessageInfo) -> None:
        """Count the messages that were lost between this message and its predecessor."""
        number = info.number
        if not number:
            self._is_partial = True
            return
        publisher = bytes(info.publisher)
        if publisher in self._last:
            self._count_earlier(publisher, number, info.source_timestamp)
        elif number > 1:
            now = self._clock()
            if self._discovered.get(publisher, now) - self._restarted_at >= _DISCOVERY_SECONDS:
                self._first[publisher] = _FirstMessage(number, info.source_timestamp, now)
            else:
                self._is_partial = True
        last = self._last.get(publisher, number)
        self._count(max(0, number - last - 1))
        # Older messages may arrive later, in reply to a request of the subscription.
        self._last[publisher] = max(number, last)

    def add_unnumbered(self) -> None:
        """Record a message that arrived without its number, so that the next gap has it."""
        self._unnumbered += 1

    def _count_earlier(self, publisher: bytes, number: int, source_timestamp: int) -> None:
        """Count the messages that a new publisher sent before its first one that arrived."""
        first = self._first.get(publisher)
        if first and number > first.number:
            del self._first[publisher]
            period = (source_timestamp - first.source_timestamp) / (number - first.number) / 1e9
            if first.arrived - (first.number - 1) * period >= self._restarted_at:
                self._count(first.number - 1)
            else:
                self._is_partial = True

    def _count(self, missing: int) -> None:
        """Count missing messages, except those that arrived without a number."""
        arrived = min(missing, self._unnumbered)
        self._unnumbered -= arrived
        self.count += missing - arrived
