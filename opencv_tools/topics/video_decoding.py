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

"""Decoding of video where it is received, because each picture needs those before it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from opencv_tools.image.cdr import WireMessage
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import CdrError, ImageError, KeyFrameNeeded
from opencv_tools.image.layout import array_to_wire
from opencv_tools.topics.messages import AnyMessage
from opencv_tools.video.messages import WireVideo

if TYPE_CHECKING:
    from opencv_tools.video.decoder import VideoDecoder

_BGR = find_encoding('bgr8')
_MAX_PUBLISHERS = 4  # with a decoder of their own


@dataclass
class _Stream:
    """The video of a publisher."""

    decoder: VideoDecoder
    codec: str
    number: int  # of the last message


class VideoDecoding:
    """
    Decode the video of each publisher to BGR images.

    After a lost message nothing is decoded until the next key frame. These messages count as lost
    too, because no frame comes of them.
    """

    def __init__(self, max_pixels: int) -> None:
        """
        Create a decoder without publishers.

        :param max_pixels: maximum number of pixels of a picture.
        """
        self._max_pixels = max_pixels
        self._streams: dict[bytes, _Stream] = {}

    def decode(
        self, message: AnyMessage | CdrError, publisher: bytes, number: int,
    ) -> WireMessage | CdrError | None:
        """
        Decode a message.

        :param message: the message; one that is no video is returned.
        :param publisher: identifier of its publisher.
        :param number: number that the publisher gave it; 0 if unknown.
        :returns: the image, or the error of video that cannot be decoded; None if the message
            needs earlier ones that are missing.
        """
        if not isinstance(message, WireVideo):
            return message
        try:
            stream = self._stream(message.codec, publisher, number)
            image = stream.decoder.decode(bytes(message.data), message.size)
        except KeyFrameNeeded:
            return None
        except ImageError as err:
            return CdrError(str(err))
        return array_to_wire(image, _BGR, message.header)

    def _stream(self, codec: str, publisher: bytes, number: int) -> _Stream:
        """Return the stream of a publisher, a new one if messages are missing before this one."""
        # It needs OpenCV, which subscriptions without video do not need.
        from opencv_tools.video.decoder import VideoDecoder
        stream = self._streams.pop(publisher, None)
        if stream is None or stream.codec != codec or (number and number != stream.number + 1):
            stream = _Stream(VideoDecoder(codec, self._max_pixels), codec, number)
        stream.number = number
        self._streams[publisher] = stream
        if len(self._streams) > _MAX_PUBLISHERS:
            del self._streams[next(iter(self._streams))]
        return stream
