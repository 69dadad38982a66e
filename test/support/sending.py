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

"""Publish images with chosen stamps at any rate."""

from __future__ import annotations

from conftest import spin_until
import numpy as np
from opencv_tools.cv_bridge import CvBridge
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image
from std_msgs.msg import Header

NANO = 10**9


def create_publisher(node: Node, depth: int = 1000) -> Publisher:
    """Create a reliable publisher of images."""
    return node.create_publisher(Image, 'video_frames', QoSProfile(depth=depth))


def stamped(image: np.ndarray, encoding: str, stamp_ns: int, frame_id: str = 'camera') -> Image:
    """Create a message of an image."""
    message = CvBridge().cv2_to_imgmsg(image, encoding)
    sec, nanosec = divmod(stamp_ns, NANO)
    message.header = Header(frame_id=frame_id)
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    return message


def send(node: Node, publisher: Publisher, *messages: Image) -> None:
    """
    Publish messages as soon as somebody subscribes.

    The publisher keeps them until they are received. That is not waited for, since Fast DDS asks
    every 3 s.
    """
    spin_until(node, lambda: publisher.get_subscription_count() > 0)
    for message in messages:
        publisher.publish(message)
