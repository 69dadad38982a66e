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

A file that is cut off at any moment plays, but for about its last second: frames wait in memory
until FFmpeg writes them together. The first frame is written with the third. MP4 holds times to
11 us, Matroska to 1 ms. AVI knows a constant rate only: it gets 300 frames a second, most of them
empty, which holds times to 2 ms and takes 26 MB an hour. OpenCV reads the true times from it, but
300 for the rate, counts the empty frames, and cannot seek; FFmpeg shows each frame when its next
one is due.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
import os
from pathlib import Path
from typing import Any

from opencv_tools.recording.naming import NANO
from opencv_tools.recording.output_file import OutputFile
from opencv_tools.recording.video_picture import VideoError, VideoPicture

# PyAV is imported where it is used: it takes a while, and most recordings are no videos.


@dataclass(frozen=True)
class _Format:
    name: str  # FFmpeg's
    ticks: int  # steps of its time in a second
    longest: int  # seconds it can wait for a frame
    # What FFmpeg writes beside the packets, in bytes at most:
    beside: int  # for each packet
    ending: int  # at the end of the file, and for what is written together
    per_key: int  # for each key frame, at the end of the file
    per_tick: int = 0  # at the end, for each tick, in a format that has a packet for each
    lag: int = 1  # packets, from the last one, that are not in what was written with it
    options: dict[str, str] = field(default_factory=dict)


_FORMATS = {
    # A fragment begins with each key frame and needs nothing that comes after it.
    '.mp4': _Format('mp4', 90000, 3600, 16, 200, 24, options={
                    'movflags': 'frag_keyframe+empty_moov+default_base_moof'}),
    '.mkv': _Format('matroska', 1000, 3600, 16, 100, 48, options={'cluster_time_limit': '500'}),
    # 300 is a multiple of the usual rates. FFmpeg puts at most 60000 empty frames in a row.
    '.avi': _Format('avi', 300, 199, 9, 100, 0, per_tick=24, lag=0),
}

#: File name extensions of the formats.
FORMATS = tuple(_FORMATS)

# Recordings run beside other work: superfast takes 12 ms of a core for a frame of 1920x1080,
# veryfast 22 ms for 0.9 of the size, ultrafast 9 ms for 1.8 of it. One frame waits in the encoder.
_OPTIONS = {
    'preset': 'superfast', 'tune': 'zerolatency', 'x264-params': 'force-cfr=0', 'forced-idr': '1',
    'threads': str(min(4, os.cpu_count() or 1)), 'colorspace': 'smpte170m', 'color_range': 'tv',
}
_NOMINAL_RATE = 30  # frames a second, for the players of formats that must tell one
_KEY_SECONDS = 1
_KEY_FRAME = 1  # AV_PICTURE_TYPE_I
_CLOCK_JUMP_NS = NANO
_BUFFER_SIZE = 2 ** 20  # bytes: a second of video at once, so that a kill seldom comes in between


def check_video() -> None:
    """
    Refuse a machine that cannot make videos.

    :raises VideoError: PyAV or its H.264 encoder is missing; the message says how to get it.
    """
    try:
        from av.codec.codec import Codec
        Codec('libx264', 'w')
    except ImportError as err:
        raise VideoError(f'a video needs PyAV, which cannot be used ({err}); install it with '
                         "'pip install av', on Ubuntu with 'sudo apt install python3-av'"
                         ) from err
    except ValueError as err:
        raise VideoError('a video needs libx264, which the installed PyAV comes without; '
                         "get one that has it with 'pip install --force-reinstall av'") from err


class VideoWriter:
    """One video file; one thread at a time may write to it."""

    def __init__(
        self, path: Path, picture: VideoPicture, time_ns: int, crf: int = 23, max_bytes: int = 0,
    ) -> None:
        """
        Make the file.

        :param path: where; its extension is the format, one of ``FORMATS``.
        :param picture: one that has the form of those to come; it is not written.
        :param time_ns: when the file begins; its comment says so.
        :param crf: quality of x264, from 0, the best, to 51.
        :param max_bytes: size of the file at most; 0 for no limit.
        :raises FileExistsError: there is such a file, which is left alone.
        :raises OSError: it cannot be written to.
        :raises VideoError: the encoder cannot take pictures of that size.
        """
        self.frames = 0  # that it took
        self.flushed = 0  # of these, that are whole in the file
        self.is_full = False  # the next frame would be too much
        self._path = path
        self._form = picture.form
        self._format = _FORMATS[path.suffix.lower()]
        self._start_ns = self._last_ns = time_ns
        self._last, self._next_key = -1, 0  # ticks
        self._packets = self._keys = 0
        self._last_packet = -1  # ticks
        self._max_bytes = max_bytes
        self._whole = 0
        self._waiting = 0  # bytes of frames that are not flushed
        self._container: Any = None
        self._stream: Any = None
        self._file = OutputFile(path)
        try:
            self._call(self._open, crf)
        except BaseException:
            self._release()
            raise

    @property
    def bytes_written(self) -> int:
        """Bytes in the file so far."""
        return self._file.size

    @property
    def left_out(self) -> int:
        """Frames that it took, but that are too much for the file."""
        return self.frames - self._packets if self.is_full else 0

    @property
    def bytes_waiting(self) -> int:
        """Bytes of frames that are not in the file yet, at most."""
        return self._waiting

    def is_named(self) -> bool:
        """Return whether the file was neither removed nor moved."""
        return self._file.is_named()

    def fits(self, picture: VideoPicture, time_ns: int) -> bool:
        """
        Tell whether the file can go on with a picture.

        :param picture: it must have the form of the others.
        :param time_ns: its time. More than a second back the clock was set; ahead, an hour can be
            waited for, of AVI 199 s.
        """
        step = time_ns - self._last_ns
        return (picture.form == self._form
                and -_CLOCK_JUMP_NS <= step <= self._format.longest * NANO)

    def write(self, picture: VideoPicture, time_ns: int) -> bool:
        """
        Add a picture to the file, where it may wait in memory for those that come.

        :param picture: one that ``fits``.
        :param time_ns: its time; one that is not later than the last is put right behind it.
        :returns: False where the file would grow larger than it may; then it can only be closed.
        :raises OSError: the file cannot be written to, and only be closed any more.
        :raises VideoError: the encoder did not take it.
        """
        self._file.check(self._whole)
        ticks = self._format.ticks
        since = ((time_ns - self._start_ns) * ticks + NANO // 2) // NANO
        pts = max(since, self._last + 1)
        # The first frame is written when the second one is a key frame: a short video has it.
        is_key = pts >= self._next_key or self.frames == 1
        self.is_full = self.is_full or not self._has_room(0, pts)
        if self.is_full:
            return False
        frame = picture.frame
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
        End the file; one that no frame was written to is removed.

        After an error of ``write`` it ends quietly. In any case, what is in the file plays.

        :raises OSError: the last frames were not written.
        :raises VideoError: FFmpeg did not end the file.
        """
        if self._container is None:
            return
        try:
            if self._file.error is None:
                self._call(self._encode, None)
                self._call(self._container.close)
                self.flushed, self._waiting = self._packets, 0
        finally:
            self._release()

    def __del__(self) -> None:
        """End a file that was forgotten; PyAV up to 12 would crash on it."""
        with suppress(Exception):
            self.close()

    def _open(self, crf: int) -> None:
        import av
        self._container = av.open(
            self._file, 'w', format=self._format.name, buffer_size=_BUFFER_SIZE,
            container_options={**self._format.options, 'flush_packets': '1'})
        seconds, rest = divmod(self._start_ns, NANO)
        self._container.metadata['comment'] = f'begins at {seconds}.{rest:09d}'
        self._stream = self._container.add_stream(
            'libx264', rate=_NOMINAL_RATE, options={**_OPTIONS, 'crf': str(crf)})
        context = self._stream.codec_context
        context.width, context.height, context.pix_fmt = self._form
        context.time_base = Fraction(1, self._format.ticks)
        self._container.start_encoding()

    def _encode(self, frame: Any) -> None:
        """Add what the encoder makes; it keeps a frame until it knows how long that one lasts."""
        for packet in self._stream.encode(frame):
            steps = packet.pts - self._last_packet if self._format.per_tick else 1
            added = packet.size + self._format.beside * steps
            self.is_full = self.is_full or not self._has_room(added, packet.pts)
            if self.is_full:
                continue
            size, self._last_packet = self._file.size, packet.pts
            self._packets += 1
            self._keys += packet.is_keyframe
            self._container.mux(packet)
            if self._file.size > size and self._file.error is None:
                self.flushed, self._whole = self._packets - self._format.lag, self._file.size
                self._waiting = 0
            self._waiting += added * self._format.lag

    def _has_room(self, size: int, pts: int) -> bool:
        form = self._format
        end = form.ending + form.per_key * (self._keys + 1) + form.per_tick * pts
        return not self._max_bytes or self._file.size + self._waiting + size + end <= (
            self._max_bytes)

    def _call(self, step: Callable[..., None], *arguments: Any) -> None:
        """Let FFmpeg do a step, and give its errors as ours."""
        import av
        try:
            step(*arguments)
        except av.error.FFmpegError as err:
            self._file.check(self._whole)
            width, height, _ = self._form
            raise VideoError(f'a {width}x{height} frame cannot be encoded as '
                             f'{self._path.suffix}: {err}') from err
        self._file.check(self._whole)
        self._whole = self._file.size

    def _release(self) -> None:
        import av
        container, self._container, self._stream = self._container, None, None
        with suppress(av.error.FFmpegError):
            if container is not None:
                container.close()  # after an error of the file it writes nothing
        with self._file.raw:
            if not self.flushed and self._file.is_named():
                self._path.unlink(missing_ok=True)
