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

"""Recording of frames in files that hold many, and the interface of their formats."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
import os
from pathlib import Path
import time
from typing import Generic, Protocol, TypeVar

from opencv_tools.base.units import NANO, STANDING
from opencv_tools.image.errors import ImageError, KeyFrameNeeded
from opencv_tools.recording.errors import error_text, LimitReached, UnwritableError
from opencv_tools.recording.folder import Folder
from opencv_tools.recording.frames import ReceivedFrame
from opencv_tools.recording.manifest import ManifestEntry
from opencv_tools.recording.numbering import Numbering, StoredFiles
from opencv_tools.recording.recorder import Prepared, SinkCounts
from opencv_tools.recording.selection import Limits

#: What a writer asks before its file grows: whether the finished file may have a size in bytes. A
#: ring deletes older files for it.
Room = Callable[[int], bool]

P = TypeVar('P', bound=Prepared)

# Delay after an error of the disk before a new file begins.
_RETRY_SECONDS = 2.0
# A new file begins when the disk has room for this multiple of the data that did not fit.
_ROOM = 2
#: Bytes of the disk that a recording with a reserve leaves free.
RESERVE_BYTES = 10**9
# Period of the check whether the file was removed or moved.
_CHECK_SECONDS = 1.0


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


#: Longest step back of the stamps within a file in nanoseconds.
CLOCK_JUMP_NS = NANO
_TICK_NS, _SLOW = NANO // 1000, 20  # of Matroska; times slower than arrivals
W = TypeVar('W', bound=FileWriter)


@dataclass(kw_only=True)
class OpenFile(Generic[W]):
    """
    A file that frames are written to.

    :param entry: manifest entry of the file, without its size and digest.
    :param offset_ns: difference from CLOCK_MONOTONIC to the system clock at the first frame.
    :param began_ns: arrival time of the first frame in nanoseconds of CLOCK_MONOTONIC.
    :param last_ns: the same of the last frame.
    :param is_described: whether the entry describes a frame, not only other messages.
    :param last_time_ns: result of ``time_ns`` for the last frame; 0 before the first one.
    :param last_arrival_ns: arrival time of that frame, as ``began_ns``.
    :param last_stamp_ns: stamp of that frame; 0 for none.
    :param uses_arrivals: whether the stamps of further frames are no times.
    """

    path: Path
    entry: ManifestEntry
    writer: W
    offset_ns: int
    began_ns: int
    is_described: bool
    last_ns: int = 0
    last_time_ns: int = 0
    last_arrival_ns: int = 0
    last_stamp_ns: int = 0
    uses_arrivals: bool = False

    def time_ns(self, frame: ReceivedFrame) -> int:
        """
        Return the time of a frame, independent of changes of the system clock.

        It is the stamp while stamps advance as arrivals do. A stamp that stands still, or steps
        back by up to a second, is replaced by the time of the last frame and the time between both
        arrivals. So are steps of less than a millisecond, if the frames are slower.
        """
        stamp_ns, passed = frame.metadata.stamp_ns, max(0, frame.arrival_ns - self.last_arrival_ns)
        step = stamp_ns - self.last_time_ns
        if not stamp_ns:
            return frame.arrival_ns + self.offset_ns
        is_jump = stamp_ns < self.last_stamp_ns - CLOCK_JUMP_NS
        advances = step * STANDING > passed and (step >= _TICK_NS or step * _SLOW > passed)
        if not (self.last_time_ns and (self.uses_arrivals or not (is_jump or advances))):
            return stamp_ns
        return self.last_time_ns + passed

    def is_over(self, limits: Limits, frame: ReceivedFrame) -> bool:
        """Return whether the file has reached the limits of one file before a frame."""
        writer = self.writer
        size = writer.size + writer.bytes_waiting
        return (0 < limits.max_frames <= writer.frames or 0 < limits.max_bytes <= size
                or 0 < limits.max_ns <= frame.arrival_ns - self.began_ns)

    def removed_text(self) -> str:
        """Return the reason for the loss of frames in a file that is gone."""
        return f'{self.path.name} was removed or moved while it was written'


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


class DiskOutage:
    """Decide when a new file begins after an error of the disk."""

    def __init__(self, monotonic: Callable[[], float]) -> None:
        self._monotonic = monotonic
        self._error: tuple[int, str] | None = None
        self._retry_at = 0.0
        self._needed = 0  # bytes of free space

    def begin(self, err: OSError, bytes_waiting: int) -> None:
        """Delay the next file, because data that wait in memory could not be written."""
        self._error = err.errno or 0, error_text(err)
        self._retry_at = self._monotonic() + _RETRY_SECONDS
        self._needed = max(self._needed, _ROOM * bytes_waiting)

    def attempt(self) -> None:
        """Delay the file after the one that begins now. A frame that is left out begins none."""
        self._retry_at = self._monotonic() + _RETRY_SECONDS

    def end(self) -> None:
        """Note that data were written."""
        self._error, self._needed = None, 0

    def check(self, folder: Path) -> None:
        """
        Check that a new file may begin: it is time, and the disk has room.

        :raises OSError: it may not; the error is that of the disk.
        """
        if self._error and not self._may_retry(folder):
            raise OSError(*self._error)

    def _may_retry(self, folder: Path) -> bool:
        now = self._monotonic()
        if now < self._retry_at:
            return False
        free = _free_bytes(folder)
        if free is None or free >= self._needed:
            return True
        self._retry_at = now + _RETRY_SECONDS
        return False


class FileSink(Generic[W, P]):
    """Write frames to files, which have their final names from the start."""

    def __init__(
        self, folder: Folder, numbering: Numbering, limits: Limits,
        file_format: FileFormat[W, P], monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        """
        Create a sink; the first file begins with the first frame.

        :param folder: output folder, closed together with this sink.
        :param limits: limits of the recording; a ring deletes its oldest files.
        :param monotonic: monotonic clock in seconds.
        """
        self.counts = SinkCounts()
        #: Free bytes of the disk at the last frame; None if they are unknown, or need not be free.
        self.left: int | None = None
        self._folder = folder
        self._limits = limits
        self._limits_of_one = limits.of_one_file()
        self._ring = StoredFiles(folder, numbering, limits) if limits.ring else None
        self._format = file_format
        self._bytes = 0
        self._numbering = numbering
        self._monotonic = monotonic
        self._file: OpenFile[W] | None = None
        self._ended = 0  # frames of finished files
        self._is_full = False
        self._refusal = ''  # of a ring that is too small for a file
        self._outage = DiskOutage(monotonic)
        self._next_check_at = 0.0
        self._paths: set[Path] = set()

    def check_reserve(self) -> None:
        """
        Check that the disk has more than the reserve, if there is one.

        :raises LimitReached: the disk has less.
        """
        if self._limits.has_reserve:
            self.left = _free_bytes(self._folder.path)
            if self.left is not None and self.left < RESERVE_BYTES:
                raise LimitReached(
                    f'the disk has {self.left / 10**6:.0f} MB left, and recordings leave '
                    f'{RESERVE_BYTES / 10**6:.0f} MB free')

    def prepare(self, frame: ReceivedFrame) -> P:
        """Convert a frame for the writer; see `FileFormat`."""
        return self._format.prepare(frame)

    def commit(self, frame: ReceivedFrame, prepared: P) -> Path:
        """
        Write a frame; one thread at a time, in the order of the frames.

        :param prepared: the frame as ``prepare`` returned it.
        :returns: path of the file; ``counts`` counts the frame when it is complete in the file.
        :raises LimitReached: the recording has reached its limits.
        :raises OSError: the file cannot be written; a new one begins when the disk has room.
        :raises KeyFrameNeeded: the frame is left out, because it needs others that are missing.
        """
        self.check_reserve()
        if not self._file:
            self._outage.check(self._folder.path)
        try:
            return self._commit(frame, prepared)
        except OSError as err:
            self._outage.begin(err, self._file.writer.bytes_waiting if self._file else 0)
            self._end_after_error(error_text(err))
            raise
        except KeyFrameNeeded:
            raise  # the file continues with a key frame
        except ImageError as err:
            self._end_after_error(error_text(err))
            raise
        finally:
            self._count()

    def close(self) -> None:
        """
        Finish the file and close the folder.

        :raises OSError: the last frames or the manifest line of the file were not written.
        """
        try:
            if self._file:
                try:
                    self._format.write_others(self._file.writer, None)
                finally:
                    self._end(self._file)
            self._folder.write_deferred()
        finally:
            self._count()
            self._folder.close()

    def _commit(self, frame: ReceivedFrame, prepared: P) -> Path:
        if self._file and self._is_over(self._file, frame, prepared):
            self._end(self._file)
        file = self._write(frame, prepared) or self._write_next(frame, prepared)
        if _has_content(file.writer):
            self._outage.end()
        return file.path

    def _is_over(self, file: OpenFile[W], frame: ReceivedFrame, prepared: P) -> bool:
        """Return whether a file ends before a frame."""
        is_split = (file.is_over(self._limits_of_one, frame)
                    and self._format.can_begin(prepared))
        return is_split or not (
            self._is_at_path(file) and self._format.continues(file, frame, prepared))

    def _write(self, frame: ReceivedFrame, prepared: P) -> OpenFile[W] | None:
        """Write a frame to the file, or to a new one; return None if that has no room."""
        self._format.check(self._file, frame, prepared)
        if self._is_full:
            return None
        file = self._file = self._file or self._numbering.claim(
            frame.metadata, lambda seq, name: self._begin(seq, name, frame, prepared))
        self._format.write_others(file.writer, prepared)
        file.last_ns = frame.arrival_ns
        if frame.count and not file.is_described:
            file.entry, file.is_described = self._format.entry(
                file.entry.seq, file.entry.name, frame, prepared), True
            self._folder.write_journal(file.entry)
        if self._ring:
            self._ring.make_room(replace(
                file.entry, size=file.writer.size, frames=file.writer.frames + 1), file.last_ns)
        return file if self._format.write(file, frame, prepared) else None

    def _write_next(self, frame: ReceivedFrame, prepared: P) -> OpenFile[W]:
        """
        Write a frame to the next file of a ring, because the present one is full.

        :raises LimitReached: there is no ring, so the recording is full.
        :raises UnwritableError: no file of the ring can hold the frame.
        """
        full = self._file
        if not self._ring or not full:
            self._is_full = True
            raise LimitReached(f'max_bytes is {self._limits.max_bytes}')
        self._end(full)
        file = self._write(frame, prepared) if _has_content(full.writer) else None
        if not file:
            raise UnwritableError(self._refusal)
        return file

    def _room_of(self, entry: ManifestEntry, arrival_ns: int) -> Room:
        """Return the room of a file that begins with a frame."""
        ring, limit = self._ring, self._limits.max_bytes
        if ring is None:
            left = limit - self._bytes
            return lambda size: not limit or size <= left

        def make_room(size: int) -> bool:
            try:
                ring.make_room(replace(entry, size=size), arrival_ns)
            except UnwritableError as err:
                self._refusal = str(err)
                return False
            return True

        return make_room

    def _end_after_error(self, reason: str) -> None:
        """Finish a file that cannot be continued."""
        with suppress(OSError, ImageError):  # the error of the frame itself is reported
            if self._file:
                self._end(self._file, reason)

    def _is_at_path(self, file: OpenFile[W]) -> bool:
        """Return whether a file is still at its path; checked once a second."""
        now = self._monotonic()
        if now < self._next_check_at:
            return True
        self._next_check_at = now + _CHECK_SECONDS
        return file.writer.is_at_path()

    def _begin(self, seq: int, name: str, frame: ReceivedFrame, prepared: P) -> OpenFile[W]:
        self._outage.attempt()
        self._folder.recreate()
        self._folder.write_deferred()
        path = self._folder.path / name
        if self._numbering.replaces and path not in self._paths:
            path.unlink(missing_ok=True)
            self._folder.remove_stale_lines(self._numbering.names)
        entry = self._format.entry(seq, name, frame, prepared)
        writer = self._format.create(
            path, frame, prepared, self._room_of(entry, frame.arrival_ns))
        try:
            self._folder.write_journal(entry)
        except OSError:
            writer.close()
            raise
        self._paths.add(path)
        return OpenFile(path=path, entry=entry, writer=writer, began_ns=frame.arrival_ns,
                        offset_ns=frame.receive_ns - frame.arrival_ns,
                        is_described=frame.count > 0)

    def _end(self, file: OpenFile[W], reason: str = '') -> None:
        """
        Finish a file and add its line to the manifest, now or when the disk has room.

        :param reason: reason for the loss of frames that are not flushed.
        :raises OSError: these frames were not written.
        :raises ImageError: the file was not finished.
        """
        self._file = None
        writer = file.writer
        is_at_path = writer.is_at_path()
        try:
            writer.close()
        except (OSError, ImageError) as err:
            reason = reason or error_text(err)
            raise
        finally:
            problem = self._add_line(file) if is_at_path else file.removed_text()
            kept = 0 if problem else writer.flushed
            skipped = 0 if self._ring else writer.skipped
            lost = writer.frames - skipped - kept
            self._ended += kept
            self._is_full = self._is_full or (writer.is_full and not self._ring)
            self.counts.skipped += skipped
            lost_others = writer.others if problem else 0
            if lost or lost_others:
                self.counts.lost += lost
                self.counts.lost_others += lost_others
                self.counts.reason = problem or reason or self._refusal

    def _add_line(self, file: OpenFile[W]) -> str:
        """Add or keep the manifest line of a file; return the problem with the file, or ''."""
        if not _has_content(file.writer):
            return ''
        try:
            entry = self._format.measured(file, self._folder.path)
        except FileNotFoundError:
            return file.removed_text()
        except OSError as err:
            return error_text(err)
        self._bytes += entry.size
        if self._ring:
            self._ring.add(replace(entry, frames=file.writer.frames), file.last_ns)
        self._folder.defer_line(replace(entry, frames=file.writer.flushed))
        with suppress(OSError):  # the line is added before the next file, or at the end
            self._folder.write_deferred()
        return ''

    def _count(self) -> None:
        self.counts.warning = self._format.warning or self._numbering.notice
        self.counts.kept = self._ended + (self._file.writer.flushed if self._file else 0)


def _free_bytes(folder: Path) -> int | None:
    """Return the free space of a disk; None for a removed folder, which is created again."""
    try:
        disk = os.statvfs(folder)
    except OSError:
        return None
    return disk.f_bavail * disk.f_frsize


def _has_content(writer: FileWriter) -> bool:
    """Return whether a frame or another message is complete in a file."""
    return writer.flushed > 0 or writer.others > 0
