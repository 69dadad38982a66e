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

"""The decoders of a topic of video, one for each publisher."""

from __future__ import annotations

from collections.abc import Callable
import time

from opencv_tools.image.cdr import WireMessage
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import CdrError, ImageError, KeyFrameNeeded, VideoError
from opencv_tools.image.layout import array_to_wire
from opencv_tools.video.decoder import NumberedDecoder
from opencv_tools.video.messages import WireVideo

_BGR = find_encoding('bgr8')
_MAX_PUBLISHERS = 8  # with a decoder of their own
_SILENT_SECONDS = 2.0  # after which a publisher gives its decoder to another one


class VideoDecoding:
    """
    Decode the video of each publisher to BGR images.

    After a lost message nothing is decoded until the next key frame. These messages count as lost
    too, because no frame comes of them.
    """

    def __init__(self, max_pixels: int, clock: Callable[[], float] = time.monotonic) -> None:
        """
        Create a decoder without publishers.

        :param max_pixels: maximum number of pixels of a picture.
        :param clock: monotonic clock in seconds.
        """
        self._clock = clock
        self._max_pixels = max_pixels
        # Decoders and the time of their last packet, in seconds; the oldest one is first.
        self._decoders: dict[bytes, tuple[NumberedDecoder, float]] = {}

    def decode(
        self, message: WireMessage | WireVideo | CdrError, publisher: bytes, number: int,
    ) -> WireMessage | CdrError | None:
        """
        Decode a message.

        :param message: the message; one that is no video is returned.
        :param number: number that the publisher gave it; 0 if unknown.
        :returns: the image, or the error of video that cannot be decoded; None if the message
            needs earlier ones that are missing.
        """
        if not isinstance(message, WireVideo):
            return message
        try:
            codec = message.codec  # a publisher of another one gets no decoder
            image = self._decoder(publisher).decode(
                codec, bytes(message.data), number, message.size)
        except KeyFrameNeeded:
            return None
        except ImageError as err:
            return CdrError(str(err))
        return array_to_wire(image, _BGR, message.header)

    def _decoder(self, publisher: bytes) -> NumberedDecoder:
        now = self._clock()
        decoder, _ = self._decoders.pop(publisher, (None, 0.0))
        if decoder is None and len(self._decoders) >= _MAX_PUBLISHERS:
            silent, (_, last) = next(iter(self._decoders.items()))
            if now - last < _SILENT_SECONDS:
                raise VideoError(f'more than {_MAX_PUBLISHERS} publishers send video on one '
                                 'topic: remap the others')
            del self._decoders[silent]
        decoder = decoder or NumberedDecoder(self._max_pixels)
        self._decoders[publisher] = decoder, now
        return decoder
