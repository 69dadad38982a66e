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
"""Topics of overlays, read in the executor while a page shows them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.text import printable
from opencv_tools.image.topic_names import camera_info_topic
from opencv_tools.topics.message_reader import MessageReader
from opencv_tools.topics.qos import following_qos
from opencv_tools.topics.timers import create_steady_timer
from opencv_tools.topics.topic_discovery import image_topics
from opencv_tools.transport.message_type import message_type
from opencv_tools.viewer.errors import RequestError
from rclpy.node import Node
from rclpy.qos import QoSProfile

#: Type of the messages with the calibration of a camera.
CALIBRATION = 'sensor_msgs/msg/CameraInfo'
#: Name of a topic, and type of its messages.
OverlayKey = tuple[str, str]
#: Gets serialized messages, oldest first, in the executor.
Receive = Callable[[Sequence[NDArray[np.uint8]]], object]

# Time between two looks. Messages do not wake the executor, so that a rate of 1 kHz costs no more.
_SECONDS = 1 / 60
_CALIBRATION_SECONDS = 0.2
_DEPTH = 16  # messages between two looks
_MAX_NAMES = 200


class OverlayTopics:
    """Find topics of overlays, and read some of them; used in the executor only."""

    def __init__(self, node: Node, is_wanted: Callable[[str], bool]) -> None:
        """
        Create an object without subscriptions.

        :param is_wanted: returns whether the parameter ``topics`` allows a topic.
        """
        self._node = node
        self._is_wanted = is_wanted
        self._open: dict[OverlayKey, Callable[[], object]] = {}

    def names(self, type_name: str) -> list[str]:
        """Return the published topics of a type, in alphabetical order."""
        return [*islice(self._published(type_name), _MAX_NAMES)]

    def open(self, key: OverlayKey, receive: Receive) -> None:  # noqa: A003
        """
        Read a topic, until it is closed, or is found to have ended.

        :param key: name and type of the topic; for a calibration the name of the image topic.
        :raises RequestError: there is no such topic, or the parameter ``topics`` forbids it.
        """
        name, type_name = key
        is_calibration = type_name == CALIBRATION
        published = {*self._published(type_name)}
        if is_calibration:
            name = camera_info_topic(name, published.__contains__)
        if key in self._open and name in published:
            return
        self.close(key)
        if name not in published:
            raise RequestError(f'{printable(name)} is not a published topic of {type_name}', 404)
        depth, seconds = (1, _CALIBRATION_SECONDS) if is_calibration else (_DEPTH, _SECONDS)
        reader = MessageReader(
            self._node, message_type(type_name), name,
            following_qos(self._offers(name, type_name), depth))

        def look() -> None:
            taken: list[Any] = []
            while len(taken) < depth and (message := reader.take_serialized()) is not None:
                taken.append(message[0])
            if taken:
                receive(taken)

        timer = create_steady_timer(self._node, seconds, look)

        def close() -> None:
            self._node.destroy_timer(timer)
            reader.destroy()

        self._open[key] = close

    def close(self, key: OverlayKey) -> None:
        """Unsubscribe from a topic."""
        if key in self._open:
            self._open.pop(key)()

    def close_all(self) -> None:
        """Unsubscribe from all topics."""
        for key in tuple(self._open):
            self.close(key)

    def _published(self, type_name: str) -> Iterator[str]:
        for name in image_topics(self._node, {type_name}):
            is_wanted = type_name == CALIBRATION or self._is_wanted(name)  # it is of a camera
            if is_wanted and self._offers(name, type_name):
                yield name

    def _offers(self, name: str, type_name: str) -> list[QoSProfile]:
        """Return what the publishers of a topic offer."""
        return [info.qos_profile for info in self._node.get_publishers_info_by_topic(name)
                if info.topic_type == type_name]
