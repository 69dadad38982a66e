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

"""Files that hold many frames, and the interface of their formats: videos and bags."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from opencv_tools.recording.frames import ReceivedFrame
from opencv_tools.recording.manifest import ManifestEntry
from opencv_tools.recording.recorder import Prepared
from opencv_tools.recording.selection import Limits


class FileWriter(Protocol):
    """
    The writer of one file with many frames.

    ``frames`` were accepted. ``flushed`` of them are complete in the file, and ``skipped`` exceed
    the maximum size. ``others`` are complete messages that are no frames. ``is_full`` means that
    the next frame would exceed it. ``bytes_waiting`` is an upper bound for the frames that are not
    in the file.
    """

    frames: int
    flushed: int
    skipped: int
    others: int
    is_full: bool
    bytes_waiting: int

    @property
    def size(self) -> int:
        """Size of the file in bytes."""

    def is_at_path(self) -> bool:
        """Return whether the file is still at its path, or that cannot be determined."""

    def close(self) -> None:
        """Finish the file; remove it if it has no frame."""


W = TypeVar('W', bound=FileWriter)

#: What a writer asks before its file grows: whether the finished file may have a size in bytes. A
#: ring deletes older files for it.
Room = Callable[[int], bool]


@dataclass(kw_only=True)
class OpenFile(Generic[W]):
    """
    A file that frames are written to.

    :param entry: manifest entry of the file, without its size and digest.
    :param offset_ns: difference from CLOCK_MONOTONIC to the system clock at the first frame.
    :param began_ns: arrival time of the first frame in nanoseconds of CLOCK_MONOTONIC.
    :param is_described: whether the entry describes a frame, not only other messages.
    :param last_ns: the same of the last frame.
    """

    path: Path
    entry: ManifestEntry
    writer: W
    offset_ns: int
    began_ns: int
    is_described: bool
    last_ns: int = 0

    def time_ns(self, frame: ReceivedFrame) -> int:
        """Return the time of a frame, independent of changes of the system clock."""
        return frame.metadata.stamp_ns or frame.arrival_ns + self.offset_ns

    def is_over(self, limits: Limits, frame: ReceivedFrame) -> bool:
        """Return whether the file has reached the limits of one file before a frame."""
        writer = self.writer
        size = writer.size + writer.bytes_waiting
        return (0 < limits.max_frames <= writer.frames or 0 < limits.max_bytes <= size
                or 0 < limits.max_ns <= frame.arrival_ns - self.began_ns)

    def removed_text(self) -> str:
        """Return the reason for the loss of frames in a file that is gone."""
        return f'{self.path.name} was removed or moved while it was written'


P = TypeVar('P', bound=Prepared)


class FileFormat(ABC, Generic[W, P]):
    """What the files of a format do with a frame; a `FileSink` decides which file gets it."""

    #: Sentence about the frames that the user should read; '' for none.
    warning = ''

    @abstractmethod
    def prepare(self, frame: ReceivedFrame) -> P:
        """
        Convert a frame for the writer; thread-safe.

        :raises ImageError: no file can hold the frame.
        """

    @abstractmethod
    def create(self, path: Path, frame: ReceivedFrame, prepared: P, room: Room) -> W:
        """Create a file; the frame is not written."""

    @abstractmethod
    def entry(self, seq: int, name: str, frame: ReceivedFrame, prepared: P) -> ManifestEntry:
        """Return the manifest entry of a file that begins with a frame."""

    @abstractmethod
    def write(self, file: OpenFile[W], frame: ReceivedFrame, prepared: P) -> bool:
        """Write a frame; return False if it would exceed the maximum size."""

    def continues(self, file: OpenFile[W], frame: ReceivedFrame, prepared: P) -> bool:
        """Return whether a frame can continue a file."""
        return True

    def can_begin(self, prepared: P) -> bool:
        """Return whether a file can begin with a frame; else the file is split later."""
        return True

    def check(self, file: OpenFile[W] | None, frame: ReceivedFrame, prepared: P) -> None:
        """
        Check that a frame can be written, before all other steps.

        :param file: file that would continue with the frame; None for a new one.
        :raises KeyFrameNeeded: the frame is left out, because it needs others that are missing.
        """

    def write_others(self, writer: W, prepared: P | None) -> None:
        """Write what was received before a frame, or at the end, but is no frame itself."""

    def measured(self, file: OpenFile[W], folder: Path) -> ManifestEntry:
        """Return the manifest entry of a closed file, with its size and its digest."""
        return file.entry.measured(folder)
