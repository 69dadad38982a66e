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
from opencv_tools.image.picture_size import check_size, MAX_PIXELS, picture_size
from opencv_tools.recording.frames import CompressedFrame, RawFrame, ReceivedFrame
from opencv_tools.recording.naming import FrameMetadata, NANO


def message_to_frame(
    bridge: CvBridge, message: WireMessage, topic: str, receive_ns: int,
    max_pixels: int = MAX_PIXELS,
) -> ReceivedFrame:
    """
    Convert a message to a frame, without a copy of its data.

    :param bridge: converter of raw images.
    :param message: raw or compressed image message.
    :param topic: topic of the message.
    :param receive_ns: time of reception in nanoseconds of the system clock.
    :param max_pixels: maximum number of pixels.
    :returns: the frame, a view of the message; a compressed image is not decoded.
    :raises CvBridgeError: the message is not a valid image.
    :raises SizeError: the image has too many pixels.
    """
    header = message.header
    stamp_ns = header.sec * NANO + header.nanosec
    if isinstance(message, WireCompressedImage):
        _check_size(*_declared_size(message.data), max_pixels)
        return CompressedFrame(
            metadata=FrameMetadata(stamp_ns, header.frame_id, message.format, topic),
            receive_ns=receive_ns, data=message.data, max_pixels=max_pixels)
    _check_size(message.width, message.height, max_pixels)
    return RawFrame(
        metadata=FrameMetadata(stamp_ns, header.frame_id, message.encoding, topic),
        receive_ns=receive_ns, image=bridge.imgmsg_to_cv2(message))


def _declared_size(data: Any) -> tuple[int, int]:
    """Read the size of a compressed image; 0 by 0 if it has none and will not be decoded."""
    try:
        return picture_size(bytes(data))
    except SizeError:
        return 0, 0


def _check_size(width: int, height: int, max_pixels: int) -> None:
    try:
        check_size(width, height, max_pixels)
    except SizeError as err:
        raise SizeError(f'{err}; raise the parameter max_pixels to receive it') from err
