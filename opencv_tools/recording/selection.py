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

"""Which of the frames that come are recorded, and for how long."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import time

from opencv_tools.recording.frames import ReceivedFrame
from opencv_tools.recording.manifest import Entry
from opencv_tools.recording.naming import NANO

# Frames that come a little early by this much of the period are not early: stamps tremble.
_SLACK = 0.25


_LONG_AGO = -1 << 62  # nanoseconds


class FullError(Exception):
    """A recording that is as large as it may get."""


@dataclass(frozen=True)
class Limits:
    """
    How much is recorded; 0 where there is no limit.

    :param max_frames: frames.
    :param max_seconds: seconds from the first frame on.
    :param max_bytes: bytes of all files.
    :param ring: go on, but keep only the newest that are within the limits.
    """

    max_frames: int = 0
    max_seconds: float = 0.0
    max_bytes: int = 0
    ring: bool = False

    @property
    def max_ns(self) -> int:
        """Give the seconds as nanoseconds."""
        return int(self.max_seconds * NANO)


class Selection:
    """Choose frames by their number and their time."""

    def __init__(
        self, every_n: int, max_rate: float, limits: Limits,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        """
        Wait for the first frame, which is wanted.

        :param every_n: take the first of so many frames.
        :param max_rate: frames per second to take at most, by their stamps; 0 for all.
        :param limits: when to end, unless they are those of a ring.
        :param monotonic: returns seconds of a clock that only goes on.
        """
        self._every_n = every_n
        self._period_ns = int(NANO / max_rate) if max_rate else 0
        self._limits = Limits() if limits.ring else limits
        self._seen = 0
        self._taken = 0
        self._monotonic = monotonic
        self._began_at: float | None = None
        self._due_ns = 0

    @property
    def has_begun(self) -> bool:
        """Tell whether a frame has come."""
        return self._began_at is not None

    @property
    def max_seconds(self) -> float:
        """Give the seconds after which it is over; 0.0 for never."""
        return self._limits.max_seconds

    @property
    def is_over(self) -> bool:
        """Tell whether so many frames were taken as are wanted."""
        return 0 < self._limits.max_frames <= self._taken

    def wants(self, frame: ReceivedFrame) -> bool:
        """Tell whether a frame that came is to be recorded."""
        self._seen += 1
        return not (self._seen - 1) % self._every_n and self._is_due(frame.time_ns)

    def take(self) -> None:
        """Count a frame that is recorded."""
        self._taken += 1

    def is_late(self) -> bool:
        """Tell whether a frame comes after the time that is recorded, which the first begins."""
        now = self._monotonic()
        if self._began_at is None:
            self._began_at = now
        return 0 < self._limits.max_seconds <= now - self._began_at

    def put_back(self) -> None:
        """Let another frame take the place of one that was dropped."""
        self._taken -= 1

    def _is_due(self, time_ns: int) -> bool:
        """Keep to a grid of times, so that rates which do not divide keep their mean."""
        period = self._period_ns
        early = self._due_ns - time_ns
        if period * _SLACK < early <= 2 * period:
            return False
        is_on_grid = -period <= early <= period * _SLACK
        self._due_ns = (self._due_ns if is_on_grid else time_ns) + period
        return True


@dataclass(frozen=True)
class _Kept:
    name: str
    size: int
    arrival_ns: int


class Budget:
    """Keep the files of a recording within its limits."""

    def __init__(
        self, limits: Limits, entries: list[Entry],
        monotonic: Callable[[], int] = time.monotonic_ns,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        """
        Begin with the files there are, in the order of their age.

        :param limits: of the recording.
        :param entries: files of earlier recordings, which a ring counts and replaces. Those of a
            time that is yet to come are the oldest: nobody knows when the clock was wrong.
        :param monotonic: returns nanoseconds of the clock of arrivals, which only goes on.
        :param wall: returns nanoseconds of the system's clock, by which earlier files have an age.
        """
        self._limits = limits
        self._kept: dict[str, _Kept] = {}
        now, offset = wall(), wall() - monotonic()
        earlier = {entry.name: entry for entry in entries} if limits.ring else {}
        for entry in sorted(earlier.values(), key=lambda entry: (
                entry.receive_ns <= now, entry.receive_ns)):
            is_past = entry.receive_ns <= now
            self._kept[entry.name] = _Kept(
                entry.name, entry.size, entry.receive_ns - offset if is_past else _LONG_AGO)
        self._bytes = sum(kept.size for kept in self._kept.values())

    @property
    def count(self) -> int:
        """Count the files that a ring keeps."""
        return len(self._kept)

    def make_room(self, entry: Entry, arrival_ns: int) -> list[str]:
        """
        Find out what has to go before a file may come.

        :param entry: the file.
        :param arrival_ns: when its frame came, by a clock that only goes on.
        :returns: names of the files to delete, the oldest first.
        :raises FullError: nothing can go, and the file is too much.
        """
        limits = self._limits
        replaced = self._kept.get(entry.name)
        size = self._bytes + entry.size - (replaced.size if replaced else 0)
        count = len(self._kept) + (not replaced)
        gone: list[str] = []
        for other in self._kept.values():
            too_many = 0 < limits.max_frames < count - len(gone)
            too_old = 0 < limits.max_ns < arrival_ns - other.arrival_ns
            if not (too_many or too_old or self._is_too_large(size)):
                break
            if other is not replaced:
                gone.append(other.name)
                size -= other.size
        if self._is_too_large(size):
            raise FullError(f'max_bytes is {limits.max_bytes}, and the next file has {entry.size}')
        return gone

    def add(self, entry: Entry, gone: list[str], arrival_ns: int) -> None:
        """Take note of a file that came, and of those that went for it."""
        for name in (*gone, entry.name):
            other = self._kept.pop(name, None)
            self._bytes -= other.size if other else 0
        self._bytes += entry.size
        if self._limits.ring:
            self._kept[entry.name] = _Kept(entry.name, entry.size, arrival_ns)

    def _is_too_large(self, size: int) -> bool:
        return 0 < self._limits.max_bytes < size
