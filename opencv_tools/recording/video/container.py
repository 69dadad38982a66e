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
Files that hold video: MP4, Matroska or AVI, with true times, also on a full disk.

A file that is truncated at any moment still plays, except for about its last second. Frames wait
in memory until FFmpeg writes several of them together. The first frame is written with the third.

MP4 stores times with a resolution of 11 us, Matroska of 1 ms. AVI has only a constant rate. An
AVI file gets 300 frames a second, most of them empty. The resolution is 2 ms, and the empty frames
take 26 MB an hour. OpenCV reads the true times from it, but a rate of 300. OpenCV counts the empty
frames and cannot seek. FFmpeg shows each frame when the next one is due.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from opencv_tools.base.regular_files import is_same_file, write_buffer
from opencv_tools.base.units import NANO
from opencv_tools.recording.errors import VideoError
from opencv_tools.recording.file_sink import CLOCK_JUMP_NS, Room
from opencv_tools.recording.recorder import Prepared


class OutputFile:
    """
    A new file that FFmpeg writes to.

    Write errors are stored here instead of raised, because FFmpeg would replace them by its own.
    """

    def __init__(self, path: Path) -> None:
        self.size = 0
        self.error: OSError | None = None
        self._path = path
        self.raw = path.open('xb', buffering=0)  # not ``close``, which PyAV would call
        self.seek, self.tell = self.raw.seek, self.raw.tell

    def write(self, data: bytes) -> int:
        """Write all data; ignore data after an error."""
        if self.error is None:
            try:
                write_buffer(self.raw, data)
            except OSError as err:
                self.error = err.with_traceback(None)  # the traceback would keep the encoder alive
            self.size = max(self.size, self.raw.tell())
        return len(data)

    def is_at_path(self) -> bool:
        """Return whether the file is still at its path, or that cannot be determined."""
        try:
            return is_same_file(self.raw.fileno(), self._path)
        except OSError:  # the folder cannot be read now
            return True

    def check(self, whole: int) -> None:
        """
        Raise the stored write error, if any.

        :param whole: size of the complete part in bytes; after an error the rest is truncated.
        :raises OSError: a write failed.
        """
        if self.error is not None:
            with suppress(OSError):
                self.size = self.raw.truncate(whole)
            raise OSError(self.error.errno, self.error.strerror, str(self._path)) from self.error


# PyAV is imported in functions, because the import is slow and most recordings are image files.


@dataclass(frozen=True, kw_only=True)
class ContainerFormat:
    """
    A format of video files.

    :param ticks: resolution of times, in ticks per second.
    :param longest: longest gap between two frames, in seconds.
    :param per_packet: upper bound of the bytes that FFmpeg writes in addition to a packet.
    :param at_end: the same at the end of the file.
    :param per_group: the same at the end of the file, for each group of packets.
    :param per_tick: the same at the end of a file with a packet for each tick.
    :param lag: number of latest packets that a write does not include.
    """

    name: str
    ticks: int
    longest: int
    per_packet: int
    at_end: int
    per_group: int
    per_tick: int = 0
    lag: int = 1
    options: dict[str, str] = field(default_factory=dict)


CONTAINER_FORMATS = {
    # A fragment begins at each key frame and after a second. It does not depend on later data.
    '.mp4': ContainerFormat(
        name='mp4', ticks=90000, longest=3600, per_packet=16, at_end=200, per_group=24,
        options={'movflags': 'frag_keyframe+empty_moov+default_base_moof',
                 'frag_duration': '1000000'}),
    '.mkv': ContainerFormat(
        name='matroska', ticks=1000, longest=3600, per_packet=16, at_end=100, per_group=48,
        options={'cluster_time_limit': '500'}),
    # 300 is a multiple of common rates. FFmpeg writes at most 60000 empty frames in a row.
    '.avi': ContainerFormat(
        name='avi', ticks=300, longest=199, per_packet=9, at_end=100, per_group=0, per_tick=24,
        lag=0),
}

_BUFFER_SIZE = 2 ** 20  # bytes; about a second of video, so that a kill rarely hits a write


class VideoPrepared(Prepared, Protocol):
    """A frame for a video."""

    @property
    def stream_format(self) -> tuple[Any, ...] | None:
        """Properties that all frames of a file share; None if the frame does not contain them."""


V = TypeVar('V', bound=VideoPrepared)


class WrittenVideo(ABC, Generic[V]):
    """
    The stream of a video file.

    ``stream_format`` has the properties that all its frames share. ``failure`` is the begin of an
    error, such as ``a 640x480 frame cannot be encoded``.
    """

    stream_format: tuple[Any, ...]
    failure: str

    @abstractmethod
    def open(self, container: Any, ticks: int) -> None:  # noqa: A003
        """
        Add the stream to a container of PyAV.

        :param ticks: resolution of times, in ticks per second.
        """

    @abstractmethod
    def packets(self, prepared: V | None, pts: int) -> Iterable[Any]:
        """
        Return the packets that are complete.

        :param prepared: the next frame; None at the end.
        """


class VideoFile(Generic[V]):
    """One video file; used by one thread at a time."""

    def __init__(
        self, path: Path, stream: WrittenVideo[V], time_ns: int, room: Room = lambda _: True,
    ) -> None:
        """
        Create the file.

        :param path: path of the file; its extension, one of ``VIDEO_FORMATS``, selects the format.
        :param time_ns: start time of the video in nanoseconds, stored in the comment of the file.
        :param room: asked before each frame that is written.
        :raises FileExistsError: the file exists; it is not changed.
        :raises OSError: the file cannot be written.
        :raises VideoError: FFmpeg does not support the stream.
        """
        self.frames = 0  # frames that were accepted
        self.flushed = 0  # accepted frames that are complete in the file
        self.skipped = 0  # accepted frames for which there is no room
        self.others = 0
        self.is_full = False  # there is no room for the next frame
        self.bytes_waiting = 0  # upper bound for the frames that are not in the file yet
        self._path = path
        #: The stream of the file.
        self.stream = stream
        self._format = CONTAINER_FORMATS[path.suffix.lower()]
        self._start_ns = self._last_ns = time_ns
        self._last = -1  # ticks
        self._packets = self._groups = 0
        self._last_packet = self._group_at = -1  # ticks
        self._room = room
        self._whole = 0
        self._container: Any = None
        self.file = OutputFile(path)
        try:
            self._call(self._open)
        except BaseException:
            self._release()
            raise

    @property
    def size(self) -> int:
        """Size of the file in bytes, without the frames that are waiting."""
        return self.file.size

    def fits(self, prepared: VideoPrepared, time_ns: int) -> bool:
        """
        Return whether a frame can continue the video.

        :param prepared: frame, which must have the properties of the video.
        :param time_ns: time of the frame in nanoseconds. More than a second before the previous
            frame means that the clock was set. The longest gap is an hour, in AVI 199 s.
        """
        step = time_ns - self._last_ns
        return (prepared.stream_format in (None, self.stream.stream_format)
                and -CLOCK_JUMP_NS <= step <= self._format.longest * NANO)

    def is_at_path(self) -> bool:
        """Return whether the file is still at its path, or that cannot be determined."""
        return self.file.is_at_path()

    def write(self, prepared: V, time_ns: int) -> bool:
        """
        Write a frame, which may wait in memory for later frames.

        :param prepared: frame for which ``fits`` returned True.
        :param time_ns: time of the frame in nanoseconds; one tick after the previous frame if it
            is not later.
        :returns: False if the frame would exceed the maximum size; the file can then only be
            closed.
        :raises OSError: the file cannot be written; it can then only be closed.
        :raises VideoError: FFmpeg refused the frame.
        """
        self.file.check(self._whole)
        ticks = self._format.ticks
        since = ((time_ns - self._start_ns) * ticks + NANO // 2) // NANO
        pts = max(since, self._last + 1)
        self.is_full = self.is_full or not self._has_room(0, pts)
        if self.is_full:
            return False
        self._call(self._mux, prepared, pts)
        if self.is_full:
            return False
        self.frames += 1
        self._last, self._last_ns = pts, time_ns
        return True

    def close(self) -> None:
        """
        Finish the file; remove it if it has no frame.

        After an error of ``write`` no error is raised. The frames in the file always play.

        :raises OSError: the last frames were not written.
        :raises VideoError: FFmpeg did not finish the file.
        """
        if self._container is None:
            return
        try:
            if self.file.error is None:
                self._call(self._mux, None, self._last + 1)
                self._call(self._container.close)
                self.flushed, self.bytes_waiting = self._packets, 0
        finally:
            self._release()

    def __del__(self) -> None:
        """Finish a file that was not closed; PyAV up to 12 would crash."""
        with suppress(Exception):
            self.close()

    def _open(self) -> None:
        import av
        self._container = av.open(
            self.file, 'w', format=self._format.name, buffer_size=_BUFFER_SIZE,
            container_options={**self._format.options, 'flush_packets': '1'})
        seconds, rest = divmod(self._start_ns, NANO)
        self._container.metadata['comment'] = f'begins at {seconds}.{rest:09d}'
        self.stream.open(self._container, self._format.ticks)
        self._container.start_encoding()

    def _mux(self, prepared: V | None, pts: int) -> None:
        """Write the packets of a frame, or the last ones, as far as there is room."""
        for packet in self.stream.packets(prepared, pts):
            steps = packet.pts - self._last_packet if self._format.per_tick else 1
            added = packet.size + self._format.per_packet * steps
            self.is_full = self.is_full or not self._has_room(added, packet.pts)
            if self.is_full:
                continue
            size, self._last_packet = self.file.size, packet.pts
            self._packets += 1
            if packet.is_keyframe or packet.pts - self._group_at >= self._format.ticks:
                self._groups, self._group_at = self._groups + 1, packet.pts
            self._container.mux(packet)
            if self.file.size > size and self.file.error is None:
                self.flushed, self._whole = self._packets - self._format.lag, self.file.size
                self.bytes_waiting = 0
            self.bytes_waiting += added * self._format.lag
        if self.is_full:
            self.skipped = self.frames - self._packets

    def _has_room(self, added: int, pts: int) -> bool:
        """Return whether the finished file may have more bytes, with a last frame at a tick."""
        container = self._format
        end = (container.at_end + container.per_group * (self._groups + 1)
               + container.per_tick * pts)
        return self._room(self.size + self.bytes_waiting + added + end)

    def _call(self, step: Callable[..., None], *arguments: Any) -> None:
        """Call FFmpeg and convert its errors."""
        import av
        try:
            step(*arguments)
        except av.error.FFmpegError as err:
            self.file.check(self._whole)
            raise VideoError(f'{self.stream.failure} as {self._path.suffix}: {err}') from err
        self.file.check(self._whole)
        self._whole = self.file.size

    def _release(self) -> None:
        import av
        container, self._container = self._container, None
        with suppress(av.error.FFmpegError):
            if container is not None:
                container.close()  # it writes nothing after an error of the file
        with self.file.raw:
            if not self.flushed and self.is_at_path():
                self._path.unlink(missing_ok=True)
