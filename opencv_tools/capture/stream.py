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

"""Network streams as a source, by PyAV or OpenCV."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from threading import Condition, Thread
import time
from typing import Any, Literal, Protocol

from opencv_tools.base.text import without_password
from opencv_tools.capture.container import stream_rate, video_stream
from opencv_tools.capture.errors import BrokenFrameError, CaptureError, UnavailableError
from opencv_tools.capture.frame import CapturedFrame, live_frame
from opencv_tools.capture.live_video import LiveVideo
from opencv_tools.capture.urls import describe_failure
from opencv_tools.image.errors import ImageError, VideoError
from opencv_tools.image.image_size import check_size, MAX_PIXELS
from opencv_tools.video.pixels import to_bgr
from opencv_tools.video.settings import import_av

#: Schemes of URLs that are streams, never files.
STREAM_SCHEMES = ('rtsp', 'rtsps', 'rtmp', 'rtmps', 'rtp', 'srt', 'tcp', 'udp')

# Packets of video that wait to be read, and their bytes. The others are missed.
_MAX_WAITING = 120
_MAX_WAITING_BYTES = 1 << 26


class AvStream:
    """
    A stream that PyAV reads.

    H.264 without reordered pictures (B frames) is not decoded. ``missed`` counts the packets that
    could not be used.
    """

    def __init__(self, url: str, container: Any) -> None:
        """
        Wrap an open stream.

        :param container: the stream, as ``open_container`` returns it.
        :raises CaptureError: the header of the stream is damaged.
        """
        self._container, self._stream = container, video_stream(container)
        context = self._stream.codec_context
        self.needs_every = context.name == 'h264' and not context.has_b_frames
        self.rate = stream_rate(self._stream)
        try:
            self._video = LiveVideo(bytes(context.extradata or b'') if self.needs_every else b'')
        except VideoError as err:
            container.close()
            raise CaptureError(describe_failure(url)) from err
        self._damaged = 0
        self.description = (f'{"H264 " * self.needs_every}{context.width}x{context.height} at '
                            f'{self.rate:g} Hz')

    @property
    def missed(self) -> int:
        """Count of the packets that could not be used."""
        return self._video.missed + self._damaged

    def frames(self) -> Iterator[CapturedFrame]:
        """Yield the packets of H.264, or the images of another codec."""
        with suppress(import_av().error.FFmpegError):  # it ended, or sent nothing in time
            for packet in self._container.demux(self._stream):
                if not self.needs_every:
                    yield from self._images(packet)
                elif packet.size:  # not at the end
                    yield from self._packet(packet)

    def lose(self) -> None:
        """Count the last packet as missed, and yield a key frame next."""
        self._video.lose(1)

    def close(self) -> None:
        """Close the connection."""
        self._container.close()

    def _packet(self, packet: Any) -> Iterator[CapturedFrame]:
        stamp_ns = time.monotonic_ns()
        if packet.is_corrupt:
            self._video.lose(1)
            return
        picture = self._video.add(bytes(packet))
        if picture:
            yield live_frame(picture, stamp_ns)

    def _images(self, packet: Any) -> Iterator[CapturedFrame]:
        try:
            for frame in packet.decode():
                check_size(frame.width, frame.height, MAX_PIXELS)
                yield CapturedFrame(to_bgr(frame), 'bgr8', time.monotonic_ns())
        except (import_av().error.FFmpegError, ImageError, ValueError):
            self._damaged += 1


class OpenStream(Protocol):
    """
    A stream that one thread reads.

    ``rate`` and ``description`` are those of a source, ``needs_every`` too. ``missed`` counts the
    packets that could not be used.
    """

    rate: float
    description: str
    needs_every: bool

    @property
    def missed(self) -> int:
        """Count of the packets that could not be used."""

    def frames(self) -> Iterator[CapturedFrame]:
        """Yield the frames until the end of the stream or its failure."""

    def lose(self) -> None:
        """Count the last frame as missed, and yield a key frame next."""

    def close(self) -> None:
        """Close the connection."""


class StreamSource:
    """
    A stream that is read continuously by a thread.

    It keeps the newest image only, so that frames do not queue up when the publisher is slower
    than the stream. Packets of video, which need each other, are kept in order.
    """

    live: Literal[True] = True
    warnings = ()

    def __init__(self, url: str, stream: OpenStream) -> None:
        self.name = without_password(url)
        self.rate, self.description = stream.rate, stream.description
        self.needs_every = stream.needs_every
        self.missed = 0
        self._stream = stream
        self._changed = Condition()
        self._waiting: deque[CapturedFrame] = deque()
        self._dropped = 0  # of those that waited
        self._ended = False
        self._thread = Thread(target=self._read_all, name='stream', daemon=True)
        self._thread.start()

    def wait(self, seconds: float) -> bool:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._ended, seconds)
            if not self._waiting and self._ended:
                raise UnavailableError(f'{self.name} ended or is no longer reachable')
            return bool(self._waiting)

    def skip(self) -> None:
        with self._changed:
            if self._waiting:
                self._waiting.popleft()

    def read(self) -> CapturedFrame:
        with self._changed:
            frame = self._waiting.popleft() if self._waiting else None
        if frame is None:
            raise BrokenFrameError(f'{self.name} has no frame yet')
        return frame

    def close(self) -> None:
        with self._changed:
            self._ended = True
        self._thread.join()

    def _read_all(self) -> None:
        """Read frames until the stream ends or is closed."""
        try:
            for frame in self._stream.frames():
                with self._changed:
                    if self._ended:
                        break
                    self._keep(frame)
                    self.missed = self._dropped + self._stream.missed
                    self._changed.notify()
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify()
            self._stream.close()

    def _keep(self, frame: CapturedFrame) -> None:
        """Keep a frame instead of the one before, or after it if each needs the one before."""
        size = sum(other.image.nbytes for other in self._waiting)
        if not self.needs_every or len(self._waiting) >= _MAX_WAITING or size > _MAX_WAITING_BYTES:
            self._dropped += len(self._waiting)
            self._waiting.clear()
            if frame.video and not frame.video.packet.is_key:
                self._stream.lose()
                return
        self._waiting.append(frame)
