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

"""Video in a bag: pictures of its messages, decoded in their order."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.capture.frame import VIDEO
from opencv_tools.image.cdr import (
    cdr_to_compressed_image, COMPRESSED_IMAGE, IMAGE, WireCompressedImage)
from opencv_tools.image.errors import CdrError, ImageError
from opencv_tools.video.decoder import NumberedDecoder
from opencv_tools.video.messages import cdr_to_video, VIDEO_TOPICS, WireVideo
from opencv_tools.video.parameter_sets import is_key_frame

# Skipped packets that wait until a later one is read; more are decoded.
_MAX_SKIPPED = 600


def read_compressed(type_name: str, serialized: Any) -> WireCompressedImage | WireVideo:
    """
    Read a message with a compressed image or with video.

    :returns: the message; video, too, if the format of a CompressedImage is a codec of video.
    :raises CdrError: the bytes are no message of this type.
    """
    if type_name in VIDEO_TOPICS:
        return cdr_to_video(type_name, serialized)
    image = cdr_to_compressed_image(serialized)
    video = WireVideo(type_name=COMPRESSED_IMAGE, header=image.header, encoding=image.format,
                      data=image.data, serialized=serialized)
    try:
        return video if video.codec else image
    except CdrError:
        return image


def can_begin(type_name: str, serialized: Any) -> bool:
    """Return whether a message needs none before it: all but video between keys."""
    if type_name == IMAGE:
        return True
    try:
        message = read_compressed(type_name, serialized)
        return not isinstance(message, WireVideo) or is_key_frame(
            message.codec, bytes(message.data))
    except ImageError:
        return True  # decoding says why it cannot be


def is_video(type_name: str, serialized: Any) -> bool:
    """Return whether a message has video, whose pictures have the order of the bag."""
    with suppress(ImageError):
        return type_name != IMAGE and isinstance(
            read_compressed(type_name, serialized), WireVideo)
    return False


class BagVideo:
    """Decode the packets of a topic. Skipped ones are decoded if a later one needs them."""

    def __init__(self, type_name: str) -> None:
        #: Whether the packets are decoded; otherwise they are frames with the encoding ``VIDEO``.
        self.decodes = True
        self._type_name = type_name
        # A topic of compressed images has video or not; its first message tells.
        self._is_video = None if type_name == COMPRESSED_IMAGE else type_name != IMAGE
        self._decoder = NumberedDecoder()
        self._skipped: list[tuple[WireVideo, int]] = []

    @property
    def needs_skipped(self) -> bool:
        """Whether messages are to be passed to ``skip`` instead of being ignored."""
        return self.decodes and self._is_video is not False

    def skip(self, serialized: Any, number: int) -> None:
        """
        Skip a message, which a later one may need.

        :param number: number of the message from its publisher; 0 if unknown.
        :raises ImageError: the message cannot be read.
        """
        video = self.read(serialized)
        if isinstance(video, WireVideo):
            if is_key_frame(video.codec, bytes(video.data)):
                self._skipped.clear()
            self._skipped.append((video, number))
            if len(self._skipped) > _MAX_SKIPPED:
                self._decode_skipped()

    def read(self, serialized: Any) -> WireCompressedImage | WireVideo:
        """
        Read a message of the topic, unless it is a raw image.

        :raises CdrError: the message cannot be read.
        """
        message = read_compressed(self._type_name, serialized)
        self._is_video = isinstance(message, WireVideo)
        return message

    def picture(self, video: WireVideo, number: int) -> tuple[NDArray[Any], str]:
        """
        Return the picture of a message and its encoding; see ``decodes``.

        :param number: number of the message from its publisher; 0 if unknown.
        :raises ImageError: the packet is damaged, or needs earlier ones that are missing.
        """
        data = bytes(video.data)
        if not self.decodes:
            return np.frombuffer(data, np.uint8), VIDEO
        if is_key_frame(video.codec, data):
            self._skipped.clear()
        self._decode_skipped()
        return self._decode(video, number), 'bgr8'

    def restart(self) -> None:
        """Forget all packets, because some are missing."""
        self._decoder = NumberedDecoder()
        self._skipped.clear()

    def _decode_skipped(self) -> None:
        skipped, self._skipped = self._skipped, []
        for video, number in skipped:
            with suppress(ImageError):  # nobody wants this picture
                self._decode(video, number)

    def _decode(self, video: WireVideo, number: int) -> NDArray[Any]:
        return self._decoder.decode(video.codec, bytes(video.data), number, video.size)
