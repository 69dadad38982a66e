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

"""Received frames that are messages, for bags."""

from __future__ import annotations

from dataclasses import dataclass

from opencv_tools.bags.writing import BagChannel
from opencv_tools.image.cdr import WireCompressedImage, WireMessage
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import KeyFrameNeeded
from opencv_tools.image.layout import view_pixels
from opencv_tools.recording.frames import CompressedFrame, RawFrame, ReceivedFrame
from opencv_tools.video.messages import WireVideo


@dataclass(frozen=True, kw_only=True)
class MessageFrame(ReceivedFrame):
    """
    A frame as its message, for a bag.

    :param message: immutable image message of any encoding, or message with video.
    :param channel: topic of the message as a bag describes it.
    :param publish_ns: time of publication in nanoseconds of the system clock; 0 if unknown.
    :param number: number of the message from its publisher; 0 if unknown.
    """

    message: WireMessage | WireVideo
    channel: BagChannel
    publish_ns: int = 0
    number: int = 0

    def decode(self) -> RawFrame:
        """
        Return the frame as pixels.

        :raises ImageError: the message is not a valid image, or it is video.
        """
        if isinstance(self.message, WireVideo):
            raise KeyFrameNeeded('video is not decoded without the messages before it')
        message, times = self.message, {
            'receive_ns': self.receive_ns, 'arrival_ns': self.arrival_ns}
        if isinstance(message, WireCompressedImage):
            return CompressedFrame(metadata=self.metadata, data=message.data, **times).decode()
        encoding = find_encoding(message.encoding)
        image = view_pixels(message.data, message.height, message.width, message.step, encoding,
                            message.is_bigendian)
        return RawFrame(metadata=self.metadata, image=image.astype(encoding.dtype, copy=False),
                        **times)
