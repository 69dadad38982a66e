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
from dataclasses import dataclass
import errno
from fractions import Fraction
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.remedies import installation
from opencv_tools.image.encodings import declared_encoding, find_encoding
from opencv_tools.image_codecs import convert_image
from opencv_tools.opencv import cv2
from opencv_tools.recording.errors import VideoError
from opencv_tools.recording.file_sink import Room
from opencv_tools.recording.image_encoder import LOSSLESS_VIDEO
from opencv_tools.recording.recorder import Prepared
from opencv_tools.recording.video.container import CONTAINER_FORMATS, VideoFile, WrittenVideo
from opencv_tools.video.lossless import LOSSLESS_ENCODINGS, LOSSLESS_PIXELS, lossless_tags

# PyAV is imported in functions, because the import is slow and most recordings are image files.

# Order of the colour channels by encoding. OpenCV treats generic types as gray and BGR.
_ORDERS = {'mono8': 'y', '8UC1': 'y', '8U': 'y', 'rgb8': 'rgb', 'bgr8': 'bgr', '8UC3': 'bgr'}

# Matrix from R, G, B and 1 to Y, Cb, Cr: ITU-R BT.601-7, 2.5. OpenCV assumes this matrix for every
# video, and most players for a video that does not name its matrix.
_LUMA = np.array([0.299, 0.587, 0.114])
_RGB = np.array([219 * _LUMA, 224 / 1.772 * ([0, 0, 1] - _LUMA), 224 / 1.402 * ([1, 0, 0] - _LUMA)
                 ]) / 255
_OFFSETS = np.array([[16], [128], [128]])
_MATRICES = {'rgb': np.hstack([_RGB, _OFFSETS]), 'bgr': np.hstack([_RGB[:, ::-1], _OFFSETS])}

# A file up to this size may be only the header that FFmpeg wrote. A larger MP4 that ends inside
# the header of a fragment cannot be opened either, but its frames can be rescued.
_HEADER_BYTES = 8192

#: File name extensions of the video formats.
VIDEO_FORMATS = tuple(CONTAINER_FORMATS)

# Recordings run beside other work. superfast takes 12 ms of a core for a frame of 1920x1080;
# veryfast takes 22 ms for 0.9 of the size, ultrafast 9 ms for 1.8 of the size. With zerolatency
# only one frame waits in the encoder.
_OPTIONS = {
    'preset': 'superfast', 'tune': 'zerolatency', 'x264-params': 'force-cfr=0', 'forced-idr': '1',
    'threads': str(min(4, os.cpu_count() or 1)), 'colorspace': 'smpte170m', 'color_range': 'tv',
}
# Each frame is complete in itself and has checksums, so that damage costs only its frame. FFmpeg
# slices all pictures above a size, twice a side. Version 6 loses slices of one pixel a side.
_LOSSLESS_OPTIONS = {'level': '3', 'g': '1', 'slicecrc': '1', 'thread_type': 'slice',
                     'threads': _OPTIONS['threads']}
_SLICES, _UNSLICED, _LEAST_SIDE = 4, (352, 288), 4
_NOMINAL_RATE = 30  # frames per second, for players of formats that must name a rate
_KEY_SECONDS = 1
_KEY_FRAME = 1  # AV_PICTURE_TYPE_I


@dataclass(frozen=True)
class VideoFrame(Prepared):
    """
    A frame for the encoder.

    :param frame: the ``av.VideoFrame``.
    :param encoding: encoding of a frame that is stored without loss; '' for others.
    """

    frame: Any
    encoding: str = ''

    @property
    def codec(self) -> str:
        """Name of the codec."""
        return 'ffv1' if self.encoding else 'h264'

    @property
    def stream_format(self) -> tuple[int, int, str, str]:
        """Properties that all frames of a file share; the last two are those of the pixels."""
        return self.frame.width, self.frame.height, self.frame.format.name, self.encoding

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.frame.width, self.frame.height


def to_video_frame(
    image: NDArray[Any], encoding_name: str, suffix: str, to_color: bool = False,
) -> VideoFrame:
    """
    Convert an image for the encoder; thread-safe.

    :param image: (h, w) or (h, w, c) array of any strides; not modified.
    :param encoding_name: sensor_msgs/Image encoding of the image.
    :param suffix: extension of the video, one of ``VIDEO_FORMATS``, for error messages.
    :param to_color: whether 8-bit Bayer and YUV images are converted; otherwise they are refused.
    :returns: a copy in 4:2:0 if both sizes are even, else in 4:4:4, which keeps every pixel; for
        Matroska with 16 bits if these are ``LOSSLESS_ENCODINGS``.
    :raises VideoError: no video can hold the image.
    """
    import av
    encoding = find_encoding(encoding_name)
    is_converted = to_color and encoding.dtype == 'uint8' and encoding.kind in ('bayer', 'yuv')
    is_lossless = suffix == LOSSLESS_VIDEO and encoding_name in LOSSLESS_ENCODINGS
    if encoding_name not in _ORDERS and not (is_converted or is_lossless):
        raise VideoError(f'a {encoding_name} frame cannot be stored as {suffix}')
    declared_encoding(image, encoding_name)
    if not image.size:
        raise VideoError(f'an empty frame ({image.shape[1]}x{image.shape[0]}) cannot be stored '
                         f'as {suffix}')
    if is_converted:
        image = convert_image(image, encoding, find_encoding('bgr8'))
    height, width = image.shape[:2]
    if is_lossless:
        if min(width, height) < _LEAST_SIDE:
            raise VideoError(f'a {width}x{height} {encoding_name} frame cannot be stored as '
                             f'{suffix}, which needs {_LEAST_SIDE} pixels a side')
        frame = av.VideoFrame(width, height, LOSSLESS_PIXELS)
        _fill(frame, [image.reshape(height, width)], '<u2')
        return VideoFrame(frame, encoding_name)
    is_even = not (height % 2 or width % 2)
    frame = av.VideoFrame(width, height, 'yuv420p' if is_even else 'yuv444p')
    _fill(frame, _planes(image, _ORDERS.get(encoding_name, 'bgr'), is_even), 'u1')
    return VideoFrame(frame)


def _fill(frame: Any, planes: Iterable[Any], dtype: str) -> None:
    for plane, values in zip(frame.planes, planes):
        rows = np.frombuffer(plane, dtype)
        rows.reshape(plane.height, -1)[:, :plane.width] = values


def _planes(image: NDArray[Any], order: str, is_even: bool) -> tuple[Any, Any, Any]:
    """
    Return the planes Y, Cb and Cr; a number stands for a constant plane.

    OpenCV needs a third of the time of FFmpeg, whose matrix depends on the version of PyAV.
    """
    if order == 'y':
        gray = image.reshape(image.shape[:2])
        return cv2.convertScaleAbs(gray, alpha=219 / 255, beta=16), 128, 128
    yuv = chroma = cv2.transform(image, _MATRICES[order])
    if is_even:
        size = image.shape[1] // 2, image.shape[0] // 2
        chroma = cv2.resize(yuv, size, interpolation=cv2.INTER_AREA)
    return cv2.extractChannel(yuv, 0), cv2.extractChannel(chroma, 1), cv2.extractChannel(chroma, 2)


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
                         f'{installation("av")}') from err
    except ValueError as err:
        raise VideoError('videos need libx264, which the installed PyAV does not include; '
                         f'{installation("--force-reinstall av")}') from err


class _EncodedStream(WrittenVideo[VideoFrame]):
    """A stream of encoded frames; see `WrittenVideo`."""

    def __init__(self, first: VideoFrame, crf: int) -> None:
        self.stream_format = first.stream_format
        width, height, *_ = first.stream_format
        self.failure = f'a {width}x{height} frame cannot be encoded'
        self._crf = crf
        self._ticks = 1
        self._frames = self._next_key = 0
        self._stream: Any = None

    def open(self, container: Any, ticks: int) -> None:  # noqa: A003
        self._ticks = ticks
        width, height, pixels, encoding = self.stream_format
        slices = 1 if width <= _UNSLICED[0] and height <= _UNSLICED[1] else _SLICES
        codec, options = ('ffv1', {**_LOSSLESS_OPTIONS, 'slices': str(slices)}) if encoding else (
            'libx264', {**_OPTIONS, 'crf': str(self._crf)})
        # Matroska has no rate if it is negative, so that players take that of the times.
        self._stream = container.add_stream(
            codec, rate=-1 if encoding else _NOMINAL_RATE, options=options)
        self._stream.metadata.update(lossless_tags(encoding) if encoding else {})
        context = self._stream.codec_context
        context.width, context.height, context.pix_fmt = width, height, pixels
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
