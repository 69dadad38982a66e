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

"""The folder of a recording: files in it are whole or not there, and have a line each."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
import errno
import fcntl
import itertools
import os
from pathlib import Path
import re
import secrets
from threading import Lock
from typing import Any

from opencv_tools.recording.killed_video import count_frames
from opencv_tools.recording.manifest import Entry, is_file, Manifest, parse_line
from opencv_tools.regular_files import open_regular, RefusedFileError

# Every run has a journal, and temporary files with its name before theirs.
_PREFIX, _JOURNAL, _TEMPORARY = '.recording-', '.journal', '.part'
_OWN = re.compile(r'\.recording-[0-9a-z]+-')
_LINE = 1 << 24

# Lines that the manifest could not take, at most. A file begins only where there is room for it,
# so that there are few.
_MOST_OWED = 100

# What file systems say that have no hard links, or no more for this file.
_NO_LINKS = frozenset((errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK))


class RecordingError(Exception):
    """A folder that cannot be recorded to; the message says why."""


class Folder:
    """
    Write files under temporary names, and give them theirs with their line in the manifest.

    A journal, locked as long as this lives, holds the line of the file that gets its name next,
    behind those that the manifest could not take. So whoever finds an abandoned one knows which
    temporary files nobody will finish, and which files were left without their line.
    """

    def __init__(self, path: Path, sync: bool = False) -> None:
        """
        Make the folder when it is missing, and clean up behind recordings that were killed.

        :param path: where the files go.
        :param sync: have each file on the disk, not only in memory, before it gets its name.
        :raises RecordingError: the folder cannot be made or written to.
        """
        self.path = path
        self.manifest = Manifest(path)
        self._sync = sync
        self._journal = -1
        self._owed: list[Entry] = []
        self._numbers = itertools.count()
        self._making = Lock()
        try:
            path.mkdir(parents=True, exist_ok=True)
            self._open_journal()
            self._recover()
        except OSError as err:
            self.close()
            raise RecordingError(f'output_dir {path} cannot be used: {err.strerror}') from err

    def names(self) -> list[str]:
        """
        Name the files there are, without those that are hidden.

        :raises OSError: the folder cannot be read.
        """
        return [path.name for path in self.path.iterdir() if not path.name.startswith('.')]

    def write(self, data: Any) -> Path:
        """
        Write a file under a temporary name; more than one thread may.

        :param data: a buffer of its content.
        :returns: where it is.
        :raises OSError: it cannot be written; then nothing is left of it.
        """
        try:
            return self._write(data)
        except FileNotFoundError:
            self.make_again()
            return self._write(data)

    def publish(self, temporary: Path, entry: Entry, replace: bool) -> Path:
        """
        Give a file its name, and its line in the manifest; one thread at a time may.

        :param temporary: what ``write`` gave.
        :param entry: what the file is called, and its line.
        :param replace: whether it may take the place of another file.
        :returns: where it is now.
        :raises FileExistsError: there is such a file already, and it is not to be replaced.
        :raises OSError: it cannot be renamed, or has no line; then it is not there.
        """
        target = self.path / entry.name
        self.announce(entry)
        if replace:
            temporary.replace(target)
        else:
            _move(temporary, target)
        try:
            self.manifest.append(entry)
        except OSError:
            target.unlink(missing_ok=True)
            raise
        return target

    def make_again(self) -> None:
        """
        Make the folder again if it was removed, but not what it was in: that may be a mount.

        :raises OSError: it cannot be made.
        """
        with self._making:
            self.path.mkdir(exist_ok=True)
            if not self._journal_path.exists():
                os.close(self._journal)
                self._open_journal()

    def announce(self, entry: Entry) -> None:
        """
        Tell the journal of a file that gets its name now.

        :param entry: its line, without a digest when its content is yet to come.
        :raises OSError: the journal cannot be written to.
        """
        self._write_journal(*self._owed, entry)

    def owe_line(self, entry: Entry) -> None:
        """
        Keep the line of a file, which it gets with ``settle``.

        :param entry: the line.
        """
        self._owed = [*self._owed, entry][-_MOST_OWED:]

    def settle(self) -> None:
        """
        Add the lines that are owed; those of files that are no more are dropped.

        :raises OSError: the manifest cannot be written to; what is left is owed on.
        """
        while self._owed:
            if (self.path / self._owed[0].name).exists():
                self.manifest.append(self._owed[0])
            self._owed = self._owed[1:]

    def close(self) -> None:
        """Leave the folder as others expect it: without a journal, unless it owes a line."""
        if self._journal >= 0:
            with suppress(OSError):  # of a disk that is gone; the next recording removes it
                if self._owed:
                    self._write_journal(*self._owed)
                else:
                    self._journal_path.unlink(missing_ok=True)
            os.close(self._journal)
            self._journal = -1

    def _write_journal(self, *entries: Entry) -> None:
        """Write lines over those that are there; an empty one is their end."""
        os.pwrite(self._journal, b''.join(entry.line() for entry in entries) + b'\n', 0)

    def _write(self, data: Any) -> Path:
        temporary = self.path / f'{self._prefix}{next(self._numbers)}{_TEMPORARY}'
        try:
            with temporary.open('xb', buffering=0) as file:
                _write_all(file.fileno(), data)
                if self._sync:
                    os.fsync(file.fileno())
        except OSError:
            temporary.unlink(missing_ok=True)
            raise
        return temporary

    def _open_journal(self) -> None:
        while True:
            self._prefix = f'{_PREFIX}{secrets.token_hex(4)}-'
            self._journal_path = self.path / f'{self._prefix}{_JOURNAL}'
            self._journal = os.open(
                self._journal_path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
            _try_lock(self._journal)
            if is_file(self._journal, self._journal_path):
                return
            os.close(self._journal)  # one that cleaned up was quicker than the lock

    def _recover(self) -> None:
        """Remove what recordings left that were killed, and add the line that one may lack."""
        hidden = [path.name for path in self.path.glob(f'{_PREFIX}*')]
        for name in hidden:
            prefix = name.removesuffix(_JOURNAL)
            if prefix == name or prefix == self._prefix or not _OWN.fullmatch(prefix):
                continue
            try:
                journal = open_regular(self.path / name, os.O_RDWR, follow=False)
            except FileNotFoundError:
                continue  # another one that begins has cleaned up
            try:
                if _try_lock(journal):
                    self._complete(os.pread(journal, min(os.fstat(journal).st_size, _LINE), 0))
                    _remove(self.path / other for other in hidden if other.startswith(prefix))
            finally:
                os.close(journal)

    def _complete(self, journal: bytes) -> None:
        """Add the last lines of a recording that was killed before it could, if it was."""
        for line in journal.split(b'\n'):
            try:
                entry = parse_line(line)
            except ValueError:
                return  # behind the last of them, or killed before it gave a file its name
            with suppress(FileNotFoundError, RefusedFileError):
                self._complete_file(entry)

    def _complete_file(self, entry: Entry) -> None:
        found = entry.measured(self.path)
        # The name may be that of another recording's file, even with the same frame in it.
        if entry.sha256 not in ('', found.sha256) or any(
                (line.name, line.sha256) == (entry.name, found.sha256)
                for line in self.manifest.entries()):
            return
        if not entry.sha256:
            path = self.path / entry.name
            frames = count_frames(path)
            if frames == 0:
                path.unlink()
                return
            found = replace(found, frames=frames or 0)
        self.manifest.append(found)


def _write_all(file: int, data: Any) -> None:
    rest = memoryview(data).cast('B')
    while rest:
        rest = rest[os.write(file, rest):]


def _move(source: Path, target: Path) -> None:
    """
    Rename a file, but never over another one.

    :raises FileExistsError: there is one.
    """
    try:
        os.link(source, target)
    except OSError as err:
        if err.errno not in _NO_LINKS:
            raise
        if os.path.lexists(target):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target)) from err
        source.rename(target)
    else:
        source.unlink()


def _try_lock(file: int) -> bool:
    """Lock a file, unless a process that lives has it."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False  # locked, or on a file system where nobody can tell
    return True


def _remove(paths: Iterable[Path]) -> None:
    for path in paths:
        path.unlink(missing_ok=True)
