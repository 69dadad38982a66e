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
Video files: H.264 in MP4, Matroska or AVI, with the true time of each frame.

A file that is truncated at any moment still plays, except for about its last second. Frames wait
in memory until FFmpeg writes several of them together. The first frame is written with the third.

MP4 stores times with a resolution of 11 us, Matroska of 1 ms. AVI has only a constant rate. An
AVI file gets 300 frames a second, most of them empty. The resolution is 2 ms, and the empty frames
take 26 MB an hour. OpenCV reads the true times from it, but a rate of 300. OpenCV counts the empty
frames and cannot seek. FFmpeg shows each frame when the next one is due.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
import os
from pathlib import Path
from typing import Any

from opencv_tools.recording.errors import VideoError
from opencv_tools.recording.file_format import Room
from opencv_tools.recording.output_file import OutputFile
from opencv_tools.recording.video.frame import VideoFrame
from opencv_tools.remedies import installation
from opencv_tools.units import NANO

# PyAV is imported in functions, because the import is slow and most recordings are image files.


@dataclass(frozen=True, kw_only=True)
class _ContainerFormat:
    name: str  # name of the format in FFmpeg
    ticks: int  # resolution of times, in ticks per second
    longest: int  # longest gap between two frames, in seconds
    # Upper bounds of the bytes that FFmpeg writes in addition to the packets:
    per_packet: int
    at_end: int  # also for each group of packets
    per_key: int  # at the end of the file, for each key frame
    per_tick: int = 0  # at the end of a file with a packet for each tick
    lag: int = 1  # number of latest packets that a write does not include
    options: dict[str, str] = field(default_factory=dict)


_CONTAINER_FORMATS = {
    # A fragment begins at each key frame and does not depend on later data.
    '.mp4': _ContainerFormat(
        name='mp4', ticks=90000, longest=3600, per_packet=16, at_end=200, per_key=24,
        options={'movflags': 'frag_keyframe+empty_moov+default_base_moof'}),
    '.mkv': _ContainerFormat(
        name='matroska', ticks=1000, longest=3600, per_packet=16, at_end=100, per_key=48,
        options={'cluster_time_limit': '500'}),
    # 300 is a multiple of common rates. FFmpeg writes at most 60000 empty frames in a row.
    '.avi': _ContainerFormat(
        name='avi', ticks=300, longest=199, per_packet=9, at_end=100, per_key=0, per_tick=24,
        lag=0),
}

#: File name extensions of the video formats.
VIDEO_FORMATS = tuple(_CONTAINER_FORMATS)

# Recordings run beside other work. superfast takes 12 ms of a core for a frame of 1920x1080;
# veryfast takes 22 ms for 0.9 of the size, ultrafast 9 ms for 1.8 of the size. With zerolatency
# only one frame waits in the encoder.
_OPTIONS = {
    'preset': 'superfast', 'tune': 'zerolatency', 'x264-params': 'force-cfr=0', 'forced-idr': '1',
    'threads': str(min(4, os.cpu_count() or 1)), 'colorspace': 'smpte170m', 'color_range': 'tv',
}
_NOMINAL_RATE = 30  # frames per second, for players of formats that must name a rate
_KEY_SECONDS = 1
_KEY_FRAME = 1  # AV_PICTURE_TYPE_I
_CLOCK_JUMP_NS = NANO
_BUFFER_SIZE = 2 ** 20  # bytes; about a second of video, so that a kill rarely hits a write


def check_video() -> None:
    """
    Check that videos can be encoded on this machine.

    :raises VideoError: PyAV or its H.264 encoder is missing; the message includes the remedy.
    """
    try:
        from av.codec.codec import Codec
        Codec('libx264', 'w')
    except ImportError as err:
        raise VideoError(f'videos need PyAV, which cannot be imported ({err}); '
                         f'{installation("av", "python3-av")}') from err
    except ValueError as err:
        raise VideoError('videos need libx264, which the installed PyAV does not include; '
                         f'{installation("--force-reinstall av")}') from err


class VideoWriter:
    """One video file; used by one thread at a time."""

    def __init__(
        self, path: Path, video_frame: VideoFrame, time_ns: int, crf: int = 23,
        room: Room = lambda _: True,
    ) -> None:
        """
        Create the file.

        :param path: path of the file; its extension, one of ``VIDEO_FORMATS``, selects the format.
        :param video_frame: frame with the size and pixel format of the video; it is not written.
        :param time_ns: start time of the video in nanoseconds, stored in the comment of the file.
        :param crf: constant rate factor of x264, from 0 (best) to 51 (smallest).
        :param room: asked before each frame that is written.
        :raises FileExistsError: the file exists; it is not changed.
        :raises OSError: the file cannot be written.
        :raises VideoError: the encoder does not support the size.
        """
        self.frames = 0  # frames that were accepted
        self.flushed = 0  # accepted frames that are complete in the file
        self.skipped = 0  # accepted frames for which there is no room
        self.others = 0
        self.is_full = False  # there is no room for the next frame
        self.bytes_waiting = 0  # upper bound for the frames that are not in the file yet
        self._path = path
        self._stream_format = video_frame.stream_format
        self._format = _CONTAINER_FORMATS[path.suffix.lower()]
        self._start_ns = self._last_ns = time_ns
        self._last, self._next_key = -1, 0  # ticks
        self._packets = self._keys = 0
        self._last_packet = -1  # ticks
        self._room = room
        self._whole = 0
        self._container: Any = None
        self._stream: Any = None
        self.file = OutputFile(path)
        try:
            self._call(self._open, crf)
        except BaseException:
            self._release()
            raise

    @property
    def size(self) -> int:
        """Size of the file in bytes, without the frames that are waiting."""
        return self.file.size

    def fits(self, video_frame: VideoFrame, time_ns: int) -> bool:
        """
        Return whether a frame can continue the video.

        :param video_frame: frame, which must have the size and pixel format of the video.
        :param time_ns: time of the frame in nanoseconds. More than a second before the previous
            frame means that the clock was set. The longest gap is an hour, in AVI 199 s.
        """
        step = time_ns - self._last_ns
        return (video_frame.stream_format == self._stream_format
                and -_CLOCK_JUMP_NS <= step <= self._format.longest * NANO)

    def is_at_path(self) -> bool:
        """Return whether the file is still at its path, or that cannot be determined."""
        return self.file.is_at_path()

    def write(self, video_frame: VideoFrame, time_ns: int) -> bool:
        """
        Encode a frame, which may wait in memory for later frames.

        :param video_frame: frame for which ``fits`` returned True.
        :param time_ns: time of the frame in nanoseconds; one tick after the previous frame if it
            is not later.
        :returns: False if the frame would exceed the maximum size; the file can then only be
            closed.
        :raises OSError: the file cannot be written; it can then only be closed.
        :raises VideoError: the encoder refused the frame.
        """
        self.file.check(self._whole)
        ticks = self._format.ticks
        since = ((time_ns - self._start_ns) * ticks + NANO // 2) // NANO
        pts = max(since, self._last + 1)
        # The second frame is a key frame, so that the first one is written in a short video too.
        is_key = pts >= self._next_key or self.frames == 1
        self.is_full = self.is_full or not self._has_room(0, pts)
        if self.is_full:
            return False
        frame = video_frame.frame
        frame.pts, frame.time_base = pts, Fraction(1, ticks)
        frame.pict_type = _KEY_FRAME if is_key else 0
        self._call(self._encode, frame)
        if self.is_full:
            return False
        self.frames += 1
        if pts >= self._next_key:
            self._next_key = pts + _KEY_SECONDS * ticks
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
                self._call(self._encode, None)
                self._call(self._container.close)
                self.flushed, self.bytes_waiting = self._packets, 0
        finally:
            self._release()

    def __del__(self) -> None:
        """Finish a file that was not closed; PyAV up to 12 would crash."""
        with suppress(Exception):
            self.close()

    def _open(self, crf: int) -> None:
        import av
        self._container = av.open(
            self.file, 'w', format=self._format.name, buffer_size=_BUFFER_SIZE,
            container_options={**self._format.options, 'flush_packets': '1'})
        seconds, rest = divmod(self._start_ns, NANO)
        self._container.metadata['comment'] = f'begins at {seconds}.{rest:09d}'
        self._stream = self._container.add_stream(
            'libx264', rate=_NOMINAL_RATE, options={**_OPTIONS, 'crf': str(crf)})
        context = self._stream.codec_context
        context.width, context.height, context.pix_fmt = self._stream_format
        context.time_base = Fraction(1, self._format.ticks)
        self._container.start_encoding()

    def _encode(self, frame: Any) -> None:
        """Write the packets of the encoder, which holds a frame until it knows its duration."""
        for packet in self._stream.encode(frame):
            steps = packet.pts - self._last_packet if self._format.per_tick else 1
            added = packet.size + self._format.per_packet * steps
            self.is_full = self.is_full or not self._has_room(added, packet.pts)
            if self.is_full:
                continue
            size, self._last_packet = self.file.size, packet.pts
            self._packets += 1
            self._keys += packet.is_keyframe
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
        end = container.at_end + container.per_key * (self._keys + 1) + container.per_tick * pts
        return self._room(self.size + self.bytes_waiting + added + end)

    def _call(self, step: Callable[..., None], *arguments: Any) -> None:
        """Call FFmpeg and convert its errors."""
        import av
        try:
            step(*arguments)
        except av.error.FFmpegError as err:
            self.file.check(self._whole)
            width, height, _ = self._stream_format
            raise VideoError(f'a {width}x{height} frame cannot be encoded as '
                             f'{self._path.suffix}: {err}') from err
        self.file.check(self._whole)
        self._whole = self.file.size

    def _release(self) -> None:
        import av
        container, self._container, self._stream = self._container, None, None
        with suppress(av.error.FFmpegError):
            if container is not None:
                container.close()  # it writes nothing after an error of the file
        with self.file.raw:
            if not self.flushed and self.is_at_path():
                self._path.unlink(missing_ok=True)
