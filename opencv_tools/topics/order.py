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

from enum import auto, Enum
from typing import NamedTuple

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
            if self._has_begun:  # without those that say less
                self._later = [(earlier, known) for earlier, known in self._later
                               if earlier < messages or known > count]
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
        self._later = [later for later in self._later if later[1] > self.count]

    def follow(self, message: int, number: int) -> bool:
        """
        Record that the frame after the last one has arrived, as ``advance`` does.

        :returns: False, and nothing is recorded, if there is more to learn from the frame.
        """
        if self._later or not self._has_begun or (self._first and self._most is None):
            return False
        self._last = message
        self.count = max(self.count, number - message)
        return True


# Publishers whose numbers are remembered.
_MAX_PUBLISHERS = 128
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


class _Publisher:
    """The frames of one publisher, in the order in which it has published them."""

    def __init__(self) -> None:
        self.way = Way.TOPIC
        self.is_overdue = False  # the messages before the next shared frame are lost
        #: The first one that arrived; earlier ones may have been lost. Number 0: a message.
        self._first: Position | None = None
        self._message = self._number = 0  # of the last frame
        self._only_shared = OnlyShared()
        self._arrived = 0

    @property
    def last(self) -> int:
        """Return the number of the last frame."""
        return max(self._number, self._message + self._only_shared.count)

    @property
    def before(self) -> int:
        """Return the number of frames before the first one that arrived, as far as it is known."""
        if self._first is None:
            return 0
        return (self._first.number or self._first.message + self._only_shared.before_first) - 1

    @property
    def lost(self) -> int:
        """Return the number of frames after the first one that will not arrive any more."""
        return max(0, self.last - self.before - self._arrived)

    def learn(self, messages: int, number: int) -> None:
        """Record that a number of messages are among the first frames."""
        self._only_shared.learn(messages, number)

    def is_early(self, position: Position) -> bool:
        """Return whether messages are missing before a shared frame."""
        return (self.way is Way.JOINING and not self.is_overdue and position.is_message
                and position.message > self._message + 1)

    def accepts(self, position: Position) -> bool:
        """Return whether a frame is new and arrives in the right way; if so, it is counted."""
        message, number, is_message = position
        if (self.way is Way.SHARED and number == self._number + 1
                and message == self._message + is_message
                and self._only_shared.follow(message, number)):
            self._message, self._number = message, number
            self._arrived += 1
            return True
        is_shared = number > 0
        if is_shared and self.way is Way.TOPIC:
            return False
        is_new = self._is_after_last(position)
        if is_shared:
            self.learn(position.message - position.is_message, position.number - 1)
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
            if self._first is None:
                self._first = position._replace(number=number and self.last)
        return is_new

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

    Frames between the first and the last one that arrived from a publisher are lost if they did
    not arrive. Those before the first one were sent before the subscription, or are lost; nothing
    tells which. They have a count of their own.
    """

    def __init__(self) -> None:
        self._publishers: dict[bytes, _Publisher] = {}
        self._forgotten = self._before = 0  # of publishers that are not remembered
        self._unnumbered = self._failed = 0  # messages without a number, before and in a gap
        #: Number of accepted frames by publisher; b'' for those without a number.
        self.accepted: dict[bytes, int] = {}

    @property
    def count(self) -> int:
        """Return the number of lost frames."""
        return (self._forgotten - self._failed
                + sum(found.lost for found in self._publishers.values()))

    @property
    def before(self) -> int:
        """Return the number of frames of all publishers before their first ones that arrived."""
        return self._before + sum(found.before for found in self._publishers.values())

    def uncounted(self, noun: str) -> str:
        """
        Return what ``count`` does not have, as text that begins with a comma; '' for nothing.

        :param noun: what the messages are, ``'frame'`` or ``'message'``.
        """
        unnumbered = self.accepted.get(b'', 0)
        return ((f', {self.before} sent before the first received {noun}' if self.before else '')
                + (f', {unnumbered} without a number' if unnumbered else ''))

    def last(self, publisher: bytes) -> int:
        """Return the number of the last frame of a publisher; 0 if it is unknown."""
        found = self._publishers.get(publisher)
        return found.last if found else 0

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

    def accepts(self, publisher: bytes, position: Position) -> bool:
        """
        Return whether a frame is to be passed on; if so, it counts as arrived.

        :param position: its place; without any number the frame is always new.
        :raises CdrError: the numbers are too far from those of the last frame.
        """
        if not (position.message or position.number):
            self.accepted[b''] = self.accepted.get(b'', 0) + 1
            return True
        found = self._find(publisher)
        before = found.lost if self._unnumbered else 0
        if not found.accepts(position):
            return False
        if self._unnumbered:
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
            self._publishers[publisher] = _Publisher()
            if len(self._publishers) > _MAX_PUBLISHERS:
                oldest = next(iter(self._publishers))
                forgotten = self._publishers.pop(oldest)
                self.accepted.pop(oldest, None)
                self._forgotten += forgotten.lost
                self._before += forgotten.before
        return self._publishers[publisher]
