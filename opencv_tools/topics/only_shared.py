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

"""Count of the frames that a publisher has only shared, without a message on the image topic."""

from __future__ import annotations

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
