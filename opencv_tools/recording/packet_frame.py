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

"""Received frames that are packets of video."""

from __future__ import annotations

from dataclasses import dataclass

from opencv_tools.base.units import NANO
from opencv_tools.image.errors import KeyFrameNeeded
from opencv_tools.recording.frames import RawFrame, ReceivedFrame
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.video.messages import WireVideo
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.parameter_sets import is_key_frame, picture_size


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
