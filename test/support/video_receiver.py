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

"""A subscriber that keeps the messages of a video topic as they are."""

from __future__ import annotations

from opencv_tools.transport.message_type import message_type
from opencv_tools.video.messages import cdr_to_video, VIDEO_TOPICS, WireVideo
from rclpy.node import Node


class Receiver:
    """Keep the messages of a video topic as they are."""

    def __init__(self, node: Node, type_name: str, topic: str = 'video') -> None:
        self.messages: list[WireVideo] = []
        node.create_subscription(
            message_type(type_name), f'{topic}/{VIDEO_TOPICS[type_name]}',
            lambda data: self.messages.append(cdr_to_video(type_name, data)), 100, raw=True)
