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

"""Image messages as frames of a recording."""

from __future__ import annotations

from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.cdr import WireCompressedImage, WireHeader
from opencv_tools.image.text import printable
from opencv_tools.recording.frames import CompressedFrame, Frame, RawFrame
from opencv_tools.recording.naming import NANO
from opencv_tools.ros.messages import FrameMessage
from sensor_msgs.msg import CompressedImage

_MAX_TEXT = 40  # of what a message says of itself, on the console


def message_to_frame(
    bridge: CvBridge, message: FrameMessage, topic: str, receive_ns: int,
) -> Frame:
    """
    Make a frame of a message, without a copy of its data.

    :param bridge: reads images.
    :param message: an image, or a compressed one.
    :param topic: where it came from.
    :param receive_ns: when it came, in nanoseconds of the system's clock.
    :returns: the frame, a view of the message.
    :raises CvBridgeError: it is no image.
    """
    if isinstance(message, WireHeader):
        stamp, frame_id = message, message.frame_id
    else:
        stamp, frame_id = message.header.stamp, message.header.frame_id
    stamp_ns = stamp.sec * NANO + stamp.nanosec
    if isinstance(message, (WireCompressedImage, CompressedImage)):
        return CompressedFrame(
            stamp_ns, frame_id, message.format, topic, receive_ns, message.data)
    return RawFrame(stamp_ns, frame_id, message.encoding, topic, receive_ns,
                    bridge.imgmsg_to_cv2(message))


def describe_message(message: FrameMessage) -> str:
    """Say in a few words what a message has in it."""
    if isinstance(message, (WireCompressedImage, CompressedImage)):
        return f'{len(message.data)} bytes {printable(message.format, _MAX_TEXT)}'
    return f'{message.width}x{message.height} {printable(message.encoding, _MAX_TEXT)}'
