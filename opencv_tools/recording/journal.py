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

"""Journal of a recording: lines that its manifest does not have yet, and its temporary files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import itertools
import os
from pathlib import Path
import re
import secrets

from opencv_tools.recording.manifest import ManifestEntry, parse_line
from opencv_tools.regular_files import is_same_file, open_regular, try_lock

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
