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

"""Published frames that subscribers have not received yet."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from threading import Event
import time

from opencv_tools.base.logs import Log
from opencv_tools.topics.compressed_topic import CompressedTopic
from opencv_tools.transport.shared_frames.publisher import SharedFramePublisher
from rclpy.duration import Duration
from rclpy.publisher import Publisher

# rclpy blocks the interpreter while it waits for confirmations. It is polled without a wait.
_POLL_SECONDS = 0.002
_SEND_SECONDS = 0.01  # each time costs a copy
_LOGGED_AFTER_SECONDS = 2.0
# A live subscriber confirms a frame within milliseconds, on a busy machine within a second. A
# killed subscriber of the image topic stays in the graph for 20 s, and the others wait meanwhile.
_TIMEOUT_SECONDS = 10.0
# At the end nothing else waits, so that a killed subscriber leaves the graph meanwhile.
_END_SECONDS = 25.0

#: A publisher whose messages subscribers confirm.
Confirmed = Publisher | CompressedTopic


class Backlog:
    """
    Wait for slow subscribers.

    A wait ends after 10 s. Then there is none until the slow subscribers have received everything.

    A publisher keeps as many messages as its depth. One message more overwrites the oldest, which
    is lost to a subscriber that has not received it. A best-effort publisher and best-effort
    subscribers confirm nothing and are not waited for. A reader of shared memory has room for some
    frames, and does not get a frame for which it has no room.
    """

    def __init__(
        self, publishers: Iterable[Confirmed], log: Log,
        clock: Callable[[], float] = time.monotonic, sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        """
        Create an empty backlog.

        :param clock: monotonic clock in seconds.
        :param sleep: waits for a number of seconds of that clock.
        """
        self._unconfirmed = dict.fromkeys(publishers, 0)
        self._log = log
        self._clock = clock
        self._sleep = sleep
        self._seconds = _TIMEOUT_SECONDS
        self._lacks_room = False  # for the last shared frame
        self._may_wait = True
        self._stopped = Event()

    def stop(self) -> None:
        """End all waits."""
        self._stopped.set()

    def watch(self, publishers: Iterable[Confirmed]) -> None:
        """Wait for the subscribers of more publishers."""
        self._unconfirmed.update(dict.fromkeys(publishers, 0))

    def forget(self, publishers: Iterable[Confirmed]) -> None:
        """Wait no longer for the subscribers of some publishers."""
        for publisher in publishers:
            del self._unconfirmed[publisher]

    def add(self, publisher: Confirmed) -> None:
        """Count a published message."""
        self._unconfirmed[publisher] += 1

    def wait_for_room(self) -> bool:
        """
        Wait until another message of each publisher would not overwrite an unconfirmed one.

        :returns: whether there is room.
        """
        return self._wait(self._has_room)

    def wait_for_all(self, ended: Sequence[SharedFramePublisher] = ()) -> bool:
        """
        Wait until all messages are confirmed.

        :param ended: publishers that share no more frames; their readers are waited for as well.
        :returns: whether all messages are confirmed and all shared frames received.
        """
        return self._wait(lambda: not (any(self._unconfirmed.values())
                                       or any(publisher.has_readers for publisher in ended)))

    def confirm_all(self, shared: Sequence[SharedFramePublisher] = ()) -> bool:
        """
        Wait at the end of a file until all messages are confirmed; log how many are not.

        :param shared: publishers of shared frames, which share no more from now on. Their
            ``destroy`` logs how many are not received.
        :returns: whether all frames are received, or ``stop`` was called.
        """
        self._may_wait, self._seconds = True, _END_SECONDS
        for publisher in shared:
            publisher.end()
        if self.wait_for_all(shared) or self._stopped.is_set():
            return True
        count, topic = max(
            (min(count, publisher.qos_profile.depth or count), publisher.topic_name)
            for publisher, count in self._unconfirmed.items())
        if count:
            self._log.error(f'up to {count} of the last messages on {topic} were not received by '
                            'each reliable subscriber; they may be lost')
        return False

    def deliver(self, send: Callable[[], bool]) -> bool:
        """
        Send a frame to the readers of shared memory again and again, until all have room for it.

        :param send: sends the frame and returns whether all readers had room for it.
        :returns: whether all readers have the frame.
        """
        def is_sent() -> bool:
            self._lacks_room = not send()
            return not self._lacks_room

        return self._wait(is_sent, _SEND_SECONDS)

    def _wait(self, condition: Callable[[], bool], poll_seconds: float = _POLL_SECONDS) -> bool:
        self._update()
        began = self._clock()
        is_logged = False
        while not condition():
            waited = self._clock() - began
            if self._may_wait and waited > self._seconds:
                self._may_wait = False
                self._log.warning(
                    'a subscriber has not received the last frames for '
                    f'{self._seconds:g} s; the publisher no longer waits for it, and it may '
                    'lose frames')
            if self._stopped.is_set() or not self._may_wait:
                return False
            if waited > _LOGGED_AFTER_SECONDS and not is_logged:
                is_logged = True
                self._log.info('waiting for a subscriber that has not received the last frames')
            self._sleep(poll_seconds)
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
        self._may_wait |= not (any(self._unconfirmed.values()) or self._lacks_room)
