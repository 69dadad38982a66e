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

"""Encoder of video packets: exactly one packet for each image, at once."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.base.units import NANO
from opencv_tools.image.errors import VideoError
from opencv_tools.video.last_sets import LastSets
from opencv_tools.video.levels import find_level, with_level
from opencv_tools.video.packet import ENCODED, VideoPacket
from opencv_tools.video.parameter_sets import is_key_frame
from opencv_tools.video.pixels import to_i420
from opencv_tools.video.settings import (
    encoder_options, find_encoder, import_av, NOMINAL_RATE, VideoSettings)

_MAX_SIDE = 16384
_MAX_RATE = 1000.0
_TICK = Fraction(1, NOMINAL_RATE)
_KEY_FRAME = 1  # AV_PICTURE_TYPE_I
_TRIED_SIZE = 640, 480  # which all hardware encodes
_PIXEL_FORMATS = ('yuv420p', 'nv12')


class VideoEncoder:
    """Encoder for images of one size; used by one thread at a time."""

    def __init__(self, settings: VideoSettings, width: int, height: int, rate: float) -> None:
        """
        Open the encoder.

        :param width: width of the images in pixels.
        :param height: height of the images in pixels.
        :param rate: frames per second, for the bit rate; 0 if it is unknown.
        :raises VideoError: the encoder is missing, or FFmpeg cannot open it with these settings.
        """
        if not (0 < width <= _MAX_SIDE and 0 < height <= _MAX_SIDE):
            raise VideoError(f'a {width}x{height} image has no video: a side has 1 to '
                             f'{_MAX_SIDE} pixels')
        self._size = width, height
        self._settings = settings
        self._rate = rate if 0 < rate <= _MAX_RATE else NOMINAL_RATE
        self.codec, self._encoder = find_encoder(settings)
        self._number = 0
        self._last_ns: int | None = None
        self._key_ns: int | None = None
        self._sets = LastSets(self.codec)
        self._level = find_level(self.codec, width, height, settings.bit_rate)
        self._context = self._open()

    def encode(self, image: NDArray[Any], encoding: str, stamp_ns: int, key: bool = False,
               ) -> VideoPacket:
        """
        Encode an image.

        :param image: (h, w) or (h, w, c) array with 8 bits; not modified.
        :param encoding: sensor_msgs/Image encoding of the image.
        :param stamp_ns: time of the image in nanoseconds. A key frame follows when the key
            interval has passed, or when the time goes back.
        :param key: whether to force a key frame.
        :returns: the packet. A key frame has its parameter sets.
        :raises EncodingError: the encoding is unknown, or does not fit the image.
        :raises VideoError: the encoding has no video, the size is another, or FFmpeg fails.
        """
        planes = to_i420(image, encoding)
        width, height = self._size
        if planes.shape != (-(-height // 2) * 3, -(-width // 2) * 2):
            raise VideoError(f'the encoder has {width}x{height} pixels, but the image has '
                             f'{planes.shape[1]}x{planes.shape[0] * 2 // 3}: create another one')
        is_due = self._is_key_due(stamp_ns)
        self._last_ns = stamp_ns
        data = self._encode(planes, key or is_due)
        is_key = is_key_frame(self.codec, data)
        if is_key:
            self._key_ns = stamp_ns
            if self._level:
                data = with_level(self.codec, data, self._level)
            # Some encoders send their parameter sets only once.
            data = self._sets.complete(data) or data
        return VideoPacket(
            codec=self.codec, data=data, is_key=is_key, width=width, height=height)

    def _is_key_due(self, stamp_ns: int) -> bool:
        if self._key_ns is None or self._last_ns is None or stamp_ns < self._last_ns:
            return True
        return stamp_ns - self._key_ns >= round(self._settings.key_interval * NANO)

    def _encode(self, planes: NDArray[Any], is_key: bool) -> bytes:
        av = import_av()
        frame = av.VideoFrame.from_ndarray(planes, format='yuv420p')
        if self._context.pix_fmt != frame.format.name:
            frame = frame.reformat(format=self._context.pix_fmt)
        frame.pts, frame.time_base = self._number, _TICK
        frame.pict_type = _KEY_FRAME if is_key else 0
        self._number += 1
        try:
            packets = [bytes(packet) for packet in self._context.encode(frame)]
        except av.error.FFmpegError as err:
            raise VideoError(f"encoder '{self._encoder.name}' failed: "
                             f'{printable(err.strerror or err)}') from err
        if len(packets) != 1:
            raise VideoError(f"encoder '{self._encoder.name}' returned {len(packets)} packets for "
                             'an image, because it delays them: use another codec')
        return packets[0]

    def _open(self) -> Any:
        """Open the encoder; after a failure again, with the log of FFmpeg as the reason."""
        av = import_av()
        try:
            return self._try_to_open(av)
        except (av.error.FFmpegError, ValueError) as err:
            reason = self._log_of_failure(av) or getattr(err, 'strerror', None) or str(err)
            raise VideoError(
                f"encoder '{self._encoder.name}' cannot be opened for {self._size[0]}x"
                f'{self._size[1]} images: {printable(reason)}; use another codec, preset or '
                'size') from err

    def _log_of_failure(self, av: Any) -> str:
        """Return the first lines that FFmpeg logs while the encoder cannot be opened."""
        level, skips = av.logging.get_level(), av.logging.get_skip_repeated()
        with av.logging.Capture() as log:
            try:
                av.logging.set_level(av.logging.ERROR)
                av.logging.set_skip_repeated(False)
                self._try_to_open(av)
            except (av.error.FFmpegError, ValueError):
                pass
            finally:
                av.logging.set_level(level)
                av.logging.set_skip_repeated(skips)
        return '; '.join(text.strip(' .\n') for _, _, text in log[:2])

    def _try_to_open(self, av: Any) -> Any:
        width, height = self._size
        known = {one.name for one in self._encoder.video_formats or ()} or {*_PIXEL_FORMATS}
        context = av.CodecContext.create(self._encoder, 'w')
        context.width, context.height = width + width % 2, height + height % 2
        context.pix_fmt = next((name for name in _PIXEL_FORMATS if name in known), 'yuv420p')
        context.framerate, context.time_base = NOMINAL_RATE, _TICK
        context.thread_type = 'SLICE'
        context.options = encoder_options(
            self._settings, width, height, self._rate, self._level)
        context.open()
        return context


def check_encoder(settings: VideoSettings, size: tuple[int, int] | None = None) -> None:
    """
    Check that an encoder can be opened on this machine.

    Without a size those of ``ENCODED`` are not tried, because importing PyAV takes time.

    :param size: width and height of the images in pixels; None if nothing was encoded yet.
    :raises VideoError: PyAV or the encoder is missing, or FFmpeg cannot open it; the message
        includes the remedy.
    """
    if size or settings.codec not in ENCODED:
        VideoEncoder(settings, *(size or _TRIED_SIZE), NOMINAL_RATE)
