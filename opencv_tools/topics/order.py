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

"""Order of the frames of a topic: repeated, lost and only shared ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import auto, Enum
import time
from typing import NamedTuple

from opencv_tools.base.units import NANO
from opencv_tools.image.errors import CdrError

# Counts of later frames that are remembered. A publisher announces one at a change of the way.
_MAX_LATER = 64


class OnlyShared:
    """
    Count the frames that were only shared, until the first and until the last frame that arrived.

    A message does not have its number among the frames; it is the number of the message and this
    count. The counts are learned in any order, before or after the frames to which they belong.
    """

    def __init__(self) -> None:
        #: Number of frames that were only shared until the last frame that arrived.
        self.count = 0
        self._has_begun = False  # a frame has arrived
        self._last = self._first = 0  # messages; no first one if the first frame was shared
        self._least = 0  # count until the first message
        self._most: int | None = None  # count soon after it; no frame between was only shared
        self._later: list[tuple[int, int]] = []  # messages and counts after the last frame

    @property
    def before_first(self) -> int:
        """Return the count until the first message that arrived, as far as it is known."""
        return self._least if self._most is None else max(self._least, self._most)

    def learn(self, messages: int, number: int) -> None:
        """Record that a number of messages are among the first frames."""
        count = max(0, number - messages)
        if messages < self._first:
            self._least = max(self._least, count)
        elif self._first and self._most is None:
            self._most = count
        if messages < self._last:
            self.count = max(self.count, count)
        elif (count > self.count or not self._has_begun) and not any(
                earlier <= messages and known >= count for earlier, known in self._later):
            del self._later[_MAX_LATER - 1:]
            self._later.append((messages, count))

    def advance(self, message: int, number: int) -> None:
        """
        Record that a frame has arrived.

        :param message: number of its message, or of the last message before it.
        :param number: number of the frame; 0 for a message, whose number is not known.
        """
        known = [count for messages, count in self._later if messages < message]
        self._later = [later for later in self._later if later[0] >= message]
        if not self._has_begun and not number:
            self._first, self._least = message, max(known, default=0)
            if not known:
                self._most = min((count for _, count in self._later), default=None)
        self._has_begun = True
        self._last = message
        self.count = max(self.count, number - message, *known)


# A publisher that is discovered later than this after the subscription counts as new.
_DISCOVERY_SECONDS = 2.0
# Publishers whose numbers are remembered.
_MAX_PUBLISHERS = 128
# Frames from which the rate of a publisher is measured, because two may follow each other quickly.
_MEASURED_STEPS = 30
# A larger step of the numbers is an error of the frame, not a loss.
_MAX_STEP = 2**32


class Way(Enum):
    """How the frames of a publisher arrive."""

    TOPIC = auto()  # by the image topic
    JOINING = auto()  # by the image topic, until a shared frame continues its messages
    SHARED = auto()  # by shared memory; messages of the image topic are repeated frames
    LEAVING = auto()  # by shared memory, until a message of the image topic follows


class Position(NamedTuple):
    """
    Place of a frame among the frames of its publisher.

    :param message: number of its message on the image topic, or of the last message before it, if
        the frame is only shared.
    :param number: number of the frame, from 1; 0 for a message, whose number is not known.
    :param is_message: whether the frame is a message of the image topic.
    """

    message: int
    number: int = 0
    is_message: bool = True


class _FirstFrame(NamedTuple):
    """
    The first frame of a publisher that arrived; earlier frames may have been lost.

    :param number: its number; 0 if it came by the image topic.
    :param message: number of its message, or of the last message before it.
    """

    number: int
    message: int
    publish_ns: int
    arrived: float


class _Publisher:
    """The frames of one publisher, in the order in which it has published them."""

    def __init__(self, since: float | None) -> None:
        self.way = Way.TOPIC
        self.is_overdue = False  # the messages before the next shared frame are lost
        self._since = since  # time of the subscription, if the publisher was discovered later
        self._first: _FirstFrame | None = None
        self._period: float | None = None  # in seconds, from the first frames
        self._message = self._number = 0  # of the last frame
        self._only_shared = OnlyShared()
        self._arrived = 0

    @property
    def last(self) -> int:
        """Return the number of the last frame."""
        return max(self._number, self._message + self._only_shared.count)

    @property
    def lost(self) -> int:
        """Return the number of frames that were published, but neither arrived nor will arrive."""
        begin = self._number_of(self._first) - 1 if self._first and self.is_partial else 0
        return max(0, self.last - begin - self._arrived)

    @property
    def is_partial(self) -> bool:
        """Return whether the frames before the first one that arrived are not counted."""
        if self._first is None or (number := self._number_of(self._first)) == 1:
            return False
        if self._since is None or self._period is None:
            return True
        return self._first.arrived - (number - 1) * self._period < self._since

    def learn(self, messages: int, number: int) -> None:
        """Record that a number of messages are among the first frames."""
        self._only_shared.learn(messages, number)

    def is_early(self, position: Position) -> bool:
        """Return whether messages are missing before a shared frame."""
        return (self.way is Way.JOINING and not self.is_overdue and position.is_message
                and position.message > self._message + 1)

    def accepts(self, position: Position, publish_ns: int, now: float) -> bool:
        """Return whether a frame is new and arrives in the right way; if so, it is counted."""
        is_shared = position.number > 0
        if is_shared and self.way is Way.TOPIC:
            return False
        is_new = self._is_after_last(position)
        if is_shared:
            if position.is_message:
                self.learn(position.message - 1, position.number - 1)
            self.learn(position.message, position.number)
            if self.way is Way.JOINING and not self._joins(position, is_new):
                return False
        elif self.way is Way.SHARED:
            return False
        elif self.way is Way.LEAVING:
            self.way = Way.TOPIC
        if is_new:
            self._message = position.message
            self._number = max(self._number, position.number)
            self._arrived += 1
            self._only_shared.advance(position.message, position.number)
            self._measure(position, publish_ns, now)
        return is_new

    def _number_of(self, first: _FirstFrame) -> int:
        """Return the number of the first frame that arrived, as far as it is known."""
        return first.number or first.message + self._only_shared.before_first

    def _measure(self, position: Position, publish_ns: int, now: float) -> None:
        """Remember the first frame, and the period until the next one."""
        if self._first is None:
            self._first = _FirstFrame(
                self.last if position.number else 0, position.message, publish_ns, now)
        elif publish_ns and (
                0 < (steps := self.last - self._number_of(self._first)) <= _MEASURED_STEPS):
            self._period = (publish_ns - self._first.publish_ns) / steps / NANO

    def _is_after_last(self, position: Position) -> bool:
        steps = position.message - self._message, position.number - self._number
        if (self._arrived and max(steps) > _MAX_STEP) or max(position) > 2**16 * _MAX_STEP:
            raise CdrError(f'the number of the frame is {max(position)}, that of the last frame '
                           f'{self.last}')
        if position.is_message:
            return steps[0] > 0
        return steps[0] >= 0 and steps[1] > 0

    def _joins(self, position: Position, is_new: bool) -> bool:
        """Return whether no message of the image topic is missing before a shared frame."""
        if not is_new:
            if position.message == self._message:
                self.way = Way.SHARED  # the next shared frame follows
            return False
        if self.is_early(position):
            return False
        self.way = Way.SHARED
        return True


class FrameOrder:
    """
    Recognise repeated frames and count lost ones, by the numbers that the publishers give.

    The frames of a publisher that started after the subscription are counted from number 1. Those
    of other publishers are counted from the first that arrived. Frames lost after the last one
    that arrived are not counted.

    A publisher started after the subscription if it was discovered later, and if the time since
    the subscription is too short for all its frames at the rate of the first ones.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """
        Create a counter.

        :param clock: monotonic clock in seconds.
        """
        self._clock = clock
        self._publishers: dict[bytes, _Publisher] = {}
        self._discovered: dict[bytes, float] = {}
        self._forgotten = 0  # lost frames of publishers that are not remembered
        self._unnumbered = self._failed = 0  # messages without a number, before and in a gap
        self._is_partial = False
        #: Number of accepted frames by publisher; b'' for those without a number.
        self.accepted: dict[bytes, int] = {}
        self.restart()

    @property
    def count(self) -> int:
        """Return the number of lost frames."""
        return (self._forgotten - self._failed
                + sum(found.lost for found in self._publishers.values()))

    @property
    def is_complete(self) -> bool:
        """Whether the frames of every publisher are counted from number 1."""
        return not (self._is_partial or any(
            found.is_partial for found in self._publishers.values()))

    def restart(self) -> None:
        """Record the start of a subscription to another topic."""
        self._restarted_at = self._clock()

    def discover(self, publishers: Iterable[bytes]) -> None:
        """Record the discovery of publishers."""
        now = self._clock()
        for publisher in publishers:
            self._discovered.setdefault(publisher, now)
        while len(self._discovered) > _MAX_PUBLISHERS:
            del self._discovered[next(iter(self._discovered))]

    def way(self, publisher: bytes) -> Way:
        """Return how the frames of a publisher arrive."""
        found = self._publishers.get(publisher)
        return found.way if found else Way.TOPIC

    def change(self, publisher: bytes, way: Way, *, is_overdue: bool = False) -> None:
        """
        Change how the frames of a publisher arrive.

        :param is_overdue: while joining, whether the messages are lost that are missing before the
            next shared frame.
        """
        found = self._find(publisher)
        found.way, found.is_overdue = way, is_overdue

    def is_early(self, publisher: bytes, position: Position) -> bool:
        """Return whether messages of a publisher are missing before a shared frame."""
        return self._find(publisher).is_early(position)

    def learn(self, publisher: bytes, messages: int, number: int) -> None:
        """Record that a number of messages are among the first frames of a publisher."""
        self._find(publisher).learn(messages, number)

    def accepts(self, publisher: bytes, position: Position, publish_ns: int) -> bool:
        """
        Return whether a frame is to be passed on; if so, it counts as arrived.

        :param position: its place; without any number the frame is always new.
        :param publish_ns: time of publication in nanoseconds of the publisher; 0 if unknown.
        :raises CdrError: the numbers are too far from those of the last frame.
        """
        if not (position.message or position.number):
            self._is_partial = True
            self.accepted[b''] = self.accepted.get(b'', 0) + 1
            return True
        found = self._find(publisher)
        before = found.lost
        if not found.accepts(position, publish_ns, self._clock()):
            return False
        failed = min(self._unnumbered, max(0, found.lost - before))
        self._unnumbered -= failed
        self._failed += failed
        self.accepted[publisher] = self.accepted.get(publisher, 0) + 1
        return True

    def add_unnumbered(self) -> None:
        """Record a message that arrived without its number, so that the next gap has it."""
        self._unnumbered += 1

    def _find(self, publisher: bytes) -> _Publisher:
        if publisher not in self._publishers:
            now = self._clock()
            is_new = (self._discovered.get(publisher, now) - self._restarted_at
                      >= _DISCOVERY_SECONDS)
            self._publishers[publisher] = _Publisher(self._restarted_at if is_new else None)
            if len(self._publishers) > _MAX_PUBLISHERS:
                oldest = next(iter(self._publishers))
                forgotten = self._publishers.pop(oldest)
                self.accepted.pop(oldest, None)
                self._forgotten += forgotten.lost
                self._is_partial |= forgotten.is_partial
        return self._publishers[publisher]
