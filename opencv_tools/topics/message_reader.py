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

"""Readers of messages without rclpy's copies, and the waitable that waits for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from typing import Any

from opencv_tools.image.cdr import IMAGE
from opencv_tools.image.errors import CdrError
from opencv_tools.topics.errors import ParameterError, ROS_ERRORS, ros_reason
from opencv_tools.topics.messages import AnyMessage, message_class, read_message
from opencv_tools.topics.topic_discovery import ImageTopic
from opencv_tools.transport import zero_copy
from opencv_tools.transport.rcl_structures import MessageInfo
from opencv_tools.transport.zero_copy import SerializedMessage, take_image, take_serialized
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.event_handler import QoSSubscriptionEventType, SubscriptionEventCallbacks
from rclpy.exceptions import InvalidHandle
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.waitable import NumberOfEntities, Waitable

# Messages that have to follow each other before the middleware reads them. It discards messages
# that it cannot read, so that their number remains unknown.
_STEADY_MESSAGES = 30
_EVENTS = (QoSSubscriptionEventType.RCL_SUBSCRIPTION_MATCHED,
           QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS)

#: A message, or the error of one that cannot be read, and its metadata. The metadata are None if
#: the middleware has discarded the message.
TakenMessage = tuple[AnyMessage | CdrError, MessageInfo | None]


class MessageReader:
    """A subscription whose messages are taken by its owner, never by the executor."""

    def __init__(self, node: Node, message_class: Any, topic: str, qos: QoSProfile) -> None:
        """
        Subscribe.

        :param topic: name of the topic before remapping.
        :param qos: quality of service to request.
        :raises ParameterError: the name of the topic or the quality of service is invalid.
        """
        self._node = node
        try:
            self._subscription = node.create_subscription(
                message_class, topic, lambda _: None, qos, raw=True,
                callback_group=_NeverExecuted(),
                event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False))
        except ROS_ERRORS as err:
            raise ParameterError(
                f'{topic!r} cannot be subscribed to: {ros_reason(err)}') from err
        self.handle = self._subscription.handle
        #: Events of publishers that appear, leave or are incompatible.
        self.events = [
            rclpy_implementation.EventHandle(self.handle, event) for event in _EVENTS]
        #: Name of the topic after remapping.
        self.topic_name = str(self._subscription.topic_name)

    def publisher_count(self) -> int:
        """Return the number of matched publishers."""
        return int(self._subscription.get_publisher_count())

    def take_serialized(self) -> SerializedMessage | None:
        """Take a message as bytes and its metadata; None without one, or after ``destroy``."""
        try:
            return take_serialized(self.handle)
        except InvalidHandle:  # destroyed by another thread
            return None

    def destroy(self) -> None:
        """Unsubscribe. An executor that waits for messages keeps the handles meanwhile."""
        for event in self.events:
            event.destroy_when_not_in_use()
        self._node.destroy_subscription(self._subscription)


class ImageReader(MessageReader):
    """Reader of raw or compressed images, or of video."""

    def __init__(self, node: Node, image_topic: ImageTopic, qos: QoSProfile) -> None:
        """
        Subscribe.

        :param image_topic: topic to subscribe to.
        :param qos: quality of service to request.
        :raises ParameterError: the name of the topic or the quality of service is invalid.
        """
        super().__init__(node, message_class(image_topic.type_name), image_topic.name, qos)
        self.image_topic = image_topic
        #: Whether no other reader receives the same messages.
        self.is_alone = True
        self._sender = b''
        self._number = self._in_sequence = 0

    @property
    def has_numbers(self) -> bool:
        """Whether the messages have the numbers that their publishers gave."""
        return not zero_copy.reason_for_rclpy

    def take(self) -> list[TakenMessage]:
        """
        Take a message.

        :returns: the message, with the error of those that were discarded before it; empty if
            there is none.
        """
        if (self._in_sequence >= _STEADY_MESSAGES and self.is_alone
                and self.image_topic.type_name == IMAGE):
            return self._take_image()
        taken = self.take_serialized()
        if taken is None:
            return []
        data, info = taken
        self._follow(info)
        try:
            return [(read_message(data, self.image_topic.type_name), info)]
        except CdrError as err:
            self._in_sequence = 0
            return [(err, info)]

    def _take_image(self) -> list[TakenMessage]:
        """Take an image and the error of those that the middleware has discarded before it."""
        image, info, unreadable = take_image(self.handle)
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


class WakeUps(Waitable):
    """
    All that wakes the executor for a subscription: messages, events, and other threads.

    It is one waitable, because rclpy does not guard several ones that are destroyed in one thread
    while another thread waits for them.
    """

    def __init__(
        self, node: Node, on_wake: Callable[[Sequence[MessageReader], bool], None],
        is_pending: Callable[[], bool],
    ) -> None:
        """
        Create a waitable that the executor does not have before ``start``.

        :param node: node whose executor waits. The callback group is a new one, because several
            threads would otherwise starve the other callbacks of the node.
        :param on_wake: called with the readers that have messages, and whether publishers have
            changed.
        :param is_pending: returns whether ``on_wake`` is to be called without any new message.
        """
        super().__init__(MutuallyExclusiveCallbackGroup())
        #: Readers whose messages and events are waited for.
        self.readers: tuple[MessageReader, ...] = ()
        self._node = node
        self._on_wake = on_wake
        self._is_pending = is_pending
        self._guard = GuardCondition(None, None, context=node.context)
        self._in_use = ExitStack()
        self._is_woken = False
        self._is_in_use = False  # in the wait set, with these readers
        self._waited: list[MessageReader] = []
        self._ready: list[MessageReader] = []
        self._ready_events: list[Any] = []

    def start(self) -> None:
        """Have the executor wait, for other threads only until ``readers`` is set."""
        self._node.add_waitable(self)

    def wake(self) -> None:
        """Have ``on_wake`` called; thread-safe."""
        self._is_woken = True
        with suppress(InvalidHandle):
            self._guard.trigger()

    def destroy(self) -> None:
        """Stop waiting; may be called again."""
        with suppress(ValueError):
            self._node.remove_waitable(self)
        self._guard.destroy()

    # Methods of Waitable that the executor calls

    def __enter__(self) -> None:
        self._waited = []
        with ExitStack() as stack:
            stack.enter_context(self._guard.handle)
            for reader in self.readers:
                with suppress(InvalidHandle):  # destroyed by another thread
                    stack.enter_context(reader.handle)
                    for event in reader.events:
                        stack.enter_context(event)
                    self._waited.append(reader)
            self._in_use = stack.pop_all()
            self._is_in_use = True

    def __exit__(self, *error: object) -> None:
        self._is_in_use = False
        self._in_use.close()

    def get_num_entities(self) -> NumberOfEntities:
        return NumberOfEntities(
            num_subs=len(self._waited), num_gcs=1,
            num_events=sum(len(reader.events) for reader in self._waited))

    def add_to_wait_set(self, wait_set: Any) -> None:
        if not self._is_in_use:  # destroyed by another thread
            return
        # An executor may not serve what it was woken for, so the guard is triggered again.
        if self._is_woken or self._is_pending():
            self.wake()
        self._guard_index = wait_set.add_guard_condition(self._guard.handle)
        self._indices = [
            (wait_set.add_subscription(reader.handle),
             [(wait_set.add_event(event), event) for event in reader.events])
            for reader in self._waited]

    def is_ready(self, wait_set: Any) -> bool:
        if not self._is_in_use:
            return False
        self._ready = [
            reader for reader, (index, _) in zip(self._waited, self._indices)
            if wait_set.is_ready('subscription', index)]
        self._ready_events = [
            event for _, events in self._indices for index, event in events
            if wait_set.is_ready('event', index)]
        return bool(self._ready or self._ready_events
                    or wait_set.is_ready('guard_condition', self._guard_index))

    def take_data(self) -> tuple[list[MessageReader], bool]:
        self._is_woken = False
        for event in self._ready_events:
            with suppress(InvalidHandle), event:
                event.take_event()
        return self._ready, bool(self._ready_events)

    async def execute(self, taken_data: tuple[list[MessageReader], bool]) -> None:
        self._on_wake(*taken_data)


class _NeverExecuted(ReentrantCallbackGroup):
    """Callback group of a subscription whose messages the executor must not take."""

    def can_execute(self, _entity: object) -> bool:
        return False
