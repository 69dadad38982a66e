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

"""A bag that messages are written to."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from opencv_tools.bags.writing import BagChannel, BagWriter
from opencv_tools.image.cdr import WireMessage
from opencv_tools.recording.file_format import Room
from opencv_tools.recording.frames import ReceivedFrame
from opencv_tools.recording.manifest import ManifestEntry
from opencv_tools.recording.recorder import Prepared
from opencv_tools.video.messages import WireVideo


@dataclass(frozen=True, kw_only=True)
class RecordedMessage(Prepared):
    """
    A message for a bag.

    :param parts: buffers with its CDR, in order.
    :param log_ns: time of reception in nanoseconds of the system clock.
    :param publish_ns: time of publication in nanoseconds of the system clock.
    :param number: number of the message from its publisher; 0 if unknown.
    """

    channel: BagChannel
    parts: tuple[Any, ...]
    log_ns: int
    publish_ns: int
    number: int = 0

    @property
    def size(self) -> int:
        """Size of the CDR in bytes."""
        return sum(memoryview(part).nbytes for part in self.parts)


@dataclass(frozen=True, kw_only=True)
class RecordedImage(RecordedMessage):
    """
    A frame for a bag.

    :param image: the message with an image or video.
    """

    image: WireMessage | WireVideo


@dataclass(kw_only=True)
class BatchResult:
    """The first ``written`` messages of a batch are in a file."""

    written: int = 0


@dataclass(frozen=True, kw_only=True)
class MessageBatch(ReceivedFrame, Prepared):
    """
    Messages of other topics, which are written together as a frame is.

    :param messages: the messages, oldest first.
    """

    count: ClassVar[int] = 0
    messages: tuple[RecordedMessage, ...]
    result: BatchResult = field(default_factory=BatchResult)

    @property
    def log_ns(self) -> int:
        """Time of reception of the first message in nanoseconds of the system clock."""
        return self.messages[0].log_ns


class BagFile:
    """A bag as a file of frames; see `FileWriter`."""

    def __init__(self, path: Path, room: Room) -> None:
        """
        Create the file.

        :param room: asked before each message.
        :raises FileExistsError: the file exists; it is not changed.
        :raises OSError: the file cannot be written.
        """
        self.frames = self.flushed = self.skipped = self.bytes_waiting = 0
        self.is_full = self.is_finished = False
        self.others = 0  # messages of batches
        self._path = path
        self._room = room
        self._writer = BagWriter(path)
        self.is_at_path = self._writer.is_at_path

    @property
    def size(self) -> int:
        """Size of the file in bytes."""
        return self._writer.size

    def write(self, message: RecordedMessage, is_frame: bool = True) -> bool:
        """
        Write a message; it is in the file when this method returns.

        :param is_frame: whether the message is counted.
        :returns: False if the message would exceed the maximum size.
        :raises OSError: the file cannot be written; it has all earlier messages.
        """
        if not self._room(self._writer.size_with(message.channel, message.size)):
            self.is_full = self.is_full or is_frame
            return False
        self._write(message)
        self.frames += is_frame
        self.flushed = self.frames
        return True

    def write_batch(self, batch: MessageBatch) -> bool:
        """
        Write the messages of a batch that are not written yet.

        :returns: False if a message would exceed the maximum size.
        :raises OSError: the file cannot be written; it has all earlier messages.
        """
        for message in batch.messages[batch.result.written:]:
            if not self._room(self._writer.size_with(message.channel, message.size)):
                self.is_full = True
                return False
            self._write(message)
            batch.result.written += 1
            self.others += 1
        return True

    def _write(self, message: RecordedMessage) -> None:
        self.bytes_waiting = message.size
        self._writer.write(
            message.channel, message.parts, log_ns=message.log_ns, publish_ns=message.publish_ns,
            sequence=message.number)
        self.bytes_waiting = 0

    def close(self) -> None:
        """
        Finish the file; remove it if it is empty.

        :raises OSError: the summary cannot be written; the next recording writes it.
        """
        try:
            self._writer.close()
            self.is_finished = True
        except OSError as err:
            raise OSError(
                err.errno, f'{err.strerror}: {self._path.name} has no index yet, which the next '
                'recording in its folder adds') from err
        finally:
            if not (self.frames or self.others) and self.is_at_path():
                self._path.unlink(missing_ok=True)

    def measured(self, entry: ManifestEntry) -> ManifestEntry:
        """Return a manifest entry with the size, and the digest if the file is finished."""
        return replace(entry, size=self._writer.size,
                       sha256=self._writer.sha256 if self.is_finished else '')
