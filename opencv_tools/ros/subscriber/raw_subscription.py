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

"""One subscription to images, which takes serialized messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.ros.subscriber.messages import MESSAGE_TYPES
from opencv_tools.ros.subscriber.topic_discovery import ImageTopic
from opencv_tools.ros.zero_copy import MessageInfo, SerializedMessage, take_serialized
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.waitable import NumberOfEntities, Waitable

# One more than Fast DDS keeps for a subscription.
_MAX_MESSAGES = 5001


class RawSubscription(Waitable):
    """
    A subscription that the executor waits for as a waitable, to avoid rclpy's copy.

    The subscription of rclpy executes only its events, never its callback.
    """

    def __init__(
        self, node: Node, image_topic: ImageTopic, qos: QoSProfile,
        on_message: Callable[[RawSubscription, NDArray[np.uint8], MessageInfo], None],
        on_publishers: Callable[[object], None],
    ) -> None:
        """
        Subscribe.

        :param node: node that receives, in its default callback group.
        :param image_topic: topic to subscribe to.
        :param qos: quality of service to request.
        :param on_message: called with this object, the bytes of a message, (n,) uint8, and its
            metadata.
        :param on_publishers: called when publishers appear, leave or are incompatible.
        """
        super().__init__(node.default_callback_group)
        self.image_topic = image_topic
        self.qos = qos
        self._node = node
        self._on_message = on_message
        self._on_publishers = on_publishers
        self._subscription: Subscription | None = None
        self._index = 0
        self.start()
        self.topic_name = node.resolve_topic_name(image_topic.name)

    @property
    def is_stopped(self) -> bool:
        """Whether ``stop`` was called."""
        return self._subscription is None

    def publisher_count(self) -> int:
        """Return the number of matched publishers."""
        return self._subscription.get_publisher_count() if self._subscription else 0

    def start(self) -> None:
        """Subscribe, unless this was done."""
        if self._subscription is None:
            message_class, _ = MESSAGE_TYPES[self.image_topic.type_name]
            self._subscription = self._node.create_subscription(
                message_class, self.image_topic.name, lambda _: None, self.qos, raw=True,
                callback_group=_EventsOnlyGroup(),
                event_callbacks=SubscriptionEventCallbacks(
                    incompatible_qos=self._on_publishers, matched=self._on_publishers,
                    use_default_callbacks=False))
            self._handle = self._subscription.handle
            self._node.add_waitable(self)

    def stop(self) -> None:
        """Pass on the received messages and unsubscribe, until ``start`` is called."""
        if self._subscription is not None:
            self.drain()
            self.destroy()

    def drain(self) -> None:
        """Pass on all messages that were received until now."""
        for data, info in self.received_messages(time.time_ns()):
            self._on_message(self, data, info)

    def received_messages(
        self, until: int, may_continue: Callable[[], bool] = lambda: True,
    ) -> Iterator[SerializedMessage]:
        """
        Yield the messages that were received before a time, and at most one later message.

        :param until: nanoseconds of the system clock.
        :param may_continue: returns whether to take another message.
        """
        received_ns = 0
        for _ in range(_MAX_MESSAGES):
            if received_ns >= until or not may_continue():
                return
            taken = None if self._subscription is None else self.take_data()
            if taken is None:
                return
            received_ns = taken[1].received_timestamp
            yield taken

    def destroy(self) -> None:
        """Unsubscribe."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._node.remove_waitable(self)
            self._subscription = None

    # Methods of Waitable that the executor calls

    def __enter__(self) -> None:
        self._handle.__enter__()

    def __exit__(self, *error: object) -> None:
        self._handle.__exit__(*error)

    def get_num_entities(self) -> NumberOfEntities:
        return NumberOfEntities(num_subs=1)

    def add_to_wait_set(self, wait_set: Any) -> None:
        self._index = wait_set.add_subscription(self._handle)

    def is_ready(self, wait_set: Any) -> bool:
        return bool(wait_set.is_ready('subscription', self._index))

    def take_data(self) -> SerializedMessage | None:
        return take_serialized(self._handle)

    async def execute(self, taken_data: SerializedMessage | None) -> None:
        if taken_data is not None:
            self._on_message(self, *taken_data)


class _EventsOnlyGroup(ReentrantCallbackGroup):
    """Callback group that keeps the executor from taking messages; events still run."""

    def can_execute(self, entity: object) -> bool:
        return not isinstance(entity, Subscription)
