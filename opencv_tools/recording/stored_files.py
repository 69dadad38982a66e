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

"""The files of a recording within its limits; a ring deletes the oldest ones."""

from __future__ import annotations

from opencv_tools.recording.folder import Folder
from opencv_tools.recording.manifest import ManifestEntry
from opencv_tools.recording.numbering import Numbering
from opencv_tools.recording.selection import Limits, Retention


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
