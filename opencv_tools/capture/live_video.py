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

"""The H.264 that a camera or a stream sends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.errors import ImageError, KeyFrameNeeded, VideoError
from opencv_tools.image.image_size import check_size, MAX_PIXELS
from opencv_tools.video.decoder import NumberedDecoder
from opencv_tools.video.last_sets import LastSets
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.parameter_sets import (
    h264_frame_number, is_key_frame, length_prefixed_to_annexb, picture_size, read_extradata)

_CODEC = 'h264'


@dataclass(frozen=True)
class LivePicture:
    """
    One picture of a camera or stream as a packet.

    :param number: number of the packet, from 1.
    """

    packet: VideoPacket
    number: int
    video: LiveVideo

    def decode(self) -> NDArray[np.uint8]:
        """
        Decode the picture, once at most.

        :returns: new (h, w, 3) uint8 array in BGR.
        :raises KeyFrameNeeded: a picture since the last key frame was not decoded.
        :raises VideoError: the packet is damaged.
        """
        return self.video.decoder.decode(_CODEC, self.packet.data, self.number)


class LiveVideo:
    """
    The packets of a camera or stream, from a key frame on and without a gap.

    ``missed`` counts the packets that could not be used.
    """

    def __init__(self, extradata: bytes = b'') -> None:
        """
        Wait for a key frame.

        :param extradata: codec data of a container: parameter sets for key frames that lack them,
            and whether the packets have lengths instead of start codes.
        :raises VideoError: the codec data are damaged.
        """
        sets, self._length_size = read_extradata(_CODEC, extradata)
        self.missed = 0
        #: Decoder of the pictures.
        self.decoder = NumberedDecoder()
        #: Whether the next packet must be a key frame.
        self.needs_key = True
        self._sets = LastSets(_CODEC, sets)
        self._size: tuple[int, int] | None = None
        self._number = 0
        self._is_lost = False  # whether packets are missing since the last picture

    def lose(self, count: int) -> None:
        """Wait for a key frame, because packets are missing."""
        self.missed += count
        self._is_lost = self._is_lost or count > 0
        self.needs_key = True
        self._number += 1

    def add(self, data: bytes) -> LivePicture | None:
        """
        Add the next packet.

        :param data: access unit as an Annex B byte stream, or with lengths.
        :returns: the picture; None for parameter sets without a picture, which are kept, and for a
            packet that is damaged, too large, or needs packets that are missing.
        """
        try:
            if self._length_size:
                data = length_prefixed_to_annexb(data, self._length_size)
            picture = self._picture(data)
        except KeyFrameNeeded:
            self.lose(int(self._is_lost))  # those before the first key frame are not missing
        except ImageError:
            self.lose(1)
        else:
            self._is_lost = self._is_lost and picture is None
            return picture
        return None

    def _picture(self, data: bytes) -> LivePicture | None:
        if h264_frame_number(data, 0) is None:  # no slice
            if not self._sets.keep(data):
                raise VideoError('a packet of the camera has no picture: it is damaged')
            return None
        is_key = is_key_frame(_CODEC, data)
        complete = self._sets.complete(data) if is_key else data
        if complete is None or (self.needs_key and not is_key):
            raise KeyFrameNeeded('the video of the camera has no key frame yet')
        self._size = picture_size(_CODEC, complete) or self._size
        if self._size is None:
            raise KeyFrameNeeded('the video of the camera has no size yet')
        check_size(*self._size, MAX_PIXELS)
        self.needs_key = False
        self._number += 1
        width, height = self._size
        return LivePicture(VideoPacket(
            codec=_CODEC, data=complete, is_key=is_key, width=width, height=height),
            self._number, self)
