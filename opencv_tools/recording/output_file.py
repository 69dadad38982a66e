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

"""Output file for FFmpeg that keeps its complete part when the disk is full."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from opencv_tools.regular_files import is_same_file, write_buffer


class OutputFile:
    """
    A new file that FFmpeg writes to.

    Write errors are stored here instead of raised, because FFmpeg would replace them by its own.
    """

    def __init__(self, path: Path) -> None:
        self.size = 0
        self.error: OSError | None = None
        self._path = path
        self.raw = path.open('xb', buffering=0)  # not ``close``, which PyAV would call
        self.seek, self.tell = self.raw.seek, self.raw.tell

    def write(self, data: bytes) -> int:
        """Write all data; ignore data after an error."""
        if self.error is None:
            try:
                write_buffer(self.raw, data)
            except OSError as err:
                self.error = err.with_traceback(None)  # the traceback would keep the encoder alive
            self.size = max(self.size, self.raw.tell())
        return len(data)

    def is_at_path(self) -> bool:
        """Return whether the file is still at its path, or that cannot be determined."""
        try:
            return is_same_file(self.raw.fileno(), self._path)
        except OSError:  # the folder cannot be read now
            return True

    def check(self, whole: int) -> None:
        """
        Raise the stored write error, if any.

        :param whole: size of the complete part in bytes; after an error the rest is truncated.
        :raises OSError: a write failed.
        """
        if self.error is not None:
            with suppress(OSError):
                self.size = self.raw.truncate(whole)
            raise OSError(self.error.errno, self.error.strerror, str(self._path)) from self.error
