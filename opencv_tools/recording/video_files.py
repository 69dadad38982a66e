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

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
import os
from pathlib import Path
import time

from opencv_tools.image.encodings import find_encoding, generic_encoding
from opencv_tools.image.errors import EncodingError
from opencv_tools.recording.folder import Folder
from opencv_tools.recording.frames import Frame, RawFrame
from opencv_tools.recording.manifest import Entry, file_entry
from opencv_tools.recording.numbering import Numbering
from opencv_tools.recording.recorder import reason_of, Standing
from opencv_tools.recording.selection import FullError, Limits
from opencv_tools.recording.video import VideoWriter
from opencv_tools.recording.video_picture import video_picture, VideoError, VideoPicture
from opencv_tools.recording.writers import able_formats, Format, UnwritableError


# After an error of the disk no file is begun for so long.
_RETRY_SECONDS = 2.0
# How often a video is looked for that somebody may have removed or moved.
_LOOK_SECONDS = 1.0
# Room for this many times what did not fit is asked for before another file begins.
_ROOM = 2


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
    offset_ns: int  # of arrivals, to those of the system's clock when the video began

    def time_ns(self, frame: Frame) -> int:
        """Return the time of a frame, in which a clock that is set makes no hole."""
        return frame.stamp_ns or frame.arrival_ns + self.offset_ns


class VideoFiles:
    """Write frames to videos, which have their names from the beginning and always play."""

    def __init__(
        self, folder: Folder, numbering: Numbering, wanted: Format, limits: Limits,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        """
        Begin with the first frame.

        :param folder: where the videos go, which is left when this is closed.
        :param numbering: finds their names.
        :param wanted: what frames become.
        :param limits: how much is recorded.
        :param monotonic: returns seconds of a clock that only goes on.
        """
        self.standing = Standing()
        self._folder = folder
        self._wanted = wanted
        self._max_bytes = limits.max_bytes
        self._bytes = 0
        self._numbering = numbering
        self._monotonic = monotonic
        self._video: _Video | None = None
        self._ended = 0  # frames in videos that have ended
        self._is_full = False
        self._outage: tuple[int, str] | None = None
        self._retry_at = self._look_at = 0.0
        self._needed = 0  # bytes of room
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
        :returns: the video that it is in, when FFmpeg writes it: ``standing`` counts it then.
        :raises FullError: the recording is as large as it may get.
        :raises OSError: the video cannot be written; another one begins when there is room.
        """
        if self._outage and not self._has_room():
            raise OSError(*self._outage)
        try:
            return self._commit(frame, picture)
        except OSError as err:
            self._break_off(err)
            raise
        except VideoError as err:
            self._give_up(reason_of(err))
            raise
        finally:
            self._count()

    def close(self) -> None:
        """
        End the video, and leave the folder.

        :raises OSError: its last frames were not written, or it has no line.
        """
        try:
            if self._video:
                self._end(self._video)
            self._folder.settle()
        finally:
            self._count()
            self._folder.close()

    def _commit(self, frame: Frame, picture: PreparedVideoPicture) -> Path:
        video = self._video
        if video and not (self._is_there(video)
                          and video.writer.fits(picture, video.time_ns(frame))):
            self._end(video)
        if not self._is_full:
            video = self._video = self._video or self._numbering.claim(
                frame, lambda seq, name: self._begin(seq, name, frame, picture))
            self._is_full = not video.writer.write(picture, video.time_ns(frame))
        if self._is_full or not video:
            raise FullError(f'max_bytes is {self._max_bytes}')
        if video.writer.flushed:
            self._outage, self._needed = None, 0
        return video.path

    def _has_room(self) -> bool:
        """Return whether it is time to try again, and the disk may hold what it did not."""
        if self._video:
            return True
        now = self._monotonic()
        if now < self._retry_at:
            return False
        self._retry_at = now + _RETRY_SECONDS
        try:
            disk = os.statvfs(self._folder.path)
        except OSError:  # of a folder that is to be made again
            return True
        return disk.f_bavail * disk.f_frsize >= self._needed

    def _break_off(self, err: OSError) -> None:
        """End the video that could not be written, and wait before another one begins."""
        self._outage = err.errno or 0, reason_of(err)
        self._retry_at = self._monotonic() + _RETRY_SECONDS
        if self._video:
            self._needed = max(self._needed, _ROOM * self._video.writer.bytes_waiting)
        self._give_up(reason_of(err))

    def _give_up(self, reason: str) -> None:
        """End a video that could not be gone on with."""
        with suppress(OSError, VideoError):  # the frame's own trouble is told
            if self._video:
                self._end(self._video, reason)

    def _is_there(self, video: _Video) -> bool:
        """Return whether a video is where its name says; looked at once a second."""
        now = self._monotonic()
        if now < self._look_at:
            return True
        self._look_at = now + _LOOK_SECONDS
        return video.writer.is_named()

    def _begin(self, seq: int, name: str, frame: Frame, picture: VideoPicture) -> _Video:
        self._folder.make_again()
        self._folder.settle()
        path = self._folder.path / name
        if self._numbering.replaces and path not in self._paths:
            path.unlink(missing_ok=True)
        offset = frame.receive_ns - frame.arrival_ns
        room = max(1, self._max_bytes - self._bytes) if self._max_bytes else 0
        writer = VideoWriter(
            path, picture, frame.stamp_ns or frame.receive_ns, self._wanted.crf, room)
        entry = file_entry(seq, name, frame, 'h264', picture.form[:2])
        try:
            self._folder.announce(entry)
        except OSError:
            writer.close()
            raise
        self._paths.add(path)
        return _Video(path, entry, writer, offset)

    def _end(self, video: _Video, reason: str = '') -> None:
        """
        End a video and account for it; its line may have to wait for room.

        :param reason: why frames that are not flushed are lost.
        :raises OSError: they were not written.
        :raises VideoError: FFmpeg did not end the file.
        """
        self._video = None
        writer = video.writer
        is_named = writer.is_named()
        try:
            writer.close()
        except (OSError, VideoError) as err:
            reason = reason or reason_of(err)
            raise
        finally:
            trouble = self._add_line(video) if is_named else _gone(video)
            kept = 0 if trouble else writer.flushed
            lost = writer.frames - writer.left_out - kept
            self._ended += kept
            self._is_full = self._is_full or writer.is_full
            self.standing.left_out += writer.left_out
            if lost:
                self.standing.lost += lost
                self.standing.reason = trouble or reason

    def _add_line(self, video: _Video) -> str:
        """Add the line of a video, or keep it; return what is wrong with the file, if anything."""
        if not video.writer.flushed:
            return ''
        try:
            entry = video.entry.measured(self._folder.path)
        except FileNotFoundError:
            return _gone(video)
        except OSError as err:
            return reason_of(err)
        self._bytes += entry.size
        self._folder.owe_line(replace(entry, frames=video.writer.flushed))
        with suppress(OSError):  # it is added before the next one, or at the end
            self._folder.settle()
        return ''

    def _count(self) -> None:
        writer = self._video.writer if self._video else None
        self.standing.kept = self._ended + (writer.flushed if writer else 0)


def _gone(video: _Video) -> str:
    return f'{video.path.name} was removed or moved while it was written'


def _type_name(frame: RawFrame) -> str:
    """Name what a picture of the frame would hold, as far as it is one."""
    try:
        is_picture = find_encoding(frame.encoding).kind in ('generic', 'color')
        return generic_encoding(frame.image).name if is_picture else frame.encoding
    except EncodingError:
        return frame.encoding
