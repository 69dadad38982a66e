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

"""Interface of the formats whose files hold many frames: videos and bags."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Generic, TypeVar

from opencv_tools.recording.frames import ReceivedFrame
from opencv_tools.recording.manifest import ManifestEntry
from opencv_tools.recording.open_file import OpenFile, W
from opencv_tools.recording.recorder import Prepared

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
    def open(self, path: Path, frame: ReceivedFrame, prepared: P, room: int) -> W:
        """Create a file of at most ``room`` bytes, 0 for any size; the frame is not written."""

    @abstractmethod
    def entry(self, seq: int, name: str, frame: ReceivedFrame, prepared: P) -> ManifestEntry:
        """Return the manifest entry of a file that begins with a frame."""

    @abstractmethod
    def size_with(self, writer: W, prepared: P) -> int:
        """Return the largest size in bytes that a finished file of a ring has with a frame."""

    @abstractmethod
    def write(self, file: OpenFile[W], frame: ReceivedFrame, prepared: P) -> bool:
        """Write a frame; return False if it would exceed the maximum size."""

    def continues(self, file: OpenFile[W], frame: ReceivedFrame, prepared: P) -> bool:
        """Return whether a frame can continue a file."""
        return True

    def write_others(self, writer: W, prepared: P | None) -> None:
        """Write what was received before a frame, or at the end, but is no frame itself."""

    def measured(self, file: OpenFile[W], folder: Path) -> ManifestEntry:
        """Return the manifest entry of a closed file, with its size and its digest."""
        return file.entry.measured(folder)
