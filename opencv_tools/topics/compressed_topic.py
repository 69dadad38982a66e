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

"""The topic on which frames are published as compressed images."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
import time
from typing import Any

from opencv_tools.image.errors import FormError
from opencv_tools.logs import Log
from opencv_tools.topics.qos import create_frame_publisher
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import CompressedImage

# Without a frame that has no compressed form, until the topic is advertised again.
_RETURN_SECONDS = 5.0
_LOGGED_SECONDS = 10.0


class CompressedTopic:
    """
    Publish compressed images; thread-safe.

    A frame without a compressed form ends the topic, so that nobody waits for it. It returns with
    the first other frame after 5 s without such a frame.
    """

    def __init__(self, node: Node, name: str, forget: Callable[[Publisher], object]) -> None:
        """
        Create the publisher.

        :param name: name of the topic of raw images after remapping.
        :param forget: called before the publisher is removed for a frame without this form.
        :raises ParameterError: the ``qos_overrides`` parameters of the topic cannot be used.
        """
        self._node = node
        self._raw_name, self._name = name, f'{name}/compressed'
        self._forget = forget
        self._log = Log(node.get_logger())
        self._lock = Lock()
        self._without_form_at = 0.0
        #: Publisher of the topic; None while the frames have no such form.
        self.publisher: Publisher | None = None
        self._advertise()

    def count_subscribers(self) -> int:
        """Return the number of subscribers."""
        with self._lock:
            return self.publisher.get_subscription_count() if self.publisher else 0

    def publish(self, reason: str, make: Callable[[], Any]) -> Publisher | None:
        """
        Publish a compressed image, if somebody receives it.

        :param reason: why the frame has no compressed form; '' if it has one.
        :param make: creates the message, or its CDR. A `FormError` is logged.
        :returns: the publisher that has published it; None if none has.
        """
        if reason:
            self._withdraw(reason)
            return None
        if not self.publisher and time.monotonic() > self._without_form_at + _RETURN_SECONDS:
            self._advertise()
        if not self.count_subscribers():
            return None
        try:
            message = make()
        except FormError as err:
            self._log.warning(f'no frame on {self._name}: {err}', every=_LOGGED_SECONDS, key='')
            return None
        with self._lock:
            if self.publisher:
                self.publisher.publish(message)
            return self.publisher

    def destroy(self) -> None:
        """Remove the publisher."""
        with self._lock:
            publisher, self.publisher = self.publisher, None
        if publisher:
            self._node.destroy_publisher(publisher)

    def _advertise(self) -> None:
        with self._lock:
            self.publisher = self.publisher or create_frame_publisher(
                self._node, CompressedImage, self._name)

    def _withdraw(self, reason: str) -> None:
        self._without_form_at = time.monotonic()
        if self.publisher:
            sentence = f'{self._name} is not published: {reason}; receive {self._raw_name}'
            if self.count_subscribers():
                self._log.warning(sentence, once=reason)
            else:
                self._log.info(sentence, once=reason)
            self._forget(self.publisher)
            self.destroy()
