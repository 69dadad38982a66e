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

"""The newest frame of a topic for the loop of the server, also of a camera that starts again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
import time

import numpy as np
from opencv_tools.base.text import printable
from opencv_tools.base.units import NANO
from opencv_tools.image.cdr import WireMessage
from opencv_tools.image.errors import ImageError
from opencv_tools.topics.messages import AnyMessage
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.topics.rate_meter import RateMeter
from opencv_tools.viewer.errors import MAX_MESSAGE, RequestError
from opencv_tools.viewer.watched import quiet_limit

# Publishers that are remembered.
_MAX_SENDERS = 32
# Time for which a publisher can still be replaced by one that came later.
_REPLACE_SECONDS = 60.0
# A publisher that sends for longer beside another one is not replaced by it.
_OVERLAP_SECONDS = 0.5
# Seconds and periods without a frame after which a publisher is silent. The graph has the
# publishers of a killed process for 20 s.
_SILENT_SECONDS, _SILENT_PERIODS, _GRAPH_SECONDS = 2.0, 3, 30.0


@dataclass
class _Sender:
    """
    A publisher that has sent frames.

    :param first_ns: stamp of its first frame in nanoseconds.
    :param first_at: time of its first frame.
    :param begun: time of its first frame, or of its discovery if that was earlier.
    :param rivals: publishers that it may replace.
    """

    first_ns: int
    first_at: float
    begun: float
    rivals: set[bytes]
    last_ns: int = 0
    last_at: float = field(init=False)
    frames: int = 0
    topic: str = ''  # '' until the graph has it

    def __post_init__(self) -> None:
        self.last_at = self.first_at

    def replaces(self, other: _Sender) -> bool:
        """Return whether it sends, and another publisher of its topic has fallen silent."""
        if other.frames < 2 or self.topic != other.topic:
            return False
        period = (other.last_at - other.first_at) / (other.frames - 1)
        silence = self.last_at - other.last_at
        return (self.begun - other.last_at < _GRAPH_SECONDS
                and silence > max(_SILENT_SECONDS, _SILENT_PERIODS * period))


class Restarts:
    """
    Notice that a new publisher replaces another one, or that stamps begin again.

    The first publisher replaces none, nor does one that sends beside the others. The executor
    calls ``add`` and ``check``.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """
        Begin without publishers.

        :param clock: monotonic clock in seconds.
        """
        self._clock = clock
        self._senders: dict[bytes, _Sender] = {}
        self._found: dict[bytes, float] = {}  # times of discovery
        self._restarted_at: float | None = None

    @property
    def seconds(self) -> float | None:
        """Time since the last restart in seconds; None without any."""
        return None if self._restarted_at is None else self._clock() - self._restarted_at

    def add(self, publisher: bytes, stamp_ns: int) -> None:
        """Use a frame of a publisher; b'' is an unknown one."""
        now = self._clock()
        sender = self._senders.get(publisher)
        if sender is None:
            rivals = {*self._senders} - {b''} if publisher else set()
            sender = self._senders[publisher] = _Sender(
                stamp_ns, now, self._found.get(publisher, now), rivals)
            if len(self._senders) > _MAX_SENDERS:
                del self._senders[next(iter(self._senders))]
        elif stamp_ns < sender.last_ns - NANO and stamp_ns <= sender.first_ns + NANO:
            self._restarted_at = now
            sender.first_ns = stamp_ns
        sender.last_ns, sender.last_at = stamp_ns, now
        sender.frames += 1

    def check(self, present: Mapping[bytes, str]) -> None:
        """Look for publishers that were replaced."""
        now = self._clock()
        self._found = {key: self._found.get(key, now) for key in present}
        for key, sender in self._senders.items():
            sender.topic = present.get(key, sender.topic)
        for sender in tuple(self._senders.values()):
            if now - sender.begun > _REPLACE_SECONDS:
                sender.rivals.clear()
            for key in tuple(sender.rivals):
                rival = self._senders.get(key)
                if rival is None or rival.last_at > sender.begun + _OVERLAP_SECONDS:
                    sender.rivals.remove(key)
                elif (rival.topic and key not in present) or sender.replaces(rival):
                    self._restarted_at = max(sender.begun, self._restarted_at or 0.0)
                    sender.rivals.clear()
                    del self._senders[key]
                    break


#: Name and transport of a subscription.
FeedKey = tuple[str, str]

# Time between two looks at a silent feed, in which the executor receives frames that have waited.
_SECOND_LOOK_SECONDS = 0.5


@dataclass(frozen=True)
class NewFrame:
    """
    A received frame.

    :param number: number of the frame in its feed, from 1.
    :param message: the message, a view of the bytes of the middleware.
    :param receive_ns: time of reception in nanoseconds of the system clock.
    :param sequence: number of the message from its publisher; 0 if unknown.
    """

    number: int
    message: WireMessage
    receive_ns: int
    sequence: int = 0

    @property
    def stamp(self) -> float:
        """Return the stamp of the message in seconds."""
        return self.stamp_ns / NANO

    @property
    def stamp_ns(self) -> int:
        """Return the stamp of the message in nanoseconds."""
        return self.message.header.sec * NANO + self.message.header.nanosec

    @property
    def identity(self) -> str:
        """Return what pages know a picture by: stamp in nanoseconds, and number."""
        return f'{max(0, self.stamp_ns)}/{self.sequence % 2**32}'


def is_own(message: AnyMessage) -> bool:
    """Return whether the data of a message are not in the shared memory of its publisher."""
    # Only the data of shared frames are arrays, and a copy of them is a view of nothing.
    return not isinstance(message.data, np.ndarray) or message.data.base is None


class Feed:
    """
    The newest frame of a topic; an older one that nobody has taken is forgotten.

    The executor calls ``put`` and ``count_broken``. All attributes may be read on any thread.
    """

    def __init__(self, on_frame: Callable[[], object],
                 clock: Callable[[], float] = time.monotonic) -> None:
        """
        Create an empty feed.

        :param on_frame: called after each frame, in the executor.
        :param clock: monotonic clock in seconds.
        """
        self.newest: NewFrame | None = None
        #: Number of received frames, and of messages that cannot be read.
        self.frames = self.broken = 0
        #: Reason why the newest message cannot be read, or why there is no subscription; '' else.
        self.error = ''
        #: Reason why no frame arrives, as the graph has it; '' while frames arrive.
        self.reason = ''
        #: Number of lost frames.
        self.lost = 0
        #: Whether the publishers keep their last frame for new subscriptions.
        self.is_latched = False
        #: Keeps a message that needs earlier ones or does not, and returns it; in the executor.
        self.keep: Callable[[ReceivedMessage, bool], ReceivedMessage] = (
            lambda received, _: received)
        self._clock = clock
        self._silent_at: float | None = None  # of the first look at a silent feed
        self._on_frame = on_frame
        self._meter = RateMeter(clock)
        #: Restarts of the camera.
        self.restarts = Restarts(clock)

    def opened(self, outcome: RequestError | None) -> None:
        """Use the outcome of the subscription."""
        if outcome:
            self.error = str(outcome)

    def put(self, received: ReceivedMessage) -> None:
        """Use a message, and announce it."""
        self.restarts.add(received.publisher, received.stamp_ns)
        try:
            self._add(received)
        except ImageError as err:
            self.count_broken(err)
            return
        self.frames += 1
        self.error = ''
        self._count_arrival()
        self._on_frame()

    def count_broken(self, err: Exception) -> None:
        """Count a message that cannot be read."""
        self.broken += 1
        self.error = printable(err, MAX_MESSAGE)
        self._count_arrival()

    @property
    def rate(self) -> float:
        """Return the rate of the received frames in Hz."""
        return self._meter.rate

    @property
    def quiet_seconds(self) -> float | None:
        """Return the time since the last frame in seconds; None before the first one."""
        return self._meter.silent_seconds

    def look(self) -> bool:
        """
        Return whether frames are missing: none has arrived, or none for several periods.

        They must be missing at two looks, because frames may wait for a busy executor at the first
        look.
        """
        quiet, now = self._meter.silent_seconds, self._clock()
        if quiet is not None and quiet <= quiet_limit(self._meter):
            self._silent_at = None
            return False
        if self._silent_at is None:
            self._silent_at = now
        return now - self._silent_at >= _SECOND_LOOK_SECONDS

    def _add(self, received: ReceivedMessage) -> None:
        """Replace the newest frame."""
        received = self.keep(received, True)
        self.newest = NewFrame(
            self.frames + 1, received.image, received.receive_ns, received.number)

    def _count_arrival(self) -> None:
        self._meter.add()
        self._silent_at = None
