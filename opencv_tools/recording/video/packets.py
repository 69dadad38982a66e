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

"""Videos of packets that a publisher has encoded: a copy of the stream, without a codec."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
import io
from typing import Any

from opencv_tools.image.errors import KeyFrameNeeded, VideoError
from opencv_tools.recording.packet_frame import PacketFrame
from opencv_tools.recording.recorder import Prepared
from opencv_tools.recording.video.container import VideoStream
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.parameter_sets import has_parameter_sets, parameter_sets

# PyAV is imported in functions, because the import is slow and most recordings are image files.

# Formats of FFmpeg that read packets without a container.
_RAW_FORMATS = {'h264': 'h264', 'h265': 'hevc', 'av1': 'obu'}


@dataclass(frozen=True, kw_only=True)
class PreparedPacket(Prepared):
    """
    A packet for a video.

    :param packet: the packet.
    :param sets: its parameter sets; b'' if a video cannot begin with it.
    """

    packet: VideoPacket
    sets: bytes

    @property
    def stream_format(self) -> tuple[str, bytes] | None:
        """Codec and parameter sets, which contain the size; None if the packet has none."""
        return (self.packet.codec, self.sets) if self.sets else None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.packet.width, self.packet.height


def prepare_packet(packet: VideoPacket) -> PreparedPacket:
    """
    Read the parameter sets of a packet.

    :raises VideoError: the packet is empty or damaged.
    """
    if not packet.data:
        raise VideoError(f'a packet of {packet.codec} is empty')
    is_first = packet.is_key and has_parameter_sets(packet.codec, packet.data)
    return PreparedPacket(
        packet=packet, sets=parameter_sets(packet.codec, packet.data) if is_first else b'')


class CopiedStream(VideoStream[PreparedPacket]):
    """A stream of packets as they are; see `VideoStream`."""

    def __init__(self, first: PreparedPacket) -> None:
        """
        Describe a stream.

        :param first: its first packet, which has parameter sets.
        """
        self.stream_format = first.packet.codec, first.sets
        width, height = first.size
        self.failure = f'{width}x{height} {first.packet.codec} video cannot be stored'
        self._first = first
        self._ticks = 1
        self._stream: Any = None

    def open(self, container: Any, ticks: int) -> None:  # noqa: A003
        """
        Add a stream with the parameter sets, which FFmpeg converts to avcC, hvcC or av1C.

        :raises VideoError: FFmpeg finds no video in the first packet.
        """
        import av
        self._ticks = ticks
        packet = self._first.packet
        damage = f'{self.failure}: its first packet is damaged'
        options: Any = [{'skip_frame': 'all'}]  # nothing is decoded
        try:
            opened = av.open(io.BytesIO(packet.data), format=_RAW_FORMATS[packet.codec],
                             stream_options=options)
        except av.error.FFmpegError as err:
            raise VideoError(f'{damage} ({err.strerror})') from err
        with opened as raw:
            if not raw.streams.video:
                raise VideoError(damage)
            template = raw.streams.video[0]
            if hasattr(container, 'add_stream_from_template'):
                self._stream = container.add_stream_from_template(template, opaque=True)
                self._stream.time_base = Fraction(1, ticks)
            else:  # PyAV 12
                self._stream = container.add_stream(template=template)
        self._stream.codec_context.extradata = self._first.sets

    def packets(self, prepared: PreparedPacket | None, pts: int) -> Iterable[Any]:
        """Return the packet of a frame."""
        import av
        if prepared is None:
            return ()
        packet = av.Packet(prepared.packet.data)
        packet.stream, packet.time_base = self._stream, Fraction(1, self._ticks)
        packet.pts = packet.dts = pts
        packet.is_keyframe = prepared.packet.is_key
        return (packet,)


class PacketOrder:
    """
    Find the packets that no player can decode, because those before them are missing.

    Numbers of a publisher show which ones are missing. Without numbers nothing is missing.
    """

    def __init__(self) -> None:
        """Create an order without packets."""
        self._last = b'', 0  # publisher and number
        self._needs_key = True

    def interrupt(self) -> None:
        """Leave out all packets until the next key frame."""
        self._needs_key = True

    def check(self, frame: PacketFrame, prepared: PreparedPacket, begins: bool) -> None:
        """
        Check the next packet.

        :param begins: whether it would begin a video.
        :raises KeyFrameNeeded: it needs earlier packets.
        """
        publisher, number = self._last
        is_next = frame.publisher == publisher and (
            not frame.number or frame.number == number + 1)
        self._last = frame.publisher, frame.number
        self._needs_key = self._needs_key or begins or not is_next
        if self._needs_key and not (prepared.sets or (prepared.packet.is_key and not begins)):
            raise KeyFrameNeeded(
                f'a packet of {prepared.packet.codec} needs earlier packets, which are missing in '
                'the video')
        self._needs_key = False
