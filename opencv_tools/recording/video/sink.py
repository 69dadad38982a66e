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

"""Recording of frames as videos; a new video begins when a frame does not fit."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
import os
from pathlib import Path
import time

from opencv_tools.image.encodings import find_encoding, generic_encoding
from opencv_tools.image.errors import EncodingError
from opencv_tools.recording.errors import error_text, LimitReached, UnwritableError, VideoError
from opencv_tools.recording.folder import Folder
from opencv_tools.recording.frames import RawFrame, ReceivedFrame
from opencv_tools.recording.image_encoder import EncoderSettings, formats_for
from opencv_tools.recording.manifest import file_entry, ManifestEntry
from opencv_tools.recording.numbering import Numbering
from opencv_tools.recording.recorder import SinkCounts
from opencv_tools.recording.selection import Limits
from opencv_tools.recording.video.frame import to_video_frame, VideoFrame
from opencv_tools.recording.video.writer import VideoWriter


# Delay after an error of the disk before a new file begins.
_RETRY_SECONDS = 2.0
# Period of the check whether the video was removed or moved.
_CHECK_SECONDS = 1.0
# A new file begins when the disk has room for this multiple of the data that did not fit.
_ROOM = 2


@dataclass
class _Video:
    path: Path
    entry: ManifestEntry
    writer: VideoWriter
    offset_ns: int  # from CLOCK_MONOTONIC to the system clock when the video began

    def time_ns(self, frame: ReceivedFrame) -> int:
        """Return the time of a frame, independent of changes of the system clock."""
        return frame.metadata.stamp_ns or frame.arrival_ns + self.offset_ns


class VideoSink:
    """Write frames to videos, which have their final names from the start and always play."""

    def __init__(
        self, folder: Folder, numbering: Numbering, settings: EncoderSettings, limits: Limits,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        """
        Create a sink; the first video begins with the first frame.

        :param folder: output folder, closed together with this sink.
        :param numbering: source of the file names.
        :param settings: format and encoder settings of the videos.
        :param limits: limits of the recording.
        :param monotonic: monotonic clock in seconds.
        """
        self.counts = SinkCounts()
        self._folder = folder
        self._settings = settings
        self._max_bytes = limits.max_bytes
        self._bytes = 0
        self._numbering = numbering
        self._monotonic = monotonic
        self._video: _Video | None = None
        self._ended = 0  # frames of finished videos
        self._is_full = False
        self._outage: tuple[int, str] | None = None
        self._retry_at = self._next_check_at = 0.0
        self._needed = 0  # bytes of free space required for a new video
        self._paths: set[Path] = set()

    def prepare(self, frame: ReceivedFrame) -> VideoFrame:
        """
        Convert a frame for the encoder; thread-safe.

        :param frame: frame to convert.
        :returns: the converted frame.
        :raises ImageError: no video can hold the frame.
        """
        raw = frame.decode()
        try:
            return to_video_frame(
                raw.image, raw.metadata.encoding, self._settings.suffix, self._settings.to_color)
        except VideoError as err:
            raise UnwritableError(f'{err}; set the extension of file_name to '
                                  f'{formats_for(_image_type(raw))}') from err

    def commit(self, frame: ReceivedFrame, video_frame: VideoFrame) -> Path:
        """
        Encode a frame; one thread at a time, in the order of the frames.

        :param frame: frame to write.
        :param video_frame: the frame as ``prepare`` returned it.
        :returns: path of the video; ``counts`` counts the frame when FFmpeg has written it.
        :raises LimitReached: the recording has reached its limits.
        :raises OSError: the video cannot be written; a new one begins when the disk has room.
        """
        if self._outage and not self._has_room():
            raise OSError(*self._outage)
        try:
            return self._commit(frame, video_frame)
        except OSError as err:
            self._end_after_disk_error(err)
            raise
        except VideoError as err:
            self._end_after_error(error_text(err))
            raise
        finally:
            self._count()

    def close(self) -> None:
        """
        Finish the video and close the folder.

        :raises OSError: the last frames or the manifest line of the video were not written.
        """
        try:
            if self._video:
                self._end(self._video)
            self._folder.write_deferred()
        finally:
            self._count()
            self._folder.close()

    def _commit(self, frame: ReceivedFrame, video_frame: VideoFrame) -> Path:
        video = self._video
        if video and not (self._is_at_path(video)
                          and video.writer.fits(video_frame, video.time_ns(frame))):
            self._end(video)
        if not self._is_full:
            video = self._video = self._video or self._numbering.claim(
                frame.metadata, lambda seq, name: self._begin(seq, name, frame, video_frame))
            self._is_full = not video.writer.write(video_frame, video.time_ns(frame))
        if self._is_full or not video:
            raise LimitReached(f'max_bytes is {self._max_bytes}')
        if video.writer.flushed:
            self._outage, self._needed = None, 0
        return video.path

    def _has_room(self) -> bool:
        """Return whether to retry now, and the disk has room for the data that did not fit."""
        if self._video:
            return True
        now = self._monotonic()
        if now < self._retry_at:
            return False
        self._retry_at = now + _RETRY_SECONDS
        try:
            disk = os.statvfs(self._folder.path)
        except OSError:  # the folder was removed, and is created again
            return True
        return disk.f_bavail * disk.f_frsize >= self._needed

    def _end_after_disk_error(self, err: OSError) -> None:
        """Finish the video that could not be written, and delay the next one."""
        self._outage = err.errno or 0, error_text(err)
        self._retry_at = self._monotonic() + _RETRY_SECONDS
        if self._video:
            self._needed = max(self._needed, _ROOM * self._video.writer.bytes_waiting)
        self._end_after_error(error_text(err))

    def _end_after_error(self, reason: str) -> None:
        """Finish a video that cannot be continued."""
        with suppress(OSError, VideoError):  # the error of the frame itself is reported
            if self._video:
                self._end(self._video, reason)

    def _is_at_path(self, video: _Video) -> bool:
        """Return whether a video is still at its path; checked once a second."""
        now = self._monotonic()
        if now < self._next_check_at:
            return True
        self._next_check_at = now + _CHECK_SECONDS
        return video.writer.file.is_at_path()

    def _begin(self, seq: int, name: str, frame: ReceivedFrame, video_frame: VideoFrame) -> _Video:
        self._folder.recreate()
        self._folder.write_deferred()
        path = self._folder.path / name
        if self._numbering.replaces and path not in self._paths:
            path.unlink(missing_ok=True)
        offset = frame.receive_ns - frame.arrival_ns
        room = max(1, self._max_bytes - self._bytes) if self._max_bytes else 0
        writer = VideoWriter(
            path, video_frame, frame.time_ns, self._settings.crf, room)
        entry = file_entry(seq, name, frame, 'h264', video_frame.stream_format[:2])
        try:
            self._folder.write_journal(entry)
        except OSError:
            writer.close()
            raise
        self._paths.add(path)
        return _Video(path, entry, writer, offset)

    def _end(self, video: _Video, reason: str = '') -> None:
        """
        Finish a video and add its line to the manifest, now or when the disk has room.

        :param reason: reason for the loss of frames that are not flushed.
        :raises OSError: these frames were not written.
        :raises VideoError: FFmpeg did not finish the file.
        """
        self._video = None
        writer = video.writer
        is_at_path = writer.file.is_at_path()
        try:
            writer.close()
        except (OSError, VideoError) as err:
            reason = reason or error_text(err)
            raise
        finally:
            problem = self._add_line(video) if is_at_path else _removed_text(video)
            kept = 0 if problem else writer.flushed
            lost = writer.frames - writer.skipped - kept
            self._ended += kept
            self._is_full = self._is_full or writer.is_full
            self.counts.skipped += writer.skipped
            if lost:
                self.counts.lost += lost
                self.counts.reason = problem or reason

    def _add_line(self, video: _Video) -> str:
        """Add or keep the manifest line of a video; return the problem with its file, or ''."""
        if not video.writer.flushed:
            return ''
        try:
            entry = video.entry.measured(self._folder.path)
        except FileNotFoundError:
            return _removed_text(video)
        except OSError as err:
            return error_text(err)
        self._bytes += entry.size
        self._folder.defer_line(replace(entry, frames=video.writer.flushed))
        with suppress(OSError):  # the line is added before the next video, or at the end
            self._folder.write_deferred()
        return ''

    def _count(self) -> None:
        writer = self._video.writer if self._video else None
        self.counts.kept = self._ended + (writer.flushed if writer else 0)


def _removed_text(video: _Video) -> str:
    return f'{video.path.name} was removed or moved while it was written'


def _image_type(frame: RawFrame) -> str:
    """Return the type of the image of a frame, for the list of formats that can hold it."""
    encoding = frame.metadata.encoding
    try:
        has_channels = find_encoding(encoding).kind in ('generic', 'color')
        return generic_encoding(frame.image).name if has_channels else encoding
    except EncodingError:
        return encoding
