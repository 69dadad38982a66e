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
from dataclasses import replace
from pathlib import Path
import time
from typing import Any

from opencv_tools.bags.writing import BagChannel
from opencv_tools.base.units import NANO
from opencv_tools.image.cdr import (
    COMPRESSED_IMAGE, IMAGE, message_to_cdr_parts, WireCompressedImage, WireHeader, WireImage,
    WireMessage)
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import ImageError, SizeError
from opencv_tools.image.image_size import image_size
from opencv_tools.image.layout import array_to_wire
from opencv_tools.recording.bag_file import BagFile, MessageBatch, RecordedImage, RecordedMessage
from opencv_tools.recording.errors import UnwritableError
from opencv_tools.recording.file_format import FileFormat, OpenFile, Room
from opencv_tools.recording.file_sink import FileSink
from opencv_tools.recording.folder import Folder
from opencv_tools.recording.frames import CompressedFrame, ReceivedFrame
from opencv_tools.recording.image_encoder import (
    COMPRESSED_SUFFIXES, encode_frame, EncoderSettings, file_order)
from opencv_tools.recording.manifest import file_entry, ManifestEntry
from opencv_tools.recording.message_frame import MessageFrame
from opencv_tools.recording.numbering import Numbering
from opencv_tools.recording.selection import Limits
from opencv_tools.video.messages import WireVideo
from opencv_tools.video.parameter_sets import is_key_frame, picture_size

_MAX_WAITING = 1000  # other messages between two frames

# A frame, or other messages that are written together.
_Prepared = RecordedImage | MessageBatch


class BagFormat(FileFormat[BagFile, _Prepared]):
    """Write messages to bags."""

    def __init__(self, settings: EncoderSettings) -> None:
        self._settings = settings
        self._waiting: deque[RecordedMessage] = deque(maxlen=_MAX_WAITING)
        self._has_video = False  # the last frame

    def prepare(self, frame: ReceivedFrame) -> _Prepared:
        """Convert a frame to a message, without a copy of unchanged data; see `FileFormat`."""
        if isinstance(frame, MessageBatch):
            return frame
        message, channel = _message(frame)
        if self._settings.compression and isinstance(message, WireImage):
            message, channel = _compressed_message(frame, self._settings)
        publish_ns, number = (frame.publish_ns, frame.number) if isinstance(
            frame, MessageFrame) else (0, 0)
        return RecordedImage(
            image=message, channel=channel, parts=_parts(message),
            log_ns=frame.receive_ns, publish_ns=publish_ns or frame.receive_ns, number=number)

    def create(self, path: Path, frame: ReceivedFrame, prepared: _Prepared, room: Room,
               ) -> BagFile:
        """Create a bag; see `FileFormat`."""
        return BagFile(path, room)

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
            return file.writer.write_batch(prepared)
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

    def add_message(self, message: RecordedMessage) -> None:
        """Add a message that is not a frame; see `BagSink`."""
        self._waiting.append(message)

    def write_others(self, writer: BagFile, prepared: _Prepared | None) -> None:
        """Write the messages that were received before a frame, or all; see `FileFormat`."""
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
    message = WireCompressedImage(
        header=WireHeader(*divmod(metadata.stamp_ns, NANO), metadata.frame_id),
        format=f'{metadata.encoding}; {settings.compression} compressed '
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
