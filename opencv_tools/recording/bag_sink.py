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

"""Recording of messages in bags, bit for bit as they were received."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
import time
from typing import Any

from opencv_tools.bags.errors import BagError
from opencv_tools.bags.finishing import finish_bag, has_footer
from opencv_tools.bags.schemas import COMPRESSED_IMAGE, IMAGE
from opencv_tools.bags.writing import BAG_SUFFIX, BagChannel, BagWriter
from opencv_tools.image.cdr import (
    message_to_cdr_parts, WireCompressedImage, WireHeader, WireImage, WireMessage,
)
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import SizeError
from opencv_tools.image.image_size import image_size
from opencv_tools.image.layout import array_to_wire
from opencv_tools.recording.errors import UnwritableError
from opencv_tools.recording.file_sink import FileSink
from opencv_tools.recording.folder import Folder
from opencv_tools.recording.frames import CompressedFrame, MessageFrame, ReceivedFrame
from opencv_tools.recording.image_encoder import (
    COMPRESSED_SUFFIXES, encode_frame, EncoderSettings, file_order)
from opencv_tools.recording.manifest import file_entry, ManifestEntry
from opencv_tools.recording.naming import NANO
from opencv_tools.recording.numbering import Numbering
from opencv_tools.recording.open_file import OpenFile
from opencv_tools.recording.selection import Limits, Retention

_MAX_WAITING = 1000  # other messages between two frames


@dataclass(frozen=True, kw_only=True)
class RecordedMessage:
    """
    A message for a bag.

    :param channel: topic of the message.
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

    def discard(self) -> None:
        """Do nothing, because nothing is on the disk."""


@dataclass(frozen=True, kw_only=True)
class RecordedImage(RecordedMessage):
    """
    A frame for a bag.

    :param image: the image message.
    """

    image: WireMessage


class BagFile:
    """A bag as a file of frames; see ``FrameWriter``."""

    skipped = 0
    bytes_waiting = 0

    def __init__(self, path: Path, max_bytes: int = 0) -> None:
        """
        Create the file.

        :param path: path of the file.
        :param max_bytes: maximum size of the file in bytes; 0 for no limit.
        :raises FileExistsError: the file exists; it is not changed.
        :raises OSError: the file cannot be written.
        """
        self.frames = self.flushed = 0
        self.is_full = self.is_finished = False
        self._path = path
        self._max_bytes = max_bytes
        self._writer = BagWriter(path)
        self.is_at_path = self._writer.is_at_path

    @property
    def size(self) -> int:
        """Size of the file in bytes."""
        return self._writer.size

    def size_with(self, message: RecordedMessage) -> int:
        """Return the largest size of the finished file with another message."""
        return self._writer.size_with(message.channel, message.size)

    def write(self, message: RecordedMessage, is_frame: bool = True) -> bool:
        """
        Write a message; it is in the file when this method returns.

        :param is_frame: whether the message is counted.
        :returns: False if the message would exceed the maximum size.
        :raises OSError: the file cannot be written; it has all earlier messages.
        """
        if 0 < self._max_bytes < self.size_with(message):
            self.is_full = self.is_full or is_frame
            return False
        self.bytes_waiting = message.size
        self._writer.write(
            message.channel, message.parts, log_ns=message.log_ns, publish_ns=message.publish_ns,
            sequence=message.number)
        self.bytes_waiting = 0
        self.frames += is_frame
        self.flushed = self.frames
        return True

    def close(self) -> None:
        """
        Finish the file; remove it if it has no frame.

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
            if not self.frames and self.is_at_path():
                self._path.unlink(missing_ok=True)

    def measured(self, entry: ManifestEntry) -> ManifestEntry:
        """Return a manifest entry with the size, and the digest if the file is finished."""
        return replace(entry, size=self._writer.size,
                       sha256=self._writer.sha256 if self.is_finished else '')


class BagSink(FileSink[BagFile, RecordedImage]):
    """Write messages to bags."""

    def __init__(
        self, folder: Folder, numbering: Numbering, settings: EncoderSettings, limits: Limits,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        """
        Create a sink; see ``FileSink``.

        :param settings: compression of the images.
        :raises OSError: the manifest cannot be read.
        """
        super().__init__(folder, numbering, limits, monotonic)
        self._settings = settings
        self._waiting: deque[RecordedMessage] = deque(maxlen=_MAX_WAITING)
        self._arrival_ns = 0
        self._retention = Retention(limits, [
            entry for entry in folder.manifest.entries()
            if numbering.names.matches(entry.name)]) if limits.ring else None

    def prepare(self, frame: ReceivedFrame) -> RecordedImage:
        """Convert a frame to a message, without a copy of unchanged data; see ``FileSink``."""
        message, channel = _message(frame)
        if self._settings.compression and isinstance(message, WireImage):
            message, channel = _compressed_message(frame, self._settings)
        publish_ns, number = (frame.publish_ns, frame.number) if isinstance(
            frame, MessageFrame) else (0, 0)
        return RecordedImage(
            image=message, channel=channel, parts=message_to_cdr_parts(message),
            log_ns=frame.receive_ns, publish_ns=publish_ns or frame.receive_ns, number=number)

    def add_message(self, message: RecordedMessage) -> None:
        """
        Add a message that is not a frame, such as a camera_info; thread-safe.

        It is written before the next frame that is later, or at the end. Of more than 1000
        messages the oldest are removed.

        :param message: the message.
        """
        self._waiting.append(message)

    def close(self) -> None:
        """
        Write the waiting messages, finish the file and close the folder; see ``FileSink``.

        :raises OSError: the file was not finished.
        """
        try:
            if self._file:
                self._write_waiting(self._file.writer)
        finally:
            super().close()

    def _open(self, path: Path, frame: ReceivedFrame, prepared: RecordedImage, room: int,
              ) -> BagFile:
        return BagFile(path, 0 if self._retention else room)

    def _entry(self, seq: int, name: str, frame: ReceivedFrame, prepared: RecordedImage,
               ) -> ManifestEntry:
        return file_entry(seq, name, frame, *_description(prepared.image))

    def _fits(self, file: OpenFile[BagFile], frame: ReceivedFrame, prepared: RecordedImage,
              ) -> bool:
        return True

    def _write(self, file: OpenFile[BagFile], frame: ReceivedFrame, prepared: RecordedImage,
               ) -> bool:
        self._write_waiting(file.writer, prepared.log_ns)
        if self._retention:
            self._delete_oldest(self._retention, replace(
                file.entry, size=file.writer.size_with(prepared), frames=file.writer.frames + 1),
                frame.arrival_ns)
        self._arrival_ns = frame.arrival_ns
        return file.writer.write(prepared)

    def _write_waiting(self, file: BagFile, until_ns: int | None = None) -> None:
        """Write the waiting messages that were received before a time."""
        with suppress(IndexError):
            while until_ns is None or self._waiting[0].log_ns <= until_ns:
                file.write(self._waiting.popleft(), is_frame=False)

    def _delete_oldest(self, retention: Retention, entry: ManifestEntry, arrival_ns: int) -> None:
        deleted = retention.make_room(entry, arrival_ns)
        for name in deleted:
            (self._folder.path / name).unlink(missing_ok=True)
        retention.remove(deleted)
        if deleted:
            self._folder.remove_stale_lines(self._numbering.names)

    def _measured(self, file: OpenFile[BagFile]) -> ManifestEntry:
        entry = file.writer.measured(file.entry)
        if self._retention:
            self._retention.add(replace(entry, frames=file.writer.frames), self._arrival_ns)
        return entry


def finish_bags(folder: Folder) -> None:
    """
    Finish the bags of a folder whose recorders were killed.

    :param folder: output folder; its manifest gets the new size and digest of these bags.
    """
    for path in folder.path.glob(f'*{BAG_SUFFIX}'):
        with suppress(BagError, OSError):  # damaged, or without permission: it is left alone
            if not has_footer(path):
                folder.update_line(path.name, finish_bag(path))


def _message(frame: ReceivedFrame) -> tuple[WireMessage, BagChannel]:
    """Return the message of a frame, and its topic."""
    if isinstance(frame, MessageFrame):
        return frame.message, frame.channel
    metadata = frame.metadata
    header = WireHeader(*divmod(metadata.stamp_ns, NANO), metadata.frame_id)
    if isinstance(frame, CompressedFrame):
        return WireCompressedImage(header=header, format=metadata.encoding, data=frame.data), (
            BagChannel(topic=metadata.topic, type_name=COMPRESSED_IMAGE))
    message = array_to_wire(frame.decode().image, find_encoding(metadata.encoding), header)
    return message, BagChannel(topic=metadata.topic, type_name=IMAGE)


def _compressed_message(
    frame: ReceivedFrame, settings: EncoderSettings,
) -> tuple[WireCompressedImage, BagChannel]:
    """
    Return a raw frame as a compressed image with the topic and format of image_transport.

    :raises ImageError: the codec cannot store the frame.
    """
    metadata = frame.metadata
    try:
        encoded = encode_frame(
            frame, replace(settings, suffix=COMPRESSED_SUFFIXES[settings.compression]))
    except UnwritableError as err:
        raise UnwritableError(
            f'a {metadata.encoding} frame cannot be compressed as {settings.compression}; record '
            'it uncompressed') from err
    message = WireCompressedImage(
        header=WireHeader(*divmod(metadata.stamp_ns, NANO), metadata.frame_id),
        format=f'{metadata.encoding}; {settings.compression} compressed '
               f'{file_order(find_encoding(encoded.encoding)).name}',
        data=encoded.data)
    return message, BagChannel(topic=f'{metadata.topic}/compressed', type_name=COMPRESSED_IMAGE)


def _description(message: WireMessage) -> tuple[str, tuple[int, int]]:
    """Return the encoding and size of an image; 0 by 0 if a compressed image has no size."""
    if isinstance(message, WireImage):
        return message.encoding, (message.width, message.height)
    try:
        return message.format, image_size(bytes(message.data))
    except SizeError:
        return message.format, (0, 0)
