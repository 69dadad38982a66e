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

"""Received frames: raw, compressed, or packets of video."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
import time
from typing import Any, ClassVar

from numpy.typing import NDArray
from opencv_tools.base.units import NANO
from opencv_tools.image.errors import KeyFrameNeeded
from opencv_tools.image.image_size import MAX_PIXELS
from opencv_tools.image_codecs import decode_compressed
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.video.messages import WireVideo
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.parameter_sets import is_key_frame, picture_size


@dataclass(frozen=True, kw_only=True)
class ReceivedFrame:
    """
    A frame as received, raw or compressed.

    :param metadata: stamp, coordinate frame, encoding and topic of the message.
    :param receive_ns: time of reception in nanoseconds of the system clock.
    :param arrival_ns: time of reception in nanoseconds of CLOCK_MONOTONIC, which is never set.
    """

    #: Number of frames that it counts as.
    count: ClassVar[int] = 1
    metadata: FrameMetadata
    receive_ns: int
    arrival_ns: int = field(default_factory=time.monotonic_ns)

    @property
    def time_ns(self) -> int:
        """Time of the frame in nanoseconds: its stamp, or the time of reception if it has none."""
        return self.metadata.stamp_ns or self.receive_ns

    @property
    def size(self) -> int:
        """Bytes that count for the maximum size of the frames that wait."""
        return 0

    def decode(self) -> RawFrame:
        """
        Return the frame as pixels.

        :raises ImageError: the data cannot be decoded.
        """
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class RawFrame(ReceivedFrame):
    """
    A frame as pixels.

    :param image: immutable (h, w) or (h, w, c) array in the encoding of the frame; planar chroma
        follows below the rows of luma.
    """

    image: NDArray[Any]

    def decode(self) -> RawFrame:
        """Return the frame itself."""
        return self


@dataclass(frozen=True, kw_only=True)
class CompressedFrame(ReceivedFrame):
    """
    A frame as a compressed image; its encoding is the format string of the message.

    :param data: immutable buffer with the compressed image.
    :param max_pixels: maximum number of pixels to decode.
    """

    data: Any
    max_pixels: int = MAX_PIXELS

    def decode(self) -> RawFrame:
        """
        Return the decoded frame.

        :raises ImageError: the data cannot be decoded.
        """
        image, encoding = decode_compressed(self.data, self.metadata.encoding, self.max_pixels)
        return RawFrame(metadata=replace(self.metadata, encoding=encoding.name), image=image,
                        receive_ns=self.receive_ns, arrival_ns=self.arrival_ns)


@dataclass(frozen=True, kw_only=True)
class PacketFrame(ReceivedFrame):
    """
    A frame as a packet of video, which needs the frames before it.

    :param packet: the packet; its width and height are 0 if they are unknown.
    :param publisher: identifier of the publisher; b'' if unknown.
    :param number: number of the packet from its publisher; 0 if unknown.
    """

    packet: VideoPacket
    publisher: bytes = b''
    number: int = 0

    def decode(self) -> RawFrame:
        """
        Refuse to decode the frame alone.

        :raises KeyFrameNeeded: always.
        """
        raise KeyFrameNeeded(f'a packet of {self.packet.codec} is not decoded without the packets '
                             'before it')


def packet_frame(
    message: WireVideo, topic: str, receive_ns: int, arrival_ns: int, publisher: bytes = b'',
    number: int = 0,
) -> PacketFrame:
    """
    Return a message with video as a packet.

    :returns: the frame, whose size is that in its SPS or sequence header.
    :raises ImageError: the packet is damaged, or its codec is unknown.
    """
    codec, data, header = message.codec, bytes(message.data), message.header
    width, height = picture_size(codec, data) or message.size or (0, 0)
    return PacketFrame(
        metadata=FrameMetadata(
            header.sec * NANO + header.nanosec, header.frame_id, message.encoding, topic),
        receive_ns=receive_ns, arrival_ns=arrival_ns, publisher=publisher, number=number,
        packet=VideoPacket(codec=codec, data=data, is_key=is_key_frame(codec, data),
                           width=width, height=height))


class ArrivalClock:
    """Convert times of the system clock, which may be set at any moment, to CLOCK_MONOTONIC."""

    def __init__(
        self, monotonic: Callable[[], int] = time.monotonic_ns,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        """
        Create a converter.

        :param monotonic: monotonic clock in nanoseconds.
        :param wall: system clock in nanoseconds.
        """
        self._monotonic = monotonic
        self._wall = wall
        self._last = monotonic()

    def arrival_ns(self, receive_ns: int) -> int:
        """
        Return the arrival time of a message; it never decreases and is never in the future.

        :param receive_ns: time of reception in nanoseconds of the system clock.
        :returns: nanoseconds of the monotonic clock.
        """
        now = self._monotonic()
        self._last = max(self._last, now - max(0, self._wall() - receive_ns))
        return self._last
