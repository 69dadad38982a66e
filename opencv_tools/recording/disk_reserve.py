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


"""A bag that leaves space on the disk for others."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from opencv_tools.image.errors import ImageError
from opencv_tools.recording.bag_file import RecordedMessage
from opencv_tools.recording.bag_sink import BagSink
from opencv_tools.recording.errors import LimitReached
from opencv_tools.recording.frames import ReceivedFrame

#: Bytes of the disk that a recording leaves free.
RESERVE_BYTES = 10**9


class SinkWithReserve:
    """A sink of a bag that ends the recording before the disk is full."""

    def __init__(self, sink: BagSink, folder: Path) -> None:
        self.counts = sink.counts
        #: Free space of the disk in bytes at the last frame; None if it is unknown.
        self.left: int | None = None
        #: Why the recording has ended; '' until then.
        self.refusal = ''
        #: Whether the end of the bag could not be written.
        self.is_cut_off = False
        self._sink = sink
        self._folder = folder

    def check(self) -> None:
        """
        Check that the disk has more than the reserve.

        :raises LimitReached: it has less.
        """
        try:
            disk = os.statvfs(self._folder)
        except OSError:
            self.left = None  # the sink creates a removed folder again, or reports the error
            return
        self.left = disk.f_bavail * disk.f_frsize
        if self.left < RESERVE_BYTES:
            self.refusal = (f'the disk has {self.left / 10**6:.0f} MB left, and recordings leave '
                            f'{RESERVE_BYTES / 10**6:.0f} MB free')
            raise LimitReached(self.refusal)

    def prepare(self, frame: ReceivedFrame) -> Any:
        """Convert a frame to a message; see `Sink`."""
        return self._sink.prepare(frame)

    def commit(self, frame: ReceivedFrame, prepared: Any) -> Path:
        """
        Write a frame; see `Sink`.

        :raises LimitReached: the disk has less than the reserve.
        """
        self.check()
        return self._sink.commit(frame, prepared)

    def add_message(self, message: RecordedMessage) -> None:
        """Add a message that is not a frame; see `BagSink`."""
        self._sink.add_message(message)

    def close(self) -> None:
        """
        Finish the bag.

        :raises OSError: the disk is full, or another error; the bag is not finished.
        :raises ImageError: the bag cannot be finished.
        """
        try:
            self._sink.close()
        except (OSError, ImageError):
            self.is_cut_off = True
            raise
