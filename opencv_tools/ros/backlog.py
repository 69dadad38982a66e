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

"""Messages that reliable subscribers have not confirmed yet, and who can wait for them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import time
from typing import Protocol

from opencv_tools.recording.trouble import Log
from rclpy.duration import Duration
from rclpy.qos import QoSProfile

# rclpy holds the interpreter while it waits for confirmations, so it is only asked how they stand.
_POLL_SECONDS = 0.002
_LOGGED_AFTER_SECONDS = 2.0
# A subscriber that lives confirms a frame within milliseconds, on a busy machine within a second.
# One that was killed stays in the graph for 20 s, and the others have to wait for it meanwhile.
_PATIENCE_SECONDS = 10.0


class ConfirmedPublisher(Protocol):
    """What is used of a publisher of rclpy."""

    qos_profile: QoSProfile

    def wait_for_all_acked(self, timeout: Duration) -> bool:
        """Return whether reliable subscribers have confirmed every message."""


class Backlog:
    """
    Count the messages that publishers keep until reliable subscribers have confirmed them.

    A publisher keeps as many messages as its depth. One message more overwrites the oldest, which
    is lost to a subscriber that has not received it. A best-effort publisher and best-effort
    subscribers confirm nothing and are not waited for.
    """

    def __init__(
        self, publishers: Iterable[ConfirmedPublisher], log: Log,
        clock: Callable[[], float] = time.monotonic, sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        """
        Begin with nothing to be confirmed.

        :param publishers: of the topics that frames are published to.
        :param log: where a long wait is logged.
        :param clock: returns seconds that only go on.
        :param sleep: waits for some seconds of that clock.
        """
        self._unconfirmed = dict.fromkeys(publishers, 0)
        self._log = log
        self._clock = clock
        self._sleep = sleep
        self._is_patient = True

    def add(self, publisher: ConfirmedPublisher) -> None:
        """Count a message that was published."""
        self._unconfirmed[publisher] += 1

    def wait_for_room(self, is_stopped: Callable[[], bool]) -> bool:
        """
        Wait until one more message of each publisher overwrites none that is not confirmed.

        The wait ends after 10 s. From then on nobody is waited for until everything is confirmed.

        :param is_stopped: returns whether to end the wait.
        :returns: whether there is room.
        """
        return self._wait(self._has_room, is_stopped)

    def wait_for_all(self, is_stopped: Callable[[], bool]) -> bool:
        """
        Wait until every message is confirmed, for at most 10 s.

        :param is_stopped: returns whether to end the wait.
        :returns: whether all are.
        """
        return self._wait(lambda: not any(self._unconfirmed.values()), is_stopped)

    def _wait(self, condition: Callable[[], bool], is_stopped: Callable[[], bool]) -> bool:
        self._update()
        began = self._clock()
        is_logged = False
        while not condition():
            waited = self._clock() - began
            if self._is_patient and waited > _PATIENCE_SECONDS:
                self._is_patient = False
                self._log.warning(
                    'a reliable subscriber has not confirmed the last frames for '
                    f'{_PATIENCE_SECONDS:g} s; it is not waited for any more and may lose frames')
            if is_stopped() or not self._is_patient:
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
        """Read how the confirmations stand."""
        for publisher in self._unconfirmed:
            if publisher.wait_for_all_acked(Duration()):
                self._unconfirmed[publisher] = 0
        self._is_patient = self._is_patient or not any(self._unconfirmed.values())
