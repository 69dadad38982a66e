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

"""Frames as a video, and the next one when a frame does not fit."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from opencv_tools.image.encodings import find_encoding, generic_encoding
from opencv_tools.image.errors import EncodingError
from opencv_tools.recording.folder import Folder
from opencv_tools.recording.frames import Frame, RawFrame, ReceivedFrame
from opencv_tools.recording.manifest import Entry, file_entry
from opencv_tools.recording.numbering import Numbering
from opencv_tools.recording.selection import FullError, Limits
from opencv_tools.recording.video import VideoWriter
from opencv_tools.recording.video_picture import video_picture, VideoError, VideoPicture
from opencv_tools.recording.writers import able_formats, Format, UnwritableError


@dataclass(frozen=True)
class PreparedVideoPicture(VideoPicture):
    """A frame as the encoder takes it; nothing of it is on the disk yet."""

    def discard(self) -> None:
        """Let go of it."""


@dataclass
class _Video:
    path: Path
    entry: Entry
    writer: VideoWriter


class VideoFiles:
    """Write frames to videos, which have their names from the beginning and always play."""

    def __init__(
        self, folder: Folder, numbering: Numbering, wanted: Format, limits: Limits,
    ) -> None:
        """
        Begin with the first frame.

        :param folder: where the videos go, which is left when this is closed.
        :param numbering: finds their names.
        :param wanted: what frames become.
        :param limits: how much is recorded.
        """
        self._folder = folder
        self._wanted = wanted
        self._max_bytes = limits.max_bytes
        self._bytes = 0
        self._numbering = numbering
        self._video: _Video | None = None
        self._paths: set[Path] = set()

    def prepare(self, frame: Frame) -> PreparedVideoPicture:
        """
        Convert a frame to what the encoder takes; more than one thread may.

        :param frame: the frame.
        :returns: the picture.
        :raises ImageError: no video can hold the frame.
        """
        raw = frame.decode()
        try:
            picture = video_picture(
                raw.image, raw.encoding, self._wanted.suffix, self._wanted.to_color)
        except VideoError as err:
            raise UnwritableError(f'{err}; set the extension of file_name to '
                                  f'{able_formats(_type_name(raw))}') from err
        return PreparedVideoPicture(picture.frame)

    def commit(self, frame: Frame, picture: PreparedVideoPicture) -> Path:
        """
        Encode a frame; one thread at a time may, in the order of the frames.

        :param frame: the frame.
        :param picture: what ``prepare`` made of it.
        :returns: the video that it is in.
        :raises FullError: the recording is as large as it may get.
        :raises OSError: the video cannot be written; the next frame begins another one.
        """
        video = self._video
        if video and not video.writer.fits(picture, frame.time_ns):
            self._end(video)
            video = None
        if self._is_full(video):
            raise FullError(f'max_bytes is {self._max_bytes}')
        video = self._video = video or self._numbering.claim(
            frame, lambda seq, name: self._begin(seq, name, frame, picture))
        try:
            video.writer.write(picture, frame.time_ns)
        except (OSError, VideoError):
            with suppress(OSError, VideoError):  # the frame's own trouble is told
                self._end(video)
            raise
        return video.path

    def close(self) -> None:
        """
        End the video, and leave the folder.

        :raises OSError: its last frames were not written, or it has no line.
        """
        try:
            if self._video:
                self._end(self._video)
        finally:
            self._folder.close()

    def _is_full(self, video: _Video | None) -> bool:
        size = self._bytes + (video.writer.bytes_written if video else 0)
        return 0 < self._max_bytes <= size

    def _begin(
        self, seq: int, name: str, frame: ReceivedFrame, picture: VideoPicture,
    ) -> _Video:
        self._folder.make_again()
        path = self._folder.path / name
        if self._numbering.replaces and path not in self._paths:
            path.unlink(missing_ok=True)
        writer = VideoWriter(path, picture, frame.time_ns, self._wanted.crf)
        entry = file_entry(seq, name, frame, 'h264', picture.form[:2])
        self._folder.announce(entry)
        self._paths.add(path)
        return _Video(path, entry, writer)

    def _end(self, video: _Video) -> None:
        """End a video and account for it."""
        self._video = None
        try:
            video.writer.close()
        finally:
            if video.writer.frames:
                self._add_line(video)

    def _add_line(self, video: _Video) -> None:
        entry = replace(video.entry, frames=video.writer.frames).measured(self._folder.path)
        self._bytes += entry.size
        self._folder.manifest.append(entry)


def _type_name(frame: RawFrame) -> str:
    """Name what a picture of the frame would hold, as far as it is one."""
    try:
        is_picture = find_encoding(frame.encoding).kind in ('', 'color')
        return generic_encoding(frame.image).name if is_picture else frame.encoding
    except EncodingError:
        return frame.encoding
