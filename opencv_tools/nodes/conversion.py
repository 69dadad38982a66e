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

"""Conversion of image messages to frames of a recording."""

from __future__ import annotations

from typing import Any

from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.cdr import WireCompressedImage, WireMessage
from opencv_tools.image.errors import SizeError
from opencv_tools.image.image_size import check_size, image_size, MAX_PIXELS
from opencv_tools.recording.frames import ArrivalClock, CompressedFrame, RawFrame, ReceivedFrame
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.recording.packet_frame import packet_frame
from opencv_tools.video.messages import WireVideo


class FrameConverter:
    """Convert messages to frames, without a copy of their data."""

    def __init__(self, bridge: CvBridge, max_pixels: int = MAX_PIXELS) -> None:
        """
        Create a converter.

        :param max_pixels: maximum number of pixels of a frame.
        """
        self._bridge = bridge
        self._max_pixels = max_pixels
        self._arrivals = ArrivalClock()

    def convert(
        self, message: WireMessage | WireVideo, topic: str, receive_ns: int,
        publisher: bytes = b'', number: int = 0,
    ) -> ReceivedFrame:
        """
        Convert a message to a frame.

        :param message: raw or compressed image message, or message with video.
        :param receive_ns: time of reception in nanoseconds of the system clock.
        :param publisher: identifier of the publisher of video; b'' if unknown.
        :param number: number of the message from its publisher; 0 if unknown.
        :returns: the frame, a view of the message; a compressed image or video is not decoded.
        :raises CvBridgeError: the message is not a valid image.
        :raises SizeError: the image has too many pixels.
        :raises ImageError: the video is damaged, or its codec is unknown.
        """
        arrival_ns = self._arrivals.arrival_ns(receive_ns)
        header = message.header
        stamp_ns = header.stamp_ns
        if isinstance(message, WireCompressedImage):
            self._check_size(*_declared_size(message.data))
            return CompressedFrame(
                metadata=FrameMetadata(stamp_ns, header.frame_id, message.format, topic),
                receive_ns=receive_ns, arrival_ns=arrival_ns, data=message.data,
                max_pixels=self._max_pixels)
        if isinstance(message, WireVideo):
            frame = packet_frame(message, topic, receive_ns, arrival_ns, publisher, number)
            self._check_size(frame.packet.width, frame.packet.height)
            return frame
        self._check_size(message.width, message.height)
        return RawFrame(
            metadata=FrameMetadata(stamp_ns, header.frame_id, message.encoding, topic),
            receive_ns=receive_ns, arrival_ns=arrival_ns,
            image=self._bridge.imgmsg_to_cv2(message))

    def _check_size(self, width: int, height: int) -> None:
        try:
            check_size(width, height, self._max_pixels)
        except SizeError as err:
            raise SizeError(f'{err}; raise the parameter max_pixels to receive it') from err


def _declared_size(data: Any) -> tuple[int, int]:
    """Read the size of a compressed image; 0 by 0 if it has none and will not be decoded."""
    try:
        return image_size(bytes(data))
    except SizeError:
        return 0, 0
