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

"""Publisher of boxes, without an installed package of their messages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import read_definition
from opencv_tools.transport.message_type import message_type
from rclpy.node import Node
from rclpy.qos import QoSProfile

DETECTIONS = 'vision_msgs/msg/Detection2DArray'
CODEC = MessageCodec(read_definition(DETECTIONS))

#: Middle, width, height and angle of a box in pixels, and its class and score.
LabelledBox = tuple[float, float, float, float, float, str, float]


def detection(box: LabelledBox) -> dict[str, Any]:
    """Return the fields of a detection with one result."""
    x, y, width, height, angle, name, score = box
    return {'results': [{'hypothesis': {'class_id': name, 'score': score}}],
            'bbox': {'center': {'position': {'x': x, 'y': y}, 'theta': angle},
                     'size_x': width, 'size_y': height}}


def serialized(boxes: Sequence[LabelledBox], stamp_ns: int = 0, frame_id: str = '') -> bytes:
    """Return the CDR of a message with boxes."""
    sec, nanosec = divmod(stamp_ns, 10**9)
    return CODEC.write({'header': {'stamp': {'sec': sec, 'nanosec': nanosec},
                                   'frame_id': frame_id},
                        'detections': [detection(box) for box in boxes]})


class Detector:
    """A publisher of boxes."""

    def __init__(self, node: Node, topic: str, qos: QoSProfile | int = 10) -> None:
        self.publisher = node.create_publisher(message_type(DETECTIONS), topic, qos)

    def publish(self, stamp_ns: int, boxes: Sequence[LabelledBox], frame_id: str = '') -> None:
        """Publish boxes."""
        self.publisher.publish(serialized(boxes, stamp_ns, frame_id))


def filled(image: np.ndarray, box: LabelledBox, color: Sequence[int]) -> None:
    """Fill the pixels of an image whose middle is in a box."""
    x, y, width, height, angle, *_ = box
    rows, columns = np.mgrid[:image.shape[0], :image.shape[1]] + 0.5
    across = (columns - x) * np.cos(angle) + (rows - y) * np.sin(angle)
    along = (rows - y) * np.cos(angle) - (columns - x) * np.sin(angle)
    image[(abs(across) <= width / 2) & (abs(along) <= height / 2)] = color
