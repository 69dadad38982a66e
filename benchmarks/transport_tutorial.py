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

"""The nodes of the tutorial, with messages as upstream's cv_bridge fills and reads them."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.units import NANO
import rclpy
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import Image
from transport_parts import Ages, Camera, Flip, FRAMES, listen, Load, RESULTS


class TutorialPublisher(Node):
    """Publishes the frames of a camera by a timer."""

    def __init__(self, load: Load) -> None:
        """Create the publisher."""
        super().__init__('image_publisher')
        self.camera = Camera(load)
        self.publisher_ = self.create_publisher(Image, FRAMES, _qos(load))
        self.timer = self.create_timer(1 / load.rate, self.timer_callback)

    def timer_callback(self) -> None:
        """Publish a frame."""
        frame = self.camera.read().image
        sec, nanosec = divmod(time.time_ns(), NANO)
        message = _to_message(frame)
        message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
        self.publisher_.publish(message)
        self.get_logger().info('Publishing video frame')


class TutorialSubscriber(Node):
    """Records the ages of frames instead of showing them."""

    def __init__(self, load: Load) -> None:
        """Subscribe."""
        super().__init__('image_subscriber')
        self.ages = Ages()
        self.subscription = self.create_subscription(
            Image, load.topic, self.listener_callback, _qos(load))

    def listener_callback(self, data: Image) -> None:
        """Convert a frame."""
        self.get_logger().info('Receiving video frame')
        stamp = data.header.stamp
        self.ages.note(_to_array(data), stamp.sec * NANO + stamp.nanosec)


class TutorialFilter(Node):
    """Receives, flips and publishes frames."""

    def __init__(self, load: Load) -> None:
        """Create the publisher and subscribe."""
        super().__init__('image_filter')
        self.flip = Flip()
        self.publisher_ = self.create_publisher(Image, RESULTS, _qos(load))
        self.subscription = self.create_subscription(
            Image, FRAMES, self.listener_callback, _qos(load))

    def listener_callback(self, data: Image) -> None:
        """Flip a frame."""
        message = _to_message(self.flip(_to_array(data)))
        message.header = data.header
        self.publisher_.publish(message)


def publish(load: Load) -> None:
    """Run the publisher."""
    _init(load)
    node = TutorialPublisher(load)
    _spin(node, node.camera.begin)
    node.camera.meter.report()


def subscribe(load: Load) -> None:
    """Run the subscriber."""
    _init(load)
    node = TutorialSubscriber(load)
    _spin(node)
    node.ages.report()


def flip(load: Load) -> None:
    """Run the node with the filter."""
    _init(load)
    node = TutorialFilter(load)
    _spin(node)
    node.flip.report()


def _init(load: Load) -> None:
    rclpy.init(args=['tutorial', *load.arguments])


def _spin(node: Node, begin: Callable[[], object] = lambda: None) -> None:
    end = Future()
    listen(begin, lambda: end.set_result(None))
    rclpy.spin_until_future_complete(node, end)


def _to_message(image: NDArray[Any]) -> Image:
    """Return a message as cv2_to_imgmsg does."""
    message = Image(height=image.shape[0], width=image.shape[1], encoding='bgr8',
                    step=image.shape[1] * 3)
    message.data.frombytes(image.tobytes())
    return message


def _to_array(message: Image) -> NDArray[Any]:
    """Return a view as imgmsg_to_cv2 does."""
    return np.ndarray((message.height, message.width, 3), np.uint8, buffer=message.data)


def _qos(load: Load) -> QoSProfile:
    """Return the tutorial's QoS profile with depth 10, reliable or best effort."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy[load.qos.upper()])
