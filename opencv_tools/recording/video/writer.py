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

"""Videos of frames that are encoded as H.264, also those that were killed."""

from __future__ import annotations

from collections.abc import Iterable
import errno
from fractions import Fraction
import os
from pathlib import Path
from typing import Any

from opencv_tools.base.remedies import installation
from opencv_tools.recording.errors import VideoError
from opencv_tools.recording.file_format import Room
from opencv_tools.recording.video.container import CONTAINER_FORMATS, VideoFile, WrittenVideo
from opencv_tools.recording.video.frame import VideoFrame

# A file up to this size may be only the header that FFmpeg wrote. A larger MP4 that ends inside
# the header of a fragment cannot be opened either, but its frames can be rescued.
_HEADER_BYTES = 8192


def count_frames(path: Path) -> int | None:
    """
    Count the complete frames of a video.

    :param path: path of a readable video, which may be truncated anywhere.
    :returns: number of frames; 0 if the file is only a header; None if the number is unknown.
    :raises OSError: the file cannot be read.
    """
    if path.suffix.lower() not in VIDEO_FORMATS:
        return None
    try:
        import av
    except ImportError:
        return None
    count, is_read = 0, True
    try:
        with av.open(str(path)) as container:
            for packet in container.demux(video=0):
                count += bool(packet.size) and not packet.is_corrupt
    except (av.error.InvalidDataError, EOFError, IndexError):
        pass  # truncated; IndexError means that there is no stream
    except av.error.FFmpegError as err:
        is_read = err.errno == errno.EIO  # Matroska reports a truncated file by EIO
    is_empty = is_read and path.stat().st_size <= _HEADER_BYTES
    return count or (0 if is_empty else None)


# PyAV is imported in functions, because the import is slow and most recordings are image files.

#: File name extensions of the video formats.
VIDEO_FORMATS = tuple(CONTAINER_FORMATS)

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


class _EncodedStream(WrittenVideo[VideoFrame]):
    """A stream of encoded frames; see `WrittenVideo`."""

    def __init__(self, first: VideoFrame, crf: int) -> None:
        self.stream_format = first.stream_format
        width, height, _ = first.stream_format
        self.failure = f'a {width}x{height} frame cannot be encoded'
        self._crf = crf
        self._ticks = 1
        self._frames = self._next_key = 0
        self._stream: Any = None

    def open(self, container: Any, ticks: int) -> None:  # noqa: A003
        self._ticks = ticks
        self._stream = container.add_stream(
            'libx264', rate=_NOMINAL_RATE, options={**_OPTIONS, 'crf': str(self._crf)})
        context = self._stream.codec_context
        context.width, context.height, context.pix_fmt = self.stream_format
        context.time_base = Fraction(1, ticks)

    def packets(self, prepared: VideoFrame | None, pts: int) -> Iterable[Any]:
        """Return the packets of the encoder, which holds a frame until it knows its duration."""
        if prepared is None:
            return list(self._stream.encode(None))
        frame = prepared.frame
        # The second frame is a key frame, so that the first one is written in a short video too.
        is_key = pts >= self._next_key or self._frames == 1
        frame.pts, frame.time_base = pts, Fraction(1, self._ticks)
        frame.pict_type = _KEY_FRAME if is_key else 0
        self._frames += 1
        if pts >= self._next_key:
            self._next_key = pts + _KEY_SECONDS * self._ticks
        return list(self._stream.encode(frame))


class VideoWriter(VideoFile[VideoFrame]):
    """One video file of encoded frames; used by one thread at a time."""

    def __init__(
        self, path: Path, video_frame: VideoFrame, time_ns: int, crf: int = 23,
        room: Room = lambda _: True,
    ) -> None:
        """
        Create the file; see `VideoFile`.

        :param video_frame: frame with the size and pixel format of the video; it is not written.
        :param crf: constant rate factor of x264, from 0 (best) to 51 (smallest).
        """
        super().__init__(path, _EncodedStream(video_frame, crf), time_ns, room)
