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

from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
import time
from typing import Any, ClassVar
import uuid

from opencv_tools.bags.account import (
    account_bytes, account_record, begin_record, Counts, Losses, Metadata)
from opencv_tools.bags.latched import LatchedMessages
from opencv_tools.bags.writing import BagChannel, BagWriter
from opencv_tools.base.units import NANO
from opencv_tools.image.cdr import (
    COMPRESSED_IMAGE, IMAGE, message_to_cdr_parts, WireCompressedImage, WireHeader, WireImage,
    WireMessage)
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import ImageError, KeyFrameNeeded, SizeError
from opencv_tools.image.image_size import image_size
from opencv_tools.image.layout import array_to_wire, view_pixels
from opencv_tools.recording.errors import UnwritableError
from opencv_tools.recording.file_sink import FileFormat, FileSink, OpenFile, Room
from opencv_tools.recording.folder import Folder
from opencv_tools.recording.frames import CompressedFrame, RawFrame, ReceivedFrame
from opencv_tools.recording.image_encoder import (
    COMPRESSED_SUFFIXES, encode_frame, EncoderSettings, file_order, is_number)
from opencv_tools.recording.manifest import file_entry, ManifestEntry
from opencv_tools.recording.numbering import Numbering
from opencv_tools.recording.recorder import Prepared
from opencv_tools.recording.selection import Limits
from opencv_tools.video.messages import WireVideo
from opencv_tools.video.parameter_sets import is_key_frame, picture_size

_MAX_WAITING = 1000  # other messages between two frames


@dataclass(frozen=True, kw_only=True)
class MessageFrame(ReceivedFrame):
    """
    A frame as its message, for a bag.

    :param message: immutable image message of any encoding, or message with video.
    :param channel: topic of the message as a bag describes it.
    :param publish_ns: time of publication in nanoseconds of the system clock; 0 if unknown.
    :param number: number of the message from its publisher; 0 if unknown.
    :param serialized: buffer with the CDR of the message as it is; None to serialize it.
    """

    message: WireMessage | WireVideo
    channel: BagChannel
    publish_ns: int = 0
    number: int = 0
    serialized: Any = None

    @property
    def size(self) -> int:
        """Size of the data of the message in bytes."""
        return memoryview(self.message.data).nbytes

    def decode(self) -> RawFrame:
        """
        Return the frame as pixels.

        :raises ImageError: the message is not a valid image, or it is video.
        """
        if isinstance(self.message, WireVideo):
            raise KeyFrameNeeded('video is not decoded without the messages before it')
        message, times = self.message, {
            'receive_ns': self.receive_ns, 'arrival_ns': self.arrival_ns}
        if isinstance(message, WireCompressedImage):
            return CompressedFrame(metadata=self.metadata, data=message.data, **times).decode()
        encoding = find_encoding(message.encoding)
        image = view_pixels(message.data, message.height, message.width, message.step, encoding,
                            message.is_bigendian)
        return RawFrame(metadata=self.metadata, image=image.astype(encoding.dtype, copy=False),
                        **times)


@dataclass(frozen=True, kw_only=True)
class RecordedMessage(Prepared):
    """
    A message for a bag.

    :param parts: buffers with its CDR, in order.
    :param log_ns: time of reception in nanoseconds of the system clock.
    :param publish_ns: time of publication in nanoseconds of the system clock.
    :param number: number of the message from its publisher; 0 if unknown.
    :param publisher: identifier of its publisher; b'' if unknown.
    """

    channel: BagChannel
    parts: tuple[Any, ...]
    log_ns: int
    publish_ns: int
    number: int = 0
    publisher: bytes = b''

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

    def __init__(self, path: Path, room: Room, metadata: Sequence[Metadata],
                 losses: Losses | None = None) -> None:
        """
        Create the file.

        :param room: asked before each message.
        :param metadata: records at the begin of the file.
        :param losses: the rest of the account at its end; None for no account.
        :raises FileExistsError: the file exists; it is not changed.
        :raises OSError: the file cannot be written.
        """
        self.frames = self.flushed = self.skipped = self.bytes_waiting = 0
        self.is_full = self.is_finished = False
        self.others = 0  # messages of batches
        self.is_begun = False  # whether it has the latched messages of earlier files
        self._path = path
        self._room = room
        self._losses = losses
        self._written, self._repeated = Counter[str](), Counter[str]()
        self._account_bytes = account_bytes(()) if losses else 0
        self._is_known = True  # whether all losses until the end of the file are counted
        self._writer = BagWriter(path, metadata)
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
        if not self._write(message):
            self.is_full = self.is_full or is_frame
            return False
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
            if not self._write(message):
                self.is_full = True
                return False
            batch.result.written += 1
            self.others += 1
        return True

    def write_latched(self, messages: Iterable[RecordedMessage], log_ns: int) -> None:
        """
        Write messages of earlier files at the begin, which no count has.

        :param log_ns: time of the first message that follows.
        :raises OSError: the file cannot be written.
        """
        if not self.is_begun:
            for message in messages:
                self._write(replace(message, log_ns=log_ns), self._repeated)
        self.is_begun = True

    def _write(self, message: RecordedMessage, counts: Counter[str] | None = None) -> bool:
        """Write a message if there is room for it; count it as written, or in other counts."""
        topic, counts = message.channel.topic, self._written if counts is None else counts
        is_new = self._losses and topic not in self._written and topic not in self._repeated
        account = self._account_bytes + (account_bytes((topic,)) if is_new else 0)
        if not self._room(self._writer.size_with(message.channel, message.size) + account):
            return False
        self.bytes_waiting = message.size
        self._is_known = False  # an error loses this message, perhaps without another file
        self._writer.write(
            message.channel, message.parts, log_ns=message.log_ns, publish_ns=message.publish_ns,
            sequence=message.number)
        self._is_known = True
        self.bytes_waiting, self._account_bytes = 0, account
        counts[topic] += 1
        return True

    def close(self) -> None:
        """
        Finish the file; remove it if it is empty.

        :raises OSError: the summary cannot be written; the next recording writes it.
        """
        try:
            account = self._account()
            self._writer.close(
                [account_record(account, self._is_known)] if account else ())
            self.is_finished = True
            if self._losses:
                self._losses.store(account)
        except OSError as err:
            raise OSError(
                err.errno, f'{err.strerror}: {self._path.name} has no index yet, which the next '
                'recording in its folder adds') from err
        finally:
            if not (self.frames or self.others) and self.is_at_path():
                self._path.unlink(missing_ok=True)

    def _account(self) -> Counts:
        """Return the account of the file, as far as it has room for other topics than its own."""
        if not self._losses or not (self.frames or self.others):
            return {}
        account, own = self._losses.account(self._written, self._repeated), {
            *self._written, *self._repeated}
        size = self._writer.size_with(None, account_bytes([*account]))
        if account.keys() <= own or self._room(size):
            return account
        return {topic: account[topic] for topic in own}

    def measured(self, entry: ManifestEntry) -> ManifestEntry:
        """Return a manifest entry with the size, and the digest if the file is finished."""
        return replace(entry, size=self._writer.size,
                       sha256=self._writer.sha256 if self.is_finished else '')


# A frame, or other messages that are written together.
_Prepared = RecordedImage | MessageBatch


class BagFormat(FileFormat[BagFile, _Prepared]):
    """Write messages to bags."""

    def __init__(self, settings: EncoderSettings) -> None:
        self._settings = settings
        self._waiting: deque[RecordedMessage] = deque(maxlen=_MAX_WAITING)
        self._has_video = False  # the last frame
        self._latched = LatchedMessages[RecordedMessage]()  # each file begins with them
        self._recording = uuid.uuid4().hex
        #: Records of the bag that is copied; None for a recording.
        self.copied: Sequence[Metadata] | None = None
        self.losses = Losses()

    def prepare(self, frame: ReceivedFrame) -> _Prepared:
        """Convert a frame to a message, without a copy of unchanged data; see `FileFormat`."""
        if isinstance(frame, MessageBatch):
            return frame
        message, channel = _message(frame)
        if self._settings.compression and isinstance(message, WireImage):
            message, channel = _compressed_message(frame, self._settings)
        publish_ns = number = 0
        parts = _parts(message)
        if isinstance(frame, MessageFrame):
            publish_ns, number = frame.publish_ns, frame.number
            if frame.serialized is not None and message is frame.message:
                parts = (frame.serialized,)
        return RecordedImage(
            image=message, channel=channel, parts=parts,
            log_ns=frame.receive_ns, publish_ns=publish_ns or frame.receive_ns, number=number)

    def create(self, path: Path, frame: ReceivedFrame, prepared: _Prepared, room: Room,
               ) -> BagFile:
        """Create a bag; see `FileFormat`."""
        if self.copied is not None:
            return BagFile(path, room, self.copied)
        begin = begin_record(self._recording, self._latched.counts())
        return BagFile(path, room, [begin], self.losses)

    def entry(self, seq: int, name: str, frame: ReceivedFrame, prepared: _Prepared,
              ) -> ManifestEntry:
        """Return the manifest entry of a bag; see `FileFormat`."""
        if isinstance(prepared, MessageBatch):
            return file_entry(seq, name, frame, '', (0, 0))
        return file_entry(seq, name, frame, *_description(prepared.image))

    def write(self, file: OpenFile[BagFile], frame: ReceivedFrame, prepared: _Prepared,
              ) -> bool:
        """Write the message of a frame, or those of a batch; see `FileFormat`."""
        if isinstance(prepared, MessageBatch):
            written = prepared.result.written
            try:
                return file.writer.write_batch(prepared)
            finally:
                self.keep_latched(prepared.messages[written:prepared.result.written])
        self._has_video = isinstance(prepared.image, WireVideo)
        return file.writer.write(prepared)

    def can_begin(self, prepared: _Prepared) -> bool:
        """Return whether a bag can begin with a frame or batch; see `FileFormat`."""
        if isinstance(prepared, MessageBatch):
            return not self._has_video
        message = prepared.image
        try:
            return not isinstance(message, WireVideo) or is_key_frame(
                message.codec, bytes(message.data))
        except ImageError:
            return True

    def keep_latched(self, messages: Iterable[RecordedMessage]) -> None:
        """Keep messages with which the next file begins, whether they were written or not."""
        for message in messages:
            self._latched.keep(message)
        self.warning = self._latched.warning

    def add_message(self, message: RecordedMessage) -> None:
        """Add a message that is not a frame; see `BagSink`."""
        self._waiting.append(message)

    def write_others(self, writer: BagFile, prepared: _Prepared | None) -> None:
        """Write the messages that were received before a frame, or all; see `FileFormat`."""
        if prepared:
            writer.write_latched(self._latched, prepared.log_ns)
        with suppress(IndexError):
            while prepared is None or self._waiting[0].log_ns <= prepared.log_ns:
                writer.write(self._waiting.popleft(), is_frame=False)

    def measured(self, file: OpenFile[BagFile], folder: Path) -> ManifestEntry:
        """Return the manifest entry of a bag, whose digest is known; see `FileFormat`."""
        return file.writer.measured(file.entry)


class BagSink(FileSink[BagFile, _Prepared]):
    """Write frames, and other messages between them, to bags."""

    def __init__(
        self, folder: Folder, numbering: Numbering, settings: EncoderSettings, limits: Limits,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._bags = BagFormat(settings)
        super().__init__(folder, numbering, limits, self._bags, monotonic)

    def commit(self, frame: ReceivedFrame, prepared: _Prepared) -> Path:
        """Write a frame or a batch; see `FileSink`."""
        try:
            return super().commit(frame, prepared)
        finally:
            if isinstance(prepared, MessageBatch):  # a full disk takes none of them
                self._bags.keep_latched(prepared.messages[prepared.result.written:])

    def close(self) -> None:
        """Finish the bag; see `FileSink`."""
        try:
            super().close()
        finally:
            if self._paths:
                self.counts.warning = self._bags.losses.warning or self.counts.warning

    def copy_metadata(self, metadata: Sequence[Metadata]) -> None:
        """Write these metadata records of a bag that is copied, with its account."""
        self._bags.copied = metadata

    def read_losses(self, read: Callable[[], Counts]) -> None:
        """
        Set the counts for the accounts in the files.

        :param read: returns for each topic how many messages are in no file until now, by what
            became of them; called on any thread.
        """
        self._bags.losses.read = read

    def add_message(self, message: RecordedMessage) -> None:
        """
        Add a message that is not a frame, such as a camera_info; thread-safe.

        It is written before the next frame that is later, or at the end. Of more than 1000
        messages the oldest are removed.
        """
        self._bags.add_message(message)


def _parts(message: WireMessage | WireVideo) -> tuple[Any, ...]:
    """Return the CDR of a message in parts; that of video is the received one."""
    if isinstance(message, WireVideo):
        return (message.serialized,)
    return message_to_cdr_parts(message)


def _message(frame: ReceivedFrame) -> tuple[WireMessage | WireVideo, BagChannel]:
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
    # Gray within a range is no depth in millimetres.
    is_reduced = is_number(find_encoding(metadata.encoding))
    original = encoded.encoding if is_reduced else metadata.encoding
    message = WireCompressedImage(
        header=WireHeader(*divmod(metadata.stamp_ns, NANO), metadata.frame_id),
        format=f'{original}; {settings.compression} compressed '
               f'{file_order(find_encoding(encoded.encoding)).name}',
        data=encoded.data)
    return message, BagChannel(topic=f'{metadata.topic}/compressed', type_name=COMPRESSED_IMAGE)


def _description(message: WireMessage | WireVideo) -> tuple[str, tuple[int, int]]:
    """Return the encoding and size of an image or video; 0 by 0 if its size is unknown."""
    if isinstance(message, WireVideo):
        try:
            codec = message.codec
            return codec, message.size or picture_size(codec, bytes(message.data)) or (0, 0)
        except ImageError:
            return message.encoding, (0, 0)
    if isinstance(message, WireImage):
        return message.encoding, (message.width, message.height)
    try:
        return message.format, image_size(bytes(message.data))
    except SizeError:
        return message.format, (0, 0)
