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

"""Published messages that reliable subscribers have not confirmed yet."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import time

from opencv_tools.logs import Log
from rclpy.duration import Duration
from rclpy.publisher import Publisher

# rclpy blocks the interpreter while it waits for confirmations. It is polled without a wait.
_POLL_SECONDS = 0.002
_LOGGED_AFTER_SECONDS = 2.0
# A live subscriber confirms a frame within milliseconds, on a busy machine within a second. A
# killed subscriber stays in the graph for 20 s, and the other subscribers wait meanwhile.
_TIMEOUT_SECONDS = 10.0


class Backlog:
    """
    Count the messages that publishers keep until reliable subscribers have confirmed them.

    A publisher keeps as many messages as its depth. One message more overwrites the oldest, which
    is lost to a subscriber that has not received it. A best-effort publisher and best-effort
    subscribers confirm nothing and are not waited for.
    """

    def __init__(
        self, publishers: Iterable[Publisher], log: Log,
        clock: Callable[[], float] = time.monotonic, sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        """
        Create an empty backlog.

        :param publishers: publishers of the frame topics.
        :param clock: monotonic clock in seconds.
        :param sleep: waits for a number of seconds of that clock.
        """
        self._unconfirmed = dict.fromkeys(publishers, 0)
        self._log = log
        self._clock = clock
        self._sleep = sleep
        self._may_wait = True

    def add(self, publisher: Publisher) -> None:
        """Count a published message."""
        self._unconfirmed[publisher] += 1

    def wait_for_room(self, is_stopped: Callable[[], bool]) -> bool:
        """
        Wait until another message of each publisher would not overwrite an unconfirmed one.

        The wait ends after 10 s. Then there is no wait until everything is confirmed.

        :param is_stopped: returns whether to end the wait.
        :returns: whether there is room.
        """
        return self._wait(self._has_room, is_stopped)

    def wait_for_all(self, is_stopped: Callable[[], bool]) -> bool:
        """
        Wait until all messages are confirmed, for at most 10 s.

        :param is_stopped: returns whether to end the wait.
        :returns: whether all messages are confirmed.
        """
        return self._wait(lambda: not any(self._unconfirmed.values()), is_stopped)

    def _wait(self, condition: Callable[[], bool], is_stopped: Callable[[], bool]) -> bool:
        self._update()
        began = self._clock()
        is_logged = False
        while not condition():
            waited = self._clock() - began
            if self._may_wait and waited > _TIMEOUT_SECONDS:
                self._may_wait = False
                self._log.warning(
                    'a reliable subscriber has not confirmed the last frames for '
                    f'{_TIMEOUT_SECONDS:g} s; the publisher no longer waits for it, and it may '
                    'lose frames')
            if is_stopped() or not self._may_wait:
                return False
            if waited > _LOGGED_AFTER_SECONDS and not is_logged:
                is_logged = True
                self._log.info('waiting for a reliable subscriber to confirm the last frames')
            self._sleep(_POLL_SECONDS)
            self._update()
        return True

    def _has_room(self) -> bool:
        return all(count < max(1, publisher.qos_profile.depth)
                   for publisher, count in self._unconfirmed.items())

    def _update(self) -> None:
        """Update the counts of unconfirmed messages."""
        for publisher in self._unconfirmed:
            if publisher.wait_for_all_acked(Duration()):
                self._unconfirmed[publisher] = 0
        self._may_wait = self._may_wait or not any(self._unconfirmed.values())
