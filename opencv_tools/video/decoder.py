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

"""Decoder of video packets: exactly one picture for each packet, at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.image.errors import KeyFrameNeeded, SizeError, VideoError
from opencv_tools.image.image_size import check_size, MAX_PIXELS, MAX_VIDEO_PIXELS
from opencv_tools.video.bit_stream import obus
from opencv_tools.video.last_sets import LastSets
from opencv_tools.video.parameter_sets import (
    AV1_FRAMES, check_codec, h264_frame_number, is_key_frame, sequence_headers)
from opencv_tools.video.settings import import_av

_DECODERS = {'h264': 'h264', 'h265': 'hevc', 'av1': 'libdav1d'}
# Otherwise FFmpeg shows most pictures of H.265 whose end is missing.
_OPTIONS = {'h265': {'err_detect': 'explode'}}
# Largest number of frames of AV1 in a packet, of which one is shown.
_MAX_FRAMES = 16
_BLOCK = 64  # largest multiple to which a coder pads a side, in pixels


class NumberedDecoder:
    """Decode the packets of a publisher. A missing one costs those until the next key frame."""

    def __init__(self, max_pixels: int = MAX_PIXELS) -> None:
        """
        Create a decoder that waits for a key frame.

        :param max_pixels: maximum number of pixels of a picture.
        """
        self._max_pixels = max_pixels
        self._decoder: VideoDecoder | None = None
        self._codec = ''
        self._number = 0  # of the last packet

    def decode(self, codec: str, data: bytes, number: int, size: tuple[int, int] | None = None,
               ) -> NDArray[np.uint8]:
        """
        Decode a packet, as `VideoDecoder`.

        :param codec: one of ``CODECS``.
        :param number: number that the publisher gave it; 0 if unknown.
        :raises KeyFrameNeeded: the packet needs earlier packets, which are missing.
        :raises VideoError: the packet is damaged, is not one picture, or has too many pixels.
        """
        is_next = not number or number == self._number + 1
        if self._decoder is None or self._codec != codec:
            self._decoder, self._codec = VideoDecoder(codec, self._max_pixels), codec
        if not is_next:
            self._decoder.interrupt()
        self._number = number
        return self._decoder.decode(data, size)


class VideoDecoder:
    """Decoder for the packets of one stream; used by one thread at a time."""

    def __init__(self, codec: str, max_pixels: int = MAX_PIXELS) -> None:
        """
        Open the decoder.

        :param codec: codec of the packets: ``'h264'``, ``'h265'`` or ``'av1'``.
        :param max_pixels: largest allowed number of pixels, checked before decoding; at most
            ``MAX_VIDEO_PIXELS``.
        :raises VideoError: the codec is unknown, or this machine has no decoder for it.
        """
        check_codec(codec)
        self._codec, self._max_pixels = codec, min(max_pixels, MAX_VIDEO_PIXELS)
        self._av = import_av()
        self._number = 0
        self._needs_key, self._sets = True, LastSets(codec)
        self._number_bits = self._frame_number = 0  # of H.264
        self._context: Any = self._open()  # None after an error, because it keeps pictures

    def decode(self, data: bytes, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
        """
        Decode a packet.

        Packets must be complete and in order. After an error the decoder waits for a key frame.

        :param data: content of the packet: one picture.
        :param size: width and height of the picture in pixels, if they are known. The picture may
            have a row and a column more, which are removed.
        :returns: new (h, w, 3) uint8 array in BGR.
        :raises KeyFrameNeeded: the packet needs earlier packets, which are missing.
        :raises VideoError: the packet is damaged, is not one picture, or has too many pixels.
        """
        try:
            is_key = is_key_frame(self._codec, data)
            if self._needs_key and not is_key:
                raise KeyFrameNeeded(f'a {self._codec} packet needs earlier packets, which are '
                                     'missing: wait for a key frame')
            self._check_sizes(data, size)
            self._check_number(data, is_key)
            data = self._with_sets(data) if is_key else data
            image = _cropped(self._decode(data), size)
        except VideoError:
            self.interrupt()
            raise
        self._needs_key = False
        return image

    def interrupt(self) -> None:
        """Wait for a key frame, because packets are missing."""
        self._needs_key, self._context = True, None

    def _open(self) -> Any:
        try:
            context = self._av.CodecContext.create(_DECODERS[self._codec], 'r')
        except ValueError as err:
            raise VideoError(f"codec '{self._codec}': the installed PyAV has no decoder "
                             f"'{_DECODERS[self._codec]}'") from err
        # With one thread FFmpeg finds more damages of H.264.
        context.options = {
            **_OPTIONS.get(self._codec, {}), 'flags': '+low_delay+unaligned', 'threads': '1',
            'max_pixels': str(2 * self._max_pixels + _BLOCK * 2 ** 16)}  # with padding
        return context

    def _check_sizes(self, data: bytes, size: tuple[int, int] | None) -> None:
        frames = obus(data) if self._codec == 'av1' else ()
        if sum(kind in AV1_FRAMES for kind, _ in frames) > _MAX_FRAMES:
            raise VideoError(f'an av1 packet has more than {_MAX_FRAMES} frames')
        for header in sequence_headers(self._codec, data):
            self._number_bits = header.frame_number_bits
            _check_announced(size, header.width, header.height)
            padding = _BLOCK * (header.width + header.height) + _BLOCK ** 2
            try:
                check_size(header.width, header.height, self._max_pixels)
                check_size(header.coded_width, header.coded_height, self._max_pixels + padding)
            except SizeError as err:
                raise VideoError(f'a {self._codec} packet is too large: {err}') from err

    def _with_sets(self, data: bytes) -> bytes:
        """Return a key frame with parameter sets, for a new decoder after an error."""
        complete = self._sets.complete(data)
        if complete is None:
            raise KeyFrameNeeded(f'a {self._codec} key frame has no parameter sets: wait for one '
                                 'that has them')
        if self._needs_key or self._context is None:
            self._context = self._open()  # without the state that damaged packets have left
        return complete

    def _check_number(self, data: bytes, is_key: bool) -> None:
        """Check that no picture is missing, for which FFmpeg would show another one."""
        found = h264_frame_number(data, self._number_bits) if self._number_bits else None
        if found is None:
            return
        number, is_reference = found
        if not is_key and number != (self._frame_number + 1) % (1 << self._number_bits):
            raise KeyFrameNeeded(f'a packet of {self._codec} is missing before picture {number}: '
                                 'wait for a key frame')
        if is_reference:
            self._frame_number = number

    def _decode(self, data: bytes) -> NDArray[np.uint8]:
        # It needs OpenCV, which subscriptions and bags without video do not need.
        from opencv_tools.video.pixels import to_bgr
        av = self._av
        packet = av.Packet(data)
        self._number += 1
        packet.pts = self._number
        try:
            frames = self._context.decode(packet)
            if len(frames) != 1 or frames[0].pts != self._number:
                raise VideoError(f'{len(data)} bytes of {self._codec} are not one picture: they '
                                 'are damaged, or the encoder reorders pictures (B frames)')
            if frames[0].is_corrupt:
                raise VideoError(f'{len(data)} bytes of {self._codec} are damaged')
            return to_bgr(frames[0])  # FFmpeg also refuses to convert invalid colours
        except VideoError:
            raise
        except (av.error.FFmpegError, ValueError) as err:
            reason = getattr(err, 'strerror', None) or str(err)  # without FFmpeg's own number
            raise VideoError(f'{len(data)} bytes of {self._codec} cannot be decoded: '
                             f'{printable(reason)}') from err


def _check_announced(size: tuple[int, int] | None, width: int, height: int) -> None:
    """Check that a picture has a size, or a row and a column more."""
    if size and not (0 <= width - size[0] <= 1 and 0 <= height - size[1] <= 1):
        raise VideoError(f'a packet has a picture of {width}x{height} pixels, but '
                         f'{size[0]}x{size[1]} are announced')


def _cropped(image: NDArray[np.uint8], size: tuple[int, int] | None) -> NDArray[np.uint8]:
    """Return an image of a size, without a row or a column that an encoder has added."""
    height, width = image.shape[:2]
    if size is None or size == (width, height):
        return image
    _check_announced(size, width, height)
    return np.ascontiguousarray(image[:size[1], :size[0]])
