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

"""Videos of a data set: H.264, or HEVC for depth, in MP4, with frame k exactly at k / fps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from fractions import Fraction
import os
from pathlib import Path
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.regular_files import open_regular
from opencv_tools.base.remedies import installation
from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.datasets.errors import DatasetError, reason_of
from opencv_tools.recording.errors import VideoError
from opencv_tools.recording.video.writer import check_video, to_video_frame
from opencv_tools.video.settings import import_av

# PyAV is imported in functions, because the import is slow.

CODEC, PIXELS = 'h264', 'yuv420p'
#: Depth: codes of 12 bits without losses.
DEPTH_CODEC, DEPTH_PIXELS, LOSSLESS = 'hevc', 'gray12le', 'lossless=1'
#: Frames from one key frame to the next. Training reads single frames, so few are decoded for one.
KEY_INTERVAL = 2
PRESET = 'superfast'
_KEY_FRAME = 1  # AV_PICTURE_TYPE_I
_LEAST_PREDICTED = 64  # width in pixels
_LEAST_SIDE = 16  # of depth, in pixels
# AVVideoEncParams of FFmpeg: number, offset and size of the blocks, and the quantiser of a frame.
# After its place and size, a block has the difference of its own quantiser.
_PARAMETERS_TYPE, _PARAMETERS, _DIFFERENCE_AT = 19, '@IQQii', 16


def check_depth_size(codes: NDArray[Any]) -> None:
    """
    Check that a video can have codes of depth, (h, w).

    :raises DatasetError: there are too few pixels a side.
    """
    if min(codes.shape) < _LEAST_SIDE:
        raise DatasetError(
            f'depth of {codes.shape[1]}x{codes.shape[0]} is too small for HEVC, which needs '
            f'{_LEAST_SIDE} pixels a side: use --format parquet or webdataset')


class VideoFileWriter:
    """Writer of a video of one camera."""

    def __init__(self, path: Path, fps: int, crf: int, threads: int = 1,
                 is_depth: bool = False) -> None:
        """
        Create the file; the first frame decides on the size.

        :param fps: frames of a second.
        :param crf: constant rate factor of x264, from 0 (best) to 51 (smallest); depth has none.
        :raises DatasetError: PyAV or its encoder is missing.
        """
        try:
            check_video()
        except VideoError as err:
            raise DatasetError(str(err)) from err
        import av
        self._container: Any = av.open(str(path), 'w', format='mp4')
        options = {'preset': PRESET, 'g': str(KEY_INTERVAL), 'bf': '0', 'forced-idr': '1'}
        options |= {'x265-params': f'{LOSSLESS}:scenecut=0:min-keyint=1:log-level=error:'
                                   f'pools={threads}'} if is_depth else {
            'crf': str(crf), 'sc_threshold': '0', 'threads': str(threads),
            'colorspace': 'smpte170m', 'color_range': 'tv'}
        try:
            self._stream = self._container.add_stream(
                'libx265' if is_depth else 'libx264', rate=fps, options=options)
        except ValueError as err:
            self.abandon()
            raise DatasetError('depth needs libx265, which the installed PyAV does not include; '
                               f'{installation("--force-reinstall av")}') from err
        self._is_depth = is_depth
        self._fps, self._frames = fps, 0
        self._last: tuple[int, Any] = -1, None

    def write(self, number: int, image: NDArray[Any], is_first: bool) -> None:
        """
        Write a frame.

        :param number: number of the picture; that of the last frame for the same one again.
        :param image: (h, w, 3) array in BGR, or (h, w) codes of depth, of the size of the first.
        :param is_first: whether an episode begins.
        :raises DatasetError: the frame cannot be encoded.
        """
        import av
        if self._is_depth:
            check_depth_size(image)
        try:
            if number != self._last[0]:
                self._last = number, (_depth_frame(image) if self._is_depth else
                                      to_video_frame(image, 'bgr8', '.mp4').frame)
            frame = self._last[1]
            if not self._frames:
                context = self._stream.codec_context
                context.width, context.height = frame.width, frame.height
                context.pix_fmt = frame.format.name
                context.time_base = Fraction(1, self._fps)
            frame.pts, frame.time_base = self._frames, Fraction(1, self._fps)
            # The prediction of x265 is wrong in pictures with a width of 16 or 32.
            is_narrow = self._is_depth and frame.width < _LEAST_PREDICTED
            frame.pict_type = _KEY_FRAME if is_first or is_narrow else 0
            self._frames += 1
            self._container.mux(self._stream.encode(frame))
        except (VideoError, av.error.FFmpegError, ValueError) as err:
            if isinstance(err, OSError) and err.errno and err.errno > 0:
                raise  # a full disk
            size = f'{image.shape[1]}x{image.shape[0]}'
            raise DatasetError(f'a picture of {size} cannot be encoded: {printable(err)}') from err

    def close(self) -> None:
        """
        Finish the file.

        :raises OSError: the file cannot be written.
        """
        if self._frames:
            self._container.mux(self._stream.encode(None))
        self._container.close()

    def abandon(self) -> None:
        """Close the file without finishing it."""
        with suppress(Exception):
            self._container.close()


def join_videos(sources: Sequence[Path], target: Path, expected: int) -> None:
    """
    Join videos of one size and rate without encoding them again.

    :param expected: number of frames that they have.
    :raises DatasetError: a file is no video of this package.
    :raises OSError: a file cannot be read or written.
    """
    import av
    try:
        with av.open(str(target), 'w', format='mp4') as output:
            stream: Any = None
            frames = 0
            for source in sources:
                with av.open(str(source)) as container:
                    found: Any = container.streams.video[0]
                    stream = stream or _copied_stream(output, found)
                    tick = Fraction(1) / (found.average_rate * found.time_base)
                    for packet in container.demux(found):
                        if packet.size:
                            packet.pts = packet.dts = round(frames * tick)
                            packet.stream = stream
                            output.mux(packet)
                            frames += 1
        if frames != expected:
            raise DatasetError(f'the videos of {printable(target, MAX_PATH)} have {frames} frames '
                               f'instead of {expected}: convert their bags again')
    except (av.error.FFmpegError, IndexError, TypeError, ZeroDivisionError) as err:
        if isinstance(err, OSError) and err.errno and err.errno > 0:
            raise
        raise DatasetError(f'{printable(target, MAX_PATH)} cannot be joined: {printable(err)}'
                           ) from err


def stream_settings(path: Path) -> tuple[str, str, bytes]:
    """
    Return the codec, the pixel format and the header, equal for videos that can be joined.

    :raises DatasetError: the file is no video.
    """
    import av
    try:
        os.close(open_regular(path))
        with av.open(str(path)) as container:
            context: Any = container.streams.video[0].codec_context
            codec = context.name.removeprefix('lib').replace('dav1d', 'av1')
            return codec, context.pix_fmt or '', bytes(context.extradata or b'')
    except (av.error.FFmpegError, IndexError, OSError) as err:
        raise DatasetError(f'{printable(path, MAX_PATH)} is no video: {reason_of(err)}') from err


def video_frames(path: Path) -> Iterator[tuple[Fraction, Any]]:
    """
    Yield the time in seconds and the ``av.VideoFrame`` of each frame of a video.

    :raises DatasetError: the file is no video, or is damaged.
    """
    av = import_av()
    try:
        os.close(open_regular(path))  # FFmpeg would wait for a pipe
        with av.open(str(path)) as container:
            stream: Any = container.streams.video[0]
            stream.thread_type = 'AUTO'
            stream.codec_context.options = {'export_side_data': 'venc_params'}
            for frame in container.decode(stream):
                if frame.pts is None or frame.is_corrupt:
                    raise DatasetError('it has a damaged frame')
                yield frame.pts * Fraction(frame.time_base), frame
    except (av.error.FFmpegError, IndexError, OSError) as err:
        raise DatasetError(f'it is no video, or is damaged: {reason_of(err)}') from err


def frame_luma(frame: Any) -> NDArray[np.uint8]:
    """Return the brightness of a frame of 8 bits with the range of TV, (h, w), from 0 to 255."""
    luma = _first_plane(frame, np.uint8).astype(np.float32)
    return np.clip((luma - 16) * (255 / 219), 0, 255).astype(np.uint8)


def frame_step(frame: Any) -> float:
    """Return the step of the quantisation of a frame of H.264 in levels; 0.0 if it is unknown."""
    # PyAV 19 iterates over the types, earlier versions over the data.
    for side in (frame.side_data[at] for at in range(len(frame.side_data))):
        if int(getattr(side.type, 'value', side.type)) == _PARAMETERS_TYPE:
            data = bytes(side)
            count, begin, size, _, quantiser = struct.unpack_from(_PARAMETERS, data)
            own = np.ndarray(count, np.int32, data, begin + _DIFFERENCE_AT, (size,)).sum()
            return float(2 ** ((quantiser + own / max(1, count) - 4) / 6))
    return 0.0


def frame_codes(frame: Any) -> NDArray[np.uint16]:
    """
    Return the codes of a frame of depth, (h, w), as LeRobot reads them.

    :raises DatasetError: a frame of its format has none.
    """
    import av
    try:
        return _first_plane(frame.reformat(format=DEPTH_PIXELS), np.uint16).copy()
    except (av.error.FFmpegError, ValueError) as err:
        raise DatasetError(f'a frame of {frame.format.name} is no depth: {printable(err)}'
                           ) from err


def _first_plane(frame: Any, kind: type[np.generic]) -> NDArray[Any]:
    """Return the first plane of a frame as a writable view; old PyAV copies few formats."""
    plane = frame.planes[0]
    rows = np.frombuffer(plane, kind)
    view: NDArray[Any] = rows.reshape(-1, plane.line_size // rows.itemsize)
    return view[:plane.height, :plane.width]


def _depth_frame(codes: NDArray[np.uint16]) -> Any:
    import av
    height, width = codes.shape
    frame = av.VideoFrame(width, height, DEPTH_PIXELS)
    _first_plane(frame, np.uint16)[:] = codes
    return frame


def _copied_stream(output: Any, template: Any) -> Any:
    if hasattr(output, 'add_stream_from_template'):
        stream = output.add_stream_from_template(template)
    else:  # PyAV 12
        stream = output.add_stream(template=template)
    stream.time_base = template.time_base
    return stream
