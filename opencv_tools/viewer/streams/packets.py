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

"""Packets of a video topic, passed from the executor to the loop of the server."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
import time

from opencv_tools.image.errors import VideoError
from opencv_tools.image.image_size import check_size, MAX_PIXELS
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.video.last_sets import LastSets
from opencv_tools.video.messages import WireVideo
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.parameter_sets import is_key_frame, picture_size, webcodecs_name
from opencv_tools.viewer.streams.feed import Feed

#: Transport of a subscription that receives the packets of a video topic unchanged.
PACKETS = 'packets'

# Packets that wait for the loop. A missing one is a gap.
_MAX_WAITING = 120
_MAX_BYTES = 16 * 2 ** 20
_MAX_SIDE = 65_535  # pixels, as in a message to a page


@dataclass(frozen=True, kw_only=True)
class ViewedPacket:
    """
    A packet for pages.

    :param number: number of the packet; numbers of packets that need each other follow each other.
    :param message: the message of the packet, or of the image that was encoded.
    :param stamp_ns: stamp of the frame in nanoseconds.
    :param name: codec string of WebCodecs of a key frame; '' for other packets.
    """

    number: int
    stamp_ns: int
    packet: VideoPacket
    message: object = None
    name: str = ''


class PacketReader:
    """Read the messages of a video topic, which anybody can publish."""

    def __init__(self) -> None:
        self._sets = LastSets('')
        self._size = 0, 0

    def read(self, message: WireVideo) -> tuple[VideoPacket, str]:
        """
        Return the packet of a message, and the codec string of a key frame.

        :raises ImageError: the packet is damaged, too large, or has an unknown codec.
        """
        codec, count = message.codec, len(message.data)
        if not 0 < count <= _MAX_BYTES:
            raise VideoError(f'a packet has {count} bytes: 1 to {_MAX_BYTES} are shown')
        data = bytes(message.data)
        is_key, name = is_key_frame(codec, data), ''
        if is_key:
            if self._sets.codec != codec:
                self._sets = LastSets(codec)
            complete = self._sets.complete(data)
            if complete is None:
                raise VideoError(f'a {codec} key frame has no parameter sets: the publisher has '
                                 'to repeat them')
            data = complete
            name = webcodecs_name(codec, data) or ''
            self._size = _shown_size(message.size, picture_size(codec, data) or (0, 0))
        width, height = self._size
        return VideoPacket(
            codec=codec, data=data, is_key=is_key, width=width, height=height), name


class PacketFeed(Feed):
    """The packets of a topic. The executor puts them, and the loop takes them."""

    def __init__(self, on_frame: Callable[[], object],
                 clock: Callable[[], float] = time.monotonic) -> None:
        """
        Create an empty feed.

        :param on_frame: called after each packet, in the executor.
        :param clock: monotonic clock in seconds.
        """
        super().__init__(on_frame, clock)
        #: Packets that the loop has not taken yet, oldest first.
        self.waiting: deque[ViewedPacket] = deque(maxlen=_MAX_WAITING)
        self._reader = PacketReader()
        self._number = self._published = 0

    def count_broken(self, err: Exception) -> None:
        """Count a message that cannot be read; those after it need a key frame."""
        self._number += 1
        super().count_broken(err)

    def _add(self, received: ReceivedMessage) -> None:
        """Keep a packet for the loop."""
        # The numbers of the publisher show that packets are missing before this one.
        is_next = not received.number or received.number == self._published + 1
        self._published = received.number
        self._number += 1 if is_next else 2
        if not isinstance(received.message, WireVideo):
            raise VideoError('an image is not a packet of video')
        packet, name = self._reader.read(received.message)
        received = self.keep(received, packet.is_key)
        self.waiting.append(ViewedPacket(number=self._number, stamp_ns=received.stamp_ns,
                                         packet=packet, message=received.message, name=name))


def _shown_size(announced: tuple[int, int] | None, coded: tuple[int, int]) -> tuple[int, int]:
    """Return the size of a picture, without a row or a column that an encoder has added."""
    check_size(*coded, MAX_PIXELS)
    if max(coded) > _MAX_SIDE:
        raise VideoError(f'a picture of {coded[0]}x{coded[1]} pixels is too long: the limit is '
                         f'{_MAX_SIDE} pixels a side')
    if announced and all(0 <= with_edge - side <= 1
                         for side, with_edge in zip(announced, coded)):
        return announced
    return coded
