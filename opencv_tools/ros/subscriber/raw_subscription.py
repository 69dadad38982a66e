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

"""One subscription to images, which takes messages without rclpy's copies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import time
from typing import Any

from opencv_tools.image.cdr import WireMessage
from opencv_tools.image.errors import CdrError
from opencv_tools.ros.subscriber.messages import IMAGE, MESSAGE_TYPES, read_message
from opencv_tools.ros.subscriber.topic_discovery import ImageTopic
from opencv_tools.ros.zero_copy import MessageInfo, take_image, take_serialized
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.waitable import NumberOfEntities, Waitable

# One more than Fast DDS keeps for a subscription.
_MAX_MESSAGES = 5001
# Messages that have to follow each other before the middleware reads them. It discards messages
# that it cannot read, so that their number remains unknown.
_STEADY_MESSAGES = 30

#: A message, or the error of one that cannot be read, and its metadata. The metadata are None if
#: the middleware has discarded the message.
TakenMessage = tuple[WireMessage | CdrError, MessageInfo | None]


class RawSubscription(Waitable):
    """
    A subscription that the executor waits for as a waitable, to avoid rclpy's copy.

    The subscription of rclpy executes only its events, never its callback.
    """

    def __init__(
        self, node: Node, image_topic: ImageTopic, qos: QoSProfile,
        on_message: Callable[
            [RawSubscription, WireMessage | CdrError, MessageInfo | None], None],
        on_publishers: Callable[[object], None],
    ) -> None:
        """
        Subscribe.

        :param node: node that receives, in its default callback group.
        :param image_topic: topic to subscribe to.
        :param qos: quality of service to request.
        :param on_message: called with this object and the parts of a ``TakenMessage``.
        :param on_publishers: called when publishers appear, leave or are incompatible.
        """
        super().__init__(node.default_callback_group)
        self.image_topic = image_topic
        self.qos = qos
        #: Whether no other subscription receives the same messages.
        self.is_alone = True
        self._node = node
        self._on_message = on_message
        self._on_publishers = on_publishers
        self._subscription: Subscription | None = None
        self._index = 0
        self._sender = b''
        self._number = 0
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
            self._in_sequence = 0
            self._node.add_waitable(self)

    def stop(self) -> None:
        """Pass on the received messages and unsubscribe, until ``start`` is called."""
        if self._subscription is not None:
            self.drain()
            self.destroy()

    def drain(self) -> None:
        """Pass on all messages that were received until now."""
        for message, info in self.received_messages(time.time_ns()):
            self._on_message(self, message, info)

    def received_messages(
        self, until: int, may_continue: Callable[[], bool] = lambda: True,
    ) -> Iterator[TakenMessage]:
        """
        Yield the messages that were received before a time, and at most one later message.

        :param until: nanoseconds of the system clock.
        :param may_continue: returns whether to take another message.
        """
        received_ns = 0
        for _ in range(_MAX_MESSAGES):
            if received_ns >= until or not may_continue():
                return
            taken = [] if self._subscription is None else self.take_data()
            if not taken:
                return
            for message, info in taken:
                received_ns = info.received_timestamp if info else 0
                yield message, info

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

    def take_data(self) -> list[TakenMessage]:
        if (self._in_sequence >= _STEADY_MESSAGES and self.is_alone
                and self.image_topic.type_name == IMAGE):
            return self._take_image()
        taken = take_serialized(self._handle)
        if taken is None:
            return []
        data, info = taken
        self._follow(info)
        try:
            return [(read_message(data, self.image_topic.type_name), info)]
        except CdrError as err:
            self._in_sequence = 0
            return [(err, info)]

    async def execute(self, taken_data: list[TakenMessage]) -> None:
        for message, info in taken_data:
            self._on_message(self, message, info)

    def _take_image(self) -> list[TakenMessage]:
        """Take an image and the error of those that the middleware has discarded before it."""
        image, info, unreadable = take_image(self._handle)
        taken: list[TakenMessage] = []
        if unreadable:
            self._in_sequence = 0
            taken.append((CdrError(f'the middleware cannot read the message: {unreadable}'), None))
        if image is not None:
            self._follow(info)
            taken.append((image, info))
        return taken

    def _follow(self, info: MessageInfo) -> None:
        """Count the messages of one publisher that followed each other without a gap."""
        expected = self._sender, self._number + 1
        self._sender, self._number = bytes(info.publisher), info.number
        is_next = self._number > 0 and (self._sender, self._number) == expected
        self._in_sequence = self._in_sequence + 1 if is_next else 0


class _EventsOnlyGroup(ReentrantCallbackGroup):
    """Callback group that keeps the executor from taking messages; events still run."""

    def can_execute(self, entity: object) -> bool:
        return not isinstance(entity, Subscription)
