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

A file that is cut off at any moment plays, but for about its last second. MP4 holds times to
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
from opencv_tools.recording.video_picture import VideoError, VideoPicture

# PyAV is imported where it is used: it takes a while, and most recordings are no videos.


@dataclass(frozen=True)
class _Format:
    name: str  # FFmpeg's
    ticks: int  # steps of its time in a second
    longest: int  # seconds it can wait for a frame
    options: dict[str, str] = field(default_factory=dict)


_FORMATS = {
    # A fragment begins with each key frame and needs nothing that comes after it.
    '.mp4': _Format('mp4', 90000, 3600,
                    {'movflags': 'frag_keyframe+empty_moov+default_base_moof'}),
    '.mkv': _Format('matroska', 1000, 3600, {'cluster_time_limit': '500'}),
    # 300 is a multiple of the usual rates. FFmpeg puts at most 60000 empty frames in a row.
    '.avi': _Format('avi', 300, 199),
}

#: File name extensions of the formats.
FORMATS = tuple(_FORMATS)

# Recordings run beside other work: superfast takes 12 ms of a core for a frame of 1920x1080,
# veryfast 22 ms for 0.9 of the size, ultrafast 9 ms for 1.8 of it. No frame waits in the encoder.
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


class _File:
    """
    A new file as FFmpeg writes to it.

    An error is kept here; FFmpeg does not hear of it, for it would make another one of it.
    """

    def __init__(self, path: Path) -> None:
        self.size = 0
        self.error: OSError | None = None
        self._path = path
        self.raw = path.open('xb', buffering=0)  # not ``close``, which PyAV would call
        self.seek, self.tell = self.raw.seek, self.raw.tell

    def write(self, data: bytes) -> int:
        """Write all of it, or nothing after an error."""
        rest = memoryview(data)
        try:
            while rest and self.error is None:
                rest = rest[self.raw.write(rest):]  # a disk that fills up takes a part
                self.size = max(self.size, self.raw.tell())
        except OSError as err:
            self.error = err.with_traceback(None)  # which would keep the encoder alive
        return len(data)

    def check(self, whole: int) -> None:
        """
        Raise the error that was met, if any.

        :param whole: size of what is surely whole; what stands behind it is cut off then.
        """
        if self.error is not None:
            with suppress(OSError):
                self.size = self.raw.truncate(whole)
            raise OSError(self.error.errno, self.error.strerror, str(self._path)) from self.error


class VideoWriter:
    """One video file; one thread at a time may write to it."""

    def __init__(self, path: Path, picture: VideoPicture, time_ns: int, crf: int = 23) -> None:
        """
        Make the file.

        :param path: where; its extension is the format, one of ``FORMATS``.
        :param picture: one that has the form of those to come; it is not written.
        :param time_ns: when the file begins; its comment says so.
        :param crf: quality of x264, from 0, the best, to 51.
        :raises FileExistsError: there is such a file, which is left alone.
        :raises OSError: it cannot be written to.
        :raises VideoError: the encoder cannot take pictures of that size.
        """
        self.frames = 0
        self._path = path
        self._form = picture.form
        self._format = _FORMATS[path.suffix.lower()]
        self._start_ns = self._last_ns = time_ns
        self._last, self._next_key = -1, 0  # ticks
        self._whole = 0
        self._container: Any = None
        self._stream: Any = None
        self._file = _File(path)
        try:
            self._call(self._open, crf)
        except BaseException:
            self._release()
            raise

    @property
    def bytes_written(self) -> int:
        """Bytes in the file so far."""
        return self._file.size

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

    def write(self, picture: VideoPicture, time_ns: int) -> None:
        """
        Add a picture to the file.

        :param picture: one that ``fits``.
        :param time_ns: its time; one that is not later than the last is put right behind it.
        :raises OSError: the file cannot be written to, and only be closed any more.
        :raises VideoError: the encoder did not take it.
        """
        self._file.check(self._whole)
        ticks = self._format.ticks
        since = ((time_ns - self._start_ns) * ticks + NANO // 2) // NANO
        pts = max(since, self._last + 1)
        is_key = pts >= self._next_key
        frame = picture.frame
        frame.pts, frame.time_base = pts, Fraction(1, ticks)
        frame.pict_type = _KEY_FRAME if is_key else 0
        self._call(self._encode, frame)
        if is_key:
            self._next_key = pts + _KEY_SECONDS * ticks
        self._last, self._last_ns = pts, time_ns
        self.frames += 1

    def close(self) -> None:
        """
        End the file; one without a frame is removed.

        After an error of ``write`` it ends quietly. In any case, what is in the file plays.

        :raises OSError: the last frames were not written.
        :raises VideoError: FFmpeg did not end the file.
        """
        if self._container is None:
            return
        try:
            if self._file.error is None:
                self._call(self._finish)
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
        for packet in self._stream.encode(frame):
            self._container.mux(packet)

    def _finish(self) -> None:
        self._encode(None)
        self._container.close()

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
        self._file.raw.close()
        if not self.frames:
            self._path.unlink(missing_ok=True)
