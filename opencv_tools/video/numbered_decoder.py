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

"""Decoder of numbered packets, whose library is imported with the first one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.image_size import MAX_PIXELS

if TYPE_CHECKING:
    from opencv_tools.video.decoder import VideoDecoder


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
        # It needs OpenCV, which subscriptions and bags without video do not need.
        from opencv_tools.video.decoder import VideoDecoder
        is_next = not number or number == self._number + 1
        if self._decoder is None or self._codec != codec:
            self._decoder, self._codec = VideoDecoder(codec, self._max_pixels), codec
        if not is_next:
            self._decoder.interrupt()
        self._number = number
        return self._decoder.decode(data, size)
