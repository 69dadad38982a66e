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

"""The newest frame of a topic, passed from the executor to the loop of the server."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
import itertools
import time

from opencv_tools.image.cdr import WireMessage

# Number of frames of which the rate is the mean, and the age of the oldest one in seconds.
_RATE_FRAMES = 32
_RATE_SECONDS = 5.0
_NANO = 10**9
# Seconds and periods without a frame after which the reason is shown.
_QUIET_SECONDS, _QUIET_PERIODS = 1.0, 3


@dataclass(frozen=True)
class NewFrame:
    """
    A received frame.

    :param number: number of the frame in its feed, from 1.
    :param message: the message, a view of the bytes of the middleware.
    :param receive_ns: time of reception in nanoseconds of the system clock.
    """

    number: int
    message: WireMessage
    receive_ns: int

    @property
    def stamp(self) -> float:
        """Return the stamp of the message in seconds."""
        return self.message.header.sec + self.message.header.nanosec / _NANO


class Feed:
    """
    The newest frame of a topic; an older one that nobody has taken is forgotten.

    The executor calls ``put`` and ``count_broken``. All attributes may be read on any thread.
    """

    def __init__(self, on_frame: Callable[[], object]) -> None:
        """
        Create an empty feed.

        :param on_frame: called after each frame, in the executor.
        """
        self.newest: NewFrame | None = None
        self.broken = 0
        self._numbers = itertools.count(1)
        self._on_frame = on_frame
        self._arrivals: deque[float] = deque(maxlen=_RATE_FRAMES)

    def put(self, message: WireMessage, receive_ns: int) -> None:
        """Replace the newest frame."""
        self.newest = NewFrame(next(self._numbers), message, receive_ns)
        self._arrivals.append(time.monotonic())
        self._on_frame()

    def count_broken(self, _err: Exception) -> None:
        """Count a message that cannot be read."""
        self.broken += 1

    @property
    def frames(self) -> int:
        """Return the number of received frames."""
        return self.newest.number if self.newest else 0

    @property
    def rate(self) -> float:
        """Return the rate of the received frames in Hz."""
        now = time.monotonic()
        recent = [arrival for arrival in tuple(self._arrivals) if now - arrival < _RATE_SECONDS]
        if len(recent) < 2 or recent[-1] <= recent[0]:
            return 0.0
        return (len(recent) - 1) / (recent[-1] - recent[0])

    @property
    def quiet_seconds(self) -> float | None:
        """Return the time since the last frame in seconds; None before the first one."""
        arrivals = tuple(self._arrivals)[-1:]
        return time.monotonic() - arrivals[0] if arrivals else None

    @property
    def is_quiet(self) -> bool:
        """Return whether frames are missing: none has arrived, or none for several periods."""
        arrivals = tuple(self._arrivals)
        if len(arrivals) < 2:
            return not arrivals or time.monotonic() - arrivals[0] > _QUIET_SECONDS
        period = (arrivals[-1] - arrivals[0]) / (len(arrivals) - 1)
        quiet = max(_QUIET_SECONDS, _QUIET_PERIODS * period)
        return time.monotonic() - arrivals[-1] > quiet
