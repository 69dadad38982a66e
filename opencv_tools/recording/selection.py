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

"""Selection of the frames to record, and limits of a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
import math
import time
from typing import TypeVar

from opencv_tools.base.rate_limit import RateLimit
from opencv_tools.base.units import NANO
from opencv_tools.recording.errors import LimitReached, UnwritableError
from opencv_tools.recording.frames import ReceivedFrame
from opencv_tools.recording.manifest import ManifestEntry

# Arrival time of files whose age is unknown.
_UNKNOWN_AGE_NS = -math.inf

_RING_FILES = 10  # videos or bags that a ring of them consists of

_NOTHING = (0, 0, _UNKNOWN_AGE_NS)  # size, frames and arrival time

N = TypeVar('N', int, float)


@dataclass(frozen=True)
class Limits:
    """
    Limits of a recording; 0 means no limit.

    :param max_seconds: duration in seconds, from the first frame.
    :param max_bytes: size of all files in bytes.
    :param ring: whether the oldest files are deleted at the limits, instead of ending.
    :param split_seconds: duration of a video or bag, after which the next one begins.
    :param split_bytes: size in bytes of a video or bag, after which the next one begins.
    :param has_reserve: whether the recording ends before the disk is full.
    """

    max_frames: int = 0
    max_seconds: float = 0.0
    max_bytes: int = 0
    ring: bool = False
    split_seconds: float = 0.0
    split_bytes: int = 0
    has_reserve: bool = False

    def of_one_file(self) -> Limits:
        """Return the limits of a video or bag: those of a split, and a tenth of a ring."""
        if not self.ring:
            return Limits(0, self.split_seconds, self.split_bytes)
        return Limits(
            -(-self.max_frames // _RING_FILES),
            _least(self.split_seconds, self.max_seconds / _RING_FILES),
            _least(self.split_bytes, -(-self.max_bytes // _RING_FILES)))

    @property
    def max_ns(self) -> int:
        """Maximum duration in nanoseconds; 0 for no limit."""
        return int(self.max_seconds * NANO)


def _least(*limits: N) -> N:
    """Return the least limit, where 0 means no limit."""
    return min(filter(None, limits), default=0)


class Selection:
    """Select frames by their number and their time."""

    def __init__(
        self, every_n: int, max_rate: float, limits: Limits,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        """
        Create a selection; the first frame is always selected.

        :param every_n: select the first of every n frames.
        :param max_rate: maximum rate of the selected frames in Hz, by their stamps; 0 for all.
        :param limits: limits at which the selection ends, unless ``ring`` is set.
        :param monotonic: monotonic clock in seconds.
        """
        self._every_n = every_n
        self._rate_limit = RateLimit(max_rate)
        self._limits = Limits() if limits.ring else limits
        self._seen = 0
        self._counted = 0
        self._monotonic = monotonic
        self._began_at: float | None = None

    @property
    def has_begun(self) -> bool:
        """Return whether a frame has arrived."""
        return self._began_at is not None

    @property
    def max_seconds(self) -> float:
        """Maximum duration in seconds; 0.0 for no limit."""
        return self._limits.max_seconds

    @property
    def is_over(self) -> bool:
        """Return whether the maximum number of frames was counted."""
        return 0 < self._limits.max_frames <= self._counted

    def selects(self, frame: ReceivedFrame) -> bool:
        """Return whether a received frame is to be recorded."""
        self._seen += 1
        return not (self._seen - 1) % self._every_n and self._rate_limit.selects(
            frame.metadata.stamp_ns, frame.arrival_ns)

    def count(self) -> None:
        """Count a frame that is put into the queue, whether it is written or dropped later."""
        self._counted += 1

    def is_late(self) -> bool:
        """Return whether the maximum duration since the first call has passed."""
        now = self._monotonic()
        if self._began_at is None:
            self._began_at = now
        return 0 < self._limits.max_seconds <= now - self._began_at


class Retention:
    """Keep the files of a recording within its limits."""

    def __init__(
        self, limits: Limits, entries: list[ManifestEntry],
        monotonic: Callable[[], int] = time.monotonic_ns,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        """
        Sort the existing files by their age.

        :param entries: files of earlier recordings, which a ring counts and deletes. Files with a
            time in the future count as the oldest, because their age is unknown.
        :param monotonic: monotonic clock of the arrivals, in nanoseconds.
        :param wall: system clock in nanoseconds, for the age of existing files.
        """
        self._limits = limits
        # size, number of frames and arrival time, oldest first
        self._kept: dict[str, tuple[int, int, float]] = {}
        now, offset = wall(), wall() - monotonic()
        earlier = {entry.name: entry for entry in entries} if limits.ring else {}
        for entry in sorted(earlier.values(), key=lambda entry: (
                entry.receive_ns <= now, entry.receive_ns)):
            is_past = entry.receive_ns <= now
            self._kept[entry.name] = (
                entry.size, entry.frames,
                entry.receive_ns - offset if is_past else _UNKNOWN_AGE_NS)
        self._bytes = sum(size for size, _, _ in self._kept.values())
        self._frames = sum(frames for _, frames, _ in self._kept.values())

    @property
    def count(self) -> int:
        """Count of files in the ring."""
        return len(self._kept)

    def make_room(self, entry: ManifestEntry, arrival_ns: int) -> list[str]:
        """
        Select the files to delete before a new file is written.

        :param entry: manifest entry of the new file, or of a file that becomes larger.
        :param arrival_ns: arrival time of its last frame, in nanoseconds of the monotonic clock.
        :returns: names of the files to delete, oldest first.
        :raises LimitReached: the new file exceeds the limits, and no file is deleted.
        :raises UnwritableError: the same in a ring, which a smaller file does not end.
        """
        limits = self._limits
        replaced_size, replaced_frames, _ = self._kept.get(entry.name, _NOTHING)
        size = self._bytes + entry.size - replaced_size
        frames = self._frames + entry.frames - replaced_frames
        deleted: list[str] = []
        for name, (other_size, other_frames, other_arrival_ns) in self._kept.items():
            too_many = 0 < limits.max_frames < frames
            too_old = 0 < limits.max_ns < arrival_ns - other_arrival_ns
            if not (too_many or too_old or self._is_too_large(size)):
                break
            if name != entry.name:
                deleted.append(name)
                size -= other_size
                frames -= other_frames
        if self._is_too_large(size):
            if limits.ring:
                raise UnwritableError(f'a file of {entry.size} bytes does not fit in the ring, '
                                      f'whose max_bytes is {limits.max_bytes}: give a larger '
                                      'max_bytes')
            raise LimitReached(f'max_bytes is {limits.max_bytes}, the next file has {entry.size} '
                               'bytes')
        return deleted

    def remove(self, names: Iterable[str]) -> None:
        """Remove deleted files from the counts."""
        for name in names:
            size, frames, _ = self._kept.pop(name, _NOTHING)
            self._bytes -= size
            self._frames -= frames

    def add(self, entry: ManifestEntry, arrival_ns: int) -> None:
        """Count a new file."""
        self.remove((entry.name,))
        self._bytes += entry.size
        self._frames += entry.frames
        if self._limits.ring:
            self._kept[entry.name] = entry.size, entry.frames, arrival_ns

    def _is_too_large(self, size: int) -> bool:
        return 0 < self._limits.max_bytes < size
