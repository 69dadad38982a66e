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

"""
Videos as files of a recording; a new video begins when a frame does not fit.

Packets of video are copied. All other frames are encoded. A file has frames of one kind.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from opencv_tools.image.encodings import find_encoding, generic_encoding
from opencv_tools.image.errors import EncodingError, KeyFrameNeeded
from opencv_tools.recording.errors import UnwritableError, VideoError
from opencv_tools.recording.file_format import FileFormat, OpenFile, Room
from opencv_tools.recording.frames import RawFrame, ReceivedFrame
from opencv_tools.recording.image_encoder import EncoderSettings, formats_for
from opencv_tools.recording.manifest import file_entry, ManifestEntry
from opencv_tools.recording.packet_frame import PacketFrame
from opencv_tools.recording.video.container import VideoFile
from opencv_tools.recording.video.frame import to_video_frame, VideoFrame
from opencv_tools.recording.video.packets import (
    CopiedStream, PacketOrder, prepare_packet, PreparedPacket)
from opencv_tools.recording.video.writer import VideoWriter
from opencv_tools.units import NANO

# Shortest time of a file of packets whose publisher changes the size again.
_SHORTEST_NS = NANO
# Changes of the size after which a warning is logged, and files may no longer be short.
_MANY_CHANGES = 3


# One frame of a video.
_Prepared = VideoFrame | PreparedPacket


class VideoFormat(FileFormat[VideoFile[Any], _Prepared]):
    """Write frames to videos, which always play."""

    def __init__(self, settings: EncoderSettings) -> None:
        """
        Create the format.

        :param settings: format and encoder settings of the videos.
        """
        self._settings = settings
        self._size = (0, 0)
        self._changes = 0  # of the size
        self._files = 0
        self._order = PacketOrder()

    def prepare(self, frame: ReceivedFrame) -> _Prepared:
        """Convert a frame for the encoder, or read a packet; see `FileFormat`."""
        if isinstance(frame, PacketFrame):
            return prepare_packet(frame.packet)
        raw = frame.decode()
        try:
            return to_video_frame(
                raw.image, raw.metadata.encoding, self._settings.suffix, self._settings.to_color)
        except VideoError as err:
            raise UnwritableError(f'{err}; set the extension of file_name to '
                                  f'{formats_for(_image_type(raw))}') from err

    def create(self, path: Path, frame: ReceivedFrame, prepared: _Prepared, room: Room,
               ) -> VideoFile[Any]:
        """Create a video with the size and format of a frame; see `FileFormat`."""
        self._count_changes(prepared.size)
        self._files += 1
        if isinstance(prepared, PreparedPacket):
            return VideoFile(path, CopiedStream(prepared), frame.time_ns, room)
        return VideoWriter(path, prepared, frame.time_ns, self._settings.crf, room)

    def entry(self, seq: int, name: str, frame: ReceivedFrame, prepared: _Prepared,
              ) -> ManifestEntry:
        """Return the manifest entry of a video; see `FileFormat`."""
        codec = prepared.packet.codec if isinstance(prepared, PreparedPacket) else 'h264'
        return file_entry(seq, name, frame, codec, prepared.size)

    def write(self, file: OpenFile[VideoFile[Any]], frame: ReceivedFrame, prepared: _Prepared,
              ) -> bool:
        """Encode a frame, or copy a packet; see `FileFormat`."""
        return file.writer.write(prepared, file.time_ns(frame))

    def continues(self, file: OpenFile[VideoFile[Any]], frame: ReceivedFrame, prepared: _Prepared,
                  ) -> bool:
        """Return whether a frame fits a video; see `FileFormat`."""
        if file.writer.fits(prepared, file.time_ns(frame)):
            return True
        if (isinstance(prepared, PreparedPacket) and prepared.sets and self._files > _MANY_CHANGES
                and 0 <= frame.arrival_ns - file.began_ns < _SHORTEST_NS):
            self._order.interrupt()
            raise KeyFrameNeeded('the size or the codec of the video changed within a second')
        return False

    def can_begin(self, prepared: _Prepared) -> bool:
        """Return whether a video can begin with a frame; see `FileFormat`."""
        return not isinstance(prepared, PreparedPacket) or bool(prepared.sets)

    def check(self, file: OpenFile[VideoFile[Any]] | None, frame: ReceivedFrame,
              prepared: _Prepared) -> None:
        """Check that a packet does not need others that are missing; see `FileFormat`."""
        if isinstance(frame, PacketFrame) and isinstance(prepared, PreparedPacket):
            begins = file is None or not isinstance(file.writer.stream, CopiedStream)
            self._order.check(frame, prepared, begins)

    def _count_changes(self, size: tuple[int, int]) -> None:
        """Warn once of frames that change their size again and again."""
        (width, height), self._size = self._size, size
        if size == (width, height) or not width:
            return
        self._changes += 1
        if self._changes == _MANY_CHANGES:
            self.warning = (
                f'the size of the frames changed {self._changes} times, now from {width}x{height} '
                f'to {size[0]}x{size[1]}, and each change begins another video; record images, '
                'or one publisher with one size')


def _image_type(frame: RawFrame) -> str:
    """Return the type of the image of a frame, for the list of formats that can hold it."""
    encoding = frame.metadata.encoding
    try:
        has_channels = find_encoding(encoding).kind in ('generic', 'color')
        return generic_encoding(frame.image).name if has_channels else encoding
    except EncodingError:
        return encoding
