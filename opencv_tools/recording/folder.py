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

"""Output folder of a recording: atomic files, the manifest and its journal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
import errno
import itertools
import os
from pathlib import Path
import re
import secrets
from threading import Lock
from types import MappingProxyType
from typing import Any

from opencv_tools.base.regular_files import (
    is_same_file, open_regular, RefusedFileError, try_lock, write_new)
from opencv_tools.recording.manifest import Manifest, ManifestEntry, parse_line
from opencv_tools.recording.naming import FileNames

# Each recording has a journal. The names of its temporary files begin with the same prefix.
_PREFIX, _JOURNAL, _TEMPORARY = '.recording-', '.journal', '.part'
_OWN = re.compile(r'\.recording-[0-9a-z]+-')
_LINE = 1 << 24


class Journal:
    """A file that is locked while its recording runs."""

    def __init__(self, folder: Path) -> None:
        """
        Create the journal of a new recording.

        :raises OSError: the folder cannot be written to.
        """
        self._folder = folder
        self._numbers = itertools.count()
        self._file = -1
        self._open()

    def temporary_path(self) -> Path:
        """Return the path of a new temporary file; thread-safe."""
        return self._folder / f'{self._prefix}{next(self._numbers)}{_TEMPORARY}'

    def write(self, *entries: ManifestEntry) -> None:
        """
        Overwrite the journal with entries.

        :raises OSError: the journal cannot be written.
        """
        # An empty line marks the end.
        os.pwrite(self._file, b''.join(entry.line() for entry in entries) + b'\n', 0)

    def recreate(self) -> None:
        """Create the journal again if it was removed."""
        if not self._path.exists():
            os.close(self._file)
            self._open()

    def close(self, *entries: ManifestEntry) -> None:
        """Keep the journal with entries for the next recording; remove it if there are none."""
        if self._file >= 0:
            with suppress(OSError):  # the disk is gone; the next recording removes the journal
                if entries:
                    self.write(*entries)
                else:
                    self._path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = -1

    def killed(self) -> Iterator[Iterator[ManifestEntry]]:
        """
        Yield the entries of each recording that was killed; then remove its hidden files.

        :raises OSError: a journal is no regular file, or cannot be read.
        """
        hidden = [path.name for path in self._folder.glob(f'{_PREFIX}*')]
        for name in hidden:
            prefix = name.removesuffix(_JOURNAL)
            if prefix == name or prefix == self._prefix or not _OWN.fullmatch(prefix):
                continue
            try:
                journal = open_regular(self._folder / name, os.O_RDWR, follow=False)
            except FileNotFoundError:
                continue  # another recording removed it
            try:
                if try_lock(journal):
                    yield _entries(os.pread(journal, min(os.fstat(journal).st_size, _LINE), 0))
                    for other in hidden:
                        if other.startswith(prefix):
                            (self._folder / other).unlink(missing_ok=True)
            finally:
                os.close(journal)

    def _open(self) -> None:
        while True:
            self._prefix = f'{_PREFIX}{secrets.token_hex(4)}-'
            self._path = self._folder / f'{self._prefix}{_JOURNAL}'
            self._file = os.open(
                self._path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
            try_lock(self._file)
            if is_same_file(self._file, self._path):
                return
            os.close(self._file)  # another recording removed the journal before the lock


def _entries(journal: bytes) -> Iterator[ManifestEntry]:
    for line in journal.split(b'\n'):
        try:
            yield parse_line(line)
        except ValueError:
            return  # the end of the entries, or a recording that was killed before the first


# Maximum number of manifest lines that wait because the disk is full. Few lines wait, because a
# new file begins only if the disk has room for it.
_MAX_DEFERRED = 100

# Files of killed recordings that are larger have no digest, because a start must not take minutes.
_MAX_HASHED_BYTES = 1 << 30

# Errors of a file system without hard links, or with too many links to a file.
_NO_LINKS = frozenset((errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK))

#: Functions that finish a file of a killed recording, by its extension. They return the number of
#: its frames: 0 for a file that is to be removed, None if the number is unknown.
Finishers = Mapping[str, Callable[[Path], int | None]]


class Folder:
    """
    Write files under temporary names, then rename them and add their lines to the manifest.

    The journal holds the lines that the manifest could not take, and the line of the file that is
    renamed next. The next recording removes the temporary files of a killed one and completes the
    manifest.
    """

    def __init__(
        self, path: Path, sync: bool = False, finishers: Finishers = MappingProxyType({}),
    ) -> None:
        """
        Create the folder if needed and remove leftovers of killed recordings.

        :param sync: whether each file is flushed to disk before it gets its final name.
        :raises OSError: the folder cannot be created or written to.
        """
        self.path = path
        self.manifest = Manifest(path)
        self._sync = sync
        self._finishers = finishers
        self._deferred: list[ManifestEntry] = []
        self._lock = Lock()
        path.mkdir(parents=True, exist_ok=True)
        self._journal = Journal(path)
        try:
            for entries in self._journal.killed():
                for entry in entries:
                    with suppress(FileNotFoundError, RefusedFileError):
                        self._complete_file(entry)
        except OSError:
            self.close()
            raise

    def write(self, parts: Iterable[Any]) -> Path:
        """
        Write a temporary file; thread-safe.

        :param parts: buffers with the content, in order.
        :returns: path of the temporary file.
        :raises OSError: the file cannot be written; the incomplete file is removed.
        """
        try:
            return self._write(parts)
        except FileNotFoundError:  # before the first part
            self.recreate()
            return self._write(parts)

    def publish(self, temporary: Path, entry: ManifestEntry, replace: bool) -> Path:
        """
        Rename a temporary file and add its line to the manifest; one thread at a time.

        If the folder becomes read-only in between, the file stays, and its line is deferred.

        :param temporary: path returned by ``write``.
        :param entry: manifest entry with the final name.
        :param replace: whether an existing file of this name is replaced.
        :returns: final path.
        :raises FileExistsError: a file of this name exists, and ``replace`` is False.
        :raises OSError: the file cannot be renamed, or the manifest cannot be written; no file
            of this name is left.
        """
        target = self.path / entry.name
        self.write_deferred()
        self.write_journal(entry)
        if replace:
            temporary.replace(target)
        else:
            _move(temporary, target)
        try:
            self.manifest.append(entry)
        except OSError:
            try:
                target.unlink(missing_ok=True)
            except OSError:
                self.defer_line(entry)
                return target
            raise
        return target

    def recreate(self) -> None:
        """
        Create the folder again if it was removed, but not its parent, which may be a mount point.

        :raises OSError: the folder cannot be created.
        """
        with self._lock:
            self.path.mkdir(exist_ok=True)
            self._journal.recreate()

    def write_journal(self, entry: ManifestEntry) -> None:
        """
        Write the entry of the next file to the journal.

        :param entry: manifest entry, without a digest if the content is not written yet.
        :raises OSError: the journal cannot be written.
        """
        self._journal.write(*self._deferred, entry)

    def defer_line(self, entry: ManifestEntry) -> None:
        """Keep an entry in memory until ``write_deferred`` writes it to the manifest."""
        self._deferred = [*self._deferred, entry][-_MAX_DEFERRED:]

    def write_deferred(self) -> None:
        """
        Write the kept entries to the manifest; skip those whose file was removed.

        :raises OSError: the manifest cannot be written; the remaining entries are kept.
        """
        while self._deferred:
            if (self.path / self._deferred[0].name).exists():
                if self._deferred[0].sha256:
                    self.manifest.append(self._deferred[0])
                else:
                    self._complete_file(self._deferred[0])
            self._deferred = self._deferred[1:]

    def update_line(self, name: str, frames: int | None) -> None:
        """
        Replace the line of a file that has changed, if the manifest has one.

        :param frames: number of its frames; None if it has not changed.
        :raises OSError: the file cannot be read, or the manifest cannot be written.
        """
        if frames is None:
            return
        entry = {line.name: line for line in self.manifest.entries()}.get(name)
        if entry:
            self.manifest.replace(
                _measured(self.path, replace(entry, sha256='', frames=frames)), self.write)

    def remove_stale_lines(self, names: FileNames) -> None:
        """
        Remove the lines of deleted and replaced files from the manifest.

        :param names: template of the files; the last line of every other file is kept.
        :raises OSError: the manifest cannot be rewritten.
        """
        self.manifest.compact(
            lambda entry: not names.matches(entry.name) or (self.path / entry.name).exists(),
            self.write)

    def close(self) -> None:
        """Remove the journal, unless it holds an entry that the manifest does not have."""
        self._journal.close(*self._deferred)

    def _write(self, parts: Iterable[Any]) -> Path:
        temporary = self._journal.temporary_path()
        write_new(temporary, parts, self._sync)
        return temporary

    def _complete_file(self, entry: ManifestEntry) -> None:
        path = self.path / entry.name
        finish = None if entry.sha256 else self._finishers.get(path.suffix.lower())
        frames = finish(path) if finish else None
        found = _measured(self.path, entry)
        # Another recording may have written a file of this name, even with the same content.
        if entry.sha256 not in ('', found.sha256) or any(
                (line.name, line.sha256) == (entry.name, found.sha256)
                for line in self.manifest.entries()):
            return
        if not entry.sha256:
            if frames == 0:
                path.unlink()
                return
            found = replace(found, frames=frames or 0)
        self.manifest.replace(found, self.write)


def _measured(folder: Path, entry: ManifestEntry) -> ManifestEntry:
    """Return an entry with its size and its digest, which a long unfinished file has not."""
    size = (folder / entry.name).lstat().st_size
    if not entry.sha256 and size > _MAX_HASHED_BYTES:
        return replace(entry, size=size)
    return entry.measured(folder)


def _move(source: Path, target: Path) -> None:
    """Rename a file; raise a FileExistsError if the target exists."""
    try:
        os.link(source, target)
    except OSError as err:
        if err.errno not in _NO_LINKS:
            raise
        if os.path.lexists(target):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target)) from err
        source.rename(target)
    else:
        with suppress(OSError):  # the next recording removes it
            source.unlink()
