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
"""Pictures of the video that a paused page steps through."""

from __future__ import annotations

from collections.abc import Sequence

from opencv_tools.base.text import printable
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import VideoError
from opencv_tools.image.layout import array_to_wire
from opencv_tools.video.decoder import NumberedDecoder
from opencv_tools.video.messages import WireVideo
from opencv_tools.viewer.errors import MAX_MESSAGE, RequestError
from opencv_tools.viewer.inspect.history import KeptFrame
from opencv_tools.viewer.streams.feed import NewFrame

_MAX_BYTES = 32 << 20  # of pictures that are kept
_BGR = find_encoding('bgr8')


class HeldVideo:
    """Decode the packets of a topic, each with those that it needs. One call runs at a time."""

    def __init__(self) -> None:
        self._decoder = NumberedDecoder()
        self._last: KeptFrame | None = None  # the last one in the decoder
        self._pictures: dict[KeptFrame, NewFrame] = {}

    def found(self, kept: KeptFrame) -> NewFrame | None:
        """Return an image, or the picture of a packet if it was decoded lately."""
        if isinstance(kept.received.message, WireVideo):
            return self._pictures.get(kept)
        return kept.frame

    def decode(self, frames: Sequence[KeptFrame], place: int) -> NewFrame:
        """
        Return the picture of a packet, and keep those before it, for steps back.

        :param frames: packets, the first one a key frame.
        :raises RequestError: the packet is damaged, or needs one that is.
        """
        first = max(at for at in range(place + 1) if frames[at].is_start)
        if self._last in frames[first:place]:
            first = frames.index(self._last) + 1
        else:
            self._decoder = NumberedDecoder()
        for kept in frames[first:place]:
            try:
                self._add(kept)
            except VideoError:
                continue  # the packet that is shown has the reason
        try:
            return self._add(frames[place])
        except VideoError as err:
            raise RequestError(printable(err, MAX_MESSAGE)) from err

    def _add(self, kept: KeptFrame) -> NewFrame:
        received, message = kept.received, kept.received.message
        assert isinstance(message, WireVideo)
        self._last = kept
        image = self._decoder.decode(
            message.codec, bytes(message.data), received.number, message.size)
        self._pictures.pop(kept, None)
        while self._pictures and image.nbytes + sum(
                one.message.data.nbytes for one in self._pictures.values()) > _MAX_BYTES:
            del self._pictures[next(iter(self._pictures))]
        self._pictures[kept] = picture = NewFrame(
            -kept.number, array_to_wire(image, _BGR, message.header), received.receive_ns,
            received.number)
        return picture
