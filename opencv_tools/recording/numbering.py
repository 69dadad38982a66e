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

"""Numbers and names of new files, and the deletion of the oldest files of a ring."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import errno
import itertools
import os
from typing import TypeVar

from opencv_tools.base.text import printable
from opencv_tools.recording.errors import RecordingError
from opencv_tools.recording.folder import Folder
from opencv_tools.recording.manifest import ManifestEntry
from opencv_tools.recording.naming import FileNames, FrameMetadata, numbered_copy
from opencv_tools.recording.selection import Limits, Retention

T = TypeVar('T')

_SHOWN = 40  # characters of a long name in an error message

#: Handling of files that exist already.
ON_EXISTS = ('continue', 'error', 'overwrite')


class Numbering:
    """Find the next free file name."""

    def __init__(self, names: FileNames, folder: Folder, on_exists: str) -> None:
        """
        Find the number after the existing files, or 0 if they may be overwritten.

        :param on_exists: one of ``ON_EXISTS``.
        :raises RecordingError: matching files exist, and ``on_exists`` is ``error``.
        :raises OSError: the folder cannot be read.
        """
        self.replaces = on_exists == 'overwrite'
        self.names = names
        self._only_free = on_exists == 'error'
        self._copy = ('', 0)
        #: That the first file has another name, because there was one of its name; '' if not.
        self.notice = ''
        existing = [path.name for path in folder.path.iterdir()
                    if not path.name.startswith('.') and names.matches(path.name)]
        if existing and self._only_free:
            raise RecordingError(
                f'output_dir {folder.path} already contains {printable(min(existing))}; '
                'set output_dir to another folder, or on_exists to continue or overwrite')
        numbers = (entry.seq + 1 for entry in folder.manifest.tail() if names.matches(entry.name))
        self._seq = 0 if self.replaces else max(names.next_seq(existing), *numbers, 0)
        self._first = self._seq

    def claim(self, metadata: FrameMetadata, make: Callable[[int, str], T]) -> T:
        """
        Create a file under the next free name.

        :param metadata: metadata of the frame, for the name.
        :param make: creates the file of a number and a name; called until a name is free.
        :returns: the result of ``make``.
        :raises FileExistsError: the name exists, and ``on_exists`` is ``error``.
        :raises OSError: the file cannot be created; its number is not used.
        """
        for seq, name in self._candidates(metadata):
            try:
                made = make(seq, name)
            except FileExistsError:
                continue
            except OSError as err:
                if err.errno != errno.ENAMETOOLONG:
                    raise
                raise OSError(
                    err.errno, f'the file name {printable(name, _SHOWN)} has '
                    f'{len(os.fsencode(name))} bytes, too long for the file system (usually 255); '
                    'shorten file_name') from err
            if self._copy[1] and self._seq == self._first:
                self.notice = (f'{self._copy[0]} exists already: the recording is written to '
                               f'{name}')
            self._seq += 1
            return made
        raise FileExistsError(errno.EEXIST, f'{name} exists already')

    def _candidates(self, metadata: FrameMetadata) -> Iterator[tuple[int, str]]:
        """Yield numbers and names to try until one is free."""
        name = self.names.name(self._seq, metadata)
        if self._only_free:
            yield self._seq, name
        elif self.names.is_numbered:
            while True:
                yield self._seq, name
                self._seq += 1
                name = self.names.name(self._seq, metadata)
        else:
            first = self._copy[1] if self._copy[0] == name else 0
            for copy in itertools.count(first):
                self._copy = name, copy
                yield self._seq, numbered_copy(name, copy) if copy else name


class StoredFiles:
    """Delete the oldest files of a ring, and the lines of deleted files in the manifest."""

    def __init__(
        self, folder: Folder, numbering: Numbering, limits: Limits, stale_lines: int = 0,
    ) -> None:
        """
        Read the manifest of the existing files, which a ring deletes, too.

        :param numbering: names of the files; other files are never deleted.
        :param stale_lines: number of lines of deleted files that may stay in the manifest, if
            there are not more files than that.
        :raises OSError: the manifest cannot be read.
        """
        self._folder = folder
        self._numbering = numbering
        self._deletes = limits.ring or numbering.replaces
        self._most_stale = stale_lines
        self._stale = 0
        self.compact()
        entries = folder.manifest.entries() if limits.ring else []
        self._retention = Retention(
            limits, [entry for entry in entries if numbering.names.matches(entry.name)])

    def make_room(self, entry: ManifestEntry, arrival_ns: int) -> None:
        """
        Delete the oldest files until a file is within the limits.

        :param entry: manifest entry of the file, with the size and frames that it will have.
        :param arrival_ns: arrival time of its last frame, in nanoseconds of CLOCK_MONOTONIC.
        :raises LimitReached, UnwritableError: see `Retention.make_room`.
        :raises OSError: a file cannot be deleted, or the manifest cannot be rewritten.
        """
        deleted = self._retention.make_room(entry, arrival_ns)
        for name in deleted:
            (self._folder.path / name).unlink(missing_ok=True)
        self._retention.remove(deleted)
        self.remove_lines(len(deleted))

    def add(self, entry: ManifestEntry, arrival_ns: int) -> None:
        """Count a file that was written."""
        self._retention.add(entry, arrival_ns)

    def remove_lines(self, count: int) -> None:
        """Note that the manifest has lines of deleted files, and remove them if there are many."""
        self._stale += count
        if self._stale > self._most_stale and self._stale > (
                self._retention.count if self._most_stale else 0):
            self.compact()

    def compact(self) -> None:
        """Remove the lines of deleted and replaced files from the manifest."""
        self._stale = 0
        if self._deletes:
            self._folder.remove_stale_lines(self._numbering.names)

    def close(self) -> None:
        """Remove the last lines of deleted files from the manifest."""
        if self._stale:
            self.compact()
