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

"""Video files as a source, decoded by PyAV."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from fractions import Fraction
from functools import cache
from itertools import chain
import re
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import MAX_PATH, printable, without_password
from opencv_tools.capture.container import (
    count_videos, known_count, open_container, stream_rate, video_stream)
from opencv_tools.capture.declared_size import check_end
from opencv_tools.capture.errors import BrokenFrameError, CaptureError
from opencv_tools.capture.frame import CapturedFrame
from opencv_tools.capture.video_packets import VideoPackets
from opencv_tools.image.orientation import matrix_orientation, turn_upright
from opencv_tools.video.lossless import (
    describe_tags, has_no_sums, has_valid_sums, tagged_encoding)
from opencv_tools.video.pixels import to_bgr
from opencv_tools.video.settings import import_av, NOMINAL_RATE

_GRAY = re.compile('gray[0-9]+[bl]e')
# Formats of broadcasts, whose clock may begin again, and the seconds that are such a step, as in
# the ffmpeg command.
_MAY_STEP, _MOST_BACK, _MOST_AHEAD = 0x200, 0.1, 10.0  # AVFMT_TS_DISCONT


class VideoSource:
    """
    A video file. Each frame has its time in the file.

    Gray videos of more than 8 bits are read as the numbers that they have.
    """

    live: Literal[False] = False

    def __init__(self, location: str, container: Any, timeout: float | None = None) -> None:
        """
        Read from a container.

        :param location: path of the file, or its URL on a web server.
        :param container: the container, as ``open_container`` returns it.
        :param timeout: timeout in seconds for opening it again; None to wait.
        :raises CaptureError: it has no packet.
        """
        self.name = printable(without_password(location), MAX_PATH)
        self._location, self._timeout = location, timeout
        self._av = import_av()
        self._container: Any = container
        self._is_avi = container.format.name == 'avi'
        self._ticks = 0  # of an AVI, whose last pictures have no times
        self._number = 0  # of the next picture
        stream = video_stream(container)
        self.rate, self.count = stream_rate(stream), known_count(container)
        context = stream.codec_context
        self._size = context.width, context.height
        depth = max((one.bits for one in context.format.components), default=0
                    ) if context.format else 0
        self._pixels = context.format.name if depth > 8 else ''
        #: Whether its numbers have more than 8 bits, which are kept.
        self.is_deep = _GRAY.fullmatch(self._pixels) is not None
        self.description = (f'{self._pixels + " " if self.is_deep else ""}'
                            f'{context.width}x{context.height} at {self.rate:g} Hz')
        self._begin()

    def skip(self) -> bool:
        try:
            return self._next() is not None
        except BrokenFrameError:
            if self._is_checked:
                raise
            return True

    def read(self) -> CapturedFrame | None:
        frame = self._next()
        if frame is None:
            return None
        image, encoding = self._image(frame)
        ticks = frame.dts if frame.pts is None else frame.pts
        if self._is_avi:  # it has no times of presentation, and those of PyAV step back
            ticks = self._ticks = self._ticks + 1 if frame.dts is None else frame.dts
        return CapturedFrame(
            image, encoding, position=self._clock.seconds(ticks, frame.time_base))

    def read_ahead(self) -> CapturedFrame | None:
        ticks = None if self._pixels or self._decoded else self._packets.pass_over()
        if ticks is None:
            return self.read()
        self._number += 1

        def image() -> NDArray[Any]:
            self._packets.passed, self._number = ticks - 1, self._number - 1
            frame = self._next()
            if frame is None:
                raise self._broken()
            return self._image(frame)[0]

        return CapturedFrame(cache(image), 'bgr8', position=self._clock.seconds(
            ticks, self._stream.time_base))

    def _image(self, frame: Any) -> tuple[NDArray[Any], str]:
        """
        Return a picture as an upright image, and its encoding.

        :raises BrokenFrameError: its colours are invalid.
        """
        encoding = 'bgr8'
        try:
            if self.is_deep:
                encoding, kind = self._encoding, '>u2' if self._pixels.endswith('be') else '<u2'
                numbers = np.frombuffer(frame.planes[0], kind)
                image = numbers.reshape(frame.height, -1)[:, :frame.width]
            else:
                image = to_bgr(frame)
        except (self._av.error.FFmpegError, ValueError) as err:  # of invalid colours
            raise self._broken(f': {err}') from err
        matrix = frame.side_data.get('DISPLAYMATRIX')
        if matrix:
            image = turn_upright(image, matrix_orientation(bytes(matrix)))
        return image, encoding

    def rewind(self) -> None:
        # Opening it again is exact for every container; seeking to the first frame is not.
        self.close()
        self._container = open_container(self._location, self._timeout)
        self._begin()

    def close(self) -> None:
        self._container.close()

    def _begin(self) -> None:
        """Prepare to read the first packet, and find the warnings."""
        self._stream = stream = video_stream(self._container)
        context = stream.codec_context
        self._is_ffv1 = context.name == 'ffv1'
        # A picture of FFV1 is checked before it is decoded, and comes with its packet.
        stream.thread_type = 'SLICE' if self._is_ffv1 else 'AUTO'
        packets = self._container.demux(stream)
        try:
            first = next(packets)
        except (self._av.error.FFmpegError, OSError, StopIteration) as err:
            raise CaptureError(f'{self.name} cannot be read: {err}') from err
        self._packets = VideoPackets(
            self._readable(chain((first,), packets)), self._container, context.name)
        self._decoded = deque[Any]()
        self._number = 0
        self._clock = _FileClock(self._container, stream, self.rate)
        self._needs_key = self._is_checked = False
        # FFV1 before version 3 has no such data and no checksums.
        self._may_have_sums = self._is_ffv1 and self.is_deep and bool(context.extradata)
        self.warnings = []
        count = count_videos(self._container)
        if count > 1:
            self.warnings += [f'{self.name} has {count} videos; that of {context.width}x'
                              f'{context.height} is read']
        # FFmpeg's own decoders of VP8 and VP9 leave out an alpha that is a video of its own.
        if stream.metadata.get('alpha_mode') == '1' or any(
                one.is_alpha for one in (context.format.components if context.format else ())):
            self.warnings += [f'{self.name} has an alpha channel, which is dropped']
        if self._pixels and not self.is_deep:
            self.warnings += [f'{self.name} has pixels of {self._pixels}, which are reduced to 8 '
                              'bits a channel; only gray videos keep more']
        if self.is_deep:
            has_sums = self._may_have_sums and not has_no_sums(bytes(first))
            # FFmpeg scales numbers for other formats, whose copied metadata are wrong.
            tags = stream.metadata if self._pixels.startswith('gray16') else {}
            self._encoding, wrong = tagged_encoding(tags) or 'mono16', describe_tags(tags)
            self.warnings += [
                f'{self.name} has no checksums, so that damaged frames are not noticed; FFmpeg '
                'writes them with -c:v ffv1 -level 3 -slicecrc 1'
            ] if self._is_ffv1 and not has_sums else []
            self.warnings += [f'{self.name} has {wrong}'] if wrong else []

    def _readable(self, packets: Iterable[Any]) -> Iterator[Any]:
        """
        Yield packets.

        :raises BrokenFrameError: the file cannot be read.
        """
        try:
            yield from packets
        except (self._av.error.FFmpegError, OSError) as err:
            self._is_checked = True
            raise BrokenFrameError(f'{self.name} cannot be read: {err}') from err

    def _next(self) -> Any:
        """
        Return the next picture; None at the end.

        :raises BrokenFrameError: it cannot be decoded, or the file ends early, once.
        """
        while not self._decoded:
            packet = next(self._packets, None)
            if packet is not None:
                self._decoded.extend(
                    frame for frame in self._decode(packet)
                    if frame.pts is None or frame.pts > self._packets.passed)
            elif self._is_checked:
                return None
            else:
                self._is_checked = True
                check_end(self._location, self._number)
        frame = self._decoded.popleft()
        self._number += 1
        self._packets.show(frame.pts)
        # After a picture that cannot be decoded, others are not as they were.
        self._needs_key = self._needs_key and not frame.key_frame
        if self._needs_key or frame.is_corrupt or (self.is_deep and (
                frame.width, frame.height, frame.format.name) != (*self._size, self._pixels)):
            raise self._broken()
        return frame

    def _decode(self, packet: Any) -> list[Any]:
        """
        Return the pictures of a packet; the one without data at the end has the last ones.

        :raises BrokenFrameError: it is damaged.
        """
        reason = ''
        try:
            if not (self._may_have_sums and packet.size) or (
                    has_valid_sums(bytes(packet)) or has_no_sums(bytes(packet))):
                frames = packet.decode() or []
                if frames or not (self._is_ffv1 and packet.size):
                    return list(frames)
        except (self._av.error.FFmpegError, OSError, ValueError) as err:
            reason = f': {getattr(err, "strerror", None) or err}'
        self._number += 1
        raise self._broken(reason)

    def _broken(self, reason: str = '') -> BrokenFrameError:
        """Return the error of the last frame, which later ones may need."""
        self._needs_key = True
        return BrokenFrameError(
            f'frame {self._number - 1} of {self.name} cannot be decoded{reason}')


class _FileClock:
    """Times from the begin of a stream, as if the clock of the file did not step."""

    def __init__(self, container: Any, stream: Any, rate: float) -> None:
        self._start, self._rate = stream.start_time or 0, rate or NOMINAL_RATE
        self._may_step = bool(container.format.flags & _MAY_STEP)
        self._shift = 0.0
        self._last: float | None = None

    def seconds(self, ticks: int | None, time_base: Fraction) -> float | None:
        """Return the time of the next picture in seconds; None for None."""
        if ticks is None:
            return None
        time = float((ticks - self._start) * time_base) + self._shift
        step = 0.0 if self._last is None else time - self._last
        if self._may_step and not -_MOST_BACK <= step <= _MOST_AHEAD:
            self._shift += 1 / self._rate - step
            time += 1 / self._rate - step
        self._last = time
        return time
