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

"""A topic of compressed images or depth, which exists while frames have such a form."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
import time
from typing import Any

from opencv_tools.base.logs import Log
from opencv_tools.image.cdr import (
    compressed_image_to_cdr, WireCompressedImage, WireHeader)
from opencv_tools.image.errors import ImageError
from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.qos import create_frame_publisher, FRAME_DEPTH
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CompressedImage

# Frames without a compressed form, one after the other, that end the topic. A publisher that
# mixes both kinds of frames keeps it.
_MAX_WITHOUT = 10
_LOGGED_SECONDS = 10.0
_MATCH_SECONDS = 1.0  # for subscribers that have waited for the publisher
_POLL_SECONDS = 0.005
_COUNT_SECONDS = 0.1  # from one count of subscribers without a publisher to the next


class CompressedTopic:
    """
    Publish compressed images while frames have a compressed form; thread-safe.

    Other nodes prefer compressed images where they are published. The publisher is removed when
    frames have no compressed form, and created again for the next frame that has one.
    """

    def __init__(
        self, node: Node, images: str, suffix: str = 'compressed', *, is_expected: bool = True,
    ) -> None:
        """
        Create the publisher, if frames of this form are expected.

        :param images: name of the topic of raw images after remapping.
        :param suffix: last part of the name of the topic.
        :raises ParameterError: the ``qos_overrides`` parameters of the topic cannot be used.
        """
        self._node = node
        self._images = images
        self._given_name = f'{images}/{suffix}'
        self._log = Log(node.get_logger())
        self._lock = Lock()
        self._without = _MAX_WITHOUT - 1  # the first frame decides alone
        self._publisher: Publisher | None = None
        self._waiting, self._next_count = 0, 0.0  # subscribers without a publisher
        #: Number of images that were published.
        self.sent = 0
        #: Name of the topic after remapping.
        self.topic_name = node.resolve_topic_name(self._given_name)
        #: Quality of service of the publisher.
        self.qos_profile = QoSProfile(depth=FRAME_DEPTH)
        if is_expected:
            self._create()

    def count_subscribers(self) -> int:
        """Return the number of subscribers, also while there is no publisher."""
        with self._lock:
            return self._count()

    def is_due(self, why_not: str) -> bool:
        """
        Return whether a frame is to be compressed, and adapt the publisher to the frame.

        :param why_not: reason why the frame has no compressed form; '' if it has one.
        """
        with self._lock:
            if not why_not:
                self._without = 0
                try:
                    if self._publisher is None:
                        self._create()
                        self._wait_for_match()
                except ParameterError as err:
                    self._log.error(str(err), once=str(err))
                return self._publisher is not None and self._count() > 0
            self._without += 1
            if self._count():
                self._log.warning(
                    f'{self.topic_name} has no frames: {why_not}; receive {self._images}, with '
                    'transport:=raw or transport:=auto', once=why_not)
            if (self._publisher and self._without >= _MAX_WITHOUT
                    and self._publisher.wait_for_all_acked(Duration())):
                self._remove()
            return False

    def publish(
        self, make: Callable[[], tuple[Any, str]], header: WireHeader, loss: str,
    ) -> bool:
        """
        Publish an image. An error of the codec is logged.

        :param loss: what the image loses in its compressed form, logged once; '' for nothing.
        :param make: returns the compressed bytes and their format string.
        :returns: whether it was published.
        """
        try:
            data, format_text = make()
        except ImageError as err:
            self._log.error(f'no image on {self.topic_name}: {err}', every=_LOGGED_SECONDS,
                            key='compressed')
            return False
        if loss:
            self._log.warning(f'{self.topic_name}: {loss}', once=loss)
        message = compressed_image_to_cdr(WireCompressedImage(
            header=header, format=format_text, data=memoryview(data)))
        with self._lock:
            if self._publisher:  # another thread may publish other frames
                self._publisher.publish(message)
                self.sent += 1
            return self._publisher is not None

    def wait_for_all_acked(self, timeout: Duration) -> bool:
        """Return whether reliable subscribers have confirmed all images, as a publisher does."""
        with self._lock:
            return self._publisher is None or bool(self._publisher.wait_for_all_acked(timeout))

    def destroy(self) -> None:
        """Remove the publisher."""
        with self._lock:
            self._remove()

    def _create(self) -> None:
        self._publisher = create_frame_publisher(self._node, CompressedImage, self._given_name)
        self.qos_profile = self._publisher.qos_profile

    def _wait_for_match(self) -> None:
        """Wait until the publisher has a subscriber of those that have waited for it."""
        end = time.monotonic() + _MATCH_SECONDS
        while (self._node.count_subscribers(self.topic_name) and not self._count()
               and time.monotonic() < end):
            time.sleep(_POLL_SECONDS)

    def _count(self) -> int:
        if self._publisher:
            return int(self._publisher.get_subscription_count())
        now = time.monotonic()
        if now >= self._next_count:  # the graph takes as long as the rest of a frame
            self._waiting, self._next_count = (
                self._node.count_subscribers(self.topic_name), now + _COUNT_SECONDS)
        return self._waiting

    def _remove(self) -> None:
        if self._publisher:
            self._node.destroy_publisher(self._publisher)
        self._publisher = None
