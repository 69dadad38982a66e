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

"""Videos as files of a recording; a new video begins when a frame does not fit."""

from __future__ import annotations

from pathlib import Path

from opencv_tools.image.encodings import find_encoding, generic_encoding
from opencv_tools.image.errors import EncodingError
from opencv_tools.recording.errors import UnwritableError, VideoError
from opencv_tools.recording.file_format import FileFormat, OpenFile, Room
from opencv_tools.recording.frames import RawFrame, ReceivedFrame
from opencv_tools.recording.image_encoder import EncoderSettings, formats_for
from opencv_tools.recording.manifest import file_entry, ManifestEntry
from opencv_tools.recording.video.frame import to_video_frame, VideoFrame
from opencv_tools.recording.video.writer import VideoWriter

# Changes of the size after which a warning is logged.
_MANY_CHANGES = 3


class VideoFormat(FileFormat[VideoWriter, VideoFrame]):
    """Write frames to videos, which always play."""

    def __init__(self, settings: EncoderSettings) -> None:
        """
        Create the format.

        :param settings: format and encoder settings of the videos.
        """
        self._settings = settings
        self._size = (0, 0)
        self._changes = 0  # of the size

    def prepare(self, frame: ReceivedFrame) -> VideoFrame:
        """Convert a frame for the encoder; see `FileFormat`."""
        raw = frame.decode()
        try:
            return to_video_frame(
                raw.image, raw.metadata.encoding, self._settings.suffix, self._settings.to_color)
        except VideoError as err:
            raise UnwritableError(f'{err}; set the extension of file_name to '
                                  f'{formats_for(_image_type(raw))}') from err

    def create(self, path: Path, frame: ReceivedFrame, prepared: VideoFrame, room: Room,
               ) -> VideoWriter:
        """Create a video with the size and pixel format of a frame; see `FileFormat`."""
        self._count_changes(prepared.stream_format[:2])
        return VideoWriter(path, prepared, frame.time_ns, self._settings.crf, room)

    def entry(self, seq: int, name: str, frame: ReceivedFrame, prepared: VideoFrame,
              ) -> ManifestEntry:
        """Return the manifest entry of a video; see `FileFormat`."""
        return file_entry(seq, name, frame, 'h264', prepared.stream_format[:2])

    def write(self, file: OpenFile[VideoWriter], frame: ReceivedFrame, prepared: VideoFrame,
              ) -> bool:
        """Encode a frame; see `FileFormat`."""
        return file.writer.write(prepared, file.time_ns(frame))

    def continues(self, file: OpenFile[VideoWriter], frame: ReceivedFrame, prepared: VideoFrame,
                  ) -> bool:
        """Return whether a frame fits a video; see `FileFormat`."""
        return file.writer.fits(prepared, file.time_ns(frame))

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
