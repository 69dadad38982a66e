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

"""Subscription that adapts to the publishers of a topic, and reports why no frames arrive."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import time

from opencv_tools.image.cdr import WireMessage
from opencv_tools.image.errors import CdrError
from opencv_tools.logs import Log
from opencv_tools.ros.qos import describe_qos, following_qos, qos_mismatch
from opencv_tools.ros.shared_frames.publisher import can_share, NOT_SHARED
from opencv_tools.ros.shared_frames.reader import MAX_VIEWS
from opencv_tools.ros.subscriber.lost_frames import LostFrames
from opencv_tools.ros.subscriber.messages import IMAGE
from opencv_tools.ros.subscriber.no_frames_warning import NoFramesWarning
from opencv_tools.ros.subscriber.raw_subscription import RawSubscription
from opencv_tools.ros.subscriber.shared_frames import SharedFrameSubscriber
from opencv_tools.ros.subscriber.topic_discovery import ImageTopic, TopicDiscovery
from opencv_tools.ros.timers import create_steady_timer
from opencv_tools.ros.zero_copy import MessageInfo
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

# The executor has events only for publishers of the same type. The graph is polled for all others.
# Each poll wakes the executor, which is its cost.
_GRAPH_POLL_SECONDS = 0.5
# Without a subscription to the image topic there are no events for its publishers.
_SHARED_POLL_SECONDS = 0.1
# Time in which every publisher discovers a new subscription, also over a slow network.
_OVERLAP_SECONDS = 1.0
# Maximum number of messages that Fast DDS keeps for a subscription.
_MAX_IDS = 5000


class FrameSubscription:
    """
    Receive the frames of a topic with the quality of service that its publishers offer.

    The first subscription is reliable and volatile, like most image publishers. The node
    subscribes again when a publisher offers less, and when all publishers are new and offer more.
    A publisher that leaves changes nothing. The old subscription overlaps with the new one for a
    second. Messages that both receive are passed on once, so that no frame is lost or doubled.

    With the transport ``auto`` raw images are preferred to compressed ones. After the first frame
    the topic changes only when its last publisher has left. Compressed images are on
    ``<topic>/compressed``, or on the topic itself.

    All callbacks run in the executor, one at a time, in the node's default callback group.
    """

    def __init__(
        self, node: Node, topic: str, transport: str, depth: int | None, log: Log,
        on_frame: Callable[[WireMessage, int], None], on_broken: Callable[[CdrError], None], *,
        in_thread: bool = False, max_views: int = MAX_VIEWS,
    ) -> None:
        """
        Subscribe.

        :param node: node that receives the frames.
        :param topic: name of the image topic before remapping.
        :param transport: one of ``TRANSPORTS``.
        :param depth: number of newest frames that the middleware keeps; None to keep every frame,
            up to the limit of the middleware.
        :param log: log for the subscribed topic, and for the reason when no frames arrive.
        :param on_frame: called with a message and its time of reception in nanoseconds of the
            system clock.
        :param on_broken: called with the error of a message that cannot be read.
        :param in_thread: whether frames in shared memory are passed on in another thread; one
            thread at a time calls the callbacks.
        :param max_views: number of frames that may stay in the shared memory; more are copied.
        """
        self._node = node
        self._log = log
        self._depth = depth
        self._on_frame = on_frame
        self._on_broken = on_broken
        self._discovery = TopicDiscovery(node, topic, transport)
        self._no_frames_warning = NoFramesWarning(log, self.explain_no_frames)
        self._candidate: ImageTopic | None = None
        self._has_frames = False  # since the first publisher appeared
        #: Counter of messages that were published but did not arrive.
        self.losses = LostFrames()
        #: Metadata of the message during the call of ``on_frame``; None if unknown.
        self.message_info: MessageInfo | None = None
        self._publishers: frozenset[bytes] = frozenset()
        self._recent_ids: set[tuple[int, int]] = set()
        self._older_ids: set[tuple[int, int]] = set()
        self._previous: RawSubscription | None = None
        self._retire_at = 0.0
        self._has_image_topic = transport != 'shm'
        self._shared: SharedFrameSubscriber | None = None
        image_topic = self._discovery.best() or self._discovery.allowed[0]
        self._subscription = self._subscribe(
            image_topic, self._best_qos(self._discovery.publishers(image_topic)))
        self._polled_at = time.monotonic()
        self._timer = create_steady_timer(node, _GRAPH_POLL_SECONDS, self._poll_graph)
        if transport in ('auto', 'shm') and can_share():
            self._shared = SharedFrameSubscriber(
                node, topic, depth=depth, in_thread=in_thread, max_views=max_views, log=log,
                losses=self.losses, on_frame=self._pass_on, on_broken=on_broken,
                on_change=self._update_sharing, receive_messages=self._drain)
        if not self._has_image_topic:
            self._subscription.stop()

    @property
    def topic_name(self) -> str:
        """Name of the subscribed topic after remapping."""
        return self._subscription.topic_name

    @property
    def is_latched(self) -> bool:
        """Whether the publishers keep their last messages for later subscriptions."""
        return bool(self._subscription.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)

    def explain_no_frames(self) -> str:
        """Return the reason why no frame arrives, with a remedy, as a sentence."""
        if not self._has_image_topic:
            if self._shared is None:
                return NOT_SHARED
            reason = self._shared.explain(self._publishers)
            if reason:
                return (f'{self.topic_name} has a publisher that does not share its frames with '
                        f'this process: {reason}; set transport:=auto')
        return self._discovery.explain_no_frames(
            self._subscription.image_topic, self._subscription.qos)

    def close(self, may_continue: Callable[[], bool]) -> int:
        """
        Pass on the messages that were received until now, and unsubscribe.

        :param may_continue: returns whether to pass on another message; may wait before.
        :returns: number of messages that were not passed on, due to ``may_continue`` or Ctrl-C.
        """
        now = time.time_ns()
        unprocessed = 0
        is_interrupted = False

        def continues() -> bool:
            nonlocal is_interrupted
            is_interrupted = is_interrupted or not may_continue()
            return not is_interrupted

        try:
            for subscription in self._subscriptions():
                for message, info in subscription.received_messages(now, continues):
                    unprocessed = 1
                    self._receive(subscription, message, info)
                    unprocessed = 0
        except KeyboardInterrupt:
            is_interrupted = True
        for subscription in self._subscriptions() if is_interrupted else ():
            for _, info in subscription.received_messages(now):
                if info is None or not self._is_repeated(info):
                    self._count(info)
                    unprocessed += 1
        if self._shared:
            unprocessed += self._shared.close(continues)
        self.destroy()
        return unprocessed

    def destroy(self) -> None:
        """Unsubscribe."""
        self._node.destroy_timer(self._timer)
        for subscription in self._subscriptions():
            subscription.destroy()
        self._previous = None
        if self._shared:
            self._shared.destroy()
            self._shared = None

    def _subscriptions(self) -> list[RawSubscription]:
        """Return the subscriptions, oldest first."""
        return [self._previous, self._subscription] if self._previous else [self._subscription]

    # Publishers and their quality of service

    def _best_qos(self, offers: Iterable[TopicEndpointInfo]) -> QoSProfile:
        return following_qos([info.qos_profile for info in offers], self._depth)

    def _poll_graph(self) -> None:
        """Adapt to the publishers, and warn if no frames arrive."""
        now = time.monotonic()
        # If the executor was busy, received frames may not have been processed yet.
        elapsed = min(now - self._polled_at, 2 * _GRAPH_POLL_SECONDS)
        self._polled_at = now
        if self._previous and now >= self._retire_at:
            self._retire_previous()
        self._choose_topic()
        self._adapt_qos()
        # A latched topic may have published its only image already.
        self._no_frames_warning.check(
            elapsed, self.is_latched and self._has_frames and bool(self._publishers))

    def _choose_topic(self) -> None:
        """Change the topic if it has no publisher, or no frames yet and another one is better."""
        current = self._subscription.image_topic
        if len(self._discovery.allowed) == 1 or (
                self._has_frames and self._discovery.publishers(current)):
            return
        self._has_frames = False
        best = self._discovery.best() or current
        # The topics of a camera do not appear at the same time; a better one may follow.
        if best not in (current, self._candidate):
            self._candidate = best
            return
        self._candidate = None
        if best != current:
            self._subscribe_again(best, self._best_qos(self._discovery.publishers(best)))
            self._no_frames_warning.reset_period()
            self.losses.restart()

    def _adapt_qos(self, _event: object = None) -> None:
        """Subscribe again if the profiles are incompatible, or new publishers offer more."""
        subscription = self._subscription
        offers = self._discovery.publishers(subscription.image_topic)
        qos = self._best_qos(offers)
        are_new = not self._publishers & _identify(offers)
        self._update_publishers(offers)
        if offers and qos != subscription.qos and (are_new or any(
                qos_mismatch(info.qos_profile, subscription.qos) for info in offers)):
            if subscription.is_stopped:
                subscription.qos = qos
            else:
                self._subscribe_again(subscription.image_topic, qos)
        self._update_sharing()

    def _update_sharing(self) -> None:
        """Unsubscribe from the image topic while all its publishers share their frames."""
        if self._shared is None:
            return
        is_raw = self._subscription.image_topic.type_name == IMAGE
        are_shared = self._shared.update(self._publishers if is_raw else frozenset())
        if are_shared or not self._has_image_topic:
            self._retire_previous()
            self._subscription.stop()
        else:
            self._subscription.start()
        seconds = _SHARED_POLL_SECONDS if self._subscription.is_stopped else _GRAPH_POLL_SECONDS
        if self._timer.timer_period_ns != int(seconds * 1e9):
            self._timer.timer_period_ns = int(seconds * 1e9)

    def _update_publishers(self, offers: Iterable[TopicEndpointInfo]) -> None:
        """Reset the wait for a frame if the publishers have changed."""
        publishers = _identify(offers)
        if publishers != self._publishers:
            self._publishers = publishers
            self.losses.discover(publishers)
            self._no_frames_warning.reset()

    # Subscriptions

    def _subscribe(self, image_topic: ImageTopic, qos: QoSProfile) -> RawSubscription:
        return RawSubscription(self._node, image_topic, qos, self._receive, self._adapt_qos)

    def _subscribe_again(self, image_topic: ImageTopic, qos: QoSProfile) -> None:
        old = self._subscription
        self._retire_previous()
        self._previous, self._retire_at = old, time.monotonic() + _OVERLAP_SECONDS
        if image_topic != old.image_topic or not old.publisher_count():
            # The old publishers are gone, or the type differs: a process has one type per topic.
            self._retire_previous()
        self._subscription = self._subscribe(image_topic, qos)
        for subscription in self._subscriptions():
            subscription.is_alone = self._previous is None
        self._log.info(
            f'Receiving {self.topic_name} ({image_topic.type_name}, {describe_qos(qos)}), '
            'as its publishers offer')

    def _retire_previous(self) -> None:
        """Pass on the received messages of the old subscription, then remove it."""
        if self._previous:
            self._previous.drain()
            self._previous.destroy()
            self._previous = None
            self._subscription.is_alone = True

    def _drain(self) -> None:
        """Pass on the messages that were received until now."""
        for subscription in self._subscriptions():
            subscription.drain()

    def _receive(
        self, subscription: RawSubscription, message: WireMessage | CdrError,
        info: MessageInfo | None,
    ) -> None:
        """Pass a message on, unless the other subscription already has."""
        if self._previous and subscription is not self._previous:
            self._previous.drain()  # keep the order of reception
        if info is None:
            self._read(message, None)
        elif self._is_repeated(info):
            return
        elif self._shared:
            self._shared.receive(info, lambda: self._read(message, info))
        else:
            self._read(message, info)

    def _read(self, message: WireMessage | CdrError, info: MessageInfo | None) -> None:
        """Count a message and pass it on."""
        self._count(info)
        if isinstance(message, CdrError):
            self._has_frames = True
            self._on_broken(message)
            self._no_frames_warning.frame_received(self.topic_name)
        else:
            received_ns = info.received_timestamp if info else 0
            self.message_info = info
            self._pass_on(message, received_ns or time.time_ns())
            self.message_info = None

    def _pass_on(self, message: WireMessage, receive_ns: int) -> None:
        self._has_frames = True
        self._on_frame(message, receive_ns)
        self._no_frames_warning.frame_received(self.topic_name)

    def _count(self, info: MessageInfo | None) -> None:
        """Count the messages that were lost before a message."""
        if info is None:
            self.losses.add_unnumbered()
        else:
            self.losses.add(info)

    def _is_repeated(self, info: MessageInfo) -> bool:
        """Return whether a message was passed on already, and remember it."""
        identity = info.source_timestamp, info.number
        if identity in self._recent_ids or identity in self._older_ids:
            return identity[0] > 0  # a message without a time cannot be identified
        self._recent_ids.add(identity)
        if len(self._recent_ids) == _MAX_IDS:
            self._older_ids, self._recent_ids = self._recent_ids, set()
        return False


def _identify(offers: Iterable[TopicEndpointInfo]) -> frozenset[bytes]:
    return frozenset(bytes(info.endpoint_gid) for info in offers)
